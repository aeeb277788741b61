//! How many connections there are, in all and of each host.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The places of a port. One host may take half of them, rounded up, so that none shuts out all others.
#[derive(Debug)]
pub(crate) struct Places {
    all: usize,
    of_a_host: usize,
    taken: Mutex<Taken>,
}

#[derive(Debug, Default)]
struct Taken {
    all: usize,
    by_host: HashMap<IpAddr, usize>,
}

/// Why there is no place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Full {
    /// All are taken.
    All,
    /// This host has its half.
    Host,
}

impl Full {
    /// For the log.
    pub(crate) fn reason(self) -> &'static str {
        match self {
            Self::All => "there are as many as allowed",
            Self::Host => "its host has half of all that are allowed, which is the most for one",
        }
    }
}

impl Places {
    pub(crate) fn new(all: usize) -> Arc<Self> {
        Arc::new(Self { all, of_a_host: all.div_ceil(2), taken: Mutex::default() })
    }

    /// A place until it is dropped.
    pub(crate) fn take(self: &Arc<Self>, address: IpAddr) -> Result<Place, Full> {
        let host = host(address);
        let mut taken = self.lock();
        if taken.all >= self.all {
            return Err(Full::All);
        }
        let own = taken.by_host.entry(host).or_default();
        if *own >= self.of_a_host {
            return Err(Full::Host);
        }
        *own += 1;
        taken.all += 1;
        Ok(Place { host, of: Arc::clone(self) })
    }

    fn lock(&self) -> MutexGuard<'_, Taken> {
        self.taken.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// One connection's place.
#[derive(Debug)]
pub(crate) struct Place {
    host: IpAddr,
    of: Arc<Places>,
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut taken = self.of.lock();
        taken.all -= 1;
        if let Some(own) = taken.by_host.get_mut(&self.host) {
            *own -= 1;
            if *own == 0 {
                taken.by_host.remove(&self.host);
            }
        }
    }
}

/// Whose connection it is. An IPv6 address counts by its network, because a host has as many of the rest as it likes.
fn host(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(v6) => IpAddr::V6((u128::from(v6) >> 64 << 64).into()),
        v4 => v4,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ip(text: &str) -> IpAddr {
        text.parse().unwrap()
    }

    #[test]
    fn a_host_takes_half_and_all_hosts_take_all() {
        let places = Places::new(5);
        let mut held: Vec<Place> = (0..3).map(|_| places.take(ip("10.0.0.1")).unwrap()).collect();
        assert_eq!(places.take(ip("10.0.0.1")).unwrap_err(), Full::Host);
        // The same host by another name.
        assert_eq!(places.take(ip("::ffff:10.0.0.1")).unwrap_err(), Full::Host);
        held.push(places.take(ip("2001:db8::1")).unwrap());
        held.push(places.take(ip("2001:db8::2")).unwrap());
        assert_eq!(places.take(ip("10.0.0.2")).unwrap_err(), Full::All);
        held.remove(0);
        held.push(places.take(ip("10.0.0.1")).unwrap());
        drop(held);
        assert_eq!(places.lock().all, 0);
        assert!(places.lock().by_host.is_empty());
    }

    #[test]
    fn a_network_of_ipv6_is_one_host_and_a_single_place_can_be_had() {
        let places = Places::new(4);
        let _held = [places.take(ip("2001:db8::1")).unwrap(), places.take(ip("2001:db8::2")).unwrap()];
        assert_eq!(places.take(ip("2001:db8::3")).unwrap_err(), Full::Host);
        assert!(places.take(ip("2001:db8:0:1::1")).is_ok());
        assert!(Places::new(1).take(ip("10.0.0.1")).is_ok());
    }
}
