//! The Kubernetes manifests: they fit their schemas and each other, and what they start is started here, with their very
//! arguments, variables, secrets and configuration.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests: documented by their names, failed by panics"
)]

use cross_tests::binaries;
use cross_tests::certificates::Authority;
use cross_tests::processes::assert_none_left;
use cross_tests::runs::Run;
use cross_tests::s3::S3;
use cross_tests::tools::{Tools, in_checkout};
use cross_tests::{http, wait};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

/// The oldest and the newest release of Kubernetes that the manifests are held against.
const RELEASES: [&str; 2] = ["1.33", "1.37"];
const TOKEN: &str = "a-token-for-the-cluster";

/// The manifests of an overlay, rendered by kustomize and checked against their schemas.
fn render(tools: &Tools, overlay: &str) -> Option<Vec<Value>> {
    let kubectl = tools.kubectl()?;
    let folder = in_checkout("deploy/kubernetes/overlays").join(overlay);
    let rendered = Command::new(kubectl).arg("kustomize").arg(&folder).output().unwrap();
    assert!(rendered.status.success(), "{overlay}: {}", String::from_utf8_lossy(&rendered.stderr));
    let checked = checked(tools, &rendered.stdout);
    assert!(checked.status.success(), "{overlay}: {}", String::from_utf8_lossy(&checked.stderr));
    Some(serde_json::from_slice(&checked.stdout).unwrap())
}

fn checked(tools: &Tools, manifests: &[u8]) -> Output {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("manifests.yaml");
    fs::write(&file, manifests).unwrap();
    let mut check = tools.python();
    check.arg(in_checkout("tests/tools/manifests.py")).args(RELEASES);
    check.stdin(fs::File::open(&file).unwrap()).output().unwrap()
}

fn find<'a>(manifests: &'a [Value], kind: &str, name: &str) -> &'a Value {
    let is_it = |m: &&Value| m["kind"] == kind && m["metadata"]["name"] == name;
    manifests.iter().find(is_it).unwrap_or_else(|| panic!("there is no {kind} {name}"))
}

/// Pod templates with the name of what owns them.
fn pods(manifests: &[Value]) -> Vec<(&str, &Value)> {
    let owner = |m: &&Value| m["kind"] == "StatefulSet" || m["kind"] == "Deployment";
    let owners = manifests.iter().filter(owner);
    owners.map(|m| (m["metadata"]["name"].as_str().unwrap(), &m["spec"]["template"])).collect()
}

fn texts(list: &Value) -> Vec<String> {
    list.as_array().into_iter().flatten().map(|text| text.as_str().unwrap().to_owned()).collect()
}

#[test]
fn manifests_fit_their_schemas_and_each_other() {
    let Some(tools) = Tools::find() else { return };
    for overlay in ["trial", "production"] {
        let Some(manifests) = render(&tools, overlay) else { return };
        assert_everything_fits(&manifests);
    }
    // A misspelt field of either kind of schema is noticed.
    for (text, word) in [
        ("{apiVersion: v1, kind: Service, metadata: {name: x}, spec: {portz: []}}", "portz"),
        (
            "{apiVersion: monitoring.coreos.com/v1, kind: PodMonitor, metadata: {name: x}, \
             spec: {selector: {}, podMetricsEndpoints: [{portt: x}]}}",
            "portt",
        ),
    ] {
        let refused = checked(&tools, text.as_bytes());
        let said = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(!refused.status.success() && said.contains(word), "{said}");
    }
}

