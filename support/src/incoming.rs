//! Connections of a port, encrypted or not, for the gRPC server and the admin port alike.
//!
//! A task accepts and shakes hands, many at a time and each within a deadline, so that a client that is slow, or speaks
//! nothing, holds up nobody. Above the limit on connections, or on those of one host, a new one is closed at once.

use crate::patience::{Deadlines, Patience};
use crate::places::{Place, Places};
use crate::server::Protocol;
use axum::extract::connect_info;
use axum::serve::IncomingStream;
use futures::Stream;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::server::TlsStream;

/// Time for a TLS handshake.
const HANDSHAKE: Duration = Duration::from_secs(10);
/// How long a refused client may take to read why, and how much it may send meanwhile.
const LINGER: Duration = Duration::from_secs(2);
const LINGER_BYTES: u64 = 64 * 1024;
/// Connections that are ready and not yet taken.
const READY: usize = 64;
/// Pause after an accept that failed for want of file descriptors or memory.
const RECOVER: Duration = Duration::from_millis(200);
/// Between two log lines about connections that came to nothing: a scanner must not fill the disk.
const LOG_EVERY: Duration = Duration::from_secs(10);

/// Connections of a listening socket. Dropping it closes the socket.
#[derive(Debug)]
pub struct Incoming {
    local: SocketAddr,
    ready: mpsc::Receiver<Connection>,
    accepting: JoinHandle<()>,
}

impl Incoming {
    pub(crate) fn new(
        listener: TcpListener,
        tls: Option<Arc<ServerConfig>>,
        protocol: Protocol,
        connections: usize,
        deadlines: Deadlines,
    ) -> io::Result<Self> {
        let local = listener.local_addr()?;
        let (sender, ready) = mpsc::channel(READY);
        let port = Port { acceptor: tls.map(TlsAcceptor::from), protocol, deadlines };
        let accepting = tokio::spawn(accept(listener, port, Places::new(connections), sender));
        Ok(Self { local, ready, accepting })
    }
}

impl Drop for Incoming {
    fn drop(&mut self) {
        self.accepting.abort();
    }
}

/// What a port speaks, and how long it waits for that.
#[derive(Clone)]
struct Port {
    acceptor: Option<TlsAcceptor>,
    protocol: Protocol,
    deadlines: Deadlines,
}

async fn accept(listener: TcpListener, port: Port, places: Arc<Places>, ready: mpsc::Sender<Connection>) {
    let complaints = Arc::new(Complaints::default());
    loop {
        let (stream, address) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(error) => {
                complaints.say(&format!("a connection could not be accepted: {error}"));
                tokio::time::sleep(RECOVER).await;
                continue;
            }
        };
        let place = match places.take(address.ip()) {
            Ok(place) => place,
            Err(full) => {
                complaints.say(&format!("the connection of {address} is closed: {}", full.reason()));
                continue;
            }
        };
        // Fails only for a connection that is gone again.
        let _ = stream.set_nodelay(true);
        let (port, ready, complaints) = (port.clone(), ready.clone(), Arc::clone(&complaints));
        tokio::spawn(async move {
            let io = match port.acceptor {
                None => Io::Plain(stream),
                Some(acceptor) => {
                    let shaken = acceptor.accept(stream).into_fallible();
                    match tokio::time::timeout(HANDSHAKE, shaken).await {
                        Ok(Ok(stream)) => Io::Tls(Box::new(stream)),
                        Ok(Err((error, stream))) => {
                            let problem = crate::problem::of_client(&error);
                            complaints.say(&format!("no TLS with {address}: {problem}"));
                            return linger(stream).await;
                        }
                        Err(_) => {
                            let seconds = HANDSHAKE.as_secs();
                            return complaints.say(&format!("no TLS with {address} within {seconds} s"));
                        }
                    }
                }
            };
            let peer = Peer { address, certificate: io.has_certificate() };
            let patience = Patience::new(port.protocol, port.deadlines);
            // Fails only when the server has ended.
            let _ = ready.send(Connection { io, peer, patience, _place: place }).await;
        });
    }
}

