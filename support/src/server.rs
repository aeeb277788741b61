//! The server's side: what it takes to be let in.

use crate::error::SecurityError;
use crate::incoming::Incoming;
use crate::options::{ServerOptions, given};
use crate::patience::Deadlines;
use crate::pem::{self, Identity};
use crate::token::Tokens;
use std::fmt;
use std::path::Path;
use std::sync::Arc;
use tokio::net::TcpListener;
use tokio_rustls::rustls::server::WebPkiClientVerifier;
use tokio_rustls::rustls::{RootCertStore, ServerConfig};

/// What a port speaks inside TLS.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Protocol {
    /// HTTP/2, and with mutual TLS no connection at all without a certificate.
    Grpc,
    /// HTTP/1.1. A probe may come without a certificate; what it may read then is the port's to decide.
    Http,
}

/// How the ports of a process are protected; by default they are not.
#[derive(Clone, Default)]
pub struct ServerSecurity {
    grpc: Option<Arc<ServerConfig>>,
    http: Option<Arc<ServerConfig>>,
    client_certificates: bool,
    tokens: Option<Arc<Tokens>>,
}

impl fmt::Debug for ServerSecurity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.describe())
    }
}

impl ServerSecurity {
    /// Reads certificates, key and tokens. `token` is what the variable `CROSS_TOKEN` holds.
    ///
    /// # Errors
    /// [`SecurityError`] names the file or option that cannot be used.
    pub fn load(options: &ServerOptions, token: Option<String>) -> Result<Self, SecurityError> {
        let tokens = Tokens::load(&options.token, token)?.map(Arc::new);
        let (certificate, key) = (given(options.tls_cert.as_ref()), given(options.tls_key.as_ref()));
        let client_ca = given(options.tls_client_ca.as_ref());
        let alone = |given, missing| Err(SecurityError::Alone { given, missing });
        let (certificate, key) = match (certificate, key) {
            (Some(certificate), Some(key)) => (certificate, key),
            (Some(_), None) => return alone("--tls-cert", "--tls-key"),
            (None, Some(_)) => return alone("--tls-key", "--tls-cert"),
            (None, None) if client_ca.is_some() => return alone("--tls-client-ca", "--tls-cert"),
            (None, None) => return Ok(Self { tokens, ..Self::default() }),
        };
        let identity = Identity::read(certificate, key)?;
        let roots = match client_ca {
            Some(path) => Some((path, Arc::new(pem::authorities("--tls-client-ca", path)?.1))),
            None => None,
        };
        let config = |protocol| tls_config(protocol, &identity, roots.as_ref(), certificate).map(Arc::new);
        Ok(Self {
            grpc: Some(config(Protocol::Grpc)?),
            http: Some(config(Protocol::Http)?),
            client_certificates: roots.is_some(),
            tokens,
        })
    }

    /// Whether a stranger on the network can neither read along nor get in: TLS, and a token or client certificates.
    #[must_use]
    pub fn keeps_strangers_out(&self) -> bool {
        self.grpc.is_some() && (self.client_certificates || self.tokens.is_some())
    }

    /// Whether clients must show a certificate.
    #[must_use]
    pub fn wants_client_certificates(&self) -> bool {
        self.client_certificates
    }

    /// What a call must carry one of.
    #[must_use]
    pub fn tokens(&self) -> Option<&Tokens> {
        self.tokens.as_deref()
    }

    /// For the log: what is on, and nothing of what it is.
    #[must_use]
    pub fn describe(&self) -> String {
        let parts = [
            (self.grpc.is_some(), "TLS"),
            (self.client_certificates, "client certificates"),
            (self.tokens.is_some(), "token"),
        ];
        let on: Vec<_> = parts.into_iter().filter_map(|(on, name)| on.then_some(name)).collect();
        if on.is_empty() { "none".to_owned() } else { on.join(", ") }
    }

    /// The connections of a listening socket, at most `connections` at a time, half of them of one host. Silent ones are closed.
    ///
    /// # Errors
    /// If the socket cannot tell its address.
    pub fn incoming(
        &self,
        listener: TcpListener,
        protocol: Protocol,
        connections: usize,
    ) -> std::io::Result<Incoming> {
        let tls = match protocol {
            Protocol::Grpc => &self.grpc,
            Protocol::Http => &self.http,
        };
        Incoming::new(listener, tls.clone(), protocol, connections, Deadlines::default())
    }
}

fn tls_config(
    protocol: Protocol,
    identity: &Identity,
    roots: Option<&(&Path, Arc<RootCertStore>)>,
    certificate: &Path,
) -> Result<ServerConfig, SecurityError> {
    let provider = pem::provider();
    let content = |option, path: &Path, problem: String| SecurityError::Content {
        option,
        path: path.to_owned(),
        problem,
    };
    let unusable = |error: &dyn fmt::Display| {
        content("--tls-cert", certificate, format!("cannot be used for TLS: {error}"))
    };
    let builder = ServerConfig::builder_with_provider(Arc::clone(&provider))
        .with_safe_default_protocol_versions()
        .map_err(|error| unusable(&error))?;
    let builder = match roots {
        None => builder.with_no_client_auth(),
        Some((path, roots)) => {
            let verifier = WebPkiClientVerifier::builder_with_provider(Arc::clone(roots), provider);
            let verifier = match protocol {
                Protocol::Grpc => verifier,
                Protocol::Http => verifier.allow_unauthenticated(),
            };
            let verifier = verifier
                .build()
                .map_err(|error| content("--tls-client-ca", path, format!("cannot be used: {error}")))?;
            builder.with_client_cert_verifier(verifier)
        }
    };
    let mut config = builder
        .with_single_cert(identity.chain.clone(), identity.key.clone_key())
        .map_err(|error| unusable(&error))?;
    config.alpn_protocols = match protocol {
        Protocol::Grpc => vec![b"h2".to_vec()],
        Protocol::Http => vec![b"http/1.1".to_vec()],
    };
    Ok(config)
}
