//! What Zenoh is told on a local network: certificates on both sides, and who may do what.
//!
//! Zenoh's access control is fixed when the session opens and knows a certificate by its common name only, so it tells
//! what kind of party somebody is, not who: that is for the credential of every question. What is not allowed here is
//! denied. Above all, nobody but the coordinator answers questions or hears them.

use std::net::Ipv4Addr;
use std::sync::Arc;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use furrow_schema::protocol::{KEY_PREFIX, Method, coordinator_key, key};
use serde_json::{Value, json};

use crate::authority::{Authority, JOIN, ROUTER, Signed, WORKER};
use crate::zenoh_config::{ZenohError, split};

/// A local network that is served.
#[derive(Debug, Clone)]
pub struct LocalNetwork {
    /// Signs the certificates.
    pub authority: Arc<Authority>,
    /// Further addresses or names under which workers reach this machine.
    pub names: Vec<String>,
}

impl LocalNetwork {
    /// The settings of a coordinator's session that listens on `endpoints`.
    pub(crate) fn settings(
        &self,
        endpoints: &[String],
        namespace: &str,
        coordinator: &str,
        now_ms: i64,
    ) -> Result<Vec<(&'static str, Value)>, ZenohError> {
        let wrong = |name: String| ZenohError::Endpoint {
            reason: "it is neither an address nor the name of a host".to_owned(),
            endpoint: name,
        };
        let own = self.authority.coordinator(&self.all_names(endpoints), now_ms).map_err(wrong)?;
        let mut settings = certificates(&own, self.authority.certificate_pem());
        settings.push(("transport/link/protocols", json!(["quic"])));
        settings.push(("access_control", access_control(namespace, coordinator)));
        Ok(settings)
    }

    /// Where workers reach a coordinator that listens on `endpoints`.
    pub(crate) fn reached_at(&self, endpoints: &[String]) -> Vec<String> {
        let mut reached = Vec::new();
        for (host, port) in endpoints.iter().filter_map(|endpoint| host_and_port(endpoint)) {
            let hosts = if is_any(host) { addresses_of_this_machine() } else { vec![host.to_owned()] };
            reached.extend(self.names.iter().chain(&hosts).map(|host| format!("quic/{host}:{port}")));
        }
        reached
    }

    /// Everything that this machine may be called by a worker.
    fn all_names(&self, endpoints: &[String]) -> Vec<String> {
        let mut names = self.names.clone();
        for (host, _) in endpoints.iter().filter_map(|endpoint| host_and_port(endpoint)) {
            if is_any(host) {
                names.extend(addresses_of_this_machine());
                names.extend(["127.0.0.1", "localhost"].map(str::to_owned));
                names.extend(
                    hostname::get().ok().and_then(|name| name.into_string().ok()).filter(|name| is_plain(name)),
                );
            } else {
                names.push(host.to_owned());
            }
        }
        names.sort();
        names.dedup();
        names
    }
}

fn host_and_port(endpoint: &str) -> Option<(&str, u16)> {
    split(endpoint).ok().map(|(_, host, port, _)| (host, port))
}

fn is_any(host: &str) -> bool {
    host.parse() == Ok(Ipv4Addr::UNSPECIFIED)
}

/// A host may have a name that no certificate can hold.
fn is_plain(name: &str) -> bool {
    !name.is_empty() && name.bytes().all(|b| b.is_ascii_alphanumeric() || matches!(b, b'-' | b'.'))
}

/// IPv4 addresses of its interfaces that are up; that of the loopback interface if there is no other.
fn addresses_of_this_machine() -> Vec<String> {
    let interfaces = pnet_datalink::interfaces();
    let up = interfaces.iter().filter(|interface| interface.is_up() && !interface.is_loopback());
    let addresses = up.flat_map(|interface| &interface.ips).filter(|network| network.is_ipv4());
    let mut addresses: Vec<_> = addresses.map(|network| network.ip().to_string()).collect();
    if addresses.is_empty() {
        addresses.push(Ipv4Addr::LOCALHOST.to_string());
    }
    addresses
}

