//! How often a client may ask: a bucket each, in bounded memory.

use std::collections::HashMap;
use std::net::{IpAddr, Ipv6Addr};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Clients that are told apart at a time, about 100 bytes each. Further ones share a bucket.
const BUCKETS: usize = 10_000;

/// Full buckets are looked for this often at most.
const TIDY_EVERY: Duration = Duration::from_secs(1);

/// Whose bucket it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Client {
    /// Who asks from an address; the lower half of an IPv6 address is the client's to choose.
    Address(IpAddr),
    /// Who sends wrong tokens from an address.
    Stranger(IpAddr),
    /// Who sends this token.
    Token(i64),
    /// All for whom there is no bucket of their own.
    Crowd,
}

impl Client {
    /// Who asks from `address`.
    pub(super) fn at(address: IpAddr) -> Self {
        Self::Address(network(address))
    }

    /// Who sends wrong tokens from `address`.
    pub(super) fn stranger(address: IpAddr) -> Self {
        Self::Stranger(network(address))
    }
}

fn network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(v6) if !v6.is_loopback() => Ipv6Addr::from_bits(v6.to_bits() >> 64 << 64).into(),
        other => other,
    }
}

/// How fast a bucket fills and how much it holds.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rate {
    pub(super) per_s: f64,
    pub(super) burst: f64,
}

#[derive(Debug)]
struct Bucket {
    /// What was in it at `at`.
    level: f64,
    at: Instant,
    rate: Rate,
}

impl Bucket {
    fn level(&self, now: Instant) -> f64 {
        let since = now.saturating_duration_since(self.at).as_secs_f64();
        (self.level + since * self.rate.per_s).min(self.rate.burst)
    }
}

/// The buckets of all clients.
#[derive(Debug, Default)]
pub(super) struct Limiter {
    buckets: Mutex<(HashMap<Client, Bucket>, Option<Instant>)>,
}

impl Limiter {
    /// Takes one from the bucket of `client`, if there is one. It fills by one a second at least.
    pub(super) fn take(&self, client: Client, rate: Rate, now: Instant) -> bool {
        let mut guard = self.buckets.lock().unwrap_or_else(PoisonError::into_inner);
        let (buckets, tidied) = &mut *guard;
        if buckets.len() >= BUCKETS && tidied.is_none_or(|at| now.saturating_duration_since(at) >= TIDY_EVERY) {
            buckets.retain(|_, bucket| bucket.level(now) < bucket.rate.burst);
            *tidied = Some(now);
        }
        let known = buckets.len() < BUCKETS || buckets.contains_key(&client);
        let client = if known { client } else { Client::Crowd };
        let bucket = buckets.entry(client).or_insert(Bucket { level: rate.burst, at: now, rate });
        let level = bucket.level(now);
        if level < 1.0 {
            return false;
        }
        *bucket = Bucket { level: level - 1.0, at: now, rate };
        true
    }

    /// Whether the bucket of `client` has one; takes nothing.
    pub(super) fn has(&self, client: Client, now: Instant) -> bool {
        let guard = self.buckets.lock().unwrap_or_else(PoisonError::into_inner);
        guard.0.get(&client).is_none_or(|bucket| bucket.level(now) >= 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATE: Rate = Rate { per_s: 2.0, burst: 3.0 };

    fn client(n: u32) -> Client {
        Client::at(IpAddr::from(n.to_be_bytes()))
    }

    #[test]
    fn a_bucket_holds_a_burst_and_fills_again() {
        let (limiter, now) = (Limiter::default(), Instant::now());
        let taken = |at: Instant| (0..5).filter(|_| limiter.take(client(1), RATE, at)).count();
        assert_eq!(taken(now), 3);
        assert!(!limiter.has(client(1), now) && limiter.has(client(1), now + Duration::from_millis(500)));
        assert!(limiter.take(client(2), RATE, now), "another client has its own");
        assert_eq!(taken(now + Duration::from_secs(1)), 2);
        assert_eq!(taken(now + Duration::from_secs(60)), 3);
    }

    #[test]
    fn many_clients_take_bounded_memory_and_leave_room_when_they_are_gone() {
        let (limiter, now) = (Limiter::default(), Instant::now());
        let many = u32::try_from(BUCKETS).unwrap();
        assert!((0..many).all(|n| limiter.take(client(n), RATE, now)));
        let crowd = (0..5).filter(|n| limiter.take(client(many + n), RATE, now)).count();
        assert_eq!(crowd, 3, "those who come later share a bucket");
        assert!(limiter.buckets.lock().unwrap().0.len() <= BUCKETS + 1);
        let later = now + Duration::from_secs(10);
        assert!((0..5).all(|n| limiter.take(client(many + n), RATE, later)));
        assert!(limiter.buckets.lock().unwrap().0.len() <= 6);
    }

    #[test]
    fn an_ipv6_client_is_its_network_and_a_mapped_address_is_the_ipv4_one() {
        let at = |text: &str| Client::at(text.parse().unwrap());
        assert_eq!(at("2001:db8:1:2:3::4"), at("2001:db8:1:2:ffff::1"));
        assert_ne!(at("2001:db8:1:2::1"), at("2001:db8:1:3::1"));
        assert_eq!(at("::ffff:192.0.2.7"), at("192.0.2.7"));
    }
}
