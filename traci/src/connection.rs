//! One socket, one message at a time, a deadline on each.

use crate::codec::{DecodeError, MAX_MESSAGE};
use crate::intake::Intake;
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};

/// Why a message did not come back.
#[derive(Debug)]
pub(crate) enum Fault {
    /// SUMO's end is gone.
    Closed(String),
    /// The deadline passed.
    Timeout,
    /// What came is no message, or what was to be sent would not be one.
    Protocol(DecodeError),
}

impl From<io::Error> for Fault {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => Self::Timeout,
            _ => Self::Closed(error.to_string()),
        }
    }
}

/// A connected socket with its receive buffer.
#[derive(Debug)]
pub(crate) struct Connection {
    stream: TcpStream,
    received: Intake,
}

impl Connection {
    /// Connects within `timeout`.
    pub(crate) fn connect(address: SocketAddr, timeout: Duration) -> io::Result<Self> {
        let stream = TcpStream::connect_timeout(&address, timeout.max(Duration::from_millis(1)))?;
        // Small messages in strict alternation: waiting to fill a packet would cost 40 ms each.
        stream.set_nodelay(true)?;
        Ok(Self { stream, received: Intake::default() })
    }

    /// Sends `message`, whose first four bytes are still to be its length, and receives the answer. Its body is then
    /// in [`body`](Self::body).
    pub(crate) fn exchange(&mut self, message: &mut [u8], timeout: Duration) -> Result<(), Fault> {
        let deadline = Instant::now().checked_add(timeout);
        let length = message.len();
        let declared = i32::try_from(length).ok().filter(|_| length <= MAX_MESSAGE);
        let (Some(declared), Some(header)) = (declared, message.first_chunk_mut::<4>()) else {
            let declared = i64::try_from(length).unwrap_or(i64::MAX);
            return Err(Fault::Protocol(DecodeError::Length { declared, limit: MAX_MESSAGE }));
        };
        *header = declared.to_be_bytes();
        self.received.clear();
        self.send(message, deadline)?;
        self.receive(deadline)
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

    fn send(&mut self, mut message: &[u8], deadline: Option<Instant>) -> Result<(), Fault> {
        while !message.is_empty() {
            self.stream.set_write_timeout(left(deadline)?)?;
            match self.stream.write(message) {
                Ok(0) => return Err(Fault::Closed("the socket takes no more bytes".to_owned())),
                Ok(written) => message = &message[written..],
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }

    fn receive(&mut self, deadline: Option<Instant>) -> Result<(), Fault> {
        while let Some(space) = self.received.wanted().map_err(Fault::Protocol)? {
            self.stream.set_read_timeout(left(deadline)?)?;
            match self.stream.read(space) {
                Ok(0) => return Err(Fault::Closed("end of the stream".to_owned())),
                Ok(count) => self.received.took(count),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }
}

/// Time left until the deadline; `None` is a deadline too far away to be expressed.
fn left(deadline: Option<Instant>) -> Result<Option<Duration>, Fault> {
    let Some(deadline) = deadline else { return Ok(None) };
    match deadline.saturating_duration_since(Instant::now()) {
        Duration::ZERO => Err(Fault::Timeout),
        left => Ok(Some(left)),
    }
}
