//! The other clients, each a program of its own: which are here, and how they are started.
//!
//! A program called without arguments says in one line what it is. Called with a file of a [`Job`](super::job::Job) and one
//! to write to, it drives an episode; [`program`](super::program) has the conversation.

use cross_traci::SumoHome;
use cross_traci::constants::API_VERSION;
use cross_traci::sumo::spawn_tied;
use std::ffi::OsString;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use tempfile::TempDir;

/// The program for Python.
const SCRIPT: &str = include_str!("episode.py");
/// The program for the crate traci-rs: an example, so that nothing else is linked with the crate.
const EXAMPLE: &str = "traci_rs_episode";

/// A client that can be measured.
#[derive(Debug)]
pub(super) struct Client {
    /// Short name.
    pub(super) name: &'static str,
    /// What it is, with its version.
    pub(super) title: String,
    program: PathBuf,
    arguments: Vec<OsString>,
    /// Where Python finds modules.
    modules: Option<OsString>,
    /// Holds the script.
    _folder: Option<TempDir>,
}

impl Client {
    /// The crate traci-rs; the error says why it is left out.
    pub(super) fn traci_rs() -> Result<Self, String> {
        let program = beside_this_program().ok_or_else(|| {
            format!(
                "its program is not built; build it with: cargo build --release -p cross-bench --example {EXAMPLE}"
            )
        })?;
        Self {
            name: "traci-rs",
            title: String::new(),
            program,
            arguments: vec![],
            modules: None,
            _folder: None,
        }
        .introduced()
    }

    /// Python's traci, with this interpreter or `python3`; the error says why it is left out.
    pub(super) fn python(interpreter: Option<&Path>, home: &SumoHome) -> Result<Self, String> {
        let folder = tempfile::Builder::new().prefix("cross-bench-").tempdir();
        let folder =
            folder.map_err(|error| format!("there is no temporary folder for its script: {error}"))?;
        let script = folder.path().join("episode.py");
        std::fs::write(&script, SCRIPT)
            .map_err(|error| format!("cannot write its script {}: {error}", script.display()))?;
        Self {
            name: "Python traci",
            title: String::new(),
            program: interpreter.unwrap_or(Path::new("python3")).to_owned(),
            // Nothing is written beside the modules, which are SUMO's.
            arguments: vec!["-B".into(), script.into()],
            modules: modules(home, std::env::var_os("PYTHONPATH")),
            _folder: Some(folder),
        }
        .introduced()
    }

    /// The command that starts it, whose output nobody hears yet.
    pub(super) fn command(&self) -> Command {
        let mut command = Command::new(&self.program);
        command.args(&self.arguments);
        if let Some(modules) = &self.modules {
            command.env("PYTHONPATH", modules);
        }
        command
    }

    /// Asks it what it is.
    fn introduced(mut self) -> Result<Self, String> {
        let program = self.program.display();
        let mut command = self.command();
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let output = spawn_tied(command).and_then(std::process::Child::wait_with_output);
        let output = output.map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => {
                format!("there is no {program}; install Python 3 or name one with --python")
            }
            _ => format!("{program} cannot be started: {error}"),
        })?;
        if !output.status.success() {
            let said = last_line(&output.stderr);
            return Err(format!("{program} ended with {}, saying: {said}{}", output.status, remedy(&said)));
        }
        let said = last_line(&output.stdout);
        self.title = accepted(&said).ok_or_else(|| {
            format!("it says {said:?}, and SUMO's version of TraCI is {API_VERSION}; install the traci that came with SUMO")
        })?;
        Ok(self)
    }
}

/// What helps, as the end of a sentence, where that is known.
fn remedy(said: &str) -> &'static str {
    match said {
        "ModuleNotFoundError: No module named 'traci'" => {
            "; the SUMO that `make build` installs has it, or install the traci of PyPI in SUMO's version"
        }
        _ => "",
    }
}

/// What a program says that it is: `TITLE, TraCI VERSION`, where it depends on a version of TraCI.
fn accepted(said: &str) -> Option<String> {
    match said.rsplit_once(", TraCI ") {
        Some((title, version)) if version.parse() == Ok(API_VERSION) => Some(title.to_owned()),
        Some(_) => None,
        None => Some(said.to_owned()),
    }
}

/// The example's program, in the build folder that this program is in.
fn beside_this_program() -> Option<PathBuf> {
    let own = std::env::current_exe().ok()?;
    let folders = own.ancestors().skip(1).take(2);
    folders.map(|folder| folder.join("examples").join(EXAMPLE)).find(|program| program.is_file())
}

/// Where Python is to look for modules: first at SUMO's own tools, whose traci is of SUMO's version, if they are there.
fn modules(home: &SumoHome, inherited: Option<OsString>) -> Option<OsString> {
    let tools = home.path().join("tools");
    if !tools.join("traci").is_dir() {
        return inherited;
    }
    let inherited = inherited.unwrap_or_default();
    let all = std::iter::once(tools.clone()).chain(std::env::split_paths(&inherited));
    // A path with a colon in it cannot be joined; then it is alone.
    Some(std::env::join_paths(all.filter(|path| !path.as_os_str().is_empty())).unwrap_or(tools.into()))
}

/// The last line of an output that holds something: of an error in Python it says what it was.
pub(super) fn last_line(output: &[u8]) -> String {
    let text = String::from_utf8_lossy(output);
    let line = text.lines().rev().find(|line| !line.trim().is_empty());
    line.map_or_else(|| "nothing".to_owned(), |line| line.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_client_of_another_version_of_traci_is_not_taken() {
        assert_eq!(accepted("traci-rs 0.2.0"), Some("traci-rs 0.2.0".to_owned()));
        assert_eq!(
            accepted(&format!("traci, Python 3.9, TraCI {API_VERSION}")),
            Some("traci, Python 3.9".to_owned())
        );
        assert_eq!(accepted("traci, Python 3.9, TraCI 20"), None);
    }

    #[test]
    fn what_went_wrong_is_the_last_line() {
        assert_eq!(
            last_line(b"Traceback:\n  File\nModuleNotFoundError: traci\n\n"),
            "ModuleNotFoundError: traci"
        );
        assert_eq!(last_line(b" \n"), "nothing");
    }

    #[test]
    fn a_python_that_is_not_there_is_named_with_what_to_do() {
        let home = SumoHome::locate(None).expect("run `make build` first");
        let reason = Client::python(Some(Path::new("/nowhere/python3")), &home).unwrap_err();
        assert!(reason.contains("no /nowhere/python3") && reason.contains("--python"), "{reason}");
    }
}
