//! What a dying, hanging or lying SUMO looks like to its owner.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test's helpers may fail as its body may")]

mod common;

use common::{PATIENCE, deps, grid, home, signal, start};
use cross_traci::{Client, ErrorKind, Sumo, SumoCommand, TraciError};
use rustix::process::Signal;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::Duration;

const SHORT: Duration = Duration::from_millis(300);

#[test]
fn a_killed_sumo_is_a_crash_with_the_signal_and_the_last_command() {
    let mut sumo = start();
    sumo.client().simulation_step(10.0).unwrap();
    signal(sumo.pid(), Signal::KILL);
    let error = sumo.client().simulation_step(20.0).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Crashed);
    assert_eq!(error.evidence().unwrap().signal(), Some(9));
    let text = error.to_string();
    let begin = format!(
        "SUMO (pid {}) was killed by signal 9 (SIGKILL) during the simulation step to 20 s",
        sumo.pid()
    );
    assert!(text.starts_with(&begin), "{text}");

    let later = sumo.client().time().unwrap_err();
    assert!(matches!(later, TraciError::Unusable { kind: ErrorKind::Crashed, .. }), "{later}");
    assert_eq!(sumo.close().unwrap_err().kind(), ErrorKind::Crashed);
}

#[test]
fn a_stopped_sumo_is_a_timeout_and_dies_with_its_owner() {
    let mut sumo = start();
    let pid = sumo.pid();
    sumo.client().set_timeout(SHORT);
    signal(pid, Signal::STOP);
    let error = sumo.client().simulation_step(10.0).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Timeout);
    assert!(error.to_string().contains("the simulation step to 10 s within 300ms"), "{error}");
    // The late answer to that step must never be taken for the answer to something else.
    signal(pid, Signal::CONT);
    assert!(matches!(sumo.client().time(), Err(TraciError::Unusable { kind: ErrorKind::Timeout, .. })));
    signal(pid, Signal::STOP);
    assert_eq!(sumo.close().unwrap_err().kind(), ErrorKind::Timeout);
    assert!(!common::runs(pid));
}

#[test]
fn a_sumo_that_hangs_while_it_closes_is_killed_at_the_deadline() {
    let mut sumo = start();
    let pid = sumo.pid();
    sumo.client().set_timeout(SHORT);
    signal(pid, Signal::STOP);
    assert_eq!(sumo.close().unwrap_err().kind(), ErrorKind::Timeout);
    assert!(!common::runs(pid));
}

#[test]
fn a_missing_file_is_reported_in_sumos_own_words() {
    let command = SumoCommand::new().option("-n", "/nowhere/gone.net.xml");
    let error = Sumo::start(&home(), &command, PATIENCE).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Spawn);
    assert_eq!(error.evidence().unwrap().exit_code(), Some(1));
    let text = error.to_string();
    assert!(text.contains("File '/nowhere/gone.net.xml' is not accessible"), "{text}");
    assert!(text.contains("ended while loading with exit code 1"), "{text}");
}

#[test]
fn an_unknown_option_is_reported_in_sumos_own_words() {
    let error = Sumo::start(&home(), &grid().arg("--no-such-option"), PATIENCE).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Spawn);
    assert!(error.to_string().contains("no-such-option"), "{error}");
}

#[test]
fn an_error_in_the_middle_of_a_simulation_carries_what_sumo_printed() {
    let directory = tempfile::tempdir().unwrap();
    let routes = directory.path().join("broken.rou.xml");
    // Read in portions: the broken line is met only when its time comes.
    std::fs::write(
        &routes,
        r#"<routes>
            <vehicle id="good" depart="0"><route edges="A0A1 A1A2"/></vehicle>
            <vehicle id="later" depart="500"><route edges="A0A1 A1A2"/></vehicle>
            <vehicle id="bad" depart="900"><route edges="A0A1 nowhere"/></vehicle>
        </routes>"#,
    )
    .unwrap();
    let net = deps().join("resco/grid4x4/grid4x4.net.xml");
    let command = SumoCommand::new().option("-n", net).option("-r", &routes).option("--route-steps", "10");
    let mut sumo = Sumo::start(&home(), &command, PATIENCE).unwrap();
    sumo.client().simulation_step(100.0).unwrap();
    let error = sumo.client().simulation_step(1000.0).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Crashed);
    assert_eq!(error.evidence().unwrap().exit_code(), Some(1));
    assert!(error.to_string().contains("nowhere"), "{error}");
}

