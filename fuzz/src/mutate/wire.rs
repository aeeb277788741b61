//! Fragments whose arrays keep fitting together, and safetensors files whose header keeps its length.

use super::{below, bytes, text};
use cross_proto::v1::stream_fragments_request::Message;
use cross_proto::{packing, v1};
use prost::Message as _;
use rand::{Rng, RngExt};
use rand_chacha::ChaCha8Rng;

/// A message of an actor.
pub fn fragment(input: &mut Vec<u8>, most: usize, rng: &mut ChaCha8Rng) {
    let decoded = v1::StreamFragmentsRequest::decode(input.as_slice());
    match decoded.ok().and_then(|request| request.message) {
        Some(Message::Fragment(mut fragment)) if below(rng, 8) > 0 => {
            for _ in 0..1 + below(rng, 3) {
                change(&mut fragment, rng);
            }
            *input =
                v1::StreamFragmentsRequest { message: Some(Message::Fragment(fragment)) }.encode_to_vec();
        }
        _ => bytes::mutate(input, most, rng),
    }
    input.truncate(most);
}

fn change(fragment: &mut v1::Fragment, rng: &mut impl Rng) {
    match below(rng, 12) {
        0 => fragment.first_step = number(fragment.first_step, rng),
        1 => fragment.sequence = number(fragment.sequence, rng),
        2 => fragment.end = i32::try_from(below(rng, 5)).unwrap_or(0) - 1,
        3 => float(&mut fragment.log_probs, rng),
        4 => float(&mut fragment.rewards, rng),
        5 => fragment.phases = edited(&fragment.phases, rng).into(),
        6 => fragment.actions = edited(&fragment.actions, rng).into(),
        7 => fragment.counts = edited(&fragment.counts, rng).into(),
        8 => fragment.actor_state = edited(&fragment.actor_state, rng).into(),
        9 => fragment.steps = number(fragment.steps, rng),
        10 => {
            // In the middle of an episode, with the state that belongs there, or at its beginning without.
            let width = if fragment.first_step == 0 { 4 * 8 * agents(fragment) } else { 0 };
            fragment.first_step = if width == 0 { 0 } else { 120 };
            fragment.sequence = u32::from(width > 0);
            fragment.actor_state = vec![0; width].into();
            fragment.critic_state = vec![0; width].into();
        }
        _ => resize(fragment, rng),
    }
}

fn agents(fragment: &v1::Fragment) -> usize {
    fragment.actions.len() / (fragment.steps.max(1) as usize)
}

/// Another number of steps, all arrays with it.
fn resize(fragment: &mut v1::Fragment, rng: &mut impl Rng) {
    let agents = agents(fragment).min(100);
    let steps = 1 + below(rng, 12);
    let old = fragment.steps as usize + 1;
    let lanes =
        (1..400).find(|columns| packing::unpack(&fragment.counts, old * columns).is_ok()).unwrap_or(0);
    let counts: Vec<u16> =
        (0..(steps + 1) * lanes).map(|_| [0, 0, 0, 0, 1, 2, 13, 14, u16::MAX][below(rng, 9)]).collect();
    fragment.steps = u32::try_from(steps).unwrap_or(1);
    fragment.counts = packing::pack(&counts).into();
    fragment.phases = vec![0; (steps + 1) * agents].into();
    fragment.actions = vec![0; steps * agents].into();
    fragment.log_probs = vec![-0.5; steps * agents];
    fragment.rewards = vec![-1.0; steps * agents];
}

fn number(old: u32, rng: &mut impl Rng) -> u32 {
    match below(rng, 5) {
        0 => old.wrapping_add(1),
        1 => old.wrapping_sub(1),
        2 => [0, 1, 119, 120, 121, 359, 360, u32::MAX, u32::MAX - 1][below(rng, 9)],
        _ => rng.random_range(0..400),
    }
}

fn float(values: &mut Vec<f32>, rng: &mut impl Rng) {
    let value = [0.0, -0.0, 1e-5, -1.0, -100.0, -101.0, 65535.0, 1e30, f32::NAN, f32::INFINITY, -1e-40]
        [below(rng, 11)];
    match below(rng, 6) {
        0 => values.push(value),
        1 => drop(values.pop()),
        _ => {
            let at = below(rng, values.len());
            if let Some(old) = values.get_mut(at) {
                *old = value;
            }
        }
    }
}

fn edited(old: &[u8], rng: &mut impl Rng) -> Vec<u8> {
    let mut new = old.to_vec();
    let at = below(rng, new.len());
    match below(rng, 6) {
        0 => new.push(rng.random()),
        1 => drop(new.pop()),
        2 if !new.is_empty() => new[at] = rng.random(),
        _ if !new.is_empty() => new[at] = [0, 1, 2, 3, 0xee, 0xff, 0x0f, 0xf0][below(rng, 8)],
        _ => {}
    }
    new
}

/// A safetensors file: eight bytes of length, a header of JSON, data.
pub fn safetensors(input: &mut Vec<u8>, most: usize, rng: &mut ChaCha8Rng) {
    let Some((length, rest)) = input.split_first_chunk::<8>() else { return bytes::mutate(input, most, rng) };
    let length = usize::try_from(u64::from_le_bytes(*length)).unwrap_or(usize::MAX);
    if length > rest.len() || below(rng, 12) == 0 {
        return bytes::mutate(input, most, rng);
    }
    let (header, data) = rest.split_at(length);
    let (mut header, mut data) = (header.to_vec(), data.to_vec());
    if below(rng, 6) == 0 {
        bytes::mutate(&mut data, most, rng);
    } else {
        text::json(&mut header, most.saturating_sub(8 + data.len()), rng);
    }
    *input = [&(header.len() as u64).to_le_bytes()[..], &header, &data].concat();
    input.truncate(most);
}
