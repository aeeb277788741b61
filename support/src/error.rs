//! Why certificates, keys and tokens cannot be used.

use std::path::PathBuf;

/// Something about TLS or tokens that a person must set right; every case is bad input.
#[derive(Debug, thiserror::Error)]
pub enum SecurityError {
    /// The operating system refused.
    #[error("cannot read {}, given with {option}: {source}", path.display())]
    Read {
        /// The option that names the file.
        option: &'static str,
        /// The file.
        path: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// A secret that is none.
    #[error(
        "every user of this machine may read or change {}, given with {option} (mode {mode:04o}); \
         a secret is for its owner and group: chmod o-rwx {}", path.display(), path.display()
    )]
    Permissions {
        /// The option that names the file.
        option: &'static str,
        /// The file.
        path: PathBuf,
        /// Its permission bits.
        mode: u32,
    },
    /// The file is not what it should be.
    #[error("{}, given with {option}, {problem}", path.display())]
    Content {
        /// The option that names the file.
        option: &'static str,
        /// The file.
        path: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// Certificate and key are of two pairs.
    #[error(
        "the key {} does not belong to the certificate {}; give --tls-cert and --tls-key of one pair",
        key.display(), certificate.display()
    )]
    KeyMismatch {
        /// File of the certificate.
        certificate: PathBuf,
        /// File of the key.
        key: PathBuf,
    },
    /// An option that means nothing without another.
    #[error("{given} is given without {missing}; the two go together")]
    Alone {
        /// The option that is there.
        given: &'static str,
        /// The one that is not.
        missing: &'static str,
    },
    /// Two sources that may differ.
    #[error(
        "the token comes from --token-file (or CROSS_TOKEN_FILE) and from CROSS_TOKEN; leave one of them out"
    )]
    TwoTokens,
    /// A token that cannot be sent or is too easy to guess.
    #[error("the token in {origin} {problem}")]
    Token {
        /// Where it comes from.
        origin: String,
        /// What is wrong, without the token itself.
        problem: String,
    },
    /// The address is not one, or does not go with the options.
    #[error("the address {address:?} {problem}")]
    Address {
        /// As typed.
        address: String,
        /// What is wrong and what to do.
        problem: String,
    },
}
