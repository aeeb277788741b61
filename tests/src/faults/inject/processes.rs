//! Signals, and clocks.

use super::{lasts, missed, over, over_for_all};
use crate::faults::Broken;
use crate::faults::plan::Fault;
use crate::faults::recovery::Over;
use crate::faults::world::{World, actor_name};
use crate::processes::send;
use rustix::process::Signal;
use std::time::{Duration, Instant};

/// Signals an actor's SUMO, surely while it is there.
fn signal_sumo(world: &mut World, n: usize, signal: Signal) -> Result<i32, Broken> {
    world.until("a SUMO to signal", 30, |world| world.sumo(n).filter(|&pid| send(pid, signal)))
}

pub(super) fn sumo_killed(world: &mut World, fault: &Fault) -> Result<Over, Broken> {
    signal_sumo(world, fault.actor, Signal::KILL)?;
    Ok(over(fault.actor, true))
}

/// It counts as over at once: to notice and replace it is part of the recovery.
pub(super) fn sumo_hung(world: &mut World, fault: &Fault) -> Result<Over, Broken> {
    signal_sumo(world, fault.actor, Signal::STOP)?;
    Ok(over(fault.actor, true))
}

pub(super) fn sumo_paused(world: &mut World, fault: &Fault) -> Result<Over, Broken> {
    let pid = signal_sumo(world, fault.actor, Signal::STOP)?;
    world.go_on(lasts(fault, 3.0))?;
    // Its episode may have been over for another reason.
    let _ = send(pid, Signal::CONT);
    Ok(over(fault.actor, false))
}

pub(super) fn actor_killed(world: &mut World, fault: &Fault) -> Result<Over, Broken> {
    if !world.actors[fault.actor].signal(Signal::KILL) {
        return Err(missed("the actor was not there to be killed"));
    }
    Ok(over(fault.actor, true))
}

pub(super) fn actor_paused(world: &mut World, fault: &Fault) -> Result<Over, Broken> {
    let paused = world.actors[fault.actor].signal(Signal::STOP);
    world.go_on(lasts(fault, 13.0))?;
    if !paused || !world.actors[fault.actor].signal(Signal::CONT) {
        return Err(missed("the actor was not there to be stopped"));
    }
    Ok(over(fault.actor, false))
}

pub(super) fn learner_killed(world: &mut World) -> Result<Over, Broken> {
    if !world.learner.signal(Signal::KILL) {
        return Err(missed("the learner was not there to be killed"));
    }
    Ok(over_for_all(world, true))
}

pub(super) fn learner_paused(world: &mut World, fault: &Fault) -> Result<Over, Broken> {
    let paused = world.learner.signal(Signal::STOP);
    world.go_on(lasts(fault, 13.0))?;
    if !paused || !world.learner.signal(Signal::CONT) {
        return Err(missed("the learner was not there to be stopped"));
    }
    Ok(over_for_all(world, false))
}

/// A restart as for an upgrade: the learner has to end well, with a checkpoint of its last update.
pub(super) fn learner_drained(world: &mut World) -> Result<Over, Broken> {
    world.exits.clear();
    if !world.learner.signal(Signal::TERM) {
        return Err(missed("the learner was not there to be asked to stop"));
    }
    let over = over_for_all(world, true);
    let exit = world.until("the end of the learner", 30, |world| {
        world.exits.iter().find(|exit| exit.name == "learner").cloned()
    })?;
    if exit.code != Some(0) {
        return Err(Broken::new("SIGTERM ends well", exit.to_string()));
    }
    Ok(over)
}

pub(super) fn power_cut(world: &mut World) -> Result<Over, Broken> {
    let there = world.learner.signal(Signal::KILL);
    for n in 0..world.actors.len() {
        let _ = world.actors[n].signal(Signal::KILL);
    }
    if !there {
        return Err(missed("the learner was not there to be killed"));
    }
    Ok(over_for_all(world, true))
}

/// The clock of one process or of all, forwards or backwards; it stays where it is.
pub(super) fn clock_jump(world: &mut World, fault: &Fault) -> Result<Over, Broken> {
    const TWO_DAYS: f64 = 2.0 * 24.0 * 3600.0;
    // Seconds as likely as days.
    let share = (fault.draw >> 32) as f64 / f64::from(u32::MAX);
    let seconds = (TWO_DAYS.ln() * share).exp().round() as i64;
    let seconds = if fault.draw.is_multiple_of(2) { seconds } else { -seconds };
    let which = (fault.draw / 2) as usize % (world.clocks.len() + 1);
    let jumping = if which == world.clocks.len() { 0..which } else { which..which + 1 };
    for clock in &world.clocks[jumping.clone()] {
        clock.set(seconds);
    }
    let since = Instant::now();
    // By then every process has looked at its clock again.
    world.go_on(Duration::from_secs(2))?;
    let actors = jumping.flat_map(|clock| clock.checked_sub(1)).map(actor_name).collect();
    Ok(Over { since, actors, anew: false, checkpoint: None })
}
