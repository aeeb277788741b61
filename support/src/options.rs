//! Options of the programs: files of certificates, keys and tokens. A token itself is never an option, because everybody
//! on a machine can see the arguments of its processes.

use clap::Args;
use std::path::{Path, PathBuf};

/// Environment variable that holds a token, for those who would rather not have a file.
pub const TOKEN_VARIABLE: &str = "CROSS_TOKEN";

/// Variables that change how a process speaks; a process that is told everything by its parent must not see them.
pub const TLS_VARIABLES: [&str; 4] =
    ["CROSS_TLS_CERT", "CROSS_TLS_KEY", "CROSS_TLS_CLIENT_CA", "CROSS_TLS_CA"];

/// How a server is protected.
#[derive(Debug, Clone, Default, Args)]
#[command(next_help_heading = "Security (docs/security.md)")]
pub struct ServerOptions {
    /// Certificate of this server in PEM, intermediate ones after it: its ports then speak TLS
    #[arg(long, value_name = "FILE", env = "CROSS_TLS_CERT")]
    pub tls_cert: Option<PathBuf>,

    /// Private key of --tls-cert in PEM
    #[arg(long, value_name = "FILE", env = "CROSS_TLS_KEY")]
    pub tls_key: Option<PathBuf>,

    /// Take only clients with a certificate that an authority in this PEM file signed (mutual TLS)
    #[arg(long, value_name = "FILE", env = "CROSS_TLS_CLIENT_CA")]
    pub tls_client_ca: Option<PathBuf>,

    #[command(flatten)]
    #[allow(missing_docs, reason = "its documentation is that of its one option")]
    pub token: TokenOption,
}

/// How a client proves who it is, and knows whom it talks to.
#[derive(Debug, Clone, Default, Args)]
#[command(next_help_heading = "Security (docs/security.md)")]
pub struct ClientOptions {
    /// Authorities in PEM that may have signed the server's certificate; needed for https://
    #[arg(long, value_name = "FILE", env = "CROSS_TLS_CA")]
    pub tls_ca: Option<PathBuf>,

    /// Own certificate in PEM, for a server that asks for one (mutual TLS)
    #[arg(long, value_name = "FILE", env = "CROSS_TLS_CERT")]
    pub tls_cert: Option<PathBuf>,

    /// Private key of --tls-cert in PEM
    #[arg(long, value_name = "FILE", env = "CROSS_TLS_KEY")]
    pub tls_key: Option<PathBuf>,

    #[command(flatten)]
    #[allow(missing_docs, reason = "its documentation is that of its one option")]
    pub token: TokenOption,
}

/// Where the token is.
#[derive(Debug, Clone, Default, Args)]
pub struct TokenOption {
    /// File of the token that calls must carry, closed to others than its owner and group; the variable CROSS_TOKEN may hold it instead
    #[arg(long, value_name = "FILE", env = "CROSS_TOKEN_FILE", help_heading = "Security (docs/security.md)")]
    pub token_file: Option<PathBuf>,
}

/// A path that was given; an empty variable, as compose files leave them, is none.
pub(crate) fn given(path: Option<&PathBuf>) -> Option<&Path> {
    path.map(PathBuf::as_path).filter(|path| !path.as_os_str().is_empty())
}
