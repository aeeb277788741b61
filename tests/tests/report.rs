//! `cross report`: a page of a real run and real evaluations, opened in a browser.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "tests: documented by their names, failed by panics"
)]

use cross_tests::packages;
use cross_tests::runs::Run;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Drawings of an evaluation with details, by the beginning of their ids.
const DRAWINGS: [&str; 7] = [
    "metrics-grid4x4",
    "queue-grid4x4",
    "speed-grid4x4",
    "running-grid4x4",
    "arrivals-grid4x4",
    "trips-grid4x4",
    "map-grid4x4-1",
];

/// What a page of a browser does that is not drawing: it opens everything, points at a curve, and notes what it found.
const LOOK: &str = r##"<script>
document.querySelectorAll("details").forEach((part) => { part.open = true; });
const size = (element) => { const box = element.getBoundingClientRect(); return [element.id || element.tagName, Math.min(box.width, box.height)]; };
const sizes = [...document.querySelectorAll("table, figure, .canvas svg, g.curve polyline")].map(size);
const target = document.querySelector("#queue-grid4x4 svg");
const box = target.getBoundingClientRect();
target.dispatchEvent(new PointerEvent("pointermove", { clientX: box.left + box.width / 2, clientY: box.top + box.height / 2 }));
const seen = { sizes, tip: document.querySelector(".tip").textContent, requests: performance.getEntriesByType("resource").map((entry) => entry.name) };
document.body.dataset.seen = JSON.stringify(seen);
</script>"##;

/// A browser without a window.
struct Browser {
    program: PathBuf,
    folder: tempfile::TempDir,
}

/// A page as a browser has it.
struct Opened {
    /// The document after its script has run.
    dom: String,
    /// What it wrote to the console.
    console: Vec<String>,
}

impl Browser {
    fn find() -> Option<Self> {
        let program = packages::program("chromium", "chromium")?;
        Some(Self {
            program,
            folder: tempfile::Builder::new().prefix("cross-test-browser-").tempdir().unwrap(),
        })
    }

    fn open(&self, page: &Path) -> Opened {
        let output = Command::new(&self.program)
            // No sandbox: in a container there may be no right to make one, and the page is our own.
            .args([
                "--headless=new",
                "--no-sandbox",
                "--disable-gpu",
                "--disable-dev-shm-usage",
                "--no-first-run",
            ])
            .args([
                "--window-size=1280,900",
                "--enable-logging=stderr",
                "--virtual-time-budget=5000",
                "--dump-dom",
            ])
            .arg(format!("--user-data-dir={}", self.folder.path().display()))
            .arg(format!("file://{}", page.display()))
            .output()
            .unwrap();
        let log = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "chromium: {log}");
        let console = log.lines().filter(|line| line.contains("CONSOLE")).map(str::to_owned).collect();
        Opened { dom: String::from_utf8(output.stdout).unwrap(), console }
    }
}

fn report(run: &Run, inputs: &[PathBuf], page: &Path) -> Value {
    let mut command = run.cross(&["report", "--json", "--title", "A test", "--out"]);
    command.arg(page).args(inputs);
    run.spawn(command).wait().json()
}

/// A run of two updates with its closing evaluation, and a folder with an evaluation of its own.
fn run_and_evaluations() -> (Run, PathBuf) {
    let run = Run::new();
    let _ =
        run.finish(&["--scenario", "grid4x4", "--updates", "2", "--actors", "1", "--eval-seeds", "1"]).json();
    let folder = run.path().with_file_name("results");
    std::fs::create_dir(&folder).unwrap();
    let mut command =
        run.cross(&["eval", "--scenario", "grid4x4", "--policy", "greedy", "--seeds", "2", "--config"]);
    command.arg(run.config()).arg("--out").arg(folder.join("greedy.json"));
    let finished = run.spawn(command).wait();
    assert_eq!(finished.code, Some(0), "{}", finished.stderr);
    (run, folder)
}

fn text(page: &Path) -> String {
    std::fs::read_to_string(page).unwrap()
}

