//! What some tests need of PyPI: `tests/tools/install.py` puts it into a folder.

use crate::packages;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Names the folder.
pub const TOOLS: &str = "CROSS_TEST_TOOLS";

/// The folder.
#[derive(Debug, Clone)]
pub struct Tools(PathBuf);

impl Tools {
    /// The installed tools; says what was skipped and how to get them if they are not there.
    #[must_use]
    pub fn find() -> Option<Self> {
        let folder =
            std::env::var_os(TOOLS).map(PathBuf::from).filter(|folder| folder.join("stamp").is_file());
        if folder.is_none() {
            packages::skipped(&format!(
                "its tools are not installed; run python3 tests/tools/install.py FOLDER and set {TOOLS}=FOLDER"
            ));
        }
        folder.map(Self)
    }

    /// Python with the tools' packages.
    #[must_use]
    pub fn python(&self) -> Command {
        let mut command = Command::new("python3");
        command.arg("-B").env("PYTHONPATH", self.0.join("python"));
        command
    }

    /// kubectl: the tools' own, or the system's where they have none.
    #[must_use]
    pub fn kubectl(&self) -> Option<PathBuf> {
        let own = self.0.join("bin/kubectl");
        if own.is_file() { Some(own) } else { packages::program("kubectl", "kubernetes-client") }
    }
}

/// A path from the top of the checkout.
#[must_use]
pub fn in_checkout(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().join(path)
}
