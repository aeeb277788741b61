//! A client of somebody else's: it speaks the protocol, and breaks its rules one after another. Each time the answer has to be
//! the one that `docs/protocol.md` promises.

use cross_config::Config;
use cross_proto::client::LearnerClient;
use cross_proto::v1::{
    EpisodeAborted, EpisodeRequest, Fragment as WireFragment, JoinRequest, JoinResponse, Outcome,
    StreamFragmentsRequest, StreamFragmentsResponse, StreamHello, Versions,
    stream_fragments_request::Message, stream_fragments_response::Message as Answer,
};
use cross_sim::layout::load_layout;
use cross_sim::scenario::Scenario;
use cross_sim::trajectory::{Fragment, FragmentEnd, FragmentId, RecurrentState};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::transport::{Channel, Endpoint};
use tonic::{Status, Streaming};

/// Its id.
pub(super) const NAME: &str = "stranger";
/// A learner whose buffer is full takes its time.
const PATIENCE: Duration = Duration::from_secs(20);

async fn client(address: &str) -> Result<LearnerClient<Channel>, String> {
    let endpoint = Endpoint::from_shared(format!("http://{address}")).unwrap();
    let channel = endpoint.connect().await.map_err(|error| format!("cannot connect: {error}"))?;
    Ok(LearnerClient::new(channel))
}

fn join_request(protocol: u32) -> JoinRequest {
    JoinRequest {
        actor_id: NAME.to_owned(),
        host: NAME.to_owned(),
        versions: Some(Versions {
            protocol,
            cross: env!("CARGO_PKG_VERSION").to_owned(),
            sumo: "unknown".to_owned(),
            libtorch: "unknown".to_owned(),
        }),
        ..JoinRequest::default()
    }
}

fn reason(status: &Status) -> String {
    cross_proto::status::reason(status)
        .map_or_else(|| status.to_string(), |reason| reason.as_str().to_owned())
}

fn expect<T: std::fmt::Debug + PartialEq + Copy>(what: &str, seen: T, wanted: T) -> Result<(), String> {
    if seen == wanted { Ok(()) } else { Err(format!("{what}: {seen:?} instead of {wanted:?}")) }
}

/// Comes with other versions of the protocol; each is refused by name.
pub(super) async fn other_version(address: &str) -> Result<(), String> {
    let mut client = client(address).await?;
    for version in [0, cross_proto::PROTOCOL_VERSION + 1, u32::MAX] {
        match client.join(join_request(version)).await {
            Ok(_) => return Err(format!("an actor of protocol version {version} was let in")),
            Err(status) => expect("another version", reason(&status).as_str(), "PROTOCOL_MISMATCH")?,
        }
    }
    Ok(())
}

/// Speaks without a lease and under a session that is over, then joins and sends fragments twice, again after a reconnection,
/// out of order, of another session and of an episode that nobody gave it.
pub(super) async fn misbehave(address: &str, patience: u32) -> Result<(), String> {
    let patience = PATIENCE * patience;
    let mut client = client(address).await?;
    let joined = client.join(join_request(cross_proto::PROTOCOL_VERSION)).await;
    let joined = joined.map_err(|status| format!("cannot join: {status}"))?.into_inner();

    let old = joined.session_epoch - 1;
    let refused = Talk::open(&mut client, NAME, old, patience)
        .await
        .err()
        .ok_or("a session that is over was served")?;
    expect("an old session", reason(&refused).as_str(), "OLD_SESSION")?;
    let refused = Talk::open(&mut client, "nobody", joined.session_epoch, patience).await;
    let refused = refused.err().ok_or("an actor without a lease was served")?;
    expect("no lease", reason(&refused).as_str(), "NOT_JOINED")?;

    let mut talk = Talk::start(&mut client, &joined, patience).await?;
    talk.send(Message::EpisodeRequest(EpisodeRequest {})).await;
    let (episode, scenario) = match talk.answer().await? {
        Answer::Assignment(assignment) => (assignment.episode, assignment.scenario),
        other => return Err(format!("no assignment but {other:?}")),
    };
    let fragment = |episode, sequence| fragment(&joined, &scenario, episode, sequence);
    let first = fragment(episode, 0)?;
    expect("a fragment", talk.fragment(first.clone()).await?, Outcome::Accepted)?;
    expect("a duplicate", talk.fragment(first.clone()).await?, Outcome::Duplicate)?;
    expect(
        "a foreign episode",
        talk.fragment(fragment(episode + 1_000_000, 0)?).await?,
        Outcome::UnknownEpisode,
    )?;
    let mut old = fragment(episode, 1)?;
    old.session_epoch -= 1;
    expect("an old fragment", talk.fragment(old).await?, Outcome::OldSession)?;

    // The connection goes, the lease stays; what was sent before is sent again.
    drop(talk);
    let mut talk = Talk::start(&mut client, &joined, patience).await?;
    expect("a replay", talk.fragment(first).await?, Outcome::Duplicate)?;
    match talk.fragment(fragment(episode, 2)?).await {
        Ok(outcome) => return Err(format!("a fragment out of order was {outcome:?}")),
        Err(problem) if problem.contains("a fragment is missing") => {}
        Err(problem) => return Err(format!("out of order: {problem}")),
    }

    // It leaves as it should, so that nothing waits for its lease to end.
    let talk = Talk::start(&mut client, &joined, patience).await?;
    talk.send(Message::EpisodeAborted(EpisodeAborted { episode, reason: "SHUTDOWN".to_owned() })).await;
    talk.close().await
}

