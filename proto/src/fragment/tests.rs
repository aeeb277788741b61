//! Round trips of fragments, and one test for each way in which a fragment can be wrong.

use super::*;
use cross_sim::layout::{Intersection, Lane, Phase};
use proptest::prelude::*;
use prost::Message as _;

const BANDS: usize = 3;
const HIDDEN: usize = 4;

/// One intersection with that many lanes and phases; the rest of a layout does not concern the wire.
fn intersection(id: &str, lanes: usize, phases: usize) -> Intersection {
    let lane = |index| Lane::new(format!("{id}_{index}"), 100.0, 13.9);
    Intersection {
        id: id.to_owned(),
        position: (0.0, 0.0),
        incoming: (0..lanes / 2).map(lane).collect(),
        outgoing: (lanes / 2..lanes).map(lane).collect(),
        movements: Vec::new(),
        phases: (0..phases).map(|_| Phase { state: String::new(), green: Vec::new() }).collect(),
        roads_in: Vec::new(),
        roads_out: Vec::new(),
    }
}

fn spec_of(intersections: Vec<Intersection>) -> FragmentSpec {
    let layout = Arc::new(NetworkLayout { intersections });
    FragmentSpec {
        scenario: "two".to_owned(),
        layout_hash: layout.hash(),
        layout,
        bands: BANDS,
        hidden: HIDDEN,
        max_steps: 10,
        steps_per_episode: 30,
    }
}

/// Two intersections of different shape, so that a mix-up of agents shows.
fn spec() -> FragmentSpec {
    spec_of(vec![intersection("north", 6, 4), intersection("south", 3, 2)])
}

/// A valid fragment of `steps` steps that starts at `first_step`, filled from `value(index)`.
fn fragment(spec: &FragmentSpec, first_step: u32, steps: u32, value: impl Fn(usize) -> f32) -> Fragment {
    let rows = steps as usize;
    let agents = spec.agents();
    let phase = |index: usize| (index % spec.layout.intersections[index % agents].phases.len()) as u8;
    let state = if first_step == 0 { 0 } else { agents * spec.hidden };
    Fragment {
        id: FragmentId {
            actor: "actor-1".to_owned(),
            session_epoch: 3,
            episode: 17,
            sequence: first_step.min(2),
        },
        scenario: spec.scenario.clone(),
        layout_hash: spec.layout_hash.clone(),
        policy_version: 5,
        first_step,
        steps,
        counts: (0..(rows + 1) * spec.counts_per_step()).map(|index| value(index).abs() as u16).collect(),
        phases: (0..(rows + 1) * agents).map(phase).collect(),
        actions: (0..rows * agents).map(phase).collect(),
        log_probs: (0..rows * agents).map(|index| -value(index).abs() % 100.0).collect(),
        rewards: (0..rows * agents).map(&value).collect(),
        recurrent: RecurrentState {
            actor: (0..state).map(|index| value(index).sin()).collect(),
            critic: (0..state).map(|index| value(index + 1).sin()).collect(),
        },
        end: if first_step + steps == spec.steps_per_episode {
            FragmentEnd::Truncated
        } else {
            FragmentEnd::Continues
        },
    }
}

fn valid() -> v1::Fragment {
    v1::Fragment::from(&fragment(&spec(), 10, 5, |index| index as f32))
}

/// Decodes a valid fragment after `change` and gives the field and sentence of the refusal.
fn refusal(change: impl FnOnce(&mut v1::Fragment)) -> (String, String) {
    let mut message = valid();
    change(&mut message);
    let violation = decode(message, &spec()).unwrap_err();
    (violation.field.clone(), violation.to_string())
}

/// As [`refusal`], for a field of bytes.
fn with_byte(bytes: &bytes::Bytes, index: usize, value: u8) -> bytes::Bytes {
    let mut copy = bytes.to_vec();
    copy[index] = value;
    copy.into()
}

proptest! {
    #[test]
    fn round_trip(
        first_step in 0..30_u32,
        steps in 1..=10_u32,
        values in proptest::collection::vec(-6e4..6e4_f32, 1..50),
    ) {
        let spec = spec();
        let steps = steps.min(spec.steps_per_episode - first_step);
        let original = fragment(&spec, first_step, steps, |index| values[index % values.len()]);
        let bytes = v1::Fragment::from(&original).encode_to_vec();
        let message = v1::Fragment::decode(bytes.as_slice()).unwrap();
        let checked = check(message.clone(), &spec).unwrap();
        prop_assert!(checked.counts.is_empty(), "they are packed");
        prop_assert_eq!(&checked, &Checked::from(original.clone()));
        prop_assert_eq!(&checked.unpack(), &original);
        prop_assert_eq!(decode(message, &spec), Ok(original));
    }

    #[test]
    fn a_damaged_message_gives_a_whole_fragment_or_an_error(index: prop::sample::Index, value: u8) {
        let spec = spec();
        let mut bytes = valid().encode_to_vec();
        let index = index.index(bytes.len());
        bytes[index] = value;
        if let Ok(message) = v1::Fragment::decode(bytes.as_slice())
            && let Ok(fragment) = decode(message, &spec)
        {
            let steps = fragment.steps as usize;
            prop_assert_eq!(fragment.counts.len(), (steps + 1) * spec.counts_per_step());
            prop_assert_eq!(fragment.actions.len(), steps * spec.agents());
            prop_assert!(fragment.rewards.iter().all(|reward| reward.is_finite()));
        }
    }
}

