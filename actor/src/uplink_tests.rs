use super::*;

const JOIN: u64 = 1;
const EPOCH: u64 = 5;

fn fragment(episode: u64, sequence: u32) -> Record {
    Record::Fragment(Box::new(v1::Fragment { episode, sequence, session_epoch: EPOCH, ..Default::default() }))
}

fn connected(limit: usize) -> Uplink {
    let mut uplink = Uplink::new("a".into());
    assert_eq!(uplink.open(JOIN, EPOCH, limit), 0);
    assert_eq!(drain(&mut uplink), ["hello 5"]);
    uplink
}

/// Sends everything that waits, as short words.
fn drain(uplink: &mut Uplink) -> Vec<String> {
    std::iter::from_fn(|| uplink.next_message())
        .map(|request| match request.message.unwrap() {
            Message::Hello(hello) => format!("hello {}", hello.session_epoch),
            Message::Fragment(f) => format!("fragment {}.{}", f.episode, f.sequence),
            Message::EpisodeRequest(_) => "request".into(),
            Message::EpisodeAborted(aborted) => format!("aborted {} {}", aborted.episode, aborted.reason),
            Message::Heartbeat(_) => "heartbeat".into(),
        })
        .collect()
}

#[test]
fn no_more_fragments_than_the_limit_are_in_flight() {
    let mut uplink = connected(2);
    uplink.accept(JOIN, fragment(1, 0));
    assert!(!uplink.has_room(), "one is not sent yet");
    drain(&mut uplink);
    uplink.accept(JOIN, fragment(1, 1));
    drain(&mut uplink);
    assert!(!uplink.has_room(), "two are in flight");
    assert!(uplink.acknowledge(1, 0));
    assert!(uplink.has_room());
}

#[test]
fn a_reconnection_within_the_session_sends_again_what_is_not_acknowledged_in_order() {
    let mut uplink = connected(4);
    for sequence in 0..3 {
        uplink.accept(JOIN, fragment(1, sequence));
    }
    drain(&mut uplink);
    assert!(uplink.acknowledge(1, 1));
    assert_eq!(uplink.open(JOIN, EPOCH, 4), 0);
    assert_eq!(drain(&mut uplink), ["hello 5", "fragment 1.0", "fragment 1.2"]);
    assert_eq!(uplink.unacked(), 2);
}

#[test]
fn an_unanswered_request_is_asked_again_and_an_answered_one_is_not() {
    let mut uplink = connected(4);
    uplink.accept(JOIN, Record::Request);
    drain(&mut uplink);
    uplink.open(JOIN, EPOCH, 4);
    assert_eq!(drain(&mut uplink), ["hello 5", "request"]);
    assert!(uplink.assigned());
    uplink.open(JOIN, EPOCH, 4);
    assert_eq!(drain(&mut uplink), ["hello 5"]);
}

#[test]
fn an_assignment_that_nobody_asked_for_is_not_taken() {
    let mut uplink = connected(4);
    assert!(!uplink.assigned());
    uplink.accept(JOIN, Record::Request);
    assert!(uplink.assigned());
    assert!(!uplink.assigned());
}

#[test]
fn another_session_drops_and_reports_what_the_old_one_had() {
    let mut uplink = connected(4);
    uplink.accept(JOIN, fragment(1, 0));
    uplink.accept(JOIN, fragment(1, 1));
    uplink.accept(JOIN, Record::Request);
    assert_eq!(uplink.open(JOIN + 1, EPOCH + 1, 4), 2);
    assert_eq!(drain(&mut uplink), ["hello 6"]);
    assert!(uplink.is_idle());
    // What the simulator made before it heard of the new session.
    assert_eq!(uplink.accept(JOIN, fragment(1, 2)), Accepted::OtherSession { fragment: true });
    assert_eq!(uplink.accept(JOIN, Record::Request), Accepted::OtherSession { fragment: false });
    assert!(uplink.is_idle() && !uplink.assigned());
}

#[test]
fn acknowledgements_of_unknown_fragments_change_nothing() {
    let mut uplink = connected(4);
    uplink.accept(JOIN, fragment(1, 0));
    drain(&mut uplink);
    assert!(!uplink.acknowledge(1, 1));
    assert!(!uplink.acknowledge(2, 0));
    assert_eq!(uplink.unacked(), 1);
    assert!(uplink.acknowledge(1, 0));
    assert!(!uplink.acknowledge(1, 0), "acknowledged twice");
}

#[test]
fn a_fragment_acknowledged_before_it_is_sent_again_is_not_sent_again() {
    let mut uplink = connected(4);
    uplink.accept(JOIN, fragment(1, 0));
    uplink.accept(JOIN, fragment(1, 1));
    drain(&mut uplink);
    uplink.open(JOIN, EPOCH, 4);
    assert!(uplink.acknowledge(1, 0));
    assert_eq!(drain(&mut uplink), ["hello 5", "fragment 1.1"]);
}

#[test]
fn heartbeats_are_sent_only_into_silence() {
    let mut uplink = connected(4);
    uplink.accept(JOIN, fragment(1, 0));
    uplink.heartbeat();
    assert_eq!(drain(&mut uplink), ["fragment 1.0"]);
    uplink.heartbeat();
    uplink.heartbeat();
    assert_eq!(drain(&mut uplink), ["heartbeat"]);
}

#[test]
fn refused_fragments_are_dropped_and_counted() {
    let mut uplink = connected(4);
    uplink.accept(JOIN, fragment(1, 0));
    drain(&mut uplink);
    uplink.accept(JOIN, fragment(1, 1));
    assert_eq!(uplink.discard_unacked(), 2);
    uplink.open(JOIN, EPOCH, 4);
    assert_eq!(drain(&mut uplink), ["hello 5"]);
}

#[test]
fn an_abort_goes_out_behind_the_fragments_before_it() {
    let mut uplink = connected(4);
    uplink.accept(JOIN, fragment(3, 0));
    uplink.accept(JOIN, Record::Aborted { episode: 3, reason: "SUMO_CRASHED" });
    assert_eq!(drain(&mut uplink), ["fragment 3.0", "aborted 3 SUMO_CRASHED"]);
}

#[test]
fn joining_again_in_the_same_session_keeps_fragments_and_forgets_the_request() {
    let mut uplink = connected(4);
    uplink.accept(JOIN, fragment(1, 0));
    uplink.accept(JOIN, Record::Request);
    assert_eq!(uplink.open(JOIN + 1, EPOCH, 4), 0);
    assert_eq!(drain(&mut uplink), ["hello 5", "fragment 1.0"]);
    assert_eq!(uplink.accept(JOIN, Record::Request), Accepted::OtherSession { fragment: false });
    assert!(!uplink.assigned());
}
