//! Finding SUMO.

use super::environment::hide_secrets;
use super::process::Process;
use crate::error::TraciError;
use std::ffi::OsStr;
use std::fmt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;
use thiserror::Error;

/// Where `make build` puts SUMO, relative to the project.
const PROJECT_HOME: &str = ".deps/sumo/sumo";

/// How a SUMO was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// Named by `--sumo-home`.
    Option,
    /// Named by the environment variable `SUMO_HOME`.
    Environment,
    /// Installed by `make build` in the project.
    Project,
    /// On the `PATH`.
    Path,
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Option => "--sumo-home",
            Self::Environment => "SUMO_HOME",
            Self::Project => "make build",
            Self::Path => "PATH",
        })
    }
}

/// An installed SUMO.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SumoHome {
    path: PathBuf,
    binaries: PathBuf,
    origin: Origin,
}

/// No usable SUMO.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum LocateError {
    /// A place was named, and there is none.
    #[error("{origin} names {}, but {why}: correct it or leave it out and run `make build`", path.display())]
    Named {
        /// Who named it.
        origin: Origin,
        /// The place.
        path: PathBuf,
        /// What is wrong with it.
        why: String,
    },
    /// Nothing was named and nothing found.
    #[error("found no SUMO ({}): run `make build`, or name an installation with --sumo-home", searched.join("; "))]
    NotFound {
        /// Every place searched, and what was there.
        searched: Vec<String>,
    },
}

impl SumoHome {
    /// Finds SUMO: at `option`, else at `$SUMO_HOME`, else where `make build` puts it (looked for from this program's
    /// own place upwards, then from the working directory upwards), else on the `PATH`.
    ///
    /// # Errors
    /// [`LocateError`]. A place that was named but holds no SUMO is an error: another SUMO than the one meant would
    /// give other results.
    pub fn locate(option: Option<&Path>) -> Result<Self, LocateError> {
        let starts: Vec<PathBuf> =
            [std::env::current_exe().ok(), std::env::current_dir().ok()].into_iter().flatten().collect();
        Search {
            option,
            environment: std::env::var_os("SUMO_HOME").filter(|home| !home.is_empty()).map(PathBuf::from),
            starts: &starts,
            path: std::env::var_os("PATH").as_deref(),
        }
        .run()
    }

    /// The installation: what SUMO calls `SUMO_HOME`.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How it was found.
    pub fn origin(&self) -> Origin {
        self.origin
    }

    /// Path of one of its programs, such as `sumo` or `netconvert`.
    pub fn binary(&self, name: &str) -> PathBuf {
        self.binaries.join(name)
    }

    /// One of its programs, ready for arguments: it finds its own files, speaks English, and sees no variable of this process
    /// that by its name holds a secret (`API_TOKEN`, `PASSWORD`).
    #[must_use]
    pub fn command(&self, name: &str) -> Command {
        let mut command = Command::new(self.binary(name));
        hide_secrets(&mut command, std::env::vars_os().map(|(name, _)| name));
        // Without it SUMO looks for XML schemas on the web, and every message is in the machine's language.
        command.env("SUMO_HOME", &self.path).env("LC_ALL", "C");
        command
    }

    /// SUMO's version, such as `1.28.0`, by asking the program.
    ///
    /// # Errors
    /// [`TraciError::Spawn`] if it cannot be run or says something else.
    pub fn version(&self) -> Result<String, TraciError> {
        let binary = self.binary("sumo");
        let failed =
            |reason: String| TraciError::Spawn { binary: binary.clone(), reason, evidence: Box::default() };
        let mut command = self.command("sumo");
        command.arg("--version");
        let (process, first) = Process::first_line(command, Duration::from_secs(20))
            .map_err(|error| failed(error.to_string()))?;
        first.as_deref().and_then(parse_version).ok_or_else(|| TraciError::Spawn {
            binary: binary.clone(),
            reason: "it does not tell its version".to_owned(),
            evidence: Box::new(process.evidence(Duration::ZERO)),
        })
    }
}

/// `Eclipse SUMO sumo 1.28.0` or `Eclipse SUMO sumo Version 1.18.0`.
fn parse_version(line: &str) -> Option<String> {
    let last = line.strip_prefix("Eclipse SUMO")?.split_ascii_whitespace().last()?;
    last.starts_with(|c: char| c.is_ascii_digit() || c == 'v').then(|| last.to_owned())
}

/// Everything the search depends on, so that tests need not change the process's environment.
struct Search<'a> {
    option: Option<&'a Path>,
    environment: Option<PathBuf>,
    starts: &'a [PathBuf],
    path: Option<&'a OsStr>,
}

