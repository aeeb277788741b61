//! How many calls an address may begin: a bucket for each, filled at a steady rate. No clock, no I/O.

use std::collections::HashMap;
use std::net::IpAddr;
use std::time::Duration;

/// A bucket holds what flows in during this many seconds: actors that all come back at once after a restart.
const BURST_SECONDS: f64 = 10.0;
/// Addresses that are remembered; beyond that, strangers share one bucket.
const MOST_ADDRESSES: usize = 65_536;
/// Between two looks through all of them: a flood of addresses must not buy a look with each call.
const SWEEP_EVERY: Duration = Duration::from_secs(1);

/// Buckets by address.
#[derive(Debug)]
pub(super) struct Rates {
    per_second: f64,
    buckets: HashMap<IpAddr, Bucket>,
    /// When buckets were last looked through.
    swept: Duration,
}

#[derive(Debug, Clone, Copy)]
struct Bucket {
    calls: f64,
    at: Duration,
}

impl Rates {
    pub(super) fn new(per_second: u32) -> Self {
        Self { per_second: f64::from(per_second.max(1)), buckets: HashMap::new(), swept: Duration::ZERO }
    }

    /// Takes one call from an address's bucket at `now`, a time since the start; how long to wait if it is empty.
    pub(super) fn admit(&mut self, now: Duration, address: IpAddr) -> Result<(), Duration> {
        let (full, rate) = (self.full(), self.per_second);
        let key = self.key(now, address);
        let bucket = self.buckets.entry(key).or_insert(Bucket { calls: full, at: now });
        bucket.calls = (bucket.calls + now.saturating_sub(bucket.at).as_secs_f64() * rate).min(full);
        bucket.at = now;
        if bucket.calls >= 1.0 {
            bucket.calls -= 1.0;
            Ok(())
        } else {
            Err(Duration::from_secs_f64((1.0 - bucket.calls) / rate))
        }
    }

    fn full(&self) -> f64 {
        self.per_second * BURST_SECONDS
    }

    /// Whose bucket it is. An IPv6 address counts by its network, because a host has as many of the rest as it likes.
    fn key(&mut self, now: Duration, address: IpAddr) -> IpAddr {
        let key = match address.to_canonical() {
            IpAddr::V6(v6) => IpAddr::V6((u128::from(v6) >> 64 << 64).into()),
            v4 => v4,
        };
        if self.buckets.len() >= MOST_ADDRESSES && !self.buckets.contains_key(&key) {
            if now.saturating_sub(self.swept) >= SWEEP_EVERY {
                self.swept = now;
                let (full, rate) = (self.full(), self.per_second);
                // What has filled up again remembers nothing.
                self.buckets.retain(|_, b| b.calls + now.saturating_sub(b.at).as_secs_f64() * rate < full);
            }
            if self.buckets.len() >= MOST_ADDRESSES {
                return IpAddr::V4(std::net::Ipv4Addr::UNSPECIFIED);
            }
        }
        key
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::{Ipv4Addr, Ipv6Addr};

    const A: IpAddr = IpAddr::V4(Ipv4Addr::new(10, 0, 0, 1));
    const B: IpAddr = IpAddr::V4(Ipv4Addr::new(10, 0, 0, 2));

    fn seconds(seconds: f64) -> Duration {
        Duration::from_secs_f64(seconds)
    }

    #[test]
    fn ten_seconds_worth_at_once_then_the_rate() {
        let mut rates = Rates::new(5);
        for call in 0..50 {
            assert_eq!(rates.admit(Duration::ZERO, A), Ok(()), "{call}");
        }
        assert_eq!(rates.admit(Duration::ZERO, A), Err(seconds(0.2)));
        assert_eq!(rates.admit(Duration::ZERO, B), Ok(()), "another address has its own");
        assert_eq!(rates.admit(seconds(0.21), A), Ok(()));
        assert!(rates.admit(seconds(0.21), A).is_err());
        // However long the quiet, no more than a burst.
        let admitted = (0..100).filter(|_| rates.admit(seconds(1e6), A).is_ok()).count();
        assert_eq!(admitted, 50);
    }

    #[test]
    fn whoever_waits_as_told_gets_in() {
        let mut rates = Rates::new(3);
        let mut now = Duration::ZERO;
        while rates.admit(now, A).is_ok() {}
        for _ in 0..100 {
            if let Err(wait) = rates.admit(now, A) {
                now += wait + Duration::from_nanos(10);
                assert_eq!(rates.admit(now, A), Ok(()));
            }
        }
    }

    #[test]
    fn a_host_cannot_hide_among_its_own_addresses() {
        let mut rates = Rates::new(1);
        let of_one_network = |host: u16| IpAddr::V6(Ipv6Addr::new(0x2001, 0xdb8, 0, 1, 0, 0, 0, host));
        let admitted = (0..100).filter(|&h| rates.admit(Duration::ZERO, of_one_network(h)).is_ok()).count();
        assert_eq!(admitted, 10);
        let mapped = IpAddr::V6(Ipv4Addr::new(10, 0, 0, 1).to_ipv6_mapped());
        assert_eq!((0..100).filter(|_| rates.admit(Duration::ZERO, A).is_ok()).count(), 10);
        assert!(rates.admit(Duration::ZERO, mapped).is_err());
    }

    #[test]
    fn memory_is_bounded_and_forgets_only_who_was_quiet() {
        let mut rates = Rates::new(1);
        while rates.admit(seconds(100.0), A).is_ok() {}
        let stranger = |i: u32| IpAddr::V4(Ipv4Addr::from(0x0b00_0000 + i));
        for i in 0..100_000 {
            let _ = rates.admit(seconds(100.0), stranger(i));
        }
        assert!(rates.buckets.len() <= MOST_ADDRESSES + 1);
        assert!(rates.admit(seconds(100.0), A).is_err(), "who called too often is not forgotten");
        let _ = rates.admit(seconds(105.0), stranger(100_001));
        assert!(rates.buckets.len() < 10, "those who called once have a full bucket again");
        assert!(rates.admit(seconds(100.5), A).is_err());
    }
}
