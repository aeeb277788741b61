//! How long a client may say nothing.
//!
//! A connection takes a place of a limited number. The servers above wait without an end for the first bytes of one, and
//! the HTTP/1 server for the rest of a request too, so a few sockets that stay silent would keep everybody else out.

use crate::server::Protocol;
use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::time::{Instant, Sleep};

/// HTTP/2 begins with these many bytes (RFC 9113, section 3.4). After them the server's keepalive takes over.
const PREFACE: usize = 24;

/// The deadlines of a port.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Deadlines {
    /// From the accepted connection (after TLS) to the HTTP/2 preface, or to the answer to the first HTTP/1 request.
    pub(crate) first: Duration,
    /// HTTP/1: from an answer to that of the next request. A scrape every minute keeps its connection.
    pub(crate) next: Duration,
}

impl Default for Deadlines {
    fn default() -> Self {
        Self { first: Duration::from_secs(10), next: Duration::from_secs(65) }
    }
}

/// The deadline of a connection, while there is one.
#[derive(Debug)]
pub(crate) enum Patience {
    /// Until so many bytes have come; however slowly they trickle, the deadline stands.
    Preface { deadline: Pin<Box<Sleep>>, missing: usize },
    /// Until an answer is written, which moves it. What the client sends does not.
    Request { deadline: Pin<Box<Sleep>>, next: Duration },
    /// Somebody else watches.
    Over,
}

impl Patience {
    pub(crate) fn new(protocol: Protocol, deadlines: Deadlines) -> Self {
        let deadline = Box::pin(tokio::time::sleep(deadlines.first));
        match protocol {
            Protocol::Grpc => Self::Preface { deadline, missing: PREFACE },
            Protocol::Http => Self::Request { deadline, next: deadlines.next },
        }
    }

    /// To be asked before each read, and where a client takes nothing: an error once the deadline has passed. Else the task is woken when it does.
    pub(crate) fn check(&mut self, context: &mut Context<'_>) -> io::Result<()> {
        let (Self::Preface { deadline, .. } | Self::Request { deadline, .. }) = self else { return Ok(()) };
        match deadline.as_mut().poll(context) {
            Poll::Pending => Ok(()),
            Poll::Ready(()) => Err(io::Error::new(io::ErrorKind::TimedOut, "the client says nothing")),
        }
    }

    /// Bytes were read.
    pub(crate) fn heard(&mut self, bytes: usize) {
        if let Self::Preface { missing, .. } = self {
            *missing = missing.saturating_sub(bytes);
            if *missing == 0 {
                *self = Self::Over;
            }
        }
    }

    /// After each write: an answer moves the deadline, and a client that takes none has it too.
    pub(crate) fn wrote(
        &mut self,
        context: &mut Context<'_>,
        written: Poll<io::Result<usize>>,
    ) -> Poll<io::Result<usize>> {
        match (&written, &mut *self) {
            (Poll::Ready(Ok(1..)), Self::Request { deadline, next }) => {
                deadline.as_mut().reset(Instant::now() + *next);
            }
            (Poll::Pending, _) => self.check(context)?,
            _ => {}
        }
        written
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::admin::{Subject, serve};
    use crate::incoming::Incoming;
    use crate::server::ServerSecurity;
    use std::net::SocketAddr;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::net::{TcpListener, TcpSocket, TcpStream};

    const SHORT: Deadlines =
        Deadlines { first: Duration::from_millis(300), next: Duration::from_millis(300) };
    const GET: &[u8] = b"GET /live HTTP/1.0\r\n\r\n";
    /// The preface and an empty SETTINGS frame.
    const HELLO: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";
    /// The server's acknowledgement of these settings.
    const ACKNOWLEDGED: &[u8] = b"\0\0\0\x04\x01\0\0\0\0";
    const PING: &[u8] = b"\0\0\x08\x06\0\0\0\0\x00whatever";
    const PONG: &[u8] = b"\0\0\x08\x06\x01\0\0\0\x00whatever";

    #[derive(Clone)]
    struct Nothing;

    impl Subject for Nothing {
        fn metrics(&self) -> String {
            String::new()
        }

        fn ready(&self) -> Result<(), &'static str> {
            Ok(())
        }
    }

