//! The compose file with real containers: a learner, three actors and Prometheus train, and go down in good order.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests: documented by their names, failed by panics"
)]

use cross_tests::{http, packages, wait};
use serde_json::Value;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

const BASE: &str = "cross-test-base:bookworm";
const LEARNER: &str = "cross-test-learner:latest";
const ACTOR: &str = "cross-test-actor:latest";
const PROMETHEUS: &str = "cross-test-prometheus:latest";

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_owned()
}

fn run(command: impl std::borrow::BorrowMut<Command>) -> Output {
    let mut command = command;
    let command = command.borrow_mut();
    let output = command.stdin(Stdio::null()).output().unwrap();
    assert!(
        output.status.success(),
        "{command:?} failed: {}\n{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    );
    output
}

fn text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).trim().to_owned()
}

/// What this test needs of the machine; says what is missing.
fn machine_is_ready() -> bool {
    let programs = [
        ("docker", "docker.io"),
        ("docker-compose", "docker-compose"),
        ("debootstrap", "debootstrap"),
        ("prometheus", "prometheus"),
    ];
    if programs.iter().any(|(name, package)| packages::program(name, package).is_none()) {
        return false;
    }
    let answers = Command::new("docker").arg("info").output().is_ok_and(|info| info.status.success());
    if !answers {
        packages::skipped("the Docker daemon does not answer; start it with: systemctl start docker");
    } else if !rustix::process::geteuid().is_root() {
        packages::skipped("debootstrap needs root");
        return false;
    }
    answers
}

/// Builds the images as `make images` does, on a base made of Debian's packages.
fn build_images(folder: &Path) {
    let scripts = root().join("deploy/docker");
    let has_base = Command::new("docker").args(["image", "inspect", BASE]).output().unwrap().status.success();
    if !has_base {
        run(Command::new(scripts.join("base.sh")).arg(BASE));
    }
    run(Command::new(scripts.join("images.sh"))
        .env("BASE_IMAGE", BASE)
        .env("LEARNER_IMAGE", LEARNER)
        .env("ACTOR_IMAGE", ACTOR));
    let program = packages::program("prometheus", "prometheus").unwrap();
    std::fs::copy(program, folder.join("prometheus")).unwrap();
    let recipe = format!(
        "FROM {BASE}\nRUN install -d -o 65534 /prometheus\nCOPY prometheus /bin/prometheus\nUSER 65534\nENTRYPOINT [\"/bin/prometheus\"]\n"
    );
    std::fs::write(folder.join("Dockerfile"), recipe).unwrap();
    run(Command::new("docker").args(["build", "--quiet", "--tag", PROMETHEUS]).arg(folder));
}

/// The stack, taken down with its volumes when dropped.
struct Stack {
    project: String,
    grpc: u16,
    prometheus: u16,
    config: PathBuf,
}

impl Stack {
    fn up(config: PathBuf) -> Self {
        // Ports that were free a moment ago, so that a cluster of the developer's own is not in the way.
        let [grpc, prometheus] =
            [0, 1].map(|_| std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port());
        let project = format!("crosstest{}", std::process::id());
        let stack = Self { project, grpc, prometheus, config };
        // Grafana needs a registry; everything else is here.
        run(stack.compose(&[
            "up",
            "--detach",
            "--no-build",
            "--scale",
            "actor=3",
            "learner",
            "actor",
            "prometheus",
        ]));
        stack
    }

    fn compose(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new("docker-compose");
        command
            .current_dir(root())
            .args(["--project-name", &self.project])
            .args(arguments)
            .env("CROSS_LEARNER_IMAGE", LEARNER)
            .env("CROSS_ACTOR_IMAGE", ACTOR)
            .env("PROMETHEUS_IMAGE", PROMETHEUS)
            .env("CROSS_CONFIG", &self.config)
            .env("CROSS_GRPC_PORT", self.grpc.to_string())
            .env("CROSS_PROMETHEUS_PORT", self.prometheus.to_string());
        command
    }

    /// Container ids of a service.
    fn containers(&self, service: &str) -> Vec<String> {
        text(&run(self.compose(&["ps", "--quiet", service]))).lines().map(str::to_owned).collect()
    }

    /// The value of a query, once it has one.
    fn query(&self, query: &str) -> Option<f64> {
        let path = format!("/api/v1/query?query={}", http::escaped(query));
        let body = http::get(&format!("127.0.0.1:{}", self.prometheus), &path)?;
        let answer: Value = serde_json::from_str(&body).ok()?;
        answer["data"]["result"][0]["value"][1].as_str()?.parse().ok()
    }