impl Search<'_> {
    fn run(&self) -> Result<SumoHome, LocateError> {
        if let Some(path) = self.option {
            return self.named(path, Origin::Option);
        }
        if let Some(path) = &self.environment {
            return self.named(path, Origin::Environment);
        }
        let mut searched = vec!["SUMO_HOME is not set".to_owned()];
        for start in self.starts {
            for ancestor in start.ancestors() {
                let home = ancestor.join(PROJECT_HOME);
                if home.is_dir() {
                    match usable(&home.join("bin").join("sumo")) {
                        Ok(()) => return Ok(found(&home, &home.join("bin"), Origin::Project)),
                        Err(why) => searched.push(why),
                    }
                }
            }
            searched.push(format!("no {PROJECT_HOME} in {} or above", start.display()));
        }
        match self.on_path(&mut searched) {
            Some(binaries) => Ok(found(&home_of(&binaries), &binaries, Origin::Path)),
            None => Err(LocateError::NotFound { searched }),
        }
    }

    /// A place that somebody named. Distributions keep the programs apart from the rest (`/usr/bin` and
    /// `/usr/share/sumo`), so a place with SUMO's data is completed by the `PATH`.
    fn named(&self, path: &Path, origin: Origin) -> Result<SumoHome, LocateError> {
        let error = |why: String| LocateError::Named { origin, path: path.to_owned(), why };
        if !path.is_dir() {
            return Err(error("there is no such directory".to_owned()));
        }
        let binaries = path.join("bin");
        match usable(&binaries.join("sumo")) {
            Ok(()) => Ok(found(path, &binaries, origin)),
            Err(why) => match self.on_path(&mut Vec::new()) {
                Some(binaries) if path.join("data").is_dir() && !path.join("bin/sumo").exists() => {
                    Ok(found(path, &binaries, origin))
                }
                _ => Err(error(why)),
            },
        }
    }

    fn on_path(&self, searched: &mut Vec<String>) -> Option<PathBuf> {
        let mut any = false;
        for directory in std::env::split_paths(self.path.unwrap_or_default()) {
            let program = directory.join("sumo");
            if !program.is_file() {
                continue;
            }
            any = true;
            // A link leads to the installation that it belongs to.
            let program = program.canonicalize().unwrap_or(program);
            match usable(&program) {
                Ok(()) => return program.parent().map(Path::to_owned),
                Err(why) => searched.push(why),
            }
        }
        if !any {
            searched.push("no sumo on the PATH".to_owned());
        }
        None
    }
}

fn found(home: &Path, binaries: &Path, origin: Origin) -> SumoHome {
    let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    SumoHome { path: absolute(home), binaries: absolute(binaries), origin }
}

/// The installation that programs in this directory belong to: the one above it, or a distribution's.
fn home_of(binaries: &Path) -> PathBuf {
    let above = binaries.parent().unwrap_or(binaries);
    [above.to_owned(), above.join("share").join("sumo")]
        .into_iter()
        .find(|home| home.join("data").join("xsd").is_dir())
        .unwrap_or_else(|| above.to_owned())
}

/// Whether this is SUMO itself. The `sumo` that pip puts beside Python is a script which starts SUMO as a child of its
/// own; that child would outlive the script when the script is killed.
fn usable(program: &Path) -> Result<(), String> {
    use std::io::Read;
    let mut start = [0; 2];
    let read = std::fs::File::open(program).and_then(|mut file| file.read(&mut start));
    match read {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            Err(format!("there is no {}", program.display()))
        }
        Err(error) => Err(format!("{} cannot be read: {error}", program.display())),
        Ok(_) if &start == b"#!" => {
            Err(format!("{} is a script that starts SUMO, not SUMO itself", program.display()))
        }
        Ok(_) if !executable(program) => Err(format!("{} is not executable", program.display())),
        Ok(_) => Ok(()),
    }
}

#[cfg(unix)]
fn executable(program: &Path) -> bool {
    use std::os::unix::fs::PermissionsExt;
    program.metadata().is_ok_and(|metadata| metadata.is_file() && metadata.permissions().mode() & 0o111 != 0)
}