    async fn start(protocol: Protocol) -> SocketAddr {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let incoming = Incoming::new(listener, None, protocol, 4, SHORT).unwrap();
        match protocol {
            Protocol::Http => {
                tokio::spawn(serve(incoming, ServerSecurity::default(), Nothing, std::future::pending()));
            }
            Protocol::Grpc => {
                let services = tonic::service::Routes::default();
                let server = tonic::transport::Server::builder().add_routes(services);
                tokio::spawn(server.serve_with_incoming(incoming));
            }
        }
        address
    }

    async fn connect(address: SocketAddr, from: &str) -> TcpStream {
        let socket = TcpSocket::new_v4().unwrap();
        socket.bind(format!("{from}:0").parse().unwrap()).unwrap();
        socket.connect(address).await.unwrap()
    }

    /// Reads until these bytes have come, or the end.
    async fn hears(stream: &mut TcpStream, wanted: &[u8]) -> bool {
        let mut heard = Vec::new();
        while !heard.windows(wanted.len()).any(|window| window == wanted) {
            if !matches!(stream.read_buf(&mut heard).await, Ok(1..)) {
                return false;
            }
        }
        true
    }

    /// Whether a new client gets in, now or when the server has noticed that others are gone.
    async fn gets_in(address: SocketAddr, says: &[u8], wanted: &[u8]) -> bool {
        for _ in 0..1000 {
            let mut stream = connect(address, "127.0.0.1").await;
            if stream.write_all(says).await.is_ok() && hears(&mut stream, wanted).await {
                return true;
            }
            tokio::task::yield_now().await;
        }
        false
    }

    #[tokio::test]
    async fn silent_clients_give_their_places_back() {
        for (protocol, says, wanted) in
            [(Protocol::Http, GET, b"live\n".as_slice()), (Protocol::Grpc, HELLO, ACKNOWLEDGED)]
        {
            let address = start(protocol).await;
            let mut silent = Vec::new();
            for host in ["127.0.0.1", "127.0.0.1", "127.0.0.2", "127.0.0.2"] {
                silent.push(connect(address, host).await);
            }
            // All places are taken.
            let mut turned_away = connect(address, "127.0.0.3").await;
            let _ = turned_away.write_all(says).await;
            assert!(!hears(&mut turned_away, wanted).await, "{protocol:?}");
            // Half of what it takes does not help.
            silent[0].write_all(&says[..says.len() / 2]).await.unwrap();
            for stream in &mut silent {
                assert!(!hears(stream, wanted).await, "{protocol:?}");
            }
            assert!(gets_in(address, says, wanted).await, "{protocol:?}");
        }
    }

    #[tokio::test]
    async fn one_host_does_not_shut_out_another() {
        let address = start(Protocol::Http).await;
        let _silent = [connect(address, "127.0.0.1").await, connect(address, "127.0.0.1").await];
        let mut same = connect(address, "127.0.0.1").await;
        let _ = same.write_all(GET).await;
        assert!(!hears(&mut same, b"live\n").await);
        let mut other = connect(address, "127.0.0.2").await;
        other.write_all(GET).await.unwrap();
        assert!(hears(&mut other, b"live\n").await);
    }

    #[tokio::test]
    async fn a_request_that_only_trickles_comes_to_an_end() {
        let address = start(Protocol::Http).await;
        let (mut reader, mut writer) = connect(address, "127.0.0.1").await.into_split();
        let trickle = async {
            while writer.write_all(b"G").await.is_ok() {
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        };
        let closed = async {
            // Either way of ending will do.
            let _ = reader.read_to_end(&mut Vec::new()).await;
        };
        tokio::join!(trickle, closed);
    }

    #[tokio::test]
    async fn a_client_that_has_said_hello_may_be_silent() {
        let address = start(Protocol::Grpc).await;
        let mut stream = connect(address, "127.0.0.1").await;
        stream.write_all(HELLO).await.unwrap();
        assert!(hears(&mut stream, ACKNOWLEDGED).await);
        tokio::time::sleep(SHORT.first * 3).await;
        stream.write_all(PING).await.unwrap();
        assert!(hears(&mut stream, PONG).await);
    }
}
