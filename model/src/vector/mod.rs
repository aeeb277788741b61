//! Plain loops that the compiler turns into vector instructions, and linear layers made of them.
//!
//! Acting uses them for everything ([`inference`](crate::inference)); training for the parts of a pass of which libtorch would
//! make many small operations ([`net`](crate::net)).

mod dense;
mod isa;
pub(crate) mod math;
mod matrix;

pub(crate) use dense::{Dense, Mlp};
pub(crate) use isa::{Isa, Work};
pub(crate) use matrix::Matrix;
