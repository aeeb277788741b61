//! A SUMO that waits for somebody else's client.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test's helpers may fail as its body may")]

mod common;

use common::{PATIENCE, eventually, grid, home, runs};
use cross_traci::sumo::SumoServer;
use cross_traci::{Client, ErrorKind, SumoCommand};
use std::net::{Ipv4Addr, SocketAddr};

fn address(server: &SumoServer) -> SocketAddr {
    SocketAddr::from((Ipv4Addr::LOCALHOST, server.port()))
}

fn connect(server: &SumoServer) -> Client {
    Client::connect(address(server), PATIENCE).unwrap()
}

#[test]
fn it_serves_a_client_and_ends_with_it() {
    let server = SumoServer::start(&home(), &grid(), PATIENCE).unwrap();
    let mut client = connect(&server);
    client.simulation_step(5.0).unwrap();
    assert_eq!(client.time().unwrap(), 5.0);
    client.close().unwrap();
    assert!(server.wait(PATIENCE).unwrap().status.success());
}

#[test]
fn dropped_it_is_killed_with_or_without_a_client() {
    for connected in [false, true] {
        let server = SumoServer::start(&home(), &grid(), PATIENCE).unwrap();
        let pid = server.pid();
        let client = connected.then(|| connect(&server));
        drop(server);
        assert!(eventually(|| !runs(pid)), "connected: {connected}");
        drop(client);
    }
}

#[test]
fn what_its_files_lack_is_told_at_its_end() {
    let command = SumoCommand::new().option("-n", "/nowhere/town.net.xml");
    let server = SumoServer::start(&home(), &command, PATIENCE).unwrap();
    // SUMO looks at its files once it has its client, who only sees it go.
    let error = Client::connect(address(&server), PATIENCE).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Crashed);
    assert!(!error.to_string().contains("town.net.xml"), "{error}");
    let error = server.wait(PATIENCE).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Crashed);
    assert!(error.to_string().contains("town.net.xml"), "{error}");
}