fn assert_everything_fits(manifests: &[Value]) {
    let pods = pods(manifests);
    assert_eq!(pods.len(), 2);
    let recipe = fs::read_to_string(in_checkout("deploy/docker/Dockerfile")).unwrap();
    let accounts: BTreeSet<_> =
        pods.iter().map(|(_, pod)| pod["spec"]["serviceAccountName"].to_string()).collect();
    assert_eq!(accounts.len(), 2, "one account each");
    let mut port_names = BTreeSet::new();
    for (name, pod) in &pods {
        let spec = &pod["spec"];
        // As security.md asks for: nobody in there can become more than it is, or write where it should not.
        for (key, value) in [("automountServiceAccountToken", false), ("enableServiceLinks", false)] {
            assert_eq!(spec[key], value, "{name}: {key}");
        }
        let security = &spec["securityContext"];
        assert_eq!(security["runAsNonRoot"], true, "{name}");
        assert_eq!(security["seccompProfile"]["type"], "RuntimeDefault", "{name}");
        assert!(
            recipe.contains(&format!("USER {0}:{1}", security["runAsUser"], security["runAsGroup"])),
            "{name}"
        );
        assert_eq!(security["fsGroup"], security["runAsGroup"], "{name}: secrets are the group's");
        let [container] = spec["containers"].as_array().unwrap().as_slice() else { panic!("{name}") };
        let own = &container["securityContext"];
        assert_eq!(own["readOnlyRootFilesystem"], true, "{name}");
        assert_eq!(own["allowPrivilegeEscalation"], false, "{name}");
        assert_eq!(texts(&own["capabilities"]["drop"]), ["ALL"], "{name}");
        assert!(container["resources"]["requests"]["memory"].is_string(), "{name}");
        for volume in spec["volumes"].as_array().unwrap() {
            if volume["secret"].is_object() {
                assert_eq!(volume["secret"]["defaultMode"], 0o440, "{name}: {volume}");
            }
        }
        for port in container["ports"].as_array().unwrap() {
            port_names.insert(port["name"].as_str().unwrap());
            assert!(recipe.contains(&format!(" {}", port["containerPort"])), "the image exposes no {port}");
        }
        for probe in ["readinessProbe", "livenessProbe"] {
            let path = container[probe]["httpGet"]["path"].as_str().unwrap();
            assert_eq!(
                (path, &container[probe]["httpGet"]["port"]),
                (if probe == "livenessProbe" { "/live" } else { "/ready" }, &Value::from("admin"))
            );
        }
    }
    let grace = find(manifests, "StatefulSet", "cross-learner")["spec"]["template"]["spec"]["terminationGracePeriodSeconds"].as_u64();
    let drain = cross_config::Config::default().learner.drain_seconds;
    assert!(grace.unwrap() > drain, "the learner would be killed in its drain");

    // Selectors find pods, and ports have the names that policies and monitors give them.
    let labels: Vec<&Value> = pods.iter().map(|(_, pod)| &pod["metadata"]["labels"]).collect();
    let service_labels =
        manifests.iter().filter(|m| m["kind"] == "Service").map(|m| &m["metadata"]["labels"]);
    let matches = |wanted: &Value, labels: &Value| {
        wanted.as_object().into_iter().flatten().all(|(key, value)| labels[key] == *value)
    };
    let service_labels: Vec<&Value> = service_labels.collect();
    for m in manifests {
        let (kind, name) = (m["kind"].as_str().unwrap(), m["metadata"]["name"].as_str().unwrap());
        let (selector, among) = match kind {
            "Service" => (&m["spec"]["selector"], &labels),
            "NetworkPolicy" => (&m["spec"]["podSelector"]["matchLabels"], &labels),
            "PodDisruptionBudget" | "PodMonitor" => (&m["spec"]["selector"]["matchLabels"], &labels),
            "ServiceMonitor" => (&m["spec"]["selector"]["matchLabels"], &service_labels),
            _ => continue,
        };
        assert!(among.iter().any(|labels| matches(selector, labels)), "{kind} {name} selects nothing");
        let mut named = Vec::new();
        named_ports(&m["spec"], &mut named);
        for port in named {
            assert!(port_names.contains(port.as_str()), "{kind} {name}: nobody has a port {port}");
        }
    }
}

/// Every text under a key `port` or `targetPort`.
fn named_ports(value: &Value, found: &mut Vec<String>) {
    match value {
        Value::Object(map) => {
            for (key, value) in map {
                match value.as_str() {
                    Some(text) if key == "port" || key == "targetPort" => found.push(text.to_owned()),
                    _ => named_ports(value, found),
                }
            }
        }
        Value::Array(list) => list.iter().for_each(|value| named_ports(value, found)),
        _ => {}
    }
}