    fn logs(&self) -> String {
        text(&run(self.compose(&["logs", "--tail=30"])))
    }
}

impl Drop for Stack {
    fn drop(&mut self) {
        let _ = self.compose(&["down", "--volumes", "--timeout", "10"]).output();
    }
}

fn inspect(container: &str, format: &str) -> String {
    text(&run(Command::new("docker").args(["inspect", "--format", format, container])))
}

#[test]
fn the_stack_trains_in_containers_and_goes_down_with_a_checkpoint() {
    if !machine_is_ready() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    build_images(folder.path());
    let config = folder.path().join("config.toml");
    let small = format!("scenarios = [\"grid4x4\"]\nupdates = 100000\n{}", cross_tests::runs::SMALL);
    std::fs::write(&config, small).unwrap();

    let stack = Stack::up(config);
    let mut named = Vec::new();
    for (service, count) in [("learner", 1), ("actor", 3), ("prometheus", 1)] {
        let containers = stack.containers(service);
        assert_eq!(containers.len(), count, "{service}\n{}", stack.logs());
        for container in containers {
            assert_eq!(inspect(&container, "{{.HostConfig.ReadonlyRootfs}}"), "true", "{service}");
            assert_eq!(inspect(&container, "{{.HostConfig.CapDrop}}"), "[ALL]", "{service}");
            let user = inspect(&container, "{{.Config.User}}");
            assert!(!["", "0", "root"].contains(&user.as_str()), "{service} runs as {user:?}");
            named.push(inspect(&container, "{{.Name}}").trim_start_matches('/').to_owned());
        }
    }
    let [learner] = stack.containers("learner").try_into().unwrap();
    wait::until("a healthy learner", || {
        assert_eq!(inspect(&learner, "{{.RestartCount}}"), "0", "the learner ended: {}", stack.logs());
        (inspect(&learner, "{{.State.Health.Status}}") == "healthy").then_some(())
    });
    wait::until("all three actors at the learner, as Prometheus sees it", || {
        stack.query("max(cross_learner_actors)").filter(|&actors| actors >= 3.0)
    });
    let updates = wait::until("five updates, as Prometheus sees them", || {
        stack.query("max(cross_learner_updates_total)").filter(|&updates| updates >= 5.0)
    });
    // Found by Docker's name service, every actor is a target of its own.
    wait::until("every actor scraped", || {
        stack.query("sum(up{job=\"cross-actor\"})").filter(|&actors| actors >= 3.0)
    });
    // Past the capture of the test's output: it is part of what a run of the tests reports.
    let _ = writeln!(std::io::stderr(), "containers: {}; {updates} updates", named.join(", "));

    // The drain: `stop` sends SIGTERM and waits for the grace period before it kills.
    run(stack.compose(&["stop", "actor"]));
    run(stack.compose(&["stop", "learner"]));
    assert_eq!(inspect(&learner, "{{.State.ExitCode}}"), "0", "{}", stack.logs());
    let said = text(&run(stack.compose(&["logs", "--no-color", "learner"])));
    assert!(!said.contains("panicked"), "{said}");

    // What was learned is in the volume, and the next start goes on from it.
    let before = run(stack.compose(&["logs", "--no-color", "learner"])).stdout.len();
    run(stack.compose(&[
        "up",
        "--detach",
        "--no-build",
        "--scale",
        "actor=1",
        "learner",
        "actor",
        "prometheus",
    ]));
    let resumed = wait::until("the learner to resume", || {
        let said = run(stack.compose(&["logs", "--no-color", "learner"])).stdout;
        let said = String::from_utf8_lossy(said.get(before..)?).into_owned();
        let line = said.lines().find(|line| line.contains("\"message\":\"ready\""))?.to_owned();
        let (_, json) = line.split_once('{')?;
        let line: Value = serde_json::from_str(&format!("{{{json}")).ok()?;
        line["fields"]["updates"].as_f64()
    });
    assert!(resumed >= updates, "it begins at update {resumed}, but {updates} were made before");
    let _ = writeln!(std::io::stderr(), "containers: resumed at update {resumed}");
    let files = run(stack.compose(&[
        "exec",
        "-T",
        "learner",
        "cross",
        "checkpoint",
        "list",
        "--run",
        "/runs/cluster",
        "--json",
    ]));
    let listed: Value = serde_json::from_slice(&files.stdout).unwrap();
    assert!(listed["checkpoints"].as_array().is_some_and(|all| !all.is_empty()), "{listed}");
}
