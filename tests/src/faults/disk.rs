//! A disk small enough to be filled: the run directory's.

use super::tools::{run, try_run};
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Room for the checkpoints of a small model several times over.
const MEBIBYTES: u32 = 48;
const FILLER: &str = "filler";

/// A file system in memory; unmounted when dropped.
#[derive(Debug)]
pub(super) struct Disk {
    at: PathBuf,
}

impl Disk {
    /// Mounts an empty one.
    pub(super) fn mount(at: &Path) -> Self {
        std::fs::create_dir_all(at).unwrap();
        let size = format!("size={MEBIBYTES}m");
        run("mount", &["-t", "tmpfs", "-o", &size, "cross-faults", &at.display().to_string()]);
        Self { at: at.to_owned() }
    }

    /// Leaves no byte of it free.
    pub(super) fn fill(&self) {
        let mut file = File::options().create(true).append(true).open(self.at.join(FILLER)).unwrap();
        // Ever smaller pieces, so that the last page goes too.
        for piece in [1 << 20, 1 << 16, 1 << 12] {
            let zeros = vec![0_u8; piece];
            while file.write_all(&zeros).is_ok() {}
        }
    }

    /// Gives the room back.
    pub(super) fn free(&self) {
        let removed = std::fs::remove_file(self.at.join(FILLER));
        assert!(removed.is_ok(), "the disk was not full: {removed:?}");
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        // Lazily: whatever still has a file open there must not keep the suite from ending.
        try_run("umount", &["--lazy", &self.at.display().to_string()]);
    }
}
