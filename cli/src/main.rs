//! The command `cross`.
fn main() {}
