//! The plan: which fault hits whom, when and for how long, all of it drawn from one seed.

use super::inject::Kind;
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::time::Duration;

/// One fault of the plan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fault {
    /// What.
    pub kind: Kind,
    /// Whom, where it is one of the actors.
    pub actor: usize,
    /// Time before it, so that it comes at a random moment.
    pub wait: Duration,
    /// How long it lasts, as a share of the longest for its kind.
    pub share: f64,
    /// For whatever else there is to choose.
    pub draw: u64,
}

/// So many faults, none longer than this share of the longest of its kind. Every kind comes once before any comes again, in an
/// order drawn anew each time.
#[must_use]
pub fn plan(seed: u64, faults: usize, actors: usize, longest: f64) -> Vec<Fault> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut plan = Vec::with_capacity(faults);
    while plan.len() < faults {
        let mut kinds = Kind::ALL;
        kinds.shuffle(&mut rng);
        for kind in kinds.into_iter().take(faults - plan.len()) {
            plan.push(Fault {
                kind,
                actor: rng.random_range(0..actors),
                wait: Duration::from_millis(rng.random_range(0..1500)),
                share: longest * rng.random_range(0.0..1.0),
                draw: rng.random(),
            });
        }
    }
    plan
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plan_depends_on_its_seed_and_leaves_no_kind_out() {
        let kinds = Kind::ALL.len();
        assert_eq!(plan(1, 3 * kinds, 4, 1.0), plan(1, 3 * kinds, 4, 1.0));
        assert_ne!(plan(1, 3 * kinds, 4, 1.0), plan(2, 3 * kinds, 4, 1.0));
        let plan = plan(1, kinds, 4, 1.0);
        for kind in Kind::ALL {
            assert_eq!(plan.iter().filter(|fault| fault.kind == kind).count(), 1, "{kind:?}");
        }
    }
}