#[test]
fn a_run_and_evaluations_become_a_page_that_a_browser_shows() {
    let (run, folder) = run_and_evaluations();
    let page = run.path().with_file_name("page.html");
    let content = report(&run, &[run.path(), folder.clone()], &page);
    assert_eq!(content["scenarios"], json!(["grid4x4"]));
    assert_eq!(content["runs"], json!(["run"]));
    assert!(
        content["evaluations"].as_u64().unwrap() >= 5,
        "cross, Fixed-Time, Max-Pressure, greedy: {content}"
    );
    let warnings = content["warnings"].to_string();
    assert!(warnings.contains("same SUMO seeds"), "one seed in the run, two in the folder: {warnings}");

    let html = text(&page);
    for drawing in DRAWINGS.into_iter().chain([
        "return-grid4x4-run",
        "loss-actor-total-run",
        "diagnostic-approx-kl-run",
        "experts-run",
    ]) {
        assert_eq!(html.matches(&format!("<figure id=\"{drawing}\"")).count(), 1, "{drawing}");
    }
    for words in ["54.96", "Unicorn", "seeds 1 to 2", "SUMO 1.28.0", "Warning: ", "<caption>"] {
        assert!(html.contains(words), "{words} is missing");
    }
    assert!(!html.contains("kept without details"), "the run keeps the details of its closing evaluation");
    // Whoever opens the page asks nobody else for anything.
    for address in ["http:", "https:", "src=", "@import", "url("] {
        assert!(!html.contains(address), "{address} is in the page");
    }
    // The same inputs, the same page.
    let again = run.path().with_file_name("again.html");
    report(&run, &[run.path(), folder], &again);
    assert!(text(&again) == html, "two pages of the same inputs differ");

    let Some(browser) = Browser::find() else { return };
    // A console that is not heard would always be quiet.
    let probe = run.path().with_file_name("probe.html");
    std::fs::write(
        &probe,
        html.replace("<body>", "<body><script src=\"missing.js\"></script><script>nobody()</script>"),
    )
    .unwrap();
    assert!(!browser.open(&probe).console.is_empty(), "errors on the console are not seen");

    let looked_at = run.path().with_file_name("looked-at.html");
    std::fs::write(&looked_at, html.replace("</body>", &format!("{LOOK}</body>"))).unwrap();
    let Opened { dom, console } = browser.open(&looked_at);
    assert!(console.is_empty(), "{console:?}");
    for tag in ["<table", "<figure", "<svg", "<tr", "<polyline", "<circle"] {
        assert_eq!(
            dom.matches(tag).count(),
            html.matches(tag).count(),
            "{tag}: the browser read another document than was written"
        );
    }
    let seen =
        dom.split("data-seen=\"").nth(1).expect("the page's script did not run").split('"').next().unwrap();
    let seen: Value = serde_json::from_str(&seen.replace("&quot;", "\"").replace("&amp;", "&")).unwrap();
    assert_eq!(seen["requests"], json!([]), "the page asks for something");
    assert!(seen["tip"].as_str().unwrap().contains("min"), "no values under the pointer: {}", seen["tip"]);
    let sizes = seen["sizes"].as_array().unwrap();
    assert!(sizes.len() > 30, "{sizes:?}");
    for size in sizes {
        // A curve that never changes is a flat line.
        let least = if size[0] == "polyline" { 0.0 } else { 40.0 };
        assert!(size[1].as_f64().unwrap() >= least, "{size} is not to be seen");
    }
}

#[test]
fn a_run_that_goes_on_is_shown_and_what_is_broken_is_named() {
    let run = Run::new();
    let place = |name: &str| run.path().with_file_name(name);
    let page = place("page.html").display().to_string();
    let given = |name: &str| place(name).display().to_string();

    std::fs::create_dir(run.path()).unwrap();
    let line = json!({ "update": 1, "scenarios": { "grid4x4": { "episode_return": -5.0 } } });
    std::fs::write(run.path().join("metrics.jsonl"), format!("{line}\n{{\"upda")).unwrap();
    let content = run.call(&["report", &given("run"), "--out", &page, "--json"]).json();
    assert_eq!((&content["runs"], &content["evaluations"]), (&json!(["run"]), &json!(0)));
    assert!(text(&place("page.html")).contains("1 update so far"));

    std::fs::write(place("broken.json"), "{\"scenario\":").unwrap();
    std::fs::write(place("foreign.json"), "{\"name\":\"x\"}").unwrap();
    for (input, words) in
        [("broken.json", "cut off"), ("foreign.json", "no evaluation"), ("nowhere", "does not exist")]
    {
        run.call(&["report", &given(input), "--out", &page]).assert_refused(&[input, words]);
    }
    run.call(&["report", &given("run"), "--out", &given("foreign.json")])
        .assert_refused(&["foreign.json", "--out"]);
}
