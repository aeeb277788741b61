//! Cables. Only those of actors that speak to the learner itself: behind the relay a cut would be another's.

use super::{Kind, lasts, over, over_for_all};
use crate::faults::Broken;
use crate::faults::net::Direction;
use crate::faults::plan::Fault;
use crate::faults::recovery::Over;
use crate::faults::world::World;
use std::time::Duration;

fn direct(world: &World, fault: &Fault) -> usize {
    fault.actor % (world.actors.len() - 1)
}

pub(super) fn cut(world: &mut World, fault: &Fault) -> Result<Over, Broken> {
    let n = direct(world, fault);
    let direction = match (fault.kind, fault.draw % 2) {
        (Kind::CutSilently, _) => Direction::Both,
        (_, 0) => Direction::FromLearner,
        _ => Direction::ToLearner,
    };
    world.net.cut(n, direction);
    world.go_on(lasts(fault, 13.0))?;
    world.net.heal();
    Ok(over(n, false))
}

pub(super) fn cut_everybody(world: &mut World, fault: &Fault) -> Result<Over, Broken> {
    for n in 0..world.actors.len() {
        world.net.cut(n, Direction::Both);
    }
    world.go_on(lasts(fault, 8.0))?;
    world.net.heal();
    Ok(over_for_all(world, false))
}

pub(super) fn unplugged(world: &mut World, fault: &Fault) -> Result<Over, Broken> {
    let n = direct(world, fault);
    world.net.plug(n, false);
    world.go_on(lasts(fault, 8.0))?;
    world.net.plug(n, true);
    Ok(over(n, false))
}

pub(super) fn reset(world: &mut World, fault: &Fault) -> Result<Over, Broken> {
    let n = direct(world, fault);
    world.net.reset(n);
    world.go_on(Duration::from_secs(1))?;
    world.net.heal();
    Ok(over(n, false))
}

pub(super) fn slow(world: &mut World, fault: &Fault) -> Result<Over, Broken> {
    let n = direct(world, fault);
    world.net.slow(n, 64 << (fault.draw % 4));
    world.go_on(lasts(fault, 6.0))?;
    world.net.quick(n);
    Ok(over(n, false))
}
