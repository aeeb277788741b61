//! Acting against the golden numbers of the independent reference (see `golden.rs`): its fragments, decision by decision.

#![allow(clippy::unwrap_used, reason = "a test says by failing what went wrong")]

#[path = "golden/fixture.rs"]
#[allow(dead_code, reason = "golden.rs uses the rest of it")]
mod fixture;

use cross_model::snapshot::{self, PolicyMetadata};
use cross_model::{ActMode, Policy};
use cross_sim::trajectory::Observation;
use fixture::{Fixture, flat};

#[test]
fn fragments_are_acted_as_the_reference_does() {
    for name in ["paper", "movement", "movement_without_pcc", "movement_without_moe"] {
        let fixture = Fixture::load(name);
        let config = &fixture.config;
        let metadata =
            PolicyMetadata { policy_version: 1, env: config.env.clone(), model: config.model.clone() };
        let bytes = snapshot::write_policy(&fixture.actor, &fixture.critic, &metadata).unwrap();
        let mut policy = Policy::from_snapshot(&bytes).unwrap();
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
    let config = &fixture.config;
    let metadata = PolicyMetadata { policy_version: 1, env: config.env.clone(), model: config.model.clone() };
    let bytes = snapshot::write_policy(&fixture.actor, &fixture.critic, &metadata).unwrap();
    let mut policy = Policy::from_snapshot(&bytes).unwrap();
    policy.begin_episode(&fixture.layouts[0].1).unwrap();
    let before = policy.recurrent_state();
    let mut short = before.clone();
    short.critic.pop();
    assert!(policy.resume(short).unwrap_err().to_string().contains("recurrent state"));
    assert_eq!(policy.recurrent_state(), before);
}
