//! One socket: messages go out together, answers come in order, a deadline on each.

use crate::codec::DecodeError;
use crate::intake::Intake;
use crate::outbox::Outbox;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::net::{RecvFlags, SendFlags, recv, send};
use std::io;
use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};

/// Why an answer did not come.
#[derive(Debug)]
pub(crate) enum Fault {
    /// SUMO's end is gone.
    Closed(String),
    /// The deadline passed.
    Timeout,
    /// What came is no message, or what was to be sent would not be one.
    Protocol(DecodeError),
}

impl From<rustix::io::Errno> for Fault {
    fn from(error: rustix::io::Errno) -> Self {
        Self::Closed(io::Error::from(error).to_string())
    }
}

/// A connected socket with its receive buffer. No call on the socket itself blocks: waiting is `poll` alone, until the
/// deadline.
#[derive(Debug)]
pub(crate) struct Connection {
    stream: TcpStream,
    received: Intake,
}

impl Connection {
    /// Connects within `timeout`.
    pub(crate) fn connect(address: SocketAddr, timeout: Duration) -> io::Result<Self> {
        let stream = TcpStream::connect_timeout(&address, timeout.max(Duration::from_millis(1)))?;
        // Small messages: waiting to fill a packet would cost 40 ms each.
        stream.set_nodelay(true)?;
        Ok(Self { stream, received: Intake::default() })
    }

    /// Sends what is still to be sent. While SUMO takes nothing because it waits for its answers to be taken, they are.
    pub(crate) fn send(&mut self, outbox: &mut Outbox, timeout: Duration) -> Result<(), Fault> {
        let deadline = Instant::now().checked_add(timeout);
        while !outbox.unsent().is_empty() {
            match send(&self.stream, outbox.unsent(), SendFlags::DONTWAIT | SendFlags::NOSIGNAL) {
                Ok(0) => return Err(Fault::Closed("the socket takes no more bytes".to_owned())),
                Ok(count) => outbox.sent(count),
                Err(rustix::io::Errno::INTR) => {}
                Err(rustix::io::Errno::AGAIN) => {
                    let ready = self.wait(PollFlags::IN | PollFlags::OUT, deadline)?;
                    if ready.contains(PollFlags::IN) {
                        self.take()?;
                    }
                }
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }

    /// Receives the next answer, whose body is then in [`body`](Self::body); `last` if none is to follow it.
    pub(crate) fn receive(&mut self, last: bool, timeout: Duration) -> Result<(), Fault> {
        let deadline = Instant::now().checked_add(timeout);
        while !self.received.advance().map_err(Fault::Protocol)? {
            if !self.take()? {
                self.wait(PollFlags::IN, deadline)?;
            } else if deadline.is_some_and(|deadline| deadline <= Instant::now()) {
                return Err(Fault::Timeout);
            }
        }
        match self.received.behind() {
            0 => Ok(()),
            _ if !last => Ok(()),
            // Every answer belongs to a message.
            count => Err(Fault::Protocol(DecodeError::Trailing(count))),
        }
    }

    /// The last answer without its length.
    pub(crate) fn body(&self) -> &[u8] {
        self.received.body()
    }

    /// Ends the connection in both directions; a second time does nothing.
    pub(crate) fn shutdown(&self) {
        // An error means that it has ended already.
        let _ = self.stream.shutdown(std::net::Shutdown::Both);
    }

    /// Takes what has come; whether anything had.
    fn take(&mut self) -> Result<bool, Fault> {
        let space = self.received.space().map_err(Fault::Protocol)?;
        match recv(&self.stream, space, RecvFlags::DONTWAIT) {
            Ok((_, 0)) => Err(Fault::Closed("end of the stream".to_owned())),
            Ok((_, count)) => {
                self.received.took(count);
                Ok(true)
            }
            Err(rustix::io::Errno::AGAIN | rustix::io::Errno::INTR) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }

    /// Waits until one of `flags` holds, and says which; `None` is a deadline too far away to be expressed.
    fn wait(&self, flags: PollFlags, deadline: Option<Instant>) -> Result<PollFlags, Fault> {
        let left = match deadline.map(|deadline| deadline.saturating_duration_since(Instant::now())) {
            Some(Duration::ZERO) => return Err(Fault::Timeout),
            left => left.and_then(|left| Timespec::try_from(left).ok()),
        };
        let mut socket = [PollFd::new(&self.stream, flags)];
        match poll(&mut socket, left.as_ref()) {
            Ok(0) => Err(Fault::Timeout),
            Ok(_) => Ok(socket[0].revents()),
            Err(rustix::io::Errno::INTR) => Ok(PollFlags::empty()),
            Err(error) => Err(error.into()),
        }
    }
}
