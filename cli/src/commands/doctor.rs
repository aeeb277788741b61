//! `cross doctor`: is this machine ready, and if not, what to do.

use crate::failure::Outcome;
use crate::output;
use crate::sumo::SumoOption;
use clap::Args;
use cross_config::{Config, LearnerConfig};
use cross_model::Abilities;
use cross_sim::layout::load_layout;
use cross_sim::scenario::{self, Scenario};
use cross_support::child::sibling;
use cross_support::open_files;
use cross_traci::sumo::{Sumo, SumoCommand, SumoHome};
use serde::Serialize;
use std::fmt::Write as _;
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

/// Checks the machine and says what to fix
///
/// Required checks decide the exit code; warnings do not.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  cross doctor
  cross doctor --sumo-home /opt/sumo
  cross doctor --json | jq '.checks[] | select(.status != \"ok\")'")]
pub(crate) struct Doctor {
    #[command(flatten)]
    sumo: SumoOption,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Memory below which the default training may not fit.
const MEMORY_WANTED: u64 = 2 << 30;
/// Disk space that a few runs take.
const DISK_WANTED: u64 = 1 << 30;
/// Open files that a learner with a few hundred connections takes.
const FILES_WANTED: u64 = 512;
/// For SUMO to start and answer.
const SUMO_TIMEOUT: Duration = Duration::from_secs(30);

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Status {
    Ok,
    Warning,
    Failed,
}

#[derive(Debug, Serialize)]
struct Check {
    name: &'static str,
    status: Status,
    detail: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    remedy: Option<String>,
}

#[derive(Debug, Serialize)]
struct Report {
    ok: bool,
    checks: Vec<Check>,
}

impl Check {
    fn ok(name: &'static str, detail: impl Into<String>) -> Self {
        Self { name, status: Status::Ok, detail: detail.into(), remedy: None }
    }

    fn failed(name: &'static str, detail: impl std::fmt::Display, remedy: &str) -> Self {
        Self { name, status: Status::Failed, detail: detail.to_string(), remedy: Some(remedy.to_owned()) }
    }

    /// Ok if the condition holds, else a warning.
    fn warn_unless(holds: bool, name: &'static str, detail: String, remedy: &str) -> Self {
        if holds {
            Self::ok(name, detail)
        } else {
            Self { name, status: Status::Warning, detail, remedy: Some(remedy.to_owned()) }
        }
    }
}

impl Doctor {
    pub(crate) fn run(&self) -> Outcome<ExitCode> {
        let mut checks = self.sumo();
        checks.push(libtorch());
        checks.push(device());
        checks.extend(scenarios());
        checks.push(program("cross-learner"));
        checks.push(program("cross-actor"));
        checks.push(ports());
        checks.push(cores());
        checks.extend(memory());
        checks.extend(disk());
        checks.push(open_files());
        let report = Report { ok: checks.iter().all(|check| check.status != Status::Failed), checks };
        if self.json {
            output::json(&report)?;
        } else {
            output::text(&render(&report))?;
        }
        Ok(if report.ok { ExitCode::SUCCESS } else { ExitCode::from(crate::failure::FAILED) })
    }