#[test]
fn every_end_survives() {
    let spec = spec();
    for end in [FragmentEnd::Continues, FragmentEnd::Truncated, FragmentEnd::Terminated] {
        let mut original = fragment(&spec, 10, 5, |index| index as f32);
        original.end = end;
        assert_eq!(decode(v1::Fragment::from(&original), &spec).unwrap().end, end);
    }
}

#[test]
fn the_specification_follows_the_configuration() {
    let config = Config::default();
    let layout = spec().layout;
    let spec = FragmentSpec::new("two", Arc::clone(&layout), &config);
    assert_eq!(spec.layout_hash, layout.hash());
    assert_eq!(spec.bands, config.env.detection.bands());
    assert_eq!(spec.hidden as i64, config.model.hidden);
    assert_eq!(spec.max_steps, config.actor.fragment_steps);
    assert_eq!(spec.steps_per_episode, config.env.steps_per_episode());
    assert_eq!(spec.counts_per_step(), 9 * config.env.detection.bands());
}

/// Light traffic on the 16 intersections of a 4 x 4 grid, 24 lanes each: the size that the wire is made for.
#[test]
fn a_decision_of_an_intersection_takes_less_than_64_bytes() {
    let mut spec = spec_of((0..16).map(|index| intersection(&format!("A{index}"), 24, 8)).collect());
    spec.max_steps = 120;
    spec.hidden = 128;
    // Every fifth band holds one to eight vehicles, and now and then there are 20.
    let whole = fragment(&spec, 0, 120, |index| match index {
        _ if index % 97 == 0 => 20.0,
        _ if index % 5 == 0 => 1.0 + (index / 5 % 8) as f32,
        _ => 0.0,
    });
    let decisions = 120 * 16;
    let bytes = v1::Fragment::from(&whole).encoded_len();
    assert!(bytes < 64 * decisions, "{bytes} bytes for {decisions} decisions");
    let counts = packing::pack(&whole.counts).len();
    assert!(counts < 36 * decisions, "{counts} bytes of counts for {decisions} decisions");
}

#[test]
fn actor_id_with_a_slash_is_refused() {
    assert_eq!(refusal(|message| message.actor_id = "a/b".to_owned()).0, "fragment.actor_id");
}

#[test]
fn another_scenario_is_refused() {
    let (field, sentence) = refusal(|message| message.scenario = "three".to_owned());
    assert_eq!(field, "fragment.scenario");
    assert!(sentence.contains("\"three\" instead of \"two\""), "{sentence}");
}

#[test]
fn another_layout_is_refused() {
    let (field, sentence) = refusal(|message| message.layout_hash = "0123456789abcdef".to_owned());
    assert_eq!(field, "fragment.layout_hash");
    assert!(sentence.contains("0123456789abcdef") && sentence.contains(&spec().layout_hash), "{sentence}");
}

#[test]
fn no_steps_are_refused() {
    let (field, sentence) = refusal(|message| message.steps = 0);
    assert_eq!(field, "fragment.steps");
    assert!(sentence.contains("1 to 10"), "{sentence}");
}

#[test]
fn too_many_steps_are_refused() {
    assert_eq!(refusal(|message| message.steps = 11).0, "fragment.steps");
    assert_eq!(refusal(|message| message.steps = u32::MAX).0, "fragment.steps");
}

#[test]
fn steps_past_the_episode_are_refused() {
    assert_eq!(refusal(|message| message.first_step = 26).0, "fragment.first_step");
    assert_eq!(refusal(|message| message.first_step = u32::MAX).0, "fragment.first_step");
}

#[test]
fn sequence_and_first_step_start_together() {
    assert_eq!(refusal(|message| message.sequence = 0).0, "fragment.sequence");
    assert_eq!(refusal(|message| message.first_step = 0).0, "fragment.sequence");
}

#[test]
fn an_unspecified_end_is_refused() {
    let (field, sentence) = refusal(|message| message.end = 0);
    assert_eq!(field, "fragment.end");
    assert!(sentence.contains("missing"), "{sentence}");
}

#[test]
fn an_unknown_end_is_refused() {
    assert_eq!(refusal(|message| message.end = 9).0, "fragment.end");
    assert_eq!(refusal(|message| message.end = -1).0, "fragment.end");
}

#[test]
fn nothing_goes_on_after_the_last_step() {
    assert_eq!(refusal(|message| message.first_step = 25).0, "fragment.end");
}

#[test]
fn counts_of_another_shape_are_refused() {
    let (field, sentence) = refusal(|message| message.counts = message.counts.slice(1..));
    assert_eq!(field, "fragment.counts");
    assert!(sentence.contains(&(6 * 9 * BANDS).to_string()), "{sentence}");
    assert_eq!(refusal(|message| message.counts = bytes::Bytes::new()).0, "fragment.counts");
}

