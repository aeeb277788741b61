//! What `cross baselines` and `cross results` do: policies on the scenarios of the paper, beside the paper's figures, and the
//! rules also beside a measurement that an independent implementation made.
//!
//! ```text
//!   plan: scenarios, rules, seeds ── store: what is there already ── run: the rest, the longest first ──> store
//!   store ── report: means over seeds, agreement ─┬─ page: docs/baselines.md
//!                                                 ├─ results: docs/results.md
//!                                                 └─ pictures: docs/images/results
//! ```

pub(crate) mod agreement;
mod markdown;
pub(crate) mod page;
pub(crate) mod pictures;
pub(crate) mod plan;
pub(crate) mod progress;
pub(crate) mod reference;
pub(crate) mod report;
pub(crate) mod results;
pub(crate) mod run;
pub(crate) mod store;