#[test]
fn images_and_the_metric_of_scaling_have_the_names_that_others_give_them() {
    let read = |path: &str| fs::read_to_string(in_checkout(path)).unwrap();
    let compose = read("docker-compose.yml");
    for (file, image) in [("learner", "cross-learner:latest"), ("actor", "cross-actor:latest")] {
        let manifest = read(&format!("deploy/kubernetes/base/{file}.yaml"));
        assert!(manifest.contains(&format!("image: {image}\n")), "{file}");
        assert!(compose.contains(&format!(":-{image}}}")), "{image} is not docker-compose.yml's");
    }
    let value = |path: &str, key: &str| {
        let text = read(path);
        let value = text.lines().find_map(|line| line.trim().strip_prefix(key));
        value.unwrap_or_else(|| panic!("{path} has no {key}")).trim().to_owned()
    };
    let metric = value("deploy/kubernetes/prometheus-adapter.yaml", "as: ");
    let autoscaler = read("deploy/kubernetes/components/autoscaling/autoscaler.yaml");
    assert!(autoscaler.contains(&format!("name: {metric}\n")), "nothing is scaled on {metric}");
}

#[test]
fn the_operator_s_alerts_are_those_of_prometheus() {
    let rules = fs::read_to_string(in_checkout("deploy/prometheus/alerts.yml")).unwrap();
    let path = in_checkout("deploy/kubernetes/components/monitoring/alerts.yaml");
    let own = fs::read_to_string(&path).unwrap();
    let head = own.split_once("\nspec:\n").unwrap().0;
    let indent = |line: &str| if line.trim().is_empty() { line.to_owned() } else { format!("  {line}") };
    // The first line of the rules is about another page.
    let body: String = rules.split_inclusive('\n').skip(1).map(indent).collect();
    let expected = format!("{head}\nspec:\n{body}");
    if std::env::var_os("CROSS_REGENERATE").is_some() {
        fs::write(&path, &expected).unwrap();
        return;
    }
    assert!(
        own == expected,
        "deploy/kubernetes/components/monitoring/alerts.yaml is not deploy/prometheus/alerts.yml; \
         write it anew with CROSS_REGENERATE=1 cargo test --release -p cross-tests alerts_are"
    );
}

/// A container, started as a process of this machine: its arguments and variables, with the mounts in a folder.
struct Container<'a> {
    run: &'a Run,
    mounts: &'a Path,
    arguments: Vec<String>,
    variables: BTreeMap<String, String>,
}

impl<'a> Container<'a> {
    fn of(run: &'a Run, mounts: &'a Path, manifests: &[Value], kind: &str, name: &str) -> Self {
        let container = &find(manifests, kind, name)["spec"]["template"]["spec"]["containers"][0];
        let here = |text: String| {
            let root = mounts.display();
            text.replace("/etc/", &format!("{root}/etc/"))
                .replace("/runs", &format!("{root}/runs"))
                .replace("0.0.0.0:7400", "127.0.0.1:0")
                .replace("0.0.0.0:7401", "127.0.0.1:0")
        };
        let variable = |v: &Value| {
            (v["name"].as_str().unwrap().to_owned(), here(v["value"].as_str().unwrap().to_owned()))
        };
        Self {
            run,
            mounts,
            arguments: texts(&container["args"]).into_iter().map(here).collect(),
            variables: container["env"].as_array().unwrap().iter().map(variable).collect(),
        }
    }

    fn start(&self, program: &str) -> Child {
        let log = |name: &str| fs::File::create(self.mounts.join(format!("{program}.{name}"))).unwrap();
        let mut command = binaries::command(program);
        command.args(&self.arguments).envs(&self.variables).env("CROSS_TEST_RUN", self.run.marker());
        command.stdin(Stdio::null()).stdout(log("out")).stderr(log("log")).spawn().unwrap()
    }

    fn log(&self, program: &str) -> String {
        fs::read_to_string(self.mounts.join(format!("{program}.log"))).unwrap_or_default()
    }
}

fn secret(mounts: &Path, folder: &str, files: &[(&str, &str)]) {
    let folder = mounts.join("etc").join(folder);
    fs::create_dir_all(&folder).unwrap();
    for (name, text) in files {
        let path = folder.join(name);
        fs::write(&path, text).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o440)).unwrap();
    }
}

#[test]
fn what_the_manifests_start_finds_each_other_and_is_ready() {
    let Some(tools) = Tools::find() else { return };
    for overlay in ["trial", "production"] {
        let Some(manifests) = render(&tools, overlay) else { return };
        let run = Run::new();
        starts_and_is_ready(&tools, overlay, &manifests, &run);
        assert_none_left(&run.marker());
    }
}

