//! An episode by the program of another client.
//!
//! ```text
//!   bench                                       client program
//!   start it, with the file of a job ─────────> starts, reads the job
//!                        <──────────── "ready"
//!   clock starts, SUMO starts, its port ──────> connects, drives the episode, closes
//!                        <──────────── CPU seconds since the port
//!   SUMO ends, clock stops, end of input ─────> writes what it saw, ends
//! ```
//! So the starts of a language and what is written for the comparison count for nobody, and SUMO's start and end for
//! everybody. Both processes are tied to this one: whatever ends it ends them.

use super::clients::{Client, last_line};
use super::job::Job;
use super::seen::Seen;
use crate::cost::{Cost, measured};
use crate::error::BenchError;
use crate::folder::folder;
use cross_sim::SimError;
use cross_sim::lanes::LaneTable;
use cross_traci::sumo::{SumoServer, spawn_tied};
use cross_traci::{SumoCommand, SumoHome, TraciError};
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Stdio};
use std::time::Duration;

/// Longest time that SUMO may take to start or to end.
const PATIENCE: Duration = Duration::from_secs(60);
/// How long SUMO may take to end once its client has failed.
const SHORT: Duration = Duration::from_secs(2);

/// Drives an episode on a SUMO of its own; `lanes` counts what the client saw.
pub(super) fn episode(
    client: &Client,
    job: &Job,
    home: &SumoHome,
    sumo: &SumoCommand,
    lanes: &mut LaneTable,
) -> Result<(Cost, Seen), BenchError> {
    let folder = folder()?;
    let seen = folder.path().join("seen.txt");
    let mut talk = Talk::start(client, job, folder.path(), &seen)?;
    talk.hear("ready")?;
    let (seconds, cost) = measured(|| {
        let server = SumoServer::start(home, sumo, PATIENCE).map_err(SimError::from)?;
        let answer = talk.tell(server.port()).and_then(|()| talk.hear("cpu "));
        match answer {
            Ok(answer) => {
                server.wait(PATIENCE).map_err(SimError::from)?;
                Ok(answer)
            }
            // Which of the two failed first is not known; both are asked for their last words. A SUMO that goes on has none.
            Err(error) => Err(match server.wait(SHORT) {
                Err(sumo @ TraciError::Crashed { .. }) => error.beside(&sumo.to_string()),
                _ => error,
            }),
        }
    })?;
    let client_cpu: f64 = seconds.parse().map_err(|_| talk.misunderstood(&seconds))?;
    talk.end()?;
    // The client is waited for only now, so that what this process's ended children took is SUMO's time.
    let cost = Cost { cpu: cost.cpu + client_cpu, own_cpu: cost.own_cpu + client_cpu, ..cost };
    Ok((cost, Seen::read(&seen, lanes)?))
}

/// The conversation with a client program; dropped, the program is killed.
struct Talk {
    title: String,
    child: Child,
    input: Option<ChildStdin>,
    output: BufReader<ChildStdout>,
    errors: PathBuf,
}

impl Talk {
    fn start(client: &Client, job: &Job, folder: &Path, seen: &Path) -> Result<Self, BenchError> {
        let write = |path: &Path, source| BenchError::Write { path: path.to_owned(), source };
        let (task, errors) = (folder.join("job.json"), folder.join("errors.txt"));
        // Plain data serialises.
        let text = serde_json::to_vec(job).expect("a job serialises");
        std::fs::write(&task, text).map_err(|source| write(&task, source))?;
        // A file and no pipe: nobody reads it unless the program fails.
        let file = File::create(&errors).map_err(|source| write(&errors, source))?;
        let mut command = client.command();
        command.arg(&task).arg(seen);
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(file);
        let title = client.title.clone();
        let failed = |source| BenchError::ClientStart { client: client.title.clone(), source };
        let mut child = spawn_tied(command).map_err(failed)?;
        let (Some(input), Some(output)) = (child.stdin.take(), child.stdout.take()) else {
            return Err(failed(std::io::Error::other("it has no pipes")));
        };
        Ok(Self { title, child, input: Some(input), output: BufReader::new(output), errors })
    }

    /// Tells the port.
    fn tell(&mut self, port: u16) -> Result<(), BenchError> {
        match self.input.as_mut().map(|input| writeln!(input, "{port}")) {
            Some(Ok(())) => Ok(()),
            _ => Err(self.failure()),
        }
    }

    /// Waits for the line that begins so, and gives the rest of it.
    fn hear(&mut self, begin: &str) -> Result<String, BenchError> {
        let mut line = String::new();
        match self.output.read_line(&mut line) {
            Ok(0) | Err(_) => Err(self.failure()),
            Ok(_) => match line.trim_end().strip_prefix(begin) {
                Some(rest) => Ok(rest.to_owned()),
                None => Err(self.misunderstood(line.trim_end())),
            },
        }
    }

    /// Lets it write what it saw, and waits for its end.
    fn end(&mut self) -> Result<(), BenchError> {
        drop(self.input.take());
        // It says no more; this waits until it has closed its output.
        let _ = self.output.read_to_end(&mut Vec::new());
        match self.child.wait() {
            Ok(status) if status.success() => Ok(()),
            _ => Err(self.failure()),
        }
    }

    fn misunderstood(&self, said: &str) -> BenchError {
        BenchError::ClientAnswer { client: self.title.clone(), said: said.to_owned() }
    }

    /// Why it has ended, as it has or is about to.
    fn failure(&mut self) -> BenchError {
        let client = self.title.clone();
        match self.child.wait() {
            Ok(status) => {
                let said = last_line(&std::fs::read(&self.errors).unwrap_or_default());
                BenchError::Client { client, status, said, sumo: String::new() }
            }
            Err(source) => BenchError::ClientStart { client, source },
        }
    }
}

impl Drop for Talk {
    fn drop(&mut self) {
        // Fails only if it has ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
