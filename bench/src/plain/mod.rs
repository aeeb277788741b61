//! The model as the paper writes it: padded, with nothing left out and nothing joined. The baseline of the update benchmark,
//! and what the packed form is tested against.
//!
//! | | packed (`cross_model`) | plain (here) |
//! |---|---|---|
//! | phases | real ones only | all padded to the most allowed, masked |
//! | `h_p` of the form `paper` | once per agent | at every step |
//! | attention over one token | values alone | queries, keys, softmax, values |
//! | attention over lanes | in the lanes' few features | keys and values of full width per lane |
//! | first layer of clustering | three projections, added | one, of the concatenation, for every phase |
//! | prediction | the chosen phase | every phase, then the chosen one is gathered |
//! | experts | the chosen ones | all, then weighted |
//!
//! Both compute the same numbers from the same weights. What is not the network is shared, and so is not part of the
//! comparison: features, values and advantages before the epochs, the order of minibatches, Adam.

mod learner;
mod losses;
mod net;
mod padded;

pub use learner::PlainLearner;
pub use losses::{actor, critic};
pub use net::{PlainForward, PlainNet};
pub use padded::{PaddedInputs, PaddedMinibatch};