    /// Found, of which version, and does it run and talk.
    fn sumo(&self) -> Vec<Check> {
        const REMEDY: &str = "run `make build`, which installs it, or give --sumo-home DIR or SUMO_HOME";
        let home = match SumoHome::locate(self.sumo.sumo_home.as_deref()) {
            Ok(home) => home,
            Err(error) => return vec![Check::failed("sumo", error, REMEDY)],
        };
        let version = match home.version() {
            Ok(version) => version,
            Err(error) => return vec![Check::failed("sumo", error, REMEDY)],
        };
        let found = Check::ok("sumo", format!("{version} in {}", home.path().display()));
        vec![found, simulation(&home)]
    }
}

/// Starts SUMO on a net of one street and asks it something, as an actor would.
fn simulation(home: &SumoHome) -> Check {
    const NAME: &str = "sumo runs";
    let attempt = || -> anyhow::Result<String> {
        let directory = tempfile::tempdir()?;
        let net = directory.path().join("street.net.xml");
        std::fs::write(&net, STREET)?;
        let command = SumoCommand::new().option("--net-file", net);
        let mut sumo = Sumo::start(home, &command, SUMO_TIMEOUT)?;
        let (api, _) = sumo.client().version();
        sumo.client().simulation_step(0.0)?;
        sumo.close()?;
        Ok(format!("a simulation started and answered (TraCI {api})"))
    };
    match attempt() {
        Ok(detail) => Check::ok(NAME, detail),
        Err(error) => Check::failed(
            NAME,
            format!("{error:#}"),
            "reinstall SUMO: remove .deps/sumo and run `make build`",
        ),
    }
}

const STREET: &str = r#"<net version="1.20">
  <location netOffset="0,0" convBoundary="0,0,100,0" origBoundary="0,0,100,0" projParameter="!"/>
  <edge id="street" from="a" to="b" priority="1">
    <lane id="street_0" index="0" speed="13.9" length="100" shape="0,0 100,0"/>
  </edge>
  <junction id="a" type="dead_end" x="0" y="0" incLanes="" intLanes="" shape="0,0 0,-3"/>
  <junction id="b" type="dead_end" x="100" y="0" incLanes="street_0" intLanes="" shape="100,-3 100,0"/>
</net>
"#;

fn libtorch() -> Check {
    const NAME: &str = "libtorch";
    // 2 x 3 by 3 x 2 of ones: every entry 3, their sum 12.
    let ones =
        |rows: i64, columns: i64| tch::Tensor::f_ones([rows, columns], (tch::Kind::Float, tch::Device::Cpu));
    let sum = ones(2, 3)
        .and_then(|a| a.f_matmul(&ones(3, 2)?))
        .and_then(|product| product.f_sum(tch::Kind::Float))
        .and_then(|sum| f64::try_from(&sum));
    match sum {
        Ok(12.0) => Check::ok(NAME, format!("{}, and it multiplies", cross_model::libtorch_version())),
        Ok(other) => {
            Check::failed(NAME, format!("a product that should sum to 12 sums to {other}"), TORCH_REMEDY)
        }
        Err(error) => Check::failed(NAME, error, TORCH_REMEDY),
    }
}

/// Never a failure: every machine has a CPU, and what a configuration asks for beyond that is checked when it is used.
fn device() -> Check {
    let machine = Abilities::detect();
    let cuda = match (machine.cuda_built, machine.cuda_devices) {
        (false, _) => "this libtorch is without CUDA".to_owned(),
        (true, 0) => "libtorch finds no CUDA device".to_owned(),
        (true, 1) => "one CUDA device".to_owned(),
        (true, devices) => format!("{devices} CUDA devices"),
    };
    let taken = if machine.cuda_devices > 0 { "cuda:0" } else { "cpu" };
    let bf16 = if machine.cpu_bf16 { "has" } else { "does not have" };
    let detail = format!("updates run on {taken} ({cuda}); the processor {bf16} bf16 instructions");
    Check::ok("device", detail)
}

const TORCH_REMEDY: &str = "reinstall libtorch: remove .deps/libtorch and run `make build`";

fn scenarios() -> Vec<Check> {
    const NAME: &str = "scenarios";
    const REMEDY: &str =
        "run `make build`, which fetches the maps, or point CROSS_SCENARIOS at a folder of scenarios";
    let known = scenario::list();
    if known.is_empty() {
        return vec![Check::failed(NAME, "no scenario was found", REMEDY)];
    }
    let env = Config::default().env;
    let mut good = Vec::new();
    let mut checks = Vec::new();
    for entry in known {
        let loaded = Scenario::from_directory(&entry.directory)
            .map_err(anyhow::Error::from)
            .and_then(|scenario| Ok(load_layout(&scenario, &env)?));
        match loaded {
            Ok(layout) => good.push(format!("{} ({} intersections)", entry.name, layout.agents())),
            Err(error) => checks.push(Check::failed("scenario", format!("{error:#}"), REMEDY)),
        }
    }
    if !good.is_empty() {
        checks.insert(0, Check::ok(NAME, good.join(", ")));
    }
    checks
}

/// A program of the project, beside this one and of the same version.
fn program(name: &'static str) -> Check {
    const REMEDY: &str = "run `make build`";
    let path = match sibling(name) {
        Ok(path) => path,
        Err(error) => return Check::failed(name, error, REMEDY),
    };
    match std::process::Command::new(&path).arg("--version").output() {
        Ok(output) if output.status.success() => {
            let said = String::from_utf8_lossy(&output.stdout);
            let own = env!("CARGO_PKG_VERSION");
            if said.split_whitespace().any(|word| word == own) {
                Check::ok(name, format!("{own} in {}", path.display()))
            } else {
                Check::failed(name, format!("{} is {}, this is {own}", path.display(), said.trim()), REMEDY)
            }
        }
        Ok(output) => Check::failed(
            name,
            format!("{} fails to start: {}", path.display(), String::from_utf8_lossy(&output.stderr).trim()),
            REMEDY,
        ),
        Err(error) => Check::failed(name, format!("{} fails to start: {error}", path.display()), REMEDY),
    }
}

fn ports() -> Check {
    const NAME: &str = "loopback ports";
    match std::net::TcpListener::bind("127.0.0.1:0").and_then(|listener| listener.local_addr()) {
        Ok(_) => Check::ok(NAME, "a port on 127.0.0.1 can be opened"),
        Err(error) => Check::failed(
            NAME,
            format!("no port on 127.0.0.1 can be opened: {error}"),
            "allow local TCP ports",
        ),
    }
}

fn cores() -> Check {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    Check::warn_unless(
        cores >= 2,
        "cores",
        format!("{cores}"),
        "training works on one core and takes about twice as long; lend it another",
    )
}

fn memory() -> Option<Check> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    let bytes = line.split_whitespace().next()?.parse::<u64>().ok()?.saturating_mul(1024);
    let remedy = "close other programs, or train with fewer actors (--actors 1)";
    Some(Check::warn_unless(bytes >= MEMORY_WANTED, "memory", format!("{} available", gib(bytes)), remedy))
}

