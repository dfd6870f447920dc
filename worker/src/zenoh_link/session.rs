//! Client sessions, and who serves at their other end.

use std::time::Duration;

use furrow_schema::protocol::coordinator_key;
use serde_json::{Value, json};
use zenoh::config::Config;
use zenoh::{Session, Wait};

use crate::lan::Certificates;

/// Coordinators answer a question about their liveliness within this time.
const ROLL_CALL: Duration = Duration::from_secs(2);
/// One attempt to open a session takes no longer.
const OPEN_ATTEMPT: Duration = Duration::from_millis(1_500);
/// A peer that shows no life for this long is taken for dead.
const LINK_LEASE: Duration = Duration::from_secs(2);

/// A Zenoh configuration with `settings` made in it.
pub(super) fn configure(settings: &[(&str, Value)]) -> Result<Config, zenoh::Error> {
    let mut config = Config::default();
    for (path, value) in settings {
        config.insert_json5(path, &value.to_string())?;
    }
    Ok(config)
}

/// Opens a client session with the one party that these endpoints lead to, over QUIC if there are certificates for it
/// and over TCP otherwise. It connects again after a break.
///
/// Opening blocks its thread and cannot be cancelled, so each attempt is short and has a thread for it. Zenoh's own
/// unbounded wait (`timeout_ms: -1`) would hold that thread, and with it the end of the process, for ever; the
/// connection after a break does not depend on it.
pub(super) async fn open(endpoints: &[String], certificates: Option<&Certificates>) -> Result<Session, zenoh::Error> {
    let mut config = configure(&[
        ("mode", json!("client")),
        ("connect/endpoints", json!(endpoints)),
        ("connect/timeout_ms", json!(OPEN_ATTEMPT.as_millis() as u64)),
        ("connect/exit_on_failure", json!(false)),
        ("connect/retry", json!({"period_init_ms": 100, "period_max_ms": 2_000, "period_increase_factor": 2})),
        ("listen/endpoints", json!([])),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
        ("transport/link/tx/lease", json!(LINK_LEASE.as_millis() as u64)),
        ("transport/link/protocols", json!(["tcp"])),
    ])?;
    for (path, value) in certificates.iter().flat_map(|certificates| certificates.settings()) {
        config.insert_json5(path, &value.to_string())?;
    }
    tokio::task::spawn_blocking(|| zenoh::open(config).wait()).await?
}

/// The ids of all coordinators of `namespace` that this session reaches, in order.
pub(super) async fn coordinators(session: &Session, namespace: &str) -> Vec<String> {
    let everyone = coordinator_key(namespace, "*");
    let Ok(replies) = session.liveliness().get(everyone).timeout(ROLL_CALL).await else { return Vec::new() };
    let mut found = Vec::new();
    while let Ok(reply) = replies.recv_async().await {
        let id = reply.result().ok().and_then(|sample| coordinator_of(sample.key_expr().as_str()));
        found.extend(id.map(str::to_owned));
    }
    found.sort();
    found.dedup();
    found
}

/// The last word but one.
fn coordinator_of(key: &str) -> Option<&str> {
    key.rsplit('/').nth(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_coordinator_is_named_in_its_key() {
        assert_eq!(coordinator_of(&coordinator_key("default", "c0ffee")), Some("c0ffee"));
        assert_eq!(coordinator_of("alone"), None);
    }
}
