//! What `cross baselines` does: the rules on the scenarios of the paper, beside the paper's figures and a measurement that an
//! independent implementation made.
//!
//! ```text
//!   plan: scenarios, rules, seeds ── store: what is there already ── run: the rest, the longest first ──> store
//!   store ── report: means over seeds, agreement ── page: Markdown
//! ```

pub(crate) mod agreement;
pub(crate) mod page;
pub(crate) mod plan;
pub(crate) mod progress;
pub(crate) mod reference;
pub(crate) mod report;
pub(crate) mod run;
pub(crate) mod store;
