//! Reading certificates and keys, with a sentence for whatever is wrong with them.

use crate::error::SecurityError;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tokio_rustls::rustls::crypto::CryptoProvider;
use tokio_rustls::rustls::pki_types::pem::{self, PemObject};
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::sign::CertifiedKey;
use tokio_rustls::rustls::{self, RootCertStore};

/// Larger files are no certificates, keys or tokens.
const LARGEST: u64 = 1 << 20;

/// The cryptography of this project, named so that no other crate's choice changes it.
pub(crate) fn provider() -> Arc<CryptoProvider> {
    Arc::new(rustls::crypto::ring::default_provider())
}

/// A certificate with its chain, and the key that belongs to it.
pub(crate) struct Identity {
    pub(crate) chain: Vec<CertificateDer<'static>>,
    pub(crate) key: PrivateKeyDer<'static>,
    /// The same as text, for libraries that want to parse it themselves.
    pub(crate) chain_pem: Vec<u8>,
    pub(crate) key_pem: Vec<u8>,
}

impl Identity {
    /// Reads both files and checks that they are a pair.
    pub(crate) fn read(certificate: &Path, key: &Path) -> Result<Self, SecurityError> {
        let (chain_pem, chain) = certificates("--tls-cert", certificate)?;
        let key_pem = read_secret("--tls-key", key)?;
        let content = |problem: &str| SecurityError::Content {
            option: "--tls-key",
            path: key.to_owned(),
            problem: problem.to_owned(),
        };
        let parsed = PrivateKeyDer::from_pem_slice(&key_pem).map_err(|error| match error {
            pem::Error::NoItemsFound if key_pem.windows(9).any(|window| window == b"ENCRYPTED") => {
                content("is a key with a pass phrase; take it off with: openssl pkey -in OLD -out NEW")
            }
            pem::Error::NoItemsFound => content("holds no private key in PEM form"),
            _ => content("is no PEM file; nothing in it could be read"),
        })?;
        let problem = match CertifiedKey::from_der(chain.clone(), parsed.clone_key(), &provider()) {
            Ok(_) => return Ok(Self { chain, key: parsed, chain_pem, key_pem }),
            Err(rustls::Error::InconsistentKeys(_)) => {
                let (certificate, key) = (certificate.to_owned(), key.to_owned());
                return Err(SecurityError::KeyMismatch { certificate, key });
            }
            Err(error) => format!("cannot be used: {error}"),
        };
        Err(content(&problem))
    }
}

/// The certificates of a PEM file, as text and parsed.
pub(crate) fn certificates(
    option: &'static str,
    path: &Path,
) -> Result<(Vec<u8>, Vec<CertificateDer<'static>>), SecurityError> {
    let text = read(option, path)?;
    let content =
        |problem: &str| SecurityError::Content { option, path: path.to_owned(), problem: problem.to_owned() };
    let parsed: Vec<_> = CertificateDer::pem_slice_iter(&text)
        .collect::<Result<_, _>>()
        .map_err(|_| content("is damaged: a certificate in it is not in PEM form"))?;
    if parsed.is_empty() {
        return Err(content("holds no certificate in PEM form"));
    }
    Ok((text, parsed))
}

/// The authorities of a PEM file, as text and parsed.
pub(crate) fn authorities(
    option: &'static str,
    path: &Path,
) -> Result<(Vec<u8>, RootCertStore), SecurityError> {
    let (text, parsed) = certificates(option, path)?;
    let mut roots = RootCertStore::empty();
    for certificate in parsed {
        roots.add(certificate).map_err(|error| SecurityError::Content {
            option,
            path: path.to_owned(),
            problem: format!("holds a certificate that no authority can have: {error}"),
        })?;
    }
    Ok((text, roots))
}

/// Reads a file that must not be everybody's.
pub(crate) fn read_secret(option: &'static str, path: &Path) -> Result<Vec<u8>, SecurityError> {
    use std::os::unix::fs::PermissionsExt;
    let metadata = std::fs::metadata(path).map_err(failed(option, path))?;
    let mode = metadata.permissions().mode() & 0o7777;
    if mode & 0o006 != 0 {
        return Err(SecurityError::Permissions { option, path: path.to_owned(), mode });
    }
    read(option, path)
}

fn read(option: &'static str, path: &Path) -> Result<Vec<u8>, SecurityError> {
    use std::io::Read;
    let mut bytes = Vec::new();
    let file = std::fs::File::open(path).map_err(failed(option, path))?;
    file.take(LARGEST + 1).read_to_end(&mut bytes).map_err(failed(option, path))?;
    if bytes.len() as u64 > LARGEST {
        let problem = "is larger than 1 MiB, so not what it should be".to_owned();
        return Err(SecurityError::Content { option, path: path.to_owned(), problem });
    }
    Ok(bytes)
}

fn failed(option: &'static str, path: &Path) -> impl Fn(std::io::Error) -> SecurityError {
    let path: PathBuf = path.to_owned();
    move |source| SecurityError::Read { option, path: path.clone(), source }
}
