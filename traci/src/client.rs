//! The client: typed calls, a deadline on every one.
//!
//! A call sends one message and waits for the answer. Where the answer to one message does not decide the next,
//! [`Batch::post`] and [`Client::post_step`] let SUMO go on from one to the other without waiting for us: messages that
//! are posted go out together, at the latest with the next call, and are answered in order.

use crate::argument::Argument;
use crate::batch::{Batch, Replies};
use crate::codec::{DecodeError, Reader, Writer};
use crate::connection::{Connection, Fault};
use crate::constants::{API_VERSION, Domain, OLDEST_API_VERSION, command};
use crate::error::{ErrorKind, Evidence, TraciError};
use crate::outbox::{Commands, Outbox};
use crate::reply::{self, Answer, describe, describe_message};
use crate::subscription::{Subscription, SubscriptionResults};
use crate::sumo::Process;
use std::io::ErrorKind as IoErrorKind;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// How long a SUMO whose connection broke may take to end, before the error is made without its exit code.
const EXIT_PATIENCE: Duration = Duration::from_secs(2);

/// What a connection has carried so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Statistics {
    /// Messages sent, each of one or more commands.
    pub messages: u64,
    /// Commands sent.
    pub commands: u64,
    /// Bytes sent.
    pub bytes_sent: u64,
    /// Bytes received.
    pub bytes_received: u64,
    /// Time spent waiting for the answers to `simulationStep`: SUMO's work, almost all of it.
    pub stepping: Duration,
    /// The same for all other messages.
    pub other: Duration,
}

/// A connection to one SUMO. Calls block the calling thread: keep it off an async runtime's workers.
#[derive(Debug)]
pub struct Client {
    connection: Connection,
    outbox: Outbox,
    /// The answers to the message that was answered last.
    answers: Vec<Answer>,
    timeout: Duration,
    process: Option<Arc<Process>>,
    version: (u32, String),
    failed: Option<(ErrorKind, String)>,
    closed: bool,
    statistics: Statistics,
}

impl Client {
    /// Connects to a SUMO that somebody else started with `--remote-port`, and checks its version. `timeout` is the
    /// deadline for that and for every later call.
    ///
    /// # Errors
    /// [`TraciError::Crashed`] if nothing listens there, [`TraciError::Version`], [`TraciError::Timeout`].
    pub fn connect(address: SocketAddr, timeout: Duration) -> Result<Self, TraciError> {
        let begun = Instant::now();
        let connection = Connection::connect(address, timeout).map_err(|error| {
            let command = format!("connecting to {address}");
            match error.kind() {
                IoErrorKind::TimedOut | IoErrorKind::WouldBlock => {
                    TraciError::Timeout { command, after: timeout, evidence: Box::default() }
                }
                _ => TraciError::Crashed { command, detail: error.to_string(), evidence: Box::default() },
            }
        })?;
        Self::attach(connection, timeout.saturating_sub(begun.elapsed()), timeout, None)
    }

    /// Takes over a connection to a SUMO whose process errors are to tell of. `handshake` is the time for the version
    /// check, which SUMO answers only when it has loaded everything.
    pub(crate) fn attach(
        connection: Connection,
        handshake: Duration,
        timeout: Duration,
        process: Option<Arc<Process>>,
    ) -> Result<Self, TraciError> {
        let mut client = Self {
            connection,
            outbox: Outbox::default(),
            answers: Vec::new(),
            timeout: handshake,
            process,
            version: (0, String::new()),
            failed: None,
            closed: false,
            statistics: Statistics::default(),
        };
        client.handshake()?;
        client.timeout = timeout;
        Ok(client)
    }

    fn handshake(&mut self) -> Result<(), TraciError> {
        let (api, identifier) = self.request_version()?;
        if !(OLDEST_API_VERSION..=API_VERSION).contains(&api) {
            self.connection.shutdown();
            let error = TraciError::Version {
                found: api,
                identifier,
                oldest: OLDEST_API_VERSION,
                newest: API_VERSION,
            };
            return Err(self.fail(error));
        }
        self.version = (api.unsigned_abs(), identifier);
        Ok(())
    }