#[test]
fn a_state_of_the_wrong_length_ends_sumo_and_the_error_says_which() {
    let mut sumo = start();
    let error = sumo.client().set_traffic_light_state("A0", "rG").unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Crashed);
    assert!(error.to_string().contains("traffic light 'A0' to 'rG'"), "{error}");
    assert!(error.to_string().contains("Mismatching phase size in tls 'A0'"), "{error}");
}

#[test]
fn nobody_listening_is_an_error_and_not_a_wait() {
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let error = Client::connect(free, PATIENCE).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Crashed);
    assert!(error.to_string().contains(&free.to_string()), "{error}");
}

/// Accepts one client, hands its first message to `serve`, and connects to it.
fn against(serve: impl FnOnce(TcpStream) + Send + 'static, timeout: Duration) -> TraciError {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address: SocketAddr = listener.local_addr().unwrap();
    let server = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut request = [0; 6];
        stream.read_exact(&mut request).unwrap();
        assert_eq!(request, [0, 0, 0, 6, 2, 0]);
        serve(stream);
    });
    let error = Client::connect(address, timeout).unwrap_err();
    server.join().unwrap();
    error
}

fn version_answer(api: i32) -> Vec<u8> {
    let name = b"SUMO 9.9";
    let mut answer = vec![7, 0, 0, 0, 0, 0, 0];
    answer.extend([10 + name.len() as u8, 0]);
    answer.extend(api.to_be_bytes());
    answer.extend((name.len() as i32).to_be_bytes());
    answer.extend(name);
    let mut message = (answer.len() as i32 + 4).to_be_bytes().to_vec();
    message.extend(answer);
    message
}

#[test]
fn other_versions_of_the_protocol_are_refused_by_name() {
    for api in [15, 21, 23, -1, i32::MAX] {
        let error = against(move |mut stream| stream.write_all(&version_answer(api)).unwrap(), PATIENCE);
        assert_eq!(error.kind(), ErrorKind::Protocol);
        let text = error.to_string();
        assert!(text.starts_with(&format!("SUMO 9.9 speaks TraCI API version {api},")), "{text}");
        assert!(text.contains("make build"), "{text}");
    }
}

#[test]
fn answers_that_are_no_traci_end_the_connection_with_a_reason() {
    let cases: [(&[u8], &str); 6] = [
        (&[0x7f, 0xff, 0xff, 0xff, 1, 2, 3], "impossible length"),
        (&[0, 0, 0, 3], "impossible length"),
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", "impossible length"),
        // A status for another command than the one sent.
        (&[0, 0, 0, 11, 7, 2, 0, 0, 0, 0, 0], "the status of command"),
        // A status, then nothing where the version should be.
        (&[0, 0, 0, 11, 7, 0, 0, 0, 0, 0, 0], "end early"),
        // A second message that nobody asked for.
        (&[0, 0, 0, 5, 9, 0, 0, 0, 5, 9], "left over"),
    ];
    for (answer, reason) in cases {
        let error = against(move |mut stream| stream.write_all(answer).unwrap(), PATIENCE);
        assert_eq!(error.kind(), ErrorKind::Protocol, "{error}");
        assert!(error.to_string().contains(reason), "{error}");
    }
}

#[test]
fn a_connection_cut_inside_an_answer_is_a_crash() {
    let error = against(|mut stream| stream.write_all(&version_answer(22)[..9]).unwrap(), PATIENCE);
    assert_eq!(error.kind(), ErrorKind::Crashed);
    assert!(error.to_string().contains("the version request"), "{error}");
}

#[test]
fn the_deadline_is_for_the_whole_answer_and_not_for_each_byte() {
    let error = against(
        |mut stream| {
            // Announces a thousand bytes and sends one now and then, until the client has had enough.
            let mut next = [0, 0, 4, 0].into_iter().chain(std::iter::repeat(1));
            while stream.write_all(&[next.next().unwrap()]).is_ok() {
                std::thread::sleep(Duration::from_millis(10));
            }
        },
        SHORT,
    );
    assert_eq!(error.kind(), ErrorKind::Timeout, "{error}");
}
