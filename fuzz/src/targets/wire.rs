//! What comes over the network.

use super::TOWN;
use crate::{Outcome, parts};
use cross_config::{Config, EnvConfig};
use cross_proto::fragment::{FragmentSpec, decode};
use cross_proto::v1::stream_fragments_request::Message;
use cross_proto::weights::{Assembler, Snapshot, split};
use cross_proto::{ids::ActorId, status, v1};
use cross_sim::layout::NetworkLayout;
use cross_sim::net::Net;
use cross_sim::trajectory::{Fragment, FragmentEnd, FragmentId, RecurrentState};
use cross_support::token::Tokens;
use prost::Message as _;
use std::hint::black_box;
use std::path::Path;
use std::sync::{Arc, LazyLock};

/// What a fragment of the small town must agree with.
static SPEC: LazyLock<FragmentSpec> = LazyLock::new(|| {
    let net =
        Net::parse(TOWN.as_bytes(), Path::new("town")).expect("the committed net is one, there is a test");
    let layout = NetworkLayout::from_net(&net, &EnvConfig::default()).expect("as above");
    let mut config = Config::default();
    config.model.hidden = 8;
    FragmentSpec::new("town", Arc::new(layout), &config)
});

/// A message of an actor's stream; a fragment is checked and unpacked.
pub(super) fn fragment(input: &[u8]) -> Outcome {
    let Ok(request) = v1::StreamFragmentsRequest::decode(input) else { return Outcome::Refused };
    match request.message {
        Some(Message::Fragment(message)) => match decode(message, &SPEC) {
            Ok(fragment) => {
                check(&fragment);
                Outcome::Accepted
            }
            Err(violation) => {
                assert!(violation.field.starts_with("fragment."), "{violation}");
                let status = status::invalid(&violation);
                assert!(status.message().len() < 2000, "a status fits a header");
                Outcome::Refused
            }
        },
        Some(Message::Hello(hello)) => Outcome::of(&ActorId::parse(&hello.actor_id, "hello.actor_id")),
        Some(_) => Outcome::Accepted,
        None => Outcome::Refused,
    }
}

/// What the learner relies on without asking again.
fn check(fragment: &Fragment) {
    let (steps, agents) = (fragment.steps as usize, SPEC.agents());
    assert!(steps > 0 && fragment.first_step as usize + steps <= SPEC.steps_per_episode as usize);
    assert_eq!(fragment.counts.len(), (steps + 1) * SPEC.counts_per_step());
    assert_eq!((fragment.phases.len(), fragment.actions.len()), ((steps + 1) * agents, steps * agents));
    assert_eq!((fragment.log_probs.len(), fragment.rewards.len()), (steps * agents, steps * agents));
    let numbers = fragment.log_probs.iter().chain(&fragment.rewards);
    assert!(
        numbers.chain(&fragment.recurrent.actor).chain(&fragment.recurrent.critic).all(|x| x.is_finite())
    );
    let again = decode(v1::Fragment::from(fragment), &SPEC);
    assert!(again.is_ok_and(|again| again == *fragment), "what was accepted is accepted again, unchanged");
}

/// Weights in up to four messages.
pub(super) fn weights(input: &[u8]) -> Outcome {
    let mut assembler = Assembler::new(64 << 20);
    let mut outcome = Outcome::Refused;
    for part in parts::split::<4>(input) {
        let Ok(message) = v1::WatchWeightsResponse::decode(part) else { continue };
        match assembler.push(&message) {
            Ok(Some(snapshot)) => {
                let mut again = Assembler::new(64 << 20);
                let pieces = split(&snapshot)
                    .iter()
                    .filter_map(|piece| again.push(piece).ok().flatten())
                    .collect::<Vec<_>>();
                assert_eq!(pieces, [snapshot]);
                outcome = Outcome::Accepted;
            }
            Ok(None) => {}
            Err(violation) => assert!(!violation.to_string().is_empty()),
        }
    }
    outcome
}

/// The first byte chooses a message; the rest is one.
pub(super) fn messages(input: &[u8]) -> Outcome {
    macro_rules! choose {
        ($choice:expr, $rest:expr, $($message:ident),*) => {{
            let decoders: &[fn(&[u8]) -> bool] = &[$(|bytes| {
                // Shown in the logs of either side.
                v1::$message::decode(bytes).is_ok_and(|message| {
                    let _ = black_box(format!("{message:?}").len());
                    v1::$message::decode(message.encode_to_vec().as_slice()).is_ok()
                })
            }),*];
            decoders[usize::from($choice) % decoders.len()]($rest)
        }};
    }
    let Some((&choice, rest)) = input.split_first() else { return Outcome::Refused };
    let decoded = choose!(
        choice,
        rest,
        JoinRequest,
        JoinResponse,
        StreamFragmentsResponse,
        WatchWeightsRequest,
        ListCheckpointsRequest,
        ListCheckpointsResponse,
        GetCheckpointRequest,
        GetCheckpointResponse,
        WatchProgressResponse,
        CheckpointNowResponse
    );
    if let Ok(response) = v1::JoinResponse::decode(rest) {
        let _ = black_box(Config::from_json(&response.config_json, "the learner's configuration").is_ok());
    }
    if decoded { Outcome::Accepted } else { Outcome::Refused }
}