    fn request_version(&mut self) -> Result<(i32, String), TraciError> {
        self.begin();
        self.push(command::GET_VERSION, |_| {});
        self.run()?;
        let read = match self.answers.first() {
            Some(Answer::Version(range)) => {
                let mut reader = Reader::new(&self.connection.body()[range.clone()]);
                reader.i32().and_then(|api| Ok((api, reader.str()?.to_owned())))
            }
            _ => Err(DecodeError::Type { expected: "a version", found: "none" }),
        };
        read.map_err(|source| self.protocol(source))
    }

    /// SUMO's TraCI API version and its name with its version, such as `(22, "SUMO 1.28.0")`.
    pub fn version(&self) -> (u32, &str) {
        (self.version.0, &self.version.1)
    }

    /// The deadline of every call.
    pub fn timeout(&self) -> Duration {
        self.timeout
    }

    /// Changes the deadline of every later call.
    pub fn set_timeout(&mut self, timeout: Duration) {
        self.timeout = timeout;
    }

    /// What this connection has carried so far.
    pub fn statistics(&self) -> Statistics {
        self.statistics
    }

    /// Simulates until `to` seconds, in one command however many steps that are, and brings what is subscribed, as of
    /// then. Zero makes one step; a time that has passed makes none and brings the last results again.
    ///
    /// # Errors
    /// [`TraciError::Refused`] for a time that is no number; any other error ends the connection.
    pub fn simulation_step(&mut self, to: f64) -> Result<SubscriptionResults<'_>, TraciError> {
        self.begin_step(to)?;
        self.run()?;
        Ok(self.subscriptions())
    }

    pub(crate) fn begin_step(&mut self, to: f64) -> Result<(), TraciError> {
        self.begin();
        self.push(command::SIMULATION_STEP, |w| {
            w.f64(to);
        });
        if to.is_finite() {
            return Ok(());
        }
        Err(TraciError::Refused {
            command: describe_message(self.outbox.written()),
            message: "the time to simulate to must be a finite number of seconds".to_owned(),
            refused: 1,
            sent: 1,
        })
    }

    /// The results of the last [`simulation_step`](Self::simulation_step), or of the step that was [taken](Self::take) last,
    /// if nothing was called since.
    pub fn subscriptions(&self) -> SubscriptionResults<'_> {
        self.replies().step().unwrap_or_default()
    }

    /// Begins a message of several commands.
    pub fn batch(&mut self) -> Batch<'_> {
        Batch::new(self)
    }

    /// Sets the signal of every link of a traffic light, as `rRyYgGsuoO`. For several lights use
    /// [`batch`](Self::batch).
    ///
    /// # Errors
    /// [`TraciError::Refused`] for an unknown light; others end the connection. A state of another length than the
    /// light has links ends SUMO itself: [`TraciError::Crashed`].
    pub fn set_traffic_light_state(&mut self, id: &str, state: &str) -> Result<(), TraciError> {
        let mut batch = self.batch();
        batch.set_traffic_light_state(id, state);
        batch.send().map(drop)
    }

    /// Sets a variable.
    ///
    /// # Errors
    /// [`TraciError::Refused`] with SUMO's message; others end the connection.
    pub fn set(
        &mut self,
        domain: Domain,
        variable: u8,
        object: &str,
        value: Argument<'_>,
    ) -> Result<(), TraciError> {
        let mut batch = self.batch();
        batch.set(domain, variable, object, value);
        batch.send().map(drop)
    }

    /// Subscribes to variables of one object, and gives their values as of now.
    ///
    /// # Errors
    /// As [`set`](Self::set).
    pub fn subscribe(
        &mut self,
        domain: Domain,
        object: &str,
        variables: &[u8],
    ) -> Result<Subscription<'_>, TraciError> {
        let mut batch = self.batch();
        batch.subscribe(domain, object, variables);
        batch.send()?.subscription(0)
    }

    /// Subscribes to variables of all objects of the domain `of` within `range` metres of one object, and gives their
    /// values as of now. With a range larger than the network that is every object.
    ///
    /// SUMO works the values out after every simulated second, also within a step of many, though it sends only the
    /// last. To look only now and then, [`look_around`](Self::look_around) costs far less.
    ///
    /// # Errors
    /// As [`set`](Self::set).
    pub fn subscribe_context(
        &mut self,
        domain: Domain,
        object: &str,
        range: f64,
        of: Domain,
        variables: &[u8],
    ) -> Result<Subscription<'_>, TraciError> {
        let mut batch = self.batch();
        batch.subscribe_context(domain, object, range, of, variables);
        batch.send()?.subscription(0)
    }

    /// Reads variables of all objects of the domain `of` within `range` metres of one object, once: a context
    /// subscription that ends in the message that makes it. It also ends every other context subscription around that
    /// object.
    ///
    /// One round trip, and nothing in between; but SUMO searches the network for whatever is in the range. Where ids are
    /// known or asked for first, reading the same values in one [`batch`](Self::batch) takes half of the time.
    ///
    /// SUMO forgets a subscription that has ended with the next step only: looking around many times in the same second
    /// gets slower each time.
    ///
    /// # Errors
    /// As [`set`](Self::set).
    pub fn look_around(
        &mut self,
        domain: Domain,
        object: &str,
        range: f64,
        of: Domain,
        variables: &[u8],
    ) -> Result<Subscription<'_>, TraciError> {
        let mut batch = self.batch();
        batch.subscribe_context(domain, object, range, of, variables);
        batch.subscribe_context(domain, object, range, of, &[]);
        batch.send()?.subscription(0)
    }

    /// Ends a variable subscription.
    ///
    /// # Errors
    /// As [`set`](Self::set).
    pub fn unsubscribe(&mut self, domain: Domain, object: &str) -> Result<(), TraciError> {
        let mut batch = self.batch();
        batch.subscribe(domain, object, &[]);
        batch.send().map(drop)
    }

    /// Sets this client's place among several of one SUMO, lowest first. Needed only with `--num-clients` above one.
    ///
    /// # Errors
    /// [`TraciError::Refused`] if the place is taken.
    pub fn set_order(&mut self, order: i32) -> Result<(), TraciError> {
        self.begin();
        self.push(command::SET_ORDER, |w| {
            w.i32(order);
        });
        self.run()
    }

    /// Replaces the simulation by another with these SUMO arguments (without `--remote-port`), and waits until it is
    /// loaded. Subscriptions end. SUMO's memory grows a little with each load: a new process does not.
    ///
    /// # Errors
    /// [`TraciError::Crashed`], with what SUMO printed, if it cannot be loaded: SUMO ends then.
    pub fn load(&mut self, arguments: &[&str]) -> Result<(), TraciError> {
        self.begin();
        self.push(command::LOAD, |w| Argument::StrList(arguments).write(w));
        self.run()?;
        // SUMO agrees before it reads a single file; this is answered only when everything is loaded.
        self.request_version().map(drop)
    }

    /// Ends the connection, whereupon SUMO writes its outputs and ends. A second time does nothing.
    ///
    /// # Errors
    /// As every call, and [`TraciError::Unusable`] after an earlier failure; the connection has ended in any case.
    pub fn close(&mut self) -> Result<(), TraciError> {
        if self.closed {
            return Ok(());
        }
        self.begin();
        self.push(command::CLOSE, |_| {});
        let outcome = self.run();
        self.closed = true;
        self.connection.shutdown();
        outcome
    }

    /// Begins a message.
    pub(crate) fn begin(&mut self) {
        self.outbox.begin();
        self.answers.clear();
    }

    /// Adds a command to the message.
    pub(crate) fn push(&mut self, id: u8, body: impl FnOnce(&mut Writer<'_>)) {
        self.outbox.push(id, body);
    }

    /// Number of commands in the message.
    pub(crate) fn commands(&self) -> usize {
        self.outbox.commands()
    }

    /// The answers to the message that was answered last.
    pub(crate) fn replies(&self) -> Replies<'_> {
        let Commands { bytes: sent, starts } = self.outbox.answered();
        Replies { answers: &self.answers, body: self.connection.body(), sent, starts }
    }

    /// Completes the message, to be sent with the next that is waited for.
    pub(crate) fn post(&mut self) -> Result<(), TraciError> {
        if self.closed || self.failed.is_some() {
            return Err(self.unusable());
        }
        self.outbox.post().map_err(|source| {
            let command = describe_message(self.outbox.written());
            let error =
                TraciError::Protocol { command, source, evidence: gather(self.process.as_ref(), false) };
            self.fail(error)
        })
    }

    /// Sends the message and all that is posted, and reads their answers; this message's are kept. If several were
    /// refused, the first is told of.
    pub(crate) fn run(&mut self) -> Result<(), TraciError> {
        self.post()?;
        self.send()?;
        let mut refused = None;
        while self.outbox.waiting() > 0 {
            match self.receive() {
                Err(error @ TraciError::Refused { .. }) => {
                    refused.get_or_insert(error);
                }
                outcome => outcome?,
            }
        }
        refused.map_or(Ok(()), Err)
    }

    /// Sends what is posted.
    pub(crate) fn send(&mut self) -> Result<(), TraciError> {
        let outcome = self.connection.send(&mut self.outbox, self.timeout);
        outcome.map_err(|fault| self.fault(fault))
    }

    /// Messages that are posted and not answered.
    pub(crate) fn unanswered(&self) -> usize {
        self.outbox.waiting()
    }

    /// Reads the answer to the oldest message.
    pub(crate) fn receive(&mut self) -> Result<(), TraciError> {
        let begun = Instant::now();
        let outcome = self.connection.receive(self.outbox.waiting() == 1, self.timeout);
        self.count(begun.elapsed());
        outcome.map_err(|fault| self.fault(fault))?;
        let Commands { bytes, starts } = self.outbox.awaited();
        reply::read(bytes, starts, self.connection.body(), &mut self.answers)
            .map_err(|source| self.protocol(source))?;
        self.outbox.settle();
        self.refusals()
    }

    /// Why the message cannot be sent.
    fn unusable(&self) -> TraciError {
        let command = describe_message(self.outbox.written());
        let (kind, earlier) = self.failed.clone().unwrap_or((ErrorKind::Refused, "it was closed".to_owned()));
        TraciError::Unusable { command, kind, earlier }
    }

    /// Counts the oldest message, whose answer took so long.
    fn count(&mut self, took: Duration) {
        let message = self.outbox.awaited();
        let statistics = &mut self.statistics;
        statistics.messages += 1;
        statistics.commands += message.starts.len() as u64;
        statistics.bytes_sent += message.len() as u64;
        statistics.bytes_received += self.connection.body().len() as u64 + 4;
        if message.is_step() {
            statistics.stepping += took;
        } else {
            statistics.other += took;
        }
    }

    fn refusals(&self) -> Result<(), TraciError> {
        let refused = || {
            self.answers.iter().enumerate().filter_map(|(index, answer)| match answer {
                Answer::Refused(range) => Some((index, range)),
                _ => None,
            })
        };
        let Some((index, range)) = refused().next() else { return Ok(()) };
        let Commands { bytes, starts } = self.outbox.answered();
        Err(TraciError::Refused {
            command: describe(starts.get(index).map_or(&[], |&start| &bytes[start..])),
            message: String::from_utf8_lossy(&self.connection.body()[range.clone()]).into_owned(),
            refused: refused().count(),
            sent: starts.len(),
        })
    }

    fn fault(&mut self, fault: Fault) -> TraciError {
        let command = describe_message(self.outbox.awaited());
        let process = self.process.as_ref();
        let error = match fault {
            Fault::Closed(detail) => TraciError::Crashed { command, detail, evidence: gather(process, true) },
            Fault::Timeout => {
                TraciError::Timeout { command, after: self.timeout, evidence: gather(process, false) }
            }
            Fault::Protocol(source) => {
                TraciError::Protocol { command, source, evidence: gather(process, false) }
            }
        };
        self.fail(error)
    }

    fn protocol(&mut self, source: DecodeError) -> TraciError {
        self.fault(Fault::Protocol(source))
    }

    /// Remembers that commands and answers are out of step from here on.
    fn fail(&mut self, error: TraciError) -> TraciError {
        self.connection.shutdown();
        self.failed = Some((error.kind(), error.to_string()));
        error
    }
}

fn gather(process: Option<&Arc<Process>>, ending: bool) -> Box<Evidence> {
    let patience = if ending { EXIT_PATIENCE } else { Duration::ZERO };
    Box::new(process.map(|process| process.evidence(patience)).unwrap_or_default())
}