fn disk() -> Option<Check> {
    let space = rustix::fs::statvfs(Path::new(".")).ok()?;
    let bytes = space.f_bavail.saturating_mul(space.f_frsize);
    let remedy = "make room, or put the run on another disk with --run DIR";
    Some(Check::warn_unless(bytes >= DISK_WANTED, "disk", format!("{} free here", gib(bytes)), remedy))
}

fn open_files() -> Check {
    // A learner raises its own limit so far. None means no limit.
    let limit = open_files::attainable();
    let holds = limit.is_none_or(|limit| limit >= FILES_WANTED);
    let wanted = LearnerConfig::default().max_connections;
    let detail = limit.map_or_else(
        || "no limit".to_owned(),
        |limit| {
            let connections = open_files::connections(wanted, Some(limit));
            format!("a process may have {limit}, a learner {connections} of {wanted} connections")
        },
    );
    Check::warn_unless(
        holds,
        "open files",
        detail,
        "raise the hard limit: ulimit -Hn 8192 as root, or LimitNOFILE=",
    )
}

fn gib(bytes: u64) -> String {
    format!("{:.1} GiB", bytes as f64 / (1u64 << 30) as f64)
}

fn render(report: &Report) -> String {
    let width = report.checks.iter().map(|check| check.name.len()).max().unwrap_or(0);
    let mut text = String::new();
    for check in &report.checks {
        let mark = match check.status {
            Status::Ok => "ok  ",
            Status::Warning => "warn",
            Status::Failed => "FAIL",
        };
        let _ = writeln!(text, "{mark}  {:width$}  {}", check.name, check.detail);
        if let Some(remedy) = &check.remedy {
            let _ = writeln!(text, "      {:width$}  -> {remedy}", "");
        }
    }
    text.push_str(if report.ok {
        "\nready: try `cross train`"
    } else {
        "\nnot ready: see the lines marked FAIL"
    });
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_line_that_is_not_ok_says_what_to_do() {
        let report = Report {
            ok: false,
            checks: vec![
                Check::ok("a", "fine"),
                Check::warn_unless(false, "bb", "1".to_owned(), "get more"),
                Check::failed("c", "gone", "bring it back"),
            ],
        };
        let text = render(&report);
        assert!(text.contains("warn  bb  1\n          -> get more\n"), "{text}");
        assert!(text.contains("FAIL  c   gone\n          -> bring it back\n"), "{text}");
        assert!(text.ends_with("see the lines marked FAIL"), "{text}");
    }

    #[test]
    fn libtorch_works_here() {
        assert_eq!(libtorch().status, Status::Ok);
        assert!(device().detail.contains("updates run on"));
    }
}