#[cfg(not(unix))]
fn executable(program: &Path) -> bool {
    program.is_file()
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::fs;
    use std::os::unix::fs::PermissionsExt;

    fn install(binaries: &Path, content: &[u8], mode: u32) {
        fs::create_dir_all(binaries).expect("a directory");
        fs::write(binaries.join("sumo"), content).expect("a file");
        fs::set_permissions(binaries.join("sumo"), fs::Permissions::from_mode(mode)).expect("permissions");
    }

    fn search(
        option: Option<&Path>,
        environment: Option<&Path>,
        starts: &[PathBuf],
        path: &Path,
    ) -> Result<SumoHome, LocateError> {
        let environment = environment.map(Path::to_owned);
        Search { option, environment, starts, path: Some(path.as_os_str()) }.run()
    }

    #[test]
    fn what_is_named_wins_then_the_project_then_the_path() {
        let root = tempfile::tempdir().unwrap();
        let root = root.path().canonicalize().unwrap();
        let (option, environment) = (root.join("option"), root.join("environment"));
        let project = root.join("project/.deps/sumo/sumo");
        let path = root.join("usr/bin");
        for binaries in [&option.join("bin"), &environment.join("bin"), &project.join("bin"), &path] {
            install(binaries, b"\x7fELF", 0o755);
        }
        fs::create_dir_all(root.join("usr/share/sumo/data/xsd")).unwrap();
        let starts = [root.join("project/target/release/cross"), root.join("elsewhere")];

        let found = search(Some(&option), Some(&environment), &starts, &path).unwrap();
        assert_eq!((found.origin(), found.path()), (Origin::Option, option.as_path()));
        let found = search(None, Some(&environment), &starts, &path).unwrap();
        assert_eq!((found.origin(), found.path()), (Origin::Environment, environment.as_path()));
        let found = search(None, None, &starts, &path).unwrap();
        assert_eq!((found.origin(), found.path()), (Origin::Project, project.as_path()));
        let found = search(None, None, &starts[1..], &path).unwrap();
        assert_eq!((found.origin(), found.path()), (Origin::Path, root.join("usr/share/sumo").as_path()));
        assert_eq!(found.binary("netconvert"), path.join("netconvert"));
    }

    #[test]
    fn a_wrong_name_is_an_error_and_never_replaced_by_another_sumo() {
        let root = tempfile::tempdir().unwrap();
        let path = root.path().join("bin");
        install(&path, b"\x7fELF", 0o755);
        let error = search(None, Some(&root.path().join("gone")), &[], &path).unwrap_err().to_string();
        assert!(error.starts_with("SUMO_HOME names ") && error.contains("no such directory"), "{error}");
        assert!(error.contains("make build"), "{error}");
    }

    #[test]
    fn nothing_found_says_what_was_searched_and_what_to_do() {
        let root = tempfile::tempdir().unwrap();
        let error = search(None, None, &[root.path().to_owned()], root.path()).unwrap_err().to_string();
        for part in
            ["SUMO_HOME is not set", ".deps/sumo/sumo", "no sumo on the PATH", "make build", "--sumo-home"]
        {
            assert!(error.contains(part), "{part}: {error}");
        }
    }

    #[test]
    fn a_script_or_a_file_that_cannot_run_is_no_sumo() {
        let root = tempfile::tempdir().unwrap();
        install(&root.path().join("bin"), b"#!/usr/bin/python3", 0o755);
        let error = search(Some(root.path()), None, &[], root.path()).unwrap_err().to_string();
        assert!(error.contains("is a script"), "{error}");
        install(&root.path().join("bin"), b"\x7fELF", 0o644);
        let error = search(Some(root.path()), None, &[], root.path()).unwrap_err().to_string();
        assert!(error.contains("not executable"), "{error}");
    }

    #[test]
    fn a_distributions_data_is_completed_by_the_path() {
        let root = tempfile::tempdir().unwrap();
        let root = root.path().canonicalize().unwrap();
        install(&root.join("bin"), b"\x7fELF", 0o755);
        fs::create_dir_all(root.join("share/sumo/data")).unwrap();
        let found = search(None, Some(&root.join("share/sumo")), &[], &root.join("bin")).unwrap();
        assert_eq!(found.path(), root.join("share/sumo"));
        assert_eq!(found.binary("sumo"), root.join("bin/sumo"));
    }

    #[test]
    fn versions_are_read_from_the_first_line() {
        assert_eq!(parse_version("Eclipse SUMO sumo 1.28.0").as_deref(), Some("1.28.0"));
        assert_eq!(parse_version("Eclipse SUMO sumo Version 1.18.0").as_deref(), Some("1.18.0"));
        assert_eq!(parse_version("bash: sumo: not found"), None);
        assert_eq!(parse_version("Eclipse SUMO"), None);
    }
}