fn starts_and_is_ready(tools: &Tools, overlay: &str, manifests: &[Value], run: &Run) {
    let folder = tempfile::tempdir().unwrap();
    let mounts = folder.path();
    let config = manifests.iter().find(|m| m["kind"] == "ConfigMap").unwrap();
    fs::create_dir_all(mounts.join("etc/cross")).unwrap();
    fs::write(mounts.join("etc/cross/config.toml"), config["data"]["config.toml"].as_str().unwrap()).unwrap();
    secret(mounts, "cross-token", &[("token", TOKEN)]);
    let mut learner = Container::of(run, mounts, manifests, "StatefulSet", "cross-learner");
    let mut actor = Container::of(run, mounts, manifests, "Deployment", "cross-actor");
    let tls = overlay == "production";
    let store = tls.then(|| {
        let authority = Authority::new("cluster");
        let ca = fs::read_to_string(authority.file(mounts, "ca")).unwrap();
        for (who, container) in [("learner", &mut learner), ("actor", &mut actor)] {
            let pair = authority.issue(mounts, who, &["cross-learner", "127.0.0.1"]);
            let read = |path: &Path| fs::read_to_string(path).unwrap();
            let files =
                [("tls.crt", &*read(&pair.certificate)), ("tls.key", &*read(&pair.key)), ("ca.crt", &*ca)];
            secret(mounts, &format!("{who}-tls"), &files);
            // Each pod has a file system of its own, this machine has one.
            for value in container.variables.values_mut() {
                *value = value.replace("/cross-tls/", &format!("/{who}-tls/"));
            }
        }
        let store = S3::start(tools);
        let url = learner.variables["CROSS_CHECKPOINTS"].clone();
        let bucket = url.strip_prefix("s3://").unwrap().split('/').next().unwrap();
        http::request("PUT", store.address(), &format!("/{bucket}"), "").unwrap();
        // What the secret cross-s3 holds.
        learner
            .variables
            .extend(store.environment().into_iter().map(|(name, value)| (name.to_owned(), value)));
        store
    });

    let mut processes = Processes(vec![learner.start("cross-learner")]);
    let listening: Value = wait::until("the learner", || {
        processes.assert_running(&learner.log("cross-learner"));
        serde_json::from_slice(&fs::read(mounts.join("runs/cluster/learner.json")).ok()?).ok()
    });
    let url = actor.variables.get_mut("CROSS_LEARNER").unwrap();
    assert_eq!(url.starts_with("https://"), tls, "{url}");
    *url = url.replace("cross-learner:7400", listening["grpc"].as_str().unwrap());
    processes.0.push(actor.start("cross-actor"));
    // It joined, with TLS and token where those are asked for, and holds the learner's weights.
    wait::until("a ready actor", || {
        let log = actor.log("cross-actor");
        processes.assert_running(&format!("{log}\n{}", learner.log("cross-learner")));
        let (_, rest) = log.split_once("metrics at http://")?;
        http::get(rest.split_once('/')?.0, "/ready")
    });
    if let Some(store) = &store {
        let claimed = || store.get_of("cross-checkpoints", "cluster/run.json");
        wait::until("the learner's claim in the store", claimed);
    }
    // As Kubernetes ends a pod.
    for child in &mut processes.0 {
        kill_process(Pid::from_child(child), Signal::TERM).unwrap();
        assert!(child.wait().unwrap().success(), "{}", learner.log("cross-learner"));
    }
    if let Some(store) = &store {
        let latest = store.get_of("cross-checkpoints", "cluster/checkpoints/latest");
        assert!(
            latest.is_some(),
            "the last checkpoint is not in the store: {}",
            learner.log("cross-learner")
        );
    }
    assert!(!learner.log("cross-learner").contains(TOKEN));
}

/// Killed when dropped, so that a failed test leaves nothing behind.
struct Processes(Vec<Child>);

impl Processes {
    fn assert_running(&mut self, log: &str) {
        for child in &mut self.0 {
            assert!(child.try_wait().unwrap().is_none(), "it ended early: {log}");
        }
    }
}

impl Drop for Processes {
    fn drop(&mut self) {
        for child in &mut self.0 {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}