/// The text of a token, and an `authorization` header.
pub(super) fn token(input: &[u8]) -> Outcome {
    let [text, header] = parts::split(input);
    let tokens = Tokens::load(&Default::default(), Some(String::from_utf8_lossy(text).into_owned()));
    match &tokens {
        Ok(Some(tokens)) => {
            let _ = black_box(tokens.accepts(Some(header)));
            let _ = black_box(tokens.accepts(None));
        }
        Ok(None) => {}
        Err(error) => assert!(!error.to_string().is_empty()),
    }
    Outcome::of(&tokens)
}

/// A fragment of the small town.
#[must_use]
pub(super) fn fragments() -> Vec<Vec<u8>> {
    let agents = SPEC.agents();
    let make = |first_step: u32, end: FragmentEnd, steps: usize| {
        let state = vec![0.25; if first_step == 0 { 0 } else { agents * SPEC.hidden }];
        let counts = (0..(steps + 1) * SPEC.counts_per_step()).map(|i| if i % 5 == 0 { 3 } else { 0 });
        let fragment = Fragment {
            id: FragmentId {
                actor: "actor-0".to_owned(),
                session_epoch: 1,
                episode: 2,
                sequence: u32::from(first_step > 0),
            },
            scenario: SPEC.scenario.clone(),
            layout_hash: SPEC.layout_hash.clone(),
            policy_version: 3,
            first_step,
            steps: u32::try_from(steps).unwrap_or(1),
            counts: counts.collect(),
            phases: vec![1; (steps + 1) * agents],
            actions: vec![0; steps * agents],
            log_probs: vec![-0.7; steps * agents],
            rewards: vec![-3.0; steps * agents],
            recurrent: RecurrentState { actor: state.clone(), critic: state },
            end,
        };
        Message::Fragment(v1::Fragment::from(&fragment))
    };
    let hello = v1::StreamHello { actor_id: "actor-0".to_owned(), session_epoch: 1 };
    [
        make(0, FragmentEnd::Continues, 3),
        make(120, FragmentEnd::Truncated, 2),
        make(355, FragmentEnd::Terminated, 5),
        Message::Hello(hello),
    ]
    .into_iter()
    .map(|message| v1::StreamFragmentsRequest { message: Some(message) }.encode_to_vec())
    .collect()
}

/// Snapshots in one piece and in two.
#[must_use]
pub(super) fn snapshots() -> Vec<Vec<u8>> {
    let snapshot = Snapshot { policy_version: 7, bytes: b"weights of a small policy".to_vec().into() };
    let whole = split(&snapshot).remove(0);
    let (first, second) = whole.chunk.split_at(10);
    let part = |offset: u64, chunk: &[u8], sha256: &[u8]| {
        v1::WatchWeightsResponse {
            offset,
            chunk: chunk.to_vec().into(),
            sha256: sha256.to_vec().into(),
            ..whole.clone()
        }
        .encode_to_vec()
    };
    let (one, other) = (part(0, first, &[]), part(10, second, &whole.sha256));
    vec![parts::join([&whole.encode_to_vec()]), parts::join([one.as_slice(), &other])]
}

/// The other messages.
#[must_use]
pub(super) fn others() -> Vec<Vec<u8>> {
    let versions = v1::Versions { protocol: 1, cross: "0.1.0".to_owned(), ..v1::Versions::default() };
    let join = v1::JoinRequest {
        actor_id: "actor-0".to_owned(),
        host: "host".to_owned(),
        versions: Some(versions.clone()),
        scenarios: vec!["grid4x4".to_owned()],
        config_hash: "0123456789abcdef".to_owned(),
    };
    let joined = v1::JoinResponse {
        config_json: Config::default().to_json(),
        scenarios: vec![v1::ScenarioInfo { name: "grid4x4".to_owned(), ..v1::ScenarioInfo::default() }],
        limits: Some(v1::Limits { fragment_steps: 120, ..v1::Limits::default() }),
        versions: Some(versions),
        ..v1::JoinResponse::default()
    };
    vec![[&[0][..], &join.encode_to_vec()].concat(), [&[1][..], &joined.encode_to_vec()].concat()]
}
