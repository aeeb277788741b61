//! The program `cross-learner` in a process of its own, started as `cross train` starts it.

use super::Server;
use crate::error::BenchError;
use crate::folder::folder;
use cross_config::Config;
use serde::Deserialize;
use std::ffi::OsString;
use std::net::SocketAddr;
use std::path::Path;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

/// A learner that serves.
#[derive(Debug)]
pub(crate) struct Learner {
    pub(crate) server: Server,
    /// `host:port` of the gRPC services.
    pub(crate) address: String,
    metrics: SocketAddr,
}

/// What a learner writes once it serves.
#[derive(Debug, Deserialize)]
struct Listening {
    pid: u32,
    grpc: String,
    metrics: SocketAddr,
}

impl Learner {
    /// Starts one with this configuration and waits until it serves.
    pub(crate) async fn start(program: &Path, config: &Config) -> Result<Self, BenchError> {
        let folder = folder()?;
        let (file, run) = (folder.path().join("config.toml"), folder.path().join("run"));
        std::fs::write(&file, config.to_toml())
            .map_err(|source| BenchError::Write { path: file.clone(), source })?;
        let mut arguments: Vec<OsString> = vec!["--config".into(), file.into(), "--run".into(), run.into()];
        // All that a variable, meant for a cluster, could change.
        for text in ["--listen", "127.0.0.1:0", "--metrics-listen", "127.0.0.1:0", "--device", "cpu"] {
            arguments.push(text.into());
        }
        for text in ["--checkpoints", "", "--log-format", "text", "--log", "info"] {
            arguments.push(text.into());
        }
        let mut server = Server::start("the learner", program, folder, &arguments)?;
        let listening = server
            .ready(|folder, pid| {
                let text = std::fs::read(folder.join("run").join("learner.json")).ok()?;
                serde_json::from_slice::<Listening>(&text).ok().filter(|listening| listening.pid == pid)
            })
            .await?;
        Ok(Self { server, address: listening.grpc, metrics: listening.metrics })
    }

    /// The sum of a metric's series, as `/metrics` tells it now.
    pub(crate) async fn metric(&self, series: &str) -> Result<f64, BenchError> {
        let failed = |source| BenchError::Metrics { address: self.metrics, source };
        let mut stream = TcpStream::connect(self.metrics).await.map_err(failed)?;
        let request = "GET /metrics HTTP/1.1\r\nhost: learner\r\nconnection: close\r\n\r\n";
        stream.write_all(request.as_bytes()).await.map_err(failed)?;
        let mut text = String::new();
        stream.read_to_string(&mut text).await.map_err(failed)?;
        Ok(sum(&text, series))
    }
}

/// Adds up the lines that begin with `series`, a name with or without the beginning of its labels.
fn sum(metrics: &str, series: &str) -> f64 {
    let value = |line: &str| {
        let rest = line.strip_prefix(series)?;
        let whole = series.contains('{') || rest.starts_with([' ', '{']);
        rest.rsplit(' ').next().filter(|_| whole)?.trim().parse::<f64>().ok()
    };
    metrics.lines().filter_map(value).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn series_add_up_and_names_that_only_begin_alike_do_not_count() {
        let text = "# HELP a b\na_total{x=\"1\"} 2\na_total{x=\"2\"} 3\na_total_more 7\nb 4\r\n";
        assert_eq!(sum(text, "a_total"), 5.0);
        assert_eq!(sum(text, "a_total{x=\"2\""), 3.0);
        assert_eq!((sum(text, "b"), sum(text, "c")), (4.0, 0.0));
    }
}
