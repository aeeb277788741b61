//! Acting against the golden numbers of the independent reference (see `golden.rs`): its fragments, decision by decision.

#![allow(clippy::unwrap_used, reason = "a test says by failing what went wrong")]

#[path = "golden/fixture.rs"]
#[allow(dead_code, reason = "golden.rs uses the rest of it")]
mod fixture;

use cross_model::snapshot::{self, PolicyMetadata};
use cross_model::{ActMode, Policy};
use cross_sim::trajectory::Observation;
use fixture::{Fixture, flat};

/// The fixture's weights, ready to act.
fn policy(fixture: &Fixture) -> Policy {
    let config = &fixture.config;
    let metadata = PolicyMetadata { policy_version: 1, env: config.env.clone(), model: config.model.clone() };
    let bytes = snapshot::write_policy(&fixture.actor, &fixture.critic, &metadata).unwrap();
    Policy::from_snapshot(&bytes).unwrap()
}

#[test]
fn fragments_are_acted_as_the_reference_does() {
    for name in ["paper", "movement", "movement_without_pcc", "movement_without_moe"] {
        let fixture = Fixture::load(name);
        let mut policy = policy(&fixture);
        let mut own = Vec::new();
        for fragment in &fixture.fragments {
            let layout =
                &fixture.layouts.iter().find(|(scenario, _)| *scenario == fragment.scenario).unwrap().1;
            let agents = layout.agents();
            policy.begin_episode(layout).unwrap();
            if fragment.first_step > 0 {
                policy.resume(fragment.recurrent.clone()).unwrap();
            }
            // Log-probabilities of each step `[phases of all agents]`.
            let width = fragment.counts.len() / (fragment.steps as usize + 1);
            let observations = fragment.counts.chunks_exact(width).zip(fragment.phases.chunks_exact(agents));
            let steps: Vec<Vec<f32>> = observations
                .take(fragment.steps as usize)
                .map(|(counts, phases)| {
                    let observation = Observation { counts: counts.to_vec(), phases: phases.to_vec() };
                    policy.act(&observation, ActMode::Greedy).unwrap();
                    policy.log_probs().to_vec()
                })
                .collect();
            // The reference's order: agents, steps, phases.
            let mut first = 0;
            for junction in &layout.intersections {
                let rows = first..first + junction.phases.len();
                first = rows.end;
                own.extend(steps.iter().flat_map(|step| step[rows.clone()].iter().copied()));
            }
        }
        let expected = flat(&fixture.tensors["forward/actor/log_policy"]);
        assert_eq!(own.len(), expected.len(), "{name}");
        let scale = expected.iter().fold(0.0f64, |a, b| a.max(b.abs()));
        let off =
            own.iter().zip(&expected).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max) / scale;
        println!("{name}: {off:.1e}");
        assert!(off < 1e-5, "{name}: {off:.1e}");
    }
}

#[test]
fn a_state_of_another_network_is_refused() {
    let fixture = Fixture::load("movement");
    let mut policy = policy(&fixture);
    policy.begin_episode(&fixture.layouts[0].1).unwrap();
    let before = policy.recurrent_state();
    let mut short = before.clone();
    short.critic.pop();
    assert!(policy.resume(short).unwrap_err().to_string().contains("recurrent state"));
    assert_eq!(policy.recurrent_state(), before);
}

/// Mean of consecutive rows of a width, `phases` at a time.
fn means(rows: &[f64], width: usize, phases: usize) -> Vec<f64> {
    rows.chunks_exact(width * phases)
        .flat_map(|own| {
            (0..width).map(move |i| own.iter().skip(i).step_by(width).sum::<f64>() / phases as f64)
        })
        .collect()
}

#[test]
fn experts_and_clusters_of_a_decision_are_the_reference_s() {
    for (name, mixture, clustering) in [
        ("paper", true, true),
        ("movement", true, true),
        ("movement_without_pcc", true, false),
        ("movement_without_moe", false, true),
    ] {
        let fixture = Fixture::load(name);
        let config = &fixture.config;
        let mut policy = policy(&fixture);
        let (experts, clusters) = (config.model.experts as usize, config.model.clusters as usize);
        let rows = |key: &str| fixture.tensors.get(key).map(flat).unwrap_or_default();
        let (alpha, assignment) = (rows("forward/actor/alpha"), rows("forward/actor/w"));
        assert_eq!((!alpha.is_empty(), !assignment.is_empty()), (mixture, clustering), "{name}");
        let mut first_row = 0;
        for fragment in &fixture.fragments {
            let layout =
                &fixture.layouts.iter().find(|(scenario, _)| *scenario == fragment.scenario).unwrap().1;
            policy.begin_episode(layout).unwrap();
            assert_eq!(policy.routing(), cross_model::Routing::default(), "nothing was decided yet");
            if fragment.first_step > 0 {
                policy.resume(fragment.recurrent.clone()).unwrap();
            }
            let (agents, steps) = (layout.agents(), fragment.steps as usize);
            let width = fragment.counts.len() / (steps + 1);
            for t in 0..steps {
                let observation = Observation {
                    counts: fragment.counts[t * width..(t + 1) * width].to_vec(),
                    phases: fragment.phases[t * agents..(t + 1) * agents].to_vec(),
                };
                policy.act(&observation, ActMode::Greedy).unwrap();
                let routing = policy.routing();
                // The reference's order: agents, steps, phases.
                let mut row = first_row;
                for (agent, junction) in layout.intersections.iter().enumerate() {
                    let phases = junction.phases.len();
                    let own = row + t * phases..row + (t + 1) * phases;
                    for (shares, reference, width) in
                        [(&routing.experts, &alpha, experts), (&routing.clusters, &assignment, clusters)]
                    {
                        let Some(wanted) = reference.get(own.start * width..own.end * width) else {
                            assert!(reference.is_empty() && shares.is_empty(), "{name}");
                            continue;
                        };
                        let got = &shares[agent * width..(agent + 1) * width];
                        for (got, wanted) in got.iter().zip(means(wanted, width, phases)) {
                            assert!((f64::from(*got) - wanted).abs() < 1e-5, "{name}: {got} {wanted}");
                        }
                    }
                    row += steps * phases;
                }
            }
            first_row +=
                steps * layout.intersections.iter().map(|junction| junction.phases.len()).sum::<usize>();
        }
    }
}