/// Takes what a refused client still sends, for a moment. Closing at once would have the kernel reset the connection, and
/// the client would lose the alert that tells it what is wrong.
async fn linger(mut stream: TcpStream) {
    let drained = async {
        stream.shutdown().await?;
        let mut rest = stream.take(LINGER_BYTES);
        tokio::io::copy(&mut rest, &mut tokio::io::sink()).await
    };
    // Whatever comes of it, the connection is over.
    let _ = tokio::time::timeout(LINGER, drained).await;
}

/// Log lines, at most one in [`LOG_EVERY`].
#[derive(Debug, Default)]
struct Complaints(std::sync::Mutex<Option<Instant>>);

impl Complaints {
    fn say(&self, text: &str) {
        let now = Instant::now();
        let mut last = self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if last.is_none_or(|last| now.duration_since(last) >= LOG_EVERY) {
            *last = Some(now);
            tracing::warn!("{text}");
        } else {
            tracing::debug!("{text}");
        }
    }
}

/// Who is at the other end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Peer {
    /// Its address, or that of whatever stands between.
    pub address: SocketAddr,
    /// Whether it showed a certificate that the server's authorities signed.
    pub certificate: bool,
}

/// A connection; it counts towards the limit until it is dropped.
#[derive(Debug)]
pub struct Connection {
    io: Io,
    peer: Peer,
    patience: Patience,
    _place: Place,
}

#[derive(Debug)]
enum Io {
    Plain(TcpStream),
    Tls(Box<TlsStream<TcpStream>>),
}

impl Io {
    /// Certificates that do not verify never get this far.
    fn has_certificate(&self) -> bool {
        match self {
            Self::Plain(_) => false,
            Self::Tls(stream) => stream.get_ref().1.peer_certificates().is_some(),
        }
    }
}

impl Stream for Incoming {
    type Item = io::Result<Connection>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        self.ready.poll_recv(context).map(|connection| connection.map(Ok))
    }
}

impl axum::serve::Listener for Incoming {
    type Io = Connection;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Connection, SocketAddr) {
        match self.ready.recv().await {
            Some(connection) => {
                let address = connection.peer.address;
                (connection, address)
            }
            // The task accepts for as long as this lives.
            None => std::future::pending().await,
        }
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        Ok(self.local)
    }
}

impl tonic::transport::server::Connected for Connection {
    type ConnectInfo = Peer;

    fn connect_info(&self) -> Peer {
        self.peer
    }
}

impl connect_info::Connected<IncomingStream<'_, Incoming>> for Peer {
    fn connect_info(stream: IncomingStream<'_, Incoming>) -> Self {
        stream.io().peer
    }
}

/// Calls the same method of whichever stream it is.
macro_rules! either {
    ($io:expr, $stream:ident => $call:expr) => {
        match $io {
            Io::Plain(stream) => {
                let $stream = Pin::new(stream);
                $call
            }
            Io::Tls(stream) => {
                let $stream = Pin::new(stream.as_mut());
                $call
            }
        }
    };
}

impl AsyncRead for Connection {
    fn poll_read(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let Self { io, patience, .. } = self.get_mut();
        patience.check(context)?;
        let before = buffer.filled().len();
        let read = either!(io, stream => stream.poll_read(context, buffer));
        patience.heard(buffer.filled().len() - before);
        read
    }
}

impl AsyncWrite for Connection {
    fn poll_write(self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let Self { io, patience, .. } = self.get_mut();
        let written = either!(io, stream => stream.poll_write(context, bytes));
        patience.wrote(context, written)
    }

    fn poll_flush(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let Self { io, patience, .. } = self.get_mut();
        let flushed = either!(io, stream => stream.poll_flush(context));
        if flushed.is_pending() {
            patience.check(context)?;
        }
        flushed
    }

    fn poll_shutdown(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        either!(&mut self.get_mut().io, stream => stream.poll_shutdown(context))
    }

    fn poll_write_vectored(
        self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffers: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let Self { io, patience, .. } = self.get_mut();
        let written = either!(io, stream => stream.poll_write_vectored(context, buffers));
        patience.wrote(context, written)
    }

    fn is_write_vectored(&self) -> bool {
        match &self.io {
            Io::Plain(stream) => stream.is_write_vectored(),
            Io::Tls(stream) => stream.is_write_vectored(),
        }
    }
}
