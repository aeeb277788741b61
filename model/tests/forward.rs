//! Properties of the forward pass that no fixture is needed for.

#![allow(clippy::unwrap_used, reason = "a test says by failing what went wrong")]

mod common;

use common::{Toy, id, intersection, ragged, tiny_config};
use cross_config::{Detection, Gfe};
use cross_model::{ActMode, Policy, Trainer};
use cross_sim::layout::{Intersection, NetworkLayout};
use cross_sim::trajectory::{FragmentEnd, Observation};
use std::sync::Arc;

fn policy(gfe: Gfe, layout: &Arc<NetworkLayout>) -> Policy {
    cross_model::set_single_threaded();
    let mut config = tiny_config();
    config.model.gfe = gfe;
    if gfe == Gfe::Paper {
        config.env.detection = Detection::Paper;
    }
    let trainer = Trainer::new(&config, vec![("toy".to_owned(), Arc::clone(layout))]).unwrap();
    Policy::from_snapshot(&trainer.snapshot().unwrap()).unwrap()
}

fn counts(layout: &NetworkLayout, bands: usize) -> Vec<u16> {
    (0..layout.lane_rows() * bands).map(|i| (i * 7 % 11) as u16).collect()
}

/// Greedy decision and the state after it.
fn decide(policy: &mut Policy, layout: &NetworkLayout, counts: Vec<u16>) -> (Vec<u8>, Vec<f32>, Vec<f32>) {
    policy.begin_episode(layout).unwrap();
    let observation = Observation { counts, phases: vec![0; layout.agents()] };
    let decision = policy.act(&observation, ActMode::Greedy).unwrap();
    (decision.actions, decision.log_probs, policy.recurrent_state().actor)
}

fn close(a: &[f32], b: &[f32]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-5)
}

#[test]
fn an_agent_decides_the_same_alone_as_among_others() {
    for (gfe, bands) in [(Gfe::Movement, 3), (Gfe::Paper, 2)] {
        let layout = ragged();
        let mut policy = policy(gfe, &layout);
        let all = counts(&layout, bands);
        let (actions, log_probs, states) = decide(&mut policy, &layout, all.clone());
        let mut row = 0;
        for (agent, junction) in layout.intersections.iter().enumerate() {
            let own = all[row * bands..(row + junction.lanes()) * bands].to_vec();
            row += junction.lanes();
            let alone = NetworkLayout { intersections: vec![junction.clone()] };
            let (action, log_prob, state) = decide(&mut policy, &alone, own);
            assert_eq!(action[0], actions[agent], "{gfe:?} {}", junction.id);
            assert!(close(&log_prob, &log_probs[agent..=agent]), "{gfe:?} {}", junction.id);
            assert!(close(&state, &states[agent * 16..(agent + 1) * 16]), "{gfe:?} {}", junction.id);
        }
    }
}

/// The junction with its lanes and movements in reverse order.
fn reversed(junction: &Intersection) -> Intersection {
    let (incoming, outgoing) = (junction.incoming.len(), junction.outgoing.len());
    let mut out = junction.clone();
    out.incoming.reverse();
    out.outgoing.reverse();
    out.movements.reverse();
    for movement in &mut out.movements {
        movement.incoming = incoming - 1 - movement.incoming;
        movement.outgoing = outgoing - 1 - movement.outgoing;
    }
    for phase in &mut out.phases {
        phase.green.reverse();
    }
    out.roads_in.reverse();
    out.roads_out.reverse();
    out
}

#[test]
fn the_movement_form_does_not_see_the_order_of_links() {
    let junction = intersection("j", 4, 3);
    let layout = Arc::new(NetworkLayout { intersections: vec![junction.clone()] });
    let mut policy = policy(Gfe::Movement, &layout);
    let own = counts(&layout, 3);
    let half = junction.incoming.len() * 3;
    let mirrored: Vec<u16> =
        own[..half].chunks(3).rev().chain(own[half..].chunks(3).rev()).flatten().copied().collect();
    let straight = decide(&mut policy, &layout, own);
    let other = decide(&mut policy, &NetworkLayout { intersections: vec![reversed(&junction)] }, mirrored);
    assert_eq!(straight.0, other.0);
    assert!(close(&straight.1, &other.1) && close(&straight.2, &other.2));
}

#[test]
fn recurrent_state_carries_what_was_seen() {
    let layout = ragged();
    let mut policy = policy(Gfe::Movement, &layout);
    let config = tiny_config();
    let mut toy = Toy::new(&layout, &config, 4);
    toy.play(&mut policy, "toy", id(0, 0), 0, 6, FragmentEnd::Continues, false);
    let state = policy.recurrent_state();
    assert_eq!(state.actor.len(), layout.agents() * 16);
    assert!(state.actor.iter().any(|v| *v != 0.0) && state.critic.iter().any(|v| *v != 0.0));
    assert_ne!(state.actor, state.critic);
    policy.begin_episode(&layout).unwrap();
    assert!(policy.recurrent_state().actor.iter().all(|v| *v == 0.0));
}

#[test]
fn observations_of_another_network_are_refused() {
    let layout = ragged();
    let mut policy = policy(Gfe::Movement, &layout);
    let fits = Observation { counts: counts(&layout, 3), phases: vec![0; layout.agents()] };
    assert!(policy.act(&fits, ActMode::Greedy).is_err(), "no episode begun");
    policy.begin_episode(&layout).unwrap();
    let short = Observation { counts: vec![0; 3], phases: fits.phases.clone() };
    assert!(policy.act(&short, ActMode::Greedy).unwrap_err().to_string().contains("counts"));
    let odd = Observation { counts: fits.counts.clone(), phases: vec![9; layout.agents()] };
    assert!(policy.act(&odd, ActMode::Greedy).unwrap_err().to_string().contains("phase"));
    policy.act(&fits, ActMode::Greedy).unwrap();
    let large = NetworkLayout { intersections: vec![intersection("big", 9, 1)] };
    let error = policy.begin_episode(&large).unwrap_err().to_string();
    assert!(error.contains("big") && error.contains('9') && error.contains('8'), "{error}");
}

#[test]
fn more_roads_than_the_paper_form_holds_are_refused_by_it_alone() {
    let mut wide = intersection("wide", 4, 2);
    wide.roads_out = std::iter::repeat_n(wide.roads_out[0].clone(), 8).collect();
    let wide = NetworkLayout { intersections: vec![wide] };
    let layout = ragged();
    let error = policy(Gfe::Paper, &layout).begin_episode(&wide).unwrap_err().to_string();
    assert!(
        ["wide", "4 incoming", "8 outgoing", "at most 7"].iter().all(|part| error.contains(part)),
        "{error}"
    );
    policy(Gfe::Movement, &layout).begin_episode(&wide).unwrap();
}
