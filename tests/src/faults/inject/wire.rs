//! What comes over the wire and should not.

use super::{Kind, over, over_for_nobody};
use crate::faults::Broken;
use crate::faults::plan::Fault;
use crate::faults::recovery::Over;
use crate::faults::relay::Mischief;
use crate::faults::stranger;
use crate::faults::world::{World, actor_name};
use std::time::Duration;

/// The last actor's fragments, by the relay.
pub(super) fn mischief(world: &mut World, fault: &Fault) -> Result<Over, Broken> {
    let mischief = if fault.kind == Kind::Duplicates { Mischief::Duplicate } else { Mischief::Reorder };
    let before = world.relay.done();
    world.relay.set(mischief);
    let injected = world
        .go_on(Duration::from_secs(2))
        .and_then(|()| world.until("mischief", 20, |world| (world.relay.done() > before).then_some(())));
    world.relay.set(Mischief::None);
    injected?;
    Ok(over(world.actors.len() - 1, false))
}

/// The newcomer has the lease, so the one that was there ends; started again, it takes the lease back, and the newcomer ends.
pub(super) fn twin(world: &mut World, fault: &Fault) -> Result<Over, Broken> {
    let n = fault.actor % (world.actors.len() - 1);
    world.exits.clear();
    world.lenient = true;
    world.start_twin(n);
    let ended = world.until("the end of the twin", 40, |world| {
        world.exits.iter().find(|exit| exit.name.starts_with("twin")).cloned()
    });
    world.lenient = false;
    world.twin = None;
    let exits = std::mem::take(&mut world.exits);
    // Both were told by name that another has joined under their id.
    let refused = |name: &str| exits.iter().any(|exit| exit.name == name && exit.code == Some(2));
    if ended?.code != Some(2) || !refused(&actor_name(n)) {
        return Err(Broken::new("an id belongs to one actor", format!("{exits:?}")));
    }
    Ok(over(n, true))
}

pub(super) fn other_version(world: &mut World) -> Result<Over, Broken> {
    let refused = world.watch.block_on(stranger::other_version(&World::address()));
    refused.map_err(|problem| Broken::new("another version is refused by name", problem))?;
    Ok(over_for_nobody())
}

pub(super) fn stranger(world: &mut World) -> Result<Over, Broken> {
    let answered = world.watch.block_on(stranger::misbehave(&World::address(), world.patience()));
    answered.map_err(|problem| Broken::new("broken rules are answered by name", problem))?;
    Ok(over_for_nobody())
}
