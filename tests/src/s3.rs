//! A local S3 server.

use crate::binaries::without_own_variables;
use crate::http;
use crate::tools::Tools;
use crate::wait;
use std::net::TcpListener;
use std::process::{Child, Stdio};

/// A running server; ended when dropped. What it holds is in its memory.
#[derive(Debug)]
pub struct S3 {
    child: Child,
    address: String,
    log: tempfile::TempDir,
}

/// The bucket that every server starts with.
pub const BUCKET: &str = "cross";
/// Objects are private: the server wants to see a signature, and does not look at it.
const ANYBODY: &str = "Authorization: AWS AKIAEXAMPLE:x\r\n";
/// A secret that must not appear anywhere.
pub const SECRET: &str = "a-secret-that-nobody-may-see";

impl S3 {
    /// Starts a server that takes any credentials.
    #[must_use]
    pub fn start(tools: &Tools) -> Self {
        Self::start_anywhere(tools, false)
    }

    /// Starts a server that knows nobody: all credentials are wrong.
    #[must_use]
    pub fn start_closed(tools: &Tools) -> Self {
        Self::start_anywhere(tools, true)
    }

    fn start_anywhere(tools: &Tools, closed: bool) -> Self {
        loop {
            // It cannot be asked which port it took, so it is told one that was free a moment ago. Somebody may have taken
            // that since; then, and only then, another one is tried.
            let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string();
            match Self::try_start_at(tools, &address, closed) {
                Ok(server) => return server,
                Err(log) => assert!(log.contains("in use"), "the S3 server ended: {log}"),
            }
        }
    }

    /// Starts a server where an earlier one was.
    #[must_use]
    pub fn start_at(tools: &Tools, address: &str, closed: bool) -> Self {
        let started = Self::try_start_at(tools, address, closed);
        started.unwrap_or_else(|log| panic!("the S3 server ended: {log}"))
    }

    /// The server, or what one that ended at once had to say.
    fn try_start_at(tools: &Tools, address: &str, closed: bool) -> Result<Self, String> {
        let log = tempfile::tempdir().unwrap();
        let (host, port) = address.split_once(':').unwrap();
        let mut command = tools.python();
        without_own_variables(&mut command);
        command.args(["-m", "moto.server", "-H", host, "-p", port]);
        if closed {
            // The making of the bucket; after that, signatures are looked at.
            command.env("INITIAL_NO_AUTH_ACTION_COUNT", "1");
        }
        let child = command
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(std::fs::File::create(log.path().join("log")).unwrap())
            .spawn()
            .unwrap();
        let mut server = Self { child, address: address.to_owned(), log };
        let began = wait::until("the S3 server", || {
            // Its end is looked at last: on a port that was taken, somebody else may answer.
            let answer = http::request("PUT", &server.address, &format!("/{BUCKET}"), "");
            if server.child.try_wait().unwrap().is_some() {
                return Some(Err(server.said()));
            }
            let (status, _) = answer?;
            assert_eq!(status, 200, "{}", server.said());
            Some(Ok(()))
        });
        began.map(|()| server)
    }

    fn said(&self) -> String {
        std::fs::read_to_string(self.log.path().join("log")).unwrap_or_default()
    }

    /// Where it listens.
    #[must_use]
    pub fn address(&self) -> &str {
        &self.address
    }

    /// What a program must have in its environment to use it.
    #[must_use]
    pub fn environment(&self) -> Vec<(&'static str, String)> {
        environment(&self.address)
    }

    /// An object of the bucket.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<Vec<u8>> {
        self.get_of(BUCKET, name)
    }

    /// An object of any bucket.
    #[must_use]
    pub fn get_of(&self, bucket: &str, name: &str) -> Option<Vec<u8>> {
        let (status, body) = http::request("GET", &self.address, &format!("/{bucket}/{name}"), ANYBODY)?;
        (status == 200).then_some(body)
    }

    /// Removes an object of the bucket.
    pub fn remove(&self, name: &str) {
        let (status, _) =
            http::request("DELETE", &self.address, &format!("/{BUCKET}/{name}"), ANYBODY).unwrap();
        assert_eq!(status, 204);
    }
}

/// What a program must have in its environment to use a server at this address.
#[must_use]
pub fn environment(address: &str) -> Vec<(&'static str, String)> {
    [
        ("AWS_ENDPOINT_URL", format!("http://{address}")),
        ("AWS_ALLOW_HTTP", "true".to_owned()),
        ("AWS_REGION", "eu-west-1".to_owned()),
        ("AWS_ACCESS_KEY_ID", "AKIAEXAMPLE".to_owned()),
        ("AWS_SECRET_ACCESS_KEY", SECRET.to_owned()),
    ]
    .into()
}

impl Drop for S3 {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
