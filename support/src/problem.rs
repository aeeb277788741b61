//! What a failed handshake means, in a sentence for the person who has to mend it.

use std::error::Error;
use tokio_rustls::rustls::{self, CertificateError};

/// Why the certificate check with the server at `address` failed; `None` if that is not what `error` is about.
///
/// Trying again does not help with any of these until somebody has changed a file.
#[must_use]
pub fn of_server(error: &(dyn Error + 'static), address: &str) -> Option<String> {
    use rustls::Error as Tls;
    match find(error) {
        Some(Tls::InvalidCertificate(problem)) => Some(server_certificate(problem, address)),
        Some(Tls::AlertReceived(alert)) => of_alert(&format!("{alert:?}"), address),
        Some(Tls::InvalidMessage(_)) => Some(format!(
            "{address} does not speak TLS; use http://, or start the server with --tls-cert and --tls-key"
        )),
        Some(_) => None,
        // HTTP/2 keeps only the words of what broke its connection.
        None => of_alert(&alert_in_words(error)?, address),
    }
}

/// What an alert of the server says about this client's certificate.
fn of_alert(name: &str, address: &str) -> Option<String> {
    Some(match name {
        "CertificateRequired" => {
            format!("{address} takes only clients with a certificate; give --tls-cert and --tls-key")
        }
        "CertificateExpired" => {
            format!(
                "{address} finds the certificate of --tls-cert expired; renew it, or set the clocks right"
            )
        }
        "UnknownCA"
        | "BadCertificate"
        | "CertificateUnknown"
        | "UnsupportedCertificate"
        | "CertificateRevoked"
        | "DecryptError"
        | "AccessDenied" => format!(
            "{address} does not accept the certificate of --tls-cert; use one that an authority in the server's \
             --tls-client-ca signed for clients"
        ),
        _ => return None,
    })
}

/// The name of an alert that some error of the chain quotes.
fn alert_in_words(error: &(dyn Error + 'static)) -> Option<String> {
    let mut chain = std::iter::successors(Some(error), |error: &&(dyn Error + 'static)| (*error).source());
    chain.find_map(|error| {
        let text = error.to_string();
        let (_, name) = text.split_once("received fatal alert: ")?;
        Some(name.chars().take_while(char::is_ascii_alphanumeric).collect())
    })
}

fn server_certificate(problem: &CertificateError, address: &str) -> String {
    match problem {
        CertificateError::Expired | CertificateError::ExpiredContext { .. } => {
            format!("the certificate of {address} has expired; renew it, or set this machine's clock right")
        }
        CertificateError::NotValidYet | CertificateError::NotValidYetContext { .. } => {
            format!("the certificate of {address} is not valid yet; set this machine's clock right")
        }
        CertificateError::UnknownIssuer => format!(
            "the certificate of {address} is not signed by an authority in --tls-ca; give the one that signed it"
        ),
        CertificateError::BadSignature => format!(
            "the certificate of {address} names an authority in --tls-ca, but that one's key did not sign it; \
             give the authority's present certificate"
        ),
        CertificateError::NotValidForName => format!(
            "the certificate of {address} is for another host; connect by a name that it holds, or issue it for this one"
        ),
        CertificateError::NotValidForNameContext { presented, .. } => format!(
            "the certificate of {address} is for {}; connect by such a name, or issue it for this host",
            if presented.is_empty() { "no host at all".to_owned() } else { presented.join(", ") }
        ),
        other => format!("the certificate of {address} cannot be used: {other}"),
    }
}

/// Why a client's handshake failed, for the server's log.
pub(crate) fn of_client(error: &(dyn Error + 'static)) -> String {
    use rustls::Error as Tls;
    match find(error) {
        Some(Tls::NoCertificatesPresented) => {
            "it shows no certificate, and --tls-client-ca asks for one".to_owned()
        }
        Some(Tls::InvalidCertificate(CertificateError::UnknownIssuer)) => {
            "its certificate is not signed by an authority in --tls-client-ca".to_owned()
        }
        Some(Tls::InvalidCertificate(
            CertificateError::Expired | CertificateError::ExpiredContext { .. },
        )) => "its certificate has expired".to_owned(),
        Some(Tls::InvalidCertificate(problem)) => format!("its certificate cannot be used: {problem}"),
        Some(Tls::AlertReceived(alert)) => format!("it refuses this server's certificate ({alert:?})"),
        Some(Tls::InvalidMessage(_)) => "it does not speak TLS".to_owned(),
        Some(other) => other.to_string(),
        None => error.to_string(),
    }
}

/// The TLS error inside whatever wraps it.
fn find<'a>(error: &'a (dyn Error + 'static)) -> Option<&'a rustls::Error> {
    let mut next = Some(error);
    while let Some(error) = next {
        if let Some(found) = error.downcast_ref::<rustls::Error>() {
            return Some(found);
        }
        // Its source is the source of what it wraps, so that one would be passed over.
        if let Some(inner) = error.downcast_ref::<std::io::Error>().and_then(std::io::Error::get_ref)
            && let Some(found) = find(inner)
        {
            return Some(found);
        }
        next = error.source();
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io;
    use tokio_rustls::rustls::AlertDescription;

    #[derive(Debug, thiserror::Error)]
    #[error("transport error")]
    struct Wrapped(#[source] io::Error);

    fn wrapped(error: rustls::Error) -> Wrapped {
        Wrapped(io::Error::new(io::ErrorKind::InvalidData, error))
    }

    #[test]
    fn each_cause_has_its_own_sentence_however_deep_it_lies() {
        let cases = [
            (CertificateError::Expired.into(), "has expired"),
            (CertificateError::UnknownIssuer.into(), "--tls-ca"),
            (CertificateError::NotValidForName.into(), "another host"),
            (rustls::Error::AlertReceived(AlertDescription::CertificateRequired), "--tls-cert and --tls-key"),
            (rustls::Error::AlertReceived(AlertDescription::UnknownCA), "--tls-client-ca"),
        ];
        for (error, words) in cases {
            let sentence = of_server(&wrapped(error), "learner:7400").unwrap();
            assert!(sentence.contains("learner:7400") && sentence.contains(words), "{sentence}");
        }
    }

    #[test]
    fn an_alert_is_known_by_its_words() {
        let alert = rustls::Error::AlertReceived(AlertDescription::CertificateRequired).to_string();
        let sentence = of_server(&Wrapped(io::Error::other(alert)), "learner:7400").unwrap();
        assert!(sentence.contains("takes only clients with a certificate"), "{sentence}");
        let alert = rustls::Error::AlertReceived(AlertDescription::InternalError).to_string();
        assert_eq!(of_server(&Wrapped(io::Error::other(alert)), "learner:7400"), None);
    }

    #[test]
    fn a_broken_connection_is_no_question_of_certificates() {
        assert_eq!(of_server(&Wrapped(io::ErrorKind::ConnectionReset.into()), "a:1"), None);
        assert_eq!(of_server(&wrapped(rustls::Error::HandshakeNotComplete), "a:1"), None);
    }
}