#[test]
fn phases_of_another_shape_are_refused() {
    let (field, sentence) = refusal(|message| message.phases = message.phases.slice(2..));
    assert_eq!(field, "fragment.phases");
    assert!(sentence.contains("10 values instead of 12"), "{sentence}");
}

#[test]
fn a_phase_that_the_intersection_lacks_is_refused() {
    let (field, sentence) = refusal(|message| message.phases = with_byte(&message.phases, 1, 2));
    assert_eq!(field, "fragment.phases");
    assert!(sentence.contains("south") && sentence.contains("2 phases"), "{sentence}");
}

#[test]
fn actions_of_another_shape_are_refused() {
    assert_eq!(refusal(|message| message.actions = message.phases.clone()).0, "fragment.actions");
}

#[test]
fn an_action_that_the_intersection_lacks_is_refused() {
    // 3 is a phase of "north" (index 0), but not of "south" (index 1).
    let mut message = valid();
    message.actions = with_byte(&message.actions, 0, 3);
    decode(message, &spec()).unwrap();
    let (field, sentence) = refusal(|message| message.actions = with_byte(&message.actions, 1, 3));
    assert_eq!(field, "fragment.actions");
    assert!(sentence.contains("has 3 for intersection south"), "{sentence}");
}

#[test]
fn log_probs_of_another_shape_are_refused() {
    assert_eq!(refusal(|message| message.log_probs.push(-1.0)).0, "fragment.log_probs");
}

#[test]
fn a_log_prob_that_is_no_number_is_refused() {
    let (field, sentence) = refusal(|message| message.log_probs[3] = f32::NAN);
    assert_eq!(field, "fragment.log_probs");
    assert!(sentence.contains("NaN for intersection south at step 1"), "{sentence}");
    assert_eq!(refusal(|message| message.log_probs[0] = f32::NEG_INFINITY).0, "fragment.log_probs");
}

#[test]
fn a_log_prob_above_zero_is_refused_but_rounding_is_not() {
    assert_eq!(refusal(|message| message.log_probs[0] = 0.1).0, "fragment.log_probs");
    let mut message = valid();
    message.log_probs[0] = 1e-6;
    decode(message, &spec()).unwrap();
}

#[test]
fn finite_but_absurd_values_are_refused_too() {
    assert_eq!(refusal(|message| message.log_probs[0] = -1e30).0, "fragment.log_probs");
    assert_eq!(refusal(|message| message.rewards[1] = -1e38).0, "fragment.rewards");
    let huge = 1e30f32.to_le_bytes().repeat(spec().agents() * HIDDEN);
    assert_eq!(refusal(|message| message.actor_state = huge.into()).0, "fragment.actor_state");
}

#[test]
fn rewards_of_another_shape_are_refused() {
    assert_eq!(refusal(|message| message.rewards.clear()).0, "fragment.rewards");
}

#[test]
fn a_reward_that_is_no_number_is_refused() {
    let (field, sentence) = refusal(|message| message.rewards[2] = f32::NAN);
    assert_eq!(field, "fragment.rewards");
    assert!(sentence.contains("NaN for intersection north at step 1"), "{sentence}");
    assert_eq!(refusal(|message| message.rewards[0] = f32::INFINITY).0, "fragment.rewards");
}

#[test]
fn recurrent_state_of_another_size_is_refused() {
    assert_eq!(
        refusal(|message| message.actor_state = message.actor_state.slice(4..)).0,
        "fragment.actor_state"
    );
    assert_eq!(
        refusal(|message| message.critic_state = message.critic_state.slice(..7)).0,
        "fragment.critic_state"
    );
}

#[test]
fn recurrent_state_that_is_no_number_is_refused() {
    let nan = f32::NAN.to_le_bytes().repeat(spec().agents() * HIDDEN);
    assert_eq!(refusal(|message| message.critic_state = nan.into()).0, "fragment.critic_state");
    let infinity = f32::INFINITY.to_le_bytes().repeat(spec().agents() * HIDDEN);
    assert_eq!(refusal(|message| message.actor_state = infinity.into()).0, "fragment.actor_state");
}

#[test]
fn recurrent_state_is_empty_exactly_at_the_start() {
    let (field, sentence) = refusal(|message| message.actor_state = bytes::Bytes::new());
    assert_eq!(field, "fragment.actor_state");
    assert!(sentence.contains("empty exactly at step 0"), "{sentence}");
    // A fragment from the start that brings one all the same.
    let violation = decode(
        {
            let state = valid().actor_state;
            let mut message = v1::Fragment::from(&fragment(&spec(), 0, 5, |index| index as f32));
            message.actor_state = state;
            message
        },
        &spec(),
    )
    .unwrap_err();
    assert_eq!(violation.field, "fragment.actor_state");
}

#[test]
fn states_travel_as_little_endian_float32() {
    assert_eq!(floats_to_bytes(&[1.0, -2.0]), [0, 0, 0x80, 0x3f, 0, 0, 0, 0xc0]);
}
