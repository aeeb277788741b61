//! The client's side: whom to trust, and how to prove who one is.

use crate::error::SecurityError;
use crate::options::{ClientOptions, given};
use crate::pem::{self, Identity};
use crate::token::{Bearer, Tokens};
use std::fmt;
use std::net::IpAddr;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::{Certificate, Channel, ClientTlsConfig, Endpoint};

/// A channel whose calls carry the token, if there is one.
pub type Connection = InterceptedService<Channel, Bearer>;

/// How a client protects what it says; by default it does not.
#[derive(Clone, Default)]
pub struct ClientSecurity {
    tls: Option<ClientTlsConfig>,
    bearer: Bearer,
}

impl fmt::Debug for ClientSecurity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (tls, token) = (self.tls.is_some(), self.bearer.0.is_some());
        f.debug_struct("ClientSecurity").field("tls", &tls).field("token", &token).finish()
    }
}

impl ClientSecurity {
    /// Reads certificates, key and token. `token` is what the variable `CROSS_TOKEN` holds.
    ///
    /// # Errors
    /// [`SecurityError`] names the file or option that cannot be used.
    pub fn load(options: &ClientOptions, token: Option<String>) -> Result<Self, SecurityError> {
        let bearer = Bearer(Tokens::load(&options.token, token)?.and_then(|tokens| tokens.header()));
        let alone = |given, missing| Err(SecurityError::Alone { given, missing });
        let identity = match (given(options.tls_cert.as_ref()), given(options.tls_key.as_ref())) {
            (Some(certificate), Some(key)) => Some(Identity::read(certificate, key)?),
            (Some(_), None) => return alone("--tls-cert", "--tls-key"),
            (None, Some(_)) => return alone("--tls-key", "--tls-cert"),
            (None, None) => None,
        };
        let Some(ca) = given(options.tls_ca.as_ref()) else {
            if identity.is_some() {
                return alone("--tls-cert", "--tls-ca");
            }
            return Ok(Self { tls: None, bearer });
        };
        let (ca, _) = pem::authorities("--tls-ca", ca)?;
        let mut tls = ClientTlsConfig::new().ca_certificate(Certificate::from_pem(ca));
        if let Some(identity) = identity {
            tls = tls.identity(tonic::transport::Identity::from_pem(identity.chain_pem, identity.key_pem));
        }
        Ok(Self { tls: Some(tls), bearer })
    }

    /// The endpoint of an address as typed: `https://HOST:PORT` or `http://HOST:PORT`; without a scheme it is what the
    /// options ask for. `insecure` allows a token to travel unencrypted to another machine.
    ///
    /// # Errors
    /// [`SecurityError::Address`] if it is no address, or contradicts the options.
    pub fn endpoint(&self, address: &str, insecure: bool) -> Result<Endpoint, SecurityError> {
        let problem = |problem: &str| SecurityError::Address {
            address: address.to_owned(),
            problem: problem.to_owned(),
        };
        let scheme = if self.tls.is_some() { "https" } else { "http" };
        let whole =
            if address.contains("://") { address.to_owned() } else { format!("{scheme}://{address}") };
        let endpoint = Endpoint::from_shared(whole)
            .map_err(|_| problem("is no address; write it as https://HOST:PORT or http://HOST:PORT"))?;
        let uri = endpoint.uri().clone();
        let host = uri.host().unwrap_or_default();
        if host.is_empty() || uri.port_u16().is_none() {
            return Err(problem("lacks host or port; write it as https://HOST:PORT or http://HOST:PORT"));
        }
        match (uri.scheme_str(), &self.tls) {
            (Some("https"), Some(tls)) => {
                endpoint.tls_config(tls.clone()).map_err(|error| problem(&format!("cannot be used: {error}")))
            }
            (Some("https"), None) => Err(problem(
                "asks for TLS, and nothing says whom to trust; give the authority that signed the certificate with --tls-ca",
            )),
            (Some("http"), Some(_)) => {
                Err(problem("is not encrypted, but --tls-ca is given; write https://, or leave --tls-ca out"))
            }
            (Some("http"), None) if self.bearer.0.is_some() && !insecure && !is_loopback(host) => {
                Err(problem(
                    "is another machine's and the connection would not be encrypted, so that anybody on the way could \
                 take the token; use https:// with --tls-ca, or pass --insecure inside a network that you trust",
                ))
            }
            (Some("http"), None) => Ok(endpoint),
            _ => Err(problem("has a scheme that is neither https nor http")),
        }
    }

    /// A channel that carries the token.
    #[must_use]
    pub fn connection(&self, channel: Channel) -> Connection {
        InterceptedService::new(channel, self.bearer.clone())
    }
}

/// Whether a host, as addresses name it, is this machine for certain.
fn is_loopback(host: &str) -> bool {
    let host = host.trim_start_matches('[').trim_end_matches(']');
    host == "localhost" || host.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with_token() -> ClientSecurity {
        ClientSecurity::load(&ClientOptions::default(), Some("0123456789abcdef".to_owned())).unwrap()
    }

    #[test]
    fn addresses_need_a_host_and_a_port() {
        let open = ClientSecurity::default();
        for good in ["http://127.0.0.1:7000", "127.0.0.1:7000", "http://learner:7000", "http://[::1]:7000"] {
            assert!(open.endpoint(good, false).is_ok(), "{good}");
        }
        for bad in ["", "http://", "learner", "http://learner", "ftp://learner:7000", "a b:1"] {
            assert!(open.endpoint(bad, false).is_err(), "{bad}");
        }
        let error = open.endpoint("https://learner:7000", false).unwrap_err().to_string();
        assert!(error.contains("--tls-ca"), "{error}");
    }

    #[test]
    fn a_token_leaves_the_machine_only_encrypted_or_with_a_word_of_consent() {
        let security = with_token();
        for own in ["127.0.0.1:1", "localhost:1", "http://[::1]:1"] {
            assert!(security.endpoint(own, false).is_ok(), "{own}");
        }
        for other in ["http://learner:1", "10.0.0.1:1", "http://localhost.example:1"] {
            let error = security.endpoint(other, false).unwrap_err().to_string();
            assert!(error.contains("token") && error.contains("--insecure"), "{error}");
            assert!(security.endpoint(other, true).is_ok(), "{other}");
        }
    }

    #[test]
    fn nothing_secret_is_shown() {
        let shown = format!("{:?}", with_token());
        assert_eq!(shown, "ClientSecurity { tls: false, token: true }");
    }
}
