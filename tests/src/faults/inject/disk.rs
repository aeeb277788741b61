//! Full disks and torn files.

use super::{missed, over_for_all, over_for_nobody};
use crate::faults::Broken;
use crate::faults::plan::Fault;
use crate::faults::recovery::Over;
use crate::faults::world::World;
use rustix::process::Signal;
use std::path::{Path, PathBuf};

/// Full until a checkpoint has failed, and, if the learner is killed, until its successor has done what it could. Afterwards
/// checkpoints are written again.
pub(super) fn full(world: &mut World, killed: bool) -> Result<Over, Broken> {
    world.complaints.clear();
    world.disk.fill();
    world.until("a checkpoint that fails", 60, |world| {
        world.complaints.iter().any(|complaint| complaint.starts_with("no checkpoint")).then_some(())
    })?;
    if killed {
        let lives = world.learner.lives();
        if !world.learner.signal(Signal::KILL) {
            return Err(missed("the learner was not there to be killed"));
        }
        // A learner that resumes needs no room.
        world.until("a learner that starts on a full disk", 20, |world| {
            (world.learner.lives() > lives && world.status().is_some_and(|status| status.updates > 0))
                .then_some(())
        })?;
    }
    let newest = newest(&world.run());
    world.disk.free();
    let over = if killed { over_for_all(world, false) } else { over_for_nobody() };
    Ok(Over { checkpoint: newest, ..over })
}

/// What a machine that loses power may leave, on a file system that keeps no promises.
pub(super) fn torn(world: &mut World, fault: &Fault) -> Result<Over, Broken> {
    let run = world.run();
    world.until("two checkpoints", 60, |_| (checkpoints(&run).len() >= 2).then_some(()))?;
    world.exits.clear();
    world.learner.hold(true);
    if !world.learner.signal(Signal::KILL) {
        return Err(missed("the learner was not there to be killed"));
    }
    world.until("the end of the learner", 10, |world| {
        world.exits.iter().any(|exit| exit.name == "learner").then_some(())
    })?;
    let folder = run.join("checkpoints");
    let id = newest(&run).ok_or_else(|| missed("there is no checkpoint to tear"))?;
    let newest = folder.join(&id);
    if fault.draw % 6 < 4 {
        world.invariants.damaged(&newest);
    }
    match fault.draw % 6 {
        0 => cut_short(&newest.join("model.safetensors")),
        1 => flip(&newest.join("optimizer.safetensors"), fault.draw),
        2 => cut_short(&newest.join("metadata.json")),
        3 => std::fs::remove_file(newest.join("model.safetensors")).unwrap(),
        4 => std::fs::write(folder.join("latest"), "").unwrap(),
        _ => cut_short(&run.join("metrics.jsonl")),
    }
    world.learner.hold(false);
    Ok(over_for_all(world, true))
}

fn checkpoints(run: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(run.join("checkpoints")).into_iter().flatten().flatten();
    let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    let mut ids: Vec<String> = names.filter(|name| name.bytes().all(|byte| byte.is_ascii_digit())).collect();
    // Of six digits each in a run of this length.
    ids.sort();
    ids
}

pub(super) fn newest(run: &Path) -> Option<String> {
    checkpoints(run).pop()
}

/// The second half was not written.
fn cut_short(file: &PathBuf) {
    let bytes = std::fs::read(file).unwrap();
    std::fs::write(file, &bytes[..bytes.len() / 2]).unwrap();
}

/// A bit is another.
fn flip(file: &PathBuf, draw: u64) {
    let mut bytes = std::fs::read(file).unwrap();
    let at = usize::try_from(draw).unwrap() % bytes.len();
    bytes[at] ^= 1;
    std::fs::write(file, bytes).unwrap();
}
