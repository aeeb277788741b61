//! Room for a thousand connections: files that may be open, and what the learner is configured to allow.

use crate::error::BenchError;
use cross_config::Config;
use cross_support::open_files;

/// What a server needs besides its connections.
const SPARE: usize = 256;

/// Raises this process's limit on open files, which the servers inherit.
///
/// # Errors
/// [`BenchError::OpenFiles`] if so many clients still do not fit.
pub(crate) fn raise(clients: usize) -> Result<(), BenchError> {
    let needed = 2 * clients + SPARE;
    match open_files::raise() {
        Some(allowed) if allowed < needed as u64 => Err(BenchError::OpenFiles { clients, needed, allowed }),
        _ => Ok(()),
    }
}

/// Sets the keys that a learner of so many actors on one machine needs to have set: the defaults have room for a thousand
/// actors, but not for their coming all at once from one address, which has half of the connections.
pub(crate) fn configure(config: &mut Config, clients: usize) {
    let learner = &mut config.learner;
    learner.max_actors = learner.max_actors.max(clients + 1);
    learner.max_connections = 2 * (clients + 16);
    learner.max_streams = learner.max_streams.max(4 * (clients + 16));
    // A join and two streams each, and ten seconds' worth may come at once.
    let calls = u32::try_from(3 * clients).unwrap_or(1_000_000).min(1_000_000);
    learner.requests_per_second = learner.requests_per_second.max(calls);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_keys_are_valid_and_have_room_for_all_from_one_host() {
        for clients in [1, 1000, 10_000] {
            let mut config = Config::default();
            configure(&mut config, clients);
            config.validate().unwrap();
            assert!(config.learner.max_connections / 2 > clients && config.learner.max_actors > clients);
        }
    }

    #[test]
    fn clients_that_cannot_fit_are_refused_with_the_remedy() {
        let error = raise(usize::MAX / 4).err().map(|error| error.to_string());
        // Where there is no limit at all, anything fits.
        assert!(error.is_none_or(|error| error.contains("ulimit -Hn")));
    }
}
