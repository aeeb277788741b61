//! The admin port and the connections below it, as a client on the network meets them.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests fail by panicking, in their helpers too")]

#[path = "../../tests/src/certificates.rs"]
#[allow(dead_code, unreachable_pub, reason = "the cluster tests use the rest, from outside")]
mod certificates;

use certificates::{Authority, Pair, secret};
use cross_support::admin::{Subject, serve};
use cross_support::options::{ServerOptions, TokenOption};
use cross_support::server::{Protocol, ServerSecurity};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName};
use tokio_rustls::rustls::{self, ClientConfig, RootCertStore};

const TOKEN: &str = "0123456789abcdef-admin";

#[derive(Clone)]
struct Counts;

impl Subject for Counts {
    fn metrics(&self) -> String {
        "cross_test_total 7\n".to_owned()
    }

    fn ready(&self) -> Result<(), &'static str> {
        Err("not yet")
    }
}

async fn start(security: ServerSecurity, connections: usize) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let incoming = security.incoming(listener, Protocol::Http, connections).unwrap();
    tokio::spawn(serve(incoming, security, Counts, std::future::pending()));
    address
}

/// The answer to a request; empty if the connection was closed.
async fn get(mut io: impl AsyncRead + AsyncWrite + Unpin, path: &str, headers: &str) -> String {
    let request = format!("GET {path} HTTP/1.1\r\nhost: x\r\nconnection: close\r\n{headers}\r\n");
    let mut answer = Vec::new();
    if io.write_all(request.as_bytes()).await.is_ok() {
        let _ = io.read_to_end(&mut answer).await;
    }
    String::from_utf8(answer).unwrap()
}

async fn plain(address: SocketAddr, path: &str, headers: &str) -> String {
    get(TcpStream::connect(address).await.unwrap(), path, headers).await
}

async fn encrypted(address: SocketAddr, ca: &Path, own: Option<&Pair>, path: &str, headers: &str) -> String {
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_file(ca).unwrap()).unwrap();
    let builder = ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_root_certificates(roots);
    let config = match own {
        None => builder.with_no_client_auth(),
        Some(pair) => {
            let chain = vec![CertificateDer::from_pem_file(&pair.certificate).unwrap()];
            builder.with_client_auth_cert(chain, PrivateKeyDer::from_pem_file(&pair.key).unwrap()).unwrap()
        }
    };
    let stream = TcpStream::connect(address).await.unwrap();
    let name = ServerName::try_from("localhost").unwrap();
    get(TlsConnector::from(Arc::new(config)).connect(name, stream).await.unwrap(), path, headers).await
}

fn with_token(folder: &Path) -> TokenOption {
    let path = folder.join("token");
    secret(&path, TOKEN);
    TokenOption { token_file: Some(path) }
}

#[tokio::test]
async fn an_open_port_answers_everybody_and_has_the_process_in_its_metrics() {
    let address = start(ServerSecurity::default(), 4).await;
    let answer = plain(address, "/metrics", "").await;
    assert!(answer.starts_with("HTTP/1.1 200") && answer.contains("cross_test_total 7\n"), "{answer}");
    assert!(answer.contains("\nprocess_resident_memory_bytes "), "{answer}");
    assert!(plain(address, "/ready", "").await.contains("503"));
    assert!(plain(address, "/live", "").await.ends_with("live\n"));
}

#[tokio::test]
async fn a_token_guards_the_metrics_and_not_the_probes() {
    let folder = tempfile::tempdir().unwrap();
    let options = ServerOptions { token: with_token(folder.path()), ..ServerOptions::default() };
    let address = start(ServerSecurity::load(&options, None).unwrap(), 4).await;
    for headers in ["", "authorization: Bearer 0123456789abcdef-other\r\n", "authorization: Basic eDp5\r\n"] {
        let answer = plain(address, "/metrics", headers).await;
        assert!(answer.starts_with("HTTP/1.1 401") && !answer.contains("cross_test"), "{answer}");
        assert!(!answer.contains(TOKEN), "{answer}");
    }
    let answer = plain(address, "/metrics", &format!("authorization: Bearer {TOKEN}\r\n")).await;
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    assert!(plain(address, "/live", "").await.starts_with("HTTP/1.1 200"));
}

