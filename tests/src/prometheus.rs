//! A real Prometheus that scrapes a real run.

use crate::http;
use crate::runs::Run;
use crate::wait;
use serde_json::Value;
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// A running server; ended when dropped.
#[derive(Debug)]
pub struct Prometheus {
    child: Child,
    address: String,
    _data: tempfile::TempDir,
}

impl Prometheus {
    /// Starts a server that scrapes each job's address every second and evaluates these rules.
    #[must_use]
    pub fn start(program: &Path, run: &Run, jobs: &[(&str, &str)], rules: &Path) -> Self {
        let data = tempfile::tempdir().unwrap();
        let mut config = format!(
            "global: {{scrape_interval: 1s, evaluation_interval: 1s}}\nrule_files: [{:?}]\nscrape_configs:\n",
            rules.display().to_string()
        );
        for (job, address) in jobs {
            config.push_str(&format!(
                "  - job_name: {job}\n    static_configs: [{{targets: [{address:?}]}}]\n"
            ));
        }
        let file = data.path().join("prometheus.yml");
        std::fs::write(&file, config).unwrap();
        // It cannot be asked which port it took, so it is told one that was free a moment ago.
        let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string();
        let log = std::fs::File::create(data.path().join("log")).unwrap();
        let child = Command::new(program)
            .arg(format!("--config.file={}", file.display()))
            .arg(format!("--storage.tsdb.path={}", data.path().join("tsdb").display()))
            .arg(format!("--web.listen-address={address}"))
            .env("CROSS_TEST_RUN", run.marker())
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log)
            .spawn()
            .unwrap();
        let mut server = Self { child, address, _data: data };
        wait::until("Prometheus", || {
            let ended = server.child.try_wait().unwrap();
            let log = || std::fs::read_to_string(server._data.path().join("log")).unwrap_or_default();
            assert!(ended.is_none(), "Prometheus ended: {}", log());
            http::get(&server.address, "/-/ready")
        });
        server
    }

    /// The series that a query has now; the server's own words if it does not parse.
    ///
    /// # Errors
    /// What Prometheus says of the query.
    pub fn query(&self, query: &str) -> Result<Vec<Value>, String> {
        let body = http::get(&self.address, &format!("/api/v1/query?query={}", http::escaped(query)))
            .ok_or_else(|| format!("Prometheus refuses {query}"))?;
        let answer: Value = serde_json::from_str(&body).map_err(|error| error.to_string())?;
        Ok(answer["data"]["result"].as_array().cloned().unwrap_or_default())
    }

    /// Every alert rule as the server knows it.
    #[must_use]
    pub fn rules(&self) -> Vec<Value> {
        let body = http::get(&self.address, "/api/v1/rules").unwrap_or_default();
        let answer: Value = serde_json::from_str(&body).unwrap_or_default();
        let groups = answer["data"]["groups"].as_array().cloned().unwrap_or_default();
        groups.iter().flat_map(|group| group["rules"].as_array().cloned().unwrap_or_default()).collect()
    }
}

impl Drop for Prometheus {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The selectors of our metrics in a query, each with its labels: `cross_learner_loss{term="x"}`.
#[must_use]
pub fn selectors(query: &str) -> Vec<String> {
    let is_name = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == ':';
    let mut found = Vec::new();
    let mut rest = query;
    while let Some(start) = rest.find(|c: char| is_name(c) || c == '"' || c == '{') {
        rest = &rest[start..];
        // A text or the labels of something else: nothing in it is a metric.
        if let Some(text) = rest.strip_prefix('"') {
            rest = text.split_once('"').map_or("", |(_, after)| after);
            continue;
        }
        if let Some(labels) = rest.strip_prefix('{') {
            rest = labels.split_once('}').map_or("", |(_, after)| after);
            continue;
        }
        let end = rest.find(|c| !is_name(c)).unwrap_or(rest.len());
        let (name, after) = rest.split_at(end);
        rest = after;
        if name == "up" || name.starts_with("cross_") || name.starts_with("process_") {
            let labels = match (after.starts_with('{'), after.find('}')) {
                (true, Some(end)) => &after[..=end],
                _ => "",
            };
            found.push(format!("{name}{labels}"));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::selectors;

    #[test]
    fn selectors_are_found_with_their_labels_and_nothing_else_is() {
        let query =
            r#"sum by (cross) (rate(cross_a_total{x="cross_b"}[5m])) / up{job="j"} > time() - cross_c"#;
        assert_eq!(selectors(query), [r#"cross_a_total{x="cross_b"}"#, r#"up{job="j"}"#, "cross_c"]);
        assert_eq!(selectors("1 + 1"), Vec::<String>::new());
    }
}
