//! Traffic-signal control on SUMO: scenarios, signals, observation, reward, metrics and rule-based controllers.

pub mod env;
pub mod lanes;
pub mod layout;
pub mod trajectory;