/// A stream of its own.
struct Talk {
    requests: mpsc::Sender<StreamFragmentsRequest>,
    answers: Streaming<StreamFragmentsResponse>,
    patience: Duration,
}

impl Talk {
    async fn start(
        client: &mut LearnerClient<Channel>,
        joined: &JoinResponse,
        patience: Duration,
    ) -> Result<Self, String> {
        let opened = Self::open(client, NAME, joined.session_epoch, patience).await;
        opened.map_err(|status| format!("the stream was refused: {status}"))
    }

    async fn open(
        client: &mut LearnerClient<Channel>,
        actor: &str,
        session: u64,
        patience: Duration,
    ) -> Result<Self, Status> {
        let (requests, receiver) = mpsc::channel(8);
        let hello = StreamHello { actor_id: actor.to_owned(), session_epoch: session };
        let _ = requests.send(StreamFragmentsRequest { message: Some(Message::Hello(hello)) }).await;
        let answers = client.stream_fragments(ReceiverStream::new(receiver)).await?.into_inner();
        Ok(Self { requests, answers, patience })
    }

    async fn send(&self, message: Message) {
        // If nobody takes it, the answers say why.
        let _ = self.requests.send(StreamFragmentsRequest { message: Some(message) }).await;
    }

    async fn answer(&mut self) -> Result<Answer, String> {
        let answer = tokio::time::timeout(self.patience, self.answers.message()).await;
        let answer = answer.map_err(|_| "no answer came".to_owned())?;
        let answer = answer.map_err(|status| status.message().to_owned())?;
        answer.and_then(|answer| answer.message).ok_or_else(|| "the stream ended".to_owned())
    }

    async fn fragment(&mut self, fragment: WireFragment) -> Result<Outcome, String> {
        self.send(Message::Fragment(fragment)).await;
        match self.answer().await? {
            Answer::Ack(ack) => Ok(ack.outcome()),
            other => Err(format!("no acknowledgement but {other:?}")),
        }
    }

    async fn close(self) -> Result<(), String> {
        let Self { requests, mut answers, patience } = self;
        drop(requests);
        let ended =
            tokio::time::timeout(patience, async { while let Ok(Some(_)) = answers.message().await {} });
        ended.await.map_err(|_| "the learner does not end a stream that its actor ended".to_owned())
    }
}

/// A sound fragment: nothing on the streets, first phases.
fn fragment(
    joined: &JoinResponse,
    scenario: &str,
    episode: u64,
    sequence: u32,
) -> Result<WireFragment, String> {
    const STEPS: u32 = 2;
    let config = Config::from_json(&joined.config_json, "the learner").map_err(|error| error.to_string())?;
    let scenario = Scenario::load(scenario).map_err(|error| error.to_string())?;
    let layout = load_layout(&scenario, &config.env).map_err(|error| error.to_string())?;
    let (steps, agents) = (STEPS as usize, layout.agents());
    let hidden = vec![0.0; agents * usize::try_from(config.model.hidden).unwrap_or(0)];
    let state = if sequence == 0 { Vec::new() } else { hidden };
    Ok(WireFragment::from(&Fragment {
        id: FragmentId { actor: NAME.to_owned(), session_epoch: joined.session_epoch, episode, sequence },
        scenario: scenario.name,
        layout_hash: layout.hash(),
        policy_version: joined.policy_version,
        first_step: sequence * STEPS,
        steps: STEPS,
        counts: vec![0; (steps + 1) * layout.lane_rows() * config.env.detection.bands()],
        phases: vec![0; (steps + 1) * agents],
        actions: vec![0; steps * agents],
        log_probs: vec![-2.0; steps * agents],
        rewards: vec![0.0; steps * agents],
        recurrent: RecurrentState { actor: state.clone(), critic: state },
        end: FragmentEnd::Continues,
    }))
}
