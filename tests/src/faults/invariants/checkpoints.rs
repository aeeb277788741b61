//! Whatever bears a checkpoint's name can be loaded: its description reads, its files have the sizes and digests that the
//! description tells; and `latest` names one. Those that the suite itself has damaged are excused until they are renamed.

use super::Look;
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet};
use std::os::unix::fs::MetadataExt;
use std::path::Path;

pub(super) const NAME: &str = "checkpoints loadable";

#[derive(Debug, Default)]
pub(super) struct Checkpoints {
    /// Found whole, and by which description: a learner that resumes from an earlier one writes the same ids again.
    whole: BTreeMap<String, Writing>,
    /// Damaged by the suite: the folder's inode, since a whole one may take its place under the same id.
    damaged: BTreeMap<String, Option<u64>>,
}

/// Inode and time of a `metadata.json`, which is written once.
type Writing = (u64, i64, i64);

fn writing(checkpoint: &Path) -> Option<Writing> {
    let metadata = std::fs::metadata(checkpoint.join("metadata.json")).ok()?;
    Some((metadata.ino(), metadata.mtime(), metadata.mtime_nsec()))
}

fn inode(folder: &Path) -> Option<u64> {
    Some(std::fs::metadata(folder).ok()?.ino())
}

impl Checkpoints {
    pub(super) fn check(&mut self, look: &Look<'_>) -> Result<(), String> {
        look.run.map_or(Ok(()), |run| self.look(run))
    }

    pub(super) fn look(&mut self, run: &Path) -> Result<(), String> {
        let folder = run.join("checkpoints");
        // Read first: what it names is never removed before it names another.
        let latest = std::fs::read_to_string(folder.join("latest")).unwrap_or_default();
        let mut present = BTreeSet::new();
        for entry in std::fs::read_dir(&folder).into_iter().flatten().flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            if name.len() >= 6 && name.bytes().all(|byte| byte.is_ascii_digit()) {
                present.insert(name);
            }
        }
        self.whole.retain(|id, _| present.contains(id));
        self.damaged.retain(|id, was| present.contains(id) && inode(&folder.join(id)) == *was);
        for id in present.iter().filter(|id| !self.damaged.contains_key(*id)) {
            // Before it is verified: should it be replaced meanwhile, it is looked at again.
            let now = writing(&folder.join(id));
            if now.is_some() && self.whole.get(id) == now.as_ref() {
                continue;
            }
            self.whole.remove(id);
            match verify(&folder.join(id)) {
                Ok(()) => {
                    self.whole.extend(now.map(|now| (id.clone(), now)));
                }
                // It was old and is being removed: renamed first, so it is not there any more.
                Err(_) if !folder.join(id).exists() => {}
                Err(problem) => return Err(format!("checkpoint {id} {problem}")),
            }
        }
        let latest = latest.trim();
        if !latest.is_empty() && !self.damaged.contains_key(latest) && !folder.join(latest).exists() {
            let again = std::fs::read_to_string(folder.join("latest")).unwrap_or_default();
            if again.trim() == latest {
                return Err(format!("latest names {latest}, which is not there"));
            }
        }
        Ok(())
    }

    /// Updates of the newest whole one; 0 without any.
    pub(super) fn newest(&self) -> u64 {
        self.whole.keys().filter_map(|id| id.parse().ok()).max().unwrap_or(0)
    }

    pub(super) fn damaged(&mut self, checkpoint: &Path) {
        let id = checkpoint.file_name().unwrap_or_default().to_string_lossy().into_owned();
        self.whole.remove(&id);
        self.damaged.insert(id, inode(checkpoint));
    }
}

/// Compares a checkpoint with its own description.
fn verify(checkpoint: &Path) -> Result<(), String> {
    let read = |name: &str| {
        std::fs::read(checkpoint.join(name)).map_err(|error| format!("has no readable {name}: {error}"))
    };
    let description: Value = serde_json::from_slice(&read("metadata.json")?)
        .map_err(|error| format!("has a metadata.json that is no JSON: {error}"))?;
    let files = description["files"].as_object().ok_or("names no files")?;
    for name in ["model.safetensors", "optimizer.safetensors"] {
        let told = files.get(name).and_then(|file| file["sha256"].as_str()).ok_or("tells no digest")?;
        let found = Sha256::digest(read(name)?);
        let found: String = found.iter().map(|byte| format!("{byte:02x}")).collect();
        if found != told {
            return Err(format!("has another {name} than metadata.json says"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(run: &Path, id: &str, content: &str) {
        let folder = run.join("checkpoints").join(id);
        std::fs::create_dir_all(&folder).unwrap();
        let digest: String = Sha256::digest(b"weights").iter().map(|byte| format!("{byte:02x}")).collect();
        let file = serde_json::json!({"sha256": digest});
        let files = serde_json::json!({"files": {"model.safetensors": file, "optimizer.safetensors": file}});
        std::fs::write(folder.join("metadata.json"), files.to_string()).unwrap();
        std::fs::write(folder.join("model.safetensors"), content).unwrap();
        std::fs::write(folder.join("optimizer.safetensors"), "weights").unwrap();
    }

    #[test]
    fn half_a_checkpoint_is_seen_unless_the_suite_made_it() {
        let run = tempfile::tempdir().unwrap();
        let mut checkpoints = Checkpoints::default();
        write(run.path(), "000001", "weights");
        assert_eq!(checkpoints.look(run.path()), Ok(()));
        assert_eq!(checkpoints.newest(), 1);
        write(run.path(), "000002", "wei");
        assert!(checkpoints.look(run.path()).unwrap_err().contains("000002"));
        checkpoints.damaged(&run.path().join("checkpoints/000002"));
        assert_eq!(checkpoints.look(run.path()), Ok(()));
        assert_eq!(checkpoints.newest(), 1);
        std::fs::write(run.path().join("checkpoints/latest"), "000003\n").unwrap();
        assert!(checkpoints.look(run.path()).unwrap_err().contains("000003"));
    }

    #[test]
    fn an_id_that_is_written_again_is_looked_at_again() {
        let run = tempfile::tempdir().unwrap();
        let folder = run.path().join("checkpoints/000001");
        let mut checkpoints = Checkpoints::default();
        write(run.path(), "000001", "weights");
        assert_eq!(checkpoints.look(run.path()), Ok(()));
        // Moved and not removed, or the other might get the same inodes.
        std::fs::rename(&folder, run.path().join("aside")).unwrap();
        write(run.path(), "000001", "wei");
        assert!(checkpoints.look(run.path()).unwrap_err().contains("000001"));
        assert_eq!(checkpoints.newest(), 0);
        // The suite's own damage is not an excuse for what takes its place.
        checkpoints.damaged(&folder);
        assert_eq!(checkpoints.look(run.path()), Ok(()));
        std::fs::rename(&folder, run.path().join("another")).unwrap();
        write(run.path(), "000001", "wei");
        assert!(checkpoints.look(run.path()).unwrap_err().contains("000001"));
    }
}