fn certificates(own: &Signed, authority_pem: &str) -> Vec<(&'static str, Value)> {
    let encoded = |pem: &str| json!(STANDARD.encode(pem));
    vec![
        ("transport/link/tls/root_ca_certificate_base64", encoded(authority_pem)),
        ("transport/link/tls/listen_certificate_base64", encoded(&own.certificate_pem)),
        ("transport/link/tls/listen_private_key_base64", encoded(&own.key_pem)),
        ("transport/link/tls/enable_mtls", json!(true)),
        ("transport/link/tls/close_link_on_expiration", json!(true)),
    ]
}

/// Who may do what; everything else is denied, in both directions. A router passes on what workers and newcomers say, and
/// tells them apart itself.
fn access_control(namespace: &str, coordinator: &str) -> Value {
    let of = |methods: &[Method]| methods.iter().map(|method| key(namespace, coordinator, *method)).collect::<Vec<_>>();
    let work = of(&[Method::Hello, Method::Claim, Method::Result, Method::Renew, Method::Refresh]);
    let enrol = of(&[Method::Enrol]);
    let own = format!("{KEY_PREFIX}/{namespace}/{coordinator}");
    let lives = [format!("{own}/worker/*")];
    let hints = [format!("{own}/hint/**")];
    let found = [coordinator_key(namespace, coordinator)];
    let find = [coordinator_key(namespace, "*")];
    json!({
        "enabled": true,
        "default_permission": "deny",
        "rules": [
            rule("may-work", "ingress", &["query"], &work),
            rule("is-answered", "egress", &["reply", "declare_queryable"], &work),
            rule("may-find", "ingress", &["liveliness_query"], &find),
            rule("finds", "egress", &["liveliness_token"], &found),
            rule("may-show-life", "ingress", &["liveliness_token"], &lives),
            rule("life-is-watched", "egress", &["declare_liveliness_subscriber"], &lives),
            rule("may-hear-hints", "ingress", &["declare_subscriber"], &hints),
            rule("hears-hints", "egress", &["put"], &hints),
            rule("may-enrol", "ingress", &["query"], &enrol),
            rule("is-enrolled", "egress", &["reply", "declare_queryable"], &enrol),
        ],
        "subjects": [
            {"id": "worker", "cert_common_names": [WORKER], "link_protocols": ["quic"]},
            {"id": "newcomer", "cert_common_names": [JOIN], "link_protocols": ["quic"]},
            {"id": "router", "cert_common_names": [ROUTER], "link_protocols": ["quic"]},
        ],
        "policies": [
            {"id": "workers", "subjects": ["worker", "router"], "rules": [
                "may-work", "is-answered", "may-find", "finds", "may-show-life", "life-is-watched", "may-hear-hints",
                "hears-hints",
            ]},
            {"id": "newcomers", "subjects": ["newcomer", "router"], "rules": ["may-enrol", "is-enrolled"]},
        ],
    })
}

fn rule(id: &str, flow: &str, messages: &[&str], keys: &[String]) -> Value {
    json!({"id": id, "flows": [flow], "permission": "allow", "messages": messages, "key_exprs": keys})
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::zenoh_config::{Scouting, session};

    fn local_network(names: &[&str]) -> LocalNetwork {
        let names = names.iter().map(|name| (*name).to_owned()).collect();
        LocalNetwork { authority: Arc::new(Authority::draw(0)), names }
    }

    #[test]
    fn zenoh_knows_every_setting() {
        let endpoints = ["quic/127.0.0.1:1".to_owned()];
        let settings = local_network(&[]).settings(&endpoints, "default", "c0ffee", 0).unwrap();
        session(&endpoints, Scouting::Off, settings).unwrap();
    }

    #[test]
    fn workers_are_told_every_address_but_the_unspecified_one() {
        let network = local_network(&["barn.example"]);
        let told = network.reached_at(&["quic/0.0.0.0:7447".to_owned()]);
        assert_eq!(told[0], "quic/barn.example:7447");
        assert!(told.len() > 1 && told.iter().all(|endpoint| !endpoint.contains("0.0.0.0")), "{told:?}");
        assert_eq!(network.reached_at(&["quic/192.0.2.2:1".to_owned()])[1..], ["quic/192.0.2.2:1"]);
    }

    #[test]
    fn a_name_that_no_certificate_can_hold_is_named() {
        let error = local_network(&["schön"]).settings(&[], "default", "c0ffee", 0).unwrap_err();
        assert!(error.to_string().contains("schön"), "{error}");
    }
}
