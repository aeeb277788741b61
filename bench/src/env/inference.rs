//! A decision of the policy for all intersections of grid5x5, beside libtorch's forward pass.

use super::snapshot;
use crate::error::BenchError;
use crate::progress::Progress;
use crate::report::{Better, Row, median, quantile};
use crate::update::data;
use cross_config::{Config, Gfe};
use cross_model::{ActMode, PlainPolicy, Policy};
use cross_sim::layout::NetworkLayout;
use cross_sim::trajectory::Observation;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::time::Instant;

/// Decisions that are not counted, and those that are.
const WARM_UP: usize = 100;
const DECISIONS: usize = 1000;
/// Steps of a fragment, after which the recurrent state is read.
const FRAGMENT: usize = 60;
const BASELINE: &str = "libtorch's forward pass";

/// Measures a decision: observation to features, actor network, recurrent state of the critic, sampling; warm, one thread.
/// `weights` are used as they are, if they are given.
pub(super) fn run(
    weights: Option<&[u8]>,
    progress: Progress<'_>,
    rows: &mut Vec<Row>,
) -> Result<(), BenchError> {
    cross_model::set_single_threaded();
    let forms = match weights {
        Some(weights) => vec![weights.to_vec()],
        None => [Gfe::Movement, Gfe::Paper].into_iter().map(fresh).collect::<Result<_, _>>()?,
    };
    for weights in forms {
        let (mut ours, mut plain) = (Policy::from_snapshot(&weights)?, PlainPolicy::from_snapshot(&weights)?);
        let env = ours.env().clone();
        let form = if ours.config().gfe == Gfe::Movement { "movement" } else { "paper" };
        let (_, layout) = data::layouts(&env, &|line| progress(line)).swap_remove(2);
        let seen = observations(&layout, env.detection.bands());
        ours.begin_episode(&layout)?;
        plain.begin_episode(&layout)?;
        let own = times(&seen, |seen, rng, ends| {
            ours.act(seen, ActMode::Sample(rng))?;
            if ends {
                std::hint::black_box(ours.recurrent_state());
            }
            Ok(())
        })?;
        let other = times(&seen, |seen, rng, ends| {
            plain.act(seen, ActMode::Sample(rng))?;
            if ends {
                std::hint::black_box(plain.recurrent_state());
            }
            Ok(())
        })?;
        let agents = layout.agents();
        progress(&format!("{form}: a decision for {agents} intersections takes {:.3} ms", median(&own)));
        for (what, ours, theirs) in [
            ("median", median(&own), median(&other)),
            ("99 of 100", quantile(&own, 0.99), quantile(&other, 0.99)),
        ] {
            let case = format!("decision for {agents} intersections, {form}, {what}");
            rows.push(Row::new(case, "ms", Better::Lower, ours, (BASELINE, theirs)));
        }
    }
    Ok(())
}

/// Weights that nothing has trained, for the default environment of a form.
fn fresh(form: Gfe) -> Result<Vec<u8>, BenchError> {
    let config = match form {
        Gfe::Movement => Config::default(),
        Gfe::Paper => crate::update::config(Gfe::Paper, 1)?,
    };
    snapshot(&config)
}

/// Milliseconds of each decision; `act` is told where a fragment ends.
fn times(
    seen: &[Observation],
    mut act: impl FnMut(&Observation, &mut ChaCha8Rng, bool) -> Result<(), BenchError>,
) -> Result<Vec<f64>, BenchError> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut times = Vec::with_capacity(DECISIONS);
    for number in 0..WARM_UP + DECISIONS {
        let start = Instant::now();
        act(&seen[number % seen.len()], &mut rng, number % FRAGMENT == FRAGMENT - 1)?;
        if number >= WARM_UP {
            times.push(start.elapsed().as_secs_f64() * 1e3);
        }
    }
    Ok(times)
}

/// Made-up counts, mostly small.
fn observations(layout: &NetworkLayout, bands: usize) -> Vec<Observation> {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    (0..16)
        .map(|_| Observation {
            counts: (0..layout.lane_rows() * bands)
                .map(|_| {
                    let vehicles: u16 = rng.random_range(0..12);
                    vehicles.saturating_sub(6)
                })
                .collect(),
            phases: layout
                .intersections
                .iter()
                .map(|own| rng.random_range(0..own.phases.len()) as u8)
                .collect(),
        })
        .collect()
}