#[tokio::test]
async fn with_mutual_tls_the_metrics_need_a_certificate_and_the_probes_do_not() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let (ours, theirs) = (Authority::new("ours"), Authority::new("theirs"));
    let (ca, clients) = (ours.file(folder, "ours"), theirs.file(folder, "theirs"));
    let server = ours.issue(folder, "server", &["localhost"]);
    let client = theirs.issue(folder, "client", &["prometheus"]);
    let options = ServerOptions {
        tls_cert: Some(server.certificate.clone()),
        tls_key: Some(server.key),
        tls_client_ca: Some(clients),
        ..ServerOptions::default()
    };
    let security = ServerSecurity::load(&options, None).unwrap();
    assert!(security.keeps_strangers_out());
    let address = start(security, 4).await;
    let answer = encrypted(address, &ca, None, "/metrics", "").await;
    assert!(answer.starts_with("HTTP/1.1 403"), "{answer}");
    assert!(encrypted(address, &ca, None, "/live", "").await.starts_with("HTTP/1.1 200"));
    let answer = encrypted(address, &ca, Some(&client), "/metrics", "").await;
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
    // What is no TLS gets no HTTP either.
    assert!(!plain(address, "/live", "").await.contains("live"));
}

#[tokio::test]
async fn connections_above_the_limit_are_closed_and_leave_their_place_when_they_end() {
    // One host has half of them.
    let address = start(ServerSecurity::default(), 4).await;
    let idle = [TcpStream::connect(address).await.unwrap(), TcpStream::connect(address).await.unwrap()];
    // Both are counted once the third is turned away; accepts come in order.
    assert_eq!(plain(address, "/live", "").await, "");
    drop(idle);
    // The server notices in its own time.
    let mut answer = String::new();
    for _ in 0..1000 {
        answer = plain(address, "/live", "").await;
        if !answer.is_empty() {
            break;
        }
        tokio::task::yield_now().await;
    }
    assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
}

fn refused(options: &ServerOptions) -> String {
    ServerSecurity::load(options, None).unwrap_err().to_string()
}

#[test]
fn files_that_cannot_be_used_are_refused_with_a_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let authority = Authority::new("test");
    let (one, other) = (authority.issue(folder, "one", &["a"]), authority.issue(folder, "other", &["b"]));
    let text = folder.join("text");
    secret(&text, "no certificate at all\n");
    let options = |certificate: &Path, key: &Path| ServerOptions {
        tls_cert: Some(certificate.to_owned()),
        tls_key: Some(key.to_owned()),
        ..ServerOptions::default()
    };
    assert!(!ServerSecurity::load(&options(&one.certificate, &one.key), None).unwrap().keeps_strangers_out());

    let error = refused(&options(&one.certificate, &other.key));
    assert!(
        error.contains("other.key") && error.contains("does not belong") && error.contains("one.pem"),
        "{error}"
    );
    let error = refused(&options(&text, &one.key));
    assert!(error.contains("--tls-cert") && error.contains("no certificate in PEM form"), "{error}");
    let error = refused(&options(&one.certificate, &text));
    assert!(error.contains("--tls-key") && error.contains("no private key in PEM form"), "{error}");
    let error = refused(&options(Path::new("/nowhere/x.pem"), &one.key));
    assert!(error.contains("/nowhere/x.pem") && error.contains("--tls-cert"), "{error}");
    let error = refused(&ServerOptions { tls_client_ca: Some(text), ..options(&one.certificate, &one.key) });
    assert!(error.contains("--tls-client-ca"), "{error}");
    let error = refused(&ServerOptions { tls_key: None, ..options(&one.certificate, &one.key) });
    assert!(error.contains("--tls-cert is given without --tls-key"), "{error}");
    let ca: PathBuf = authority.file(folder, "test");
    let error = refused(&ServerOptions { tls_client_ca: Some(ca), ..ServerOptions::default() });
    assert!(error.contains("--tls-client-ca is given without --tls-cert"), "{error}");

    use std::os::unix::fs::PermissionsExt;
    std::fs::set_permissions(&one.key, std::fs::Permissions::from_mode(0o644)).unwrap();
    let error = refused(&options(&one.certificate, &one.key));
    assert!(
        error.contains("--tls-key") && error.contains("chmod o-rwx") && error.contains("0644"),
        "{error}"
    );
}
