//! How the coordinator's Zenoh session is set up: where it listens and how workers find it.
//!
//! Nothing is reachable that was not asked for: the session listens on the given endpoints alone, connects to
//! nobody, does not gossip, and answers scouts on the loopback interface only. On a local network it listens on QUIC
//! with certificates on both sides, answers no scouts, and lets nobody do what a worker has no need to do (`security`).

use std::net::{IpAddr, SocketAddr, TcpListener, ToSocketAddrs, UdpSocket};

use furrow_schema::protocol::DEFAULT_NAMESPACE;
use serde_json::{Value, json};

pub use crate::security::LocalNetwork;
use crate::wire::MAX_PAYLOAD_BYTES;

/// Settings of the Zenoh service.
#[derive(Debug, Clone)]
pub struct ZenohConfig {
    /// Endpoints to listen on, such as `tcp/127.0.0.1:7447`; port 0 takes any free one. `quic/` on a local network,
    /// `tcp/` and an address of the loopback interface otherwise.
    pub listen: Vec<String>,
    /// Separates coordinators and workers that share a network: one word of letters, digits, `-` and `_`.
    pub namespace: String,
    /// Who may find the coordinator by scouting. Nobody on a local network: a join secret says where it is.
    pub scouting: Scouting,
    /// Serves a local network; none to serve this machine alone.
    pub local_network: Option<LocalNetwork>,
}

/// Who is answered when they scout for coordinators. Being found is not being let in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scouting {
    /// Nobody: workers have to be told an endpoint.
    Off,
    /// Workers on this machine, over its loopback interface.
    ThisMachine,
}

impl ZenohConfig {
    /// The default, but listening on `endpoint`.
    #[must_use]
    pub fn on(endpoint: &str) -> Self {
        Self { listen: vec![endpoint.to_owned()], ..Self::default() }
    }
}

impl Default for ZenohConfig {
    /// Any free port of this machine alone, found by scouting on it alone.
    fn default() -> Self {
        Self {
            listen: vec!["tcp/127.0.0.1:0".to_owned()],
            namespace: DEFAULT_NAMESPACE.to_owned(),
            scouting: Scouting::ThisMachine,
            local_network: None,
        }
    }
}

/// Why the Zenoh service did not start. The caller gives up and tells the user.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ZenohError {
    /// The namespace is not one plain word. The caller names the setting.
    #[error("the namespace `{0}` is not one word of letters, digits, `-` and `_`")]
    Namespace(String),
    /// The endpoint cannot be read or is of a kind that this build does not have. The caller names the setting.
    #[error("cannot listen on `{endpoint}`: {reason}")]
    Endpoint {
        /// The endpoint as it was given.
        endpoint: String,
        /// What is wrong with it.
        reason: String,
    },
    /// Somebody else listens there. The user chooses another port, or 0 for any.
    #[error("cannot listen on `{0}`: the port is in use")]
    Busy(String),
    /// Zenoh failed otherwise.
    #[error("zenoh: {0}")]
    Zenoh(String),
}

impl From<zenoh::Error> for ZenohError {
    fn from(error: zenoh::Error) -> Self {
        Self::Zenoh(error.to_string())
    }
}

/// A link whose other end is silent for this long is given up \[ms\].
const LINK_LEASE_MS: u32 = 2_000;
/// At most so many workers, joining ones among them, are connected at a time.
const MAX_SESSIONS: u32 = 4_096;
/// The address by which the loopback interface is named.
const LOOPBACK: &str = "127.0.0.1";

impl ZenohConfig {
    /// The endpoints with a free port in place of 0, each found free a moment ago.
    pub(crate) fn endpoints(&self) -> Result<Vec<String>, ZenohError> {
        let reach = if self.local_network.is_some() { Reach::LocalNetwork } else { Reach::ThisMachine };
        self.listen.iter().map(|endpoint| with_free_port(endpoint, reach)).collect()
    }

    /// Whether the namespace can be a word of a key.
    pub(crate) fn check_namespace(&self) -> Result<(), ZenohError> {
        let plain = |b: u8| b.is_ascii_alphanumeric() || b == b'-' || b == b'_';
        let good = !self.namespace.is_empty() && self.namespace.len() <= 64 && self.namespace.bytes().all(plain);
        if good { Ok(()) } else { Err(ZenohError::Namespace(self.namespace.chars().take(80).collect())) }
    }

    /// Whether any endpoint may be served on a port of the session's choice: a lost race for it may be run again.
    pub(crate) fn has_free_choice(&self) -> bool {
        self.listen.iter().any(|endpoint| split(endpoint).is_ok_and(|(_, _, port, _)| port == 0))
    }
}

/// What Zenoh is told; `security` on top of it.
pub(crate) fn session(
    endpoints: &[String],
    scouting: Scouting,
    security: Vec<(&'static str, Value)>,
) -> Result<zenoh::Config, ZenohError> {
    let mut config = zenoh::Config::default();
    let off = scouting == Scouting::Off;
    let settings = [
        ("mode", json!("peer")),
        ("listen/endpoints", json!(endpoints)),
        ("listen/exit_on_failure", json!(true)),
        ("listen/timeout_ms", json!(0)),
        ("connect/endpoints", json!([])),
        ("open/return_conditions/connect_scouted", json!(false)),
        ("scouting/multicast/enabled", json!(!off)),
        ("scouting/multicast/interface", json!(LOOPBACK)),
        ("scouting/multicast/autoconnect", json!([])),
        ("scouting/multicast/listen", json!(true)),
        ("scouting/gossip/enabled", json!(false)),
        ("transport/link/tx/lease", json!(LINK_LEASE_MS)),
        ("transport/unicast/max_sessions", json!(MAX_SESSIONS)),
        ("transport/unicast/accept_pending", json!(MAX_SESSIONS)),
        // Room for the largest question and what Zenoh wraps it in.
        ("transport/link/rx/max_message_size", json!(MAX_PAYLOAD_BYTES + (1 << 20))),
        ("adminspace/enabled", json!(false)),
    ];
    for (key, value) in settings.into_iter().chain(security) {
        // The value is not repeated: it may be a key.
        let wrong = |_| ZenohError::Zenoh(format!("it does not take the setting `{key}`"));
        config.insert_json5(key, &value.to_string()).map_err(wrong)?;
    }
    Ok(config)
}

/// Who shall reach an endpoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Reach {
    ThisMachine,
    LocalNetwork,
}

/// The endpoint with the port that it will have, if it is free and of the kind that `reach` calls for.
fn with_free_port(endpoint: &str, reach: Reach) -> Result<String, ZenohError> {
    let wrong = |reason: String| ZenohError::Endpoint { endpoint: endpoint.to_owned(), reason };
    let (protocol, host, port, rest) = split(endpoint).map_err(wrong)?;
    let bare_host = host.trim_start_matches('[').trim_end_matches(']');
    let address = (bare_host, port)
        .to_socket_addrs()
        .map_err(|error| wrong(error.to_string()))?
        .next()
        .ok_or_else(|| wrong(format!("`{host}` is no address")))?;
    fits(reach, protocol, address, rest).map_err(|reason| wrong(reason.to_owned()))?;
    let bound = match reach {
        Reach::ThisMachine => TcpListener::bind(address).and_then(|socket| socket.local_addr()),
        Reach::LocalNetwork => UdpSocket::bind(address).and_then(|socket| socket.local_addr()),
    };
    let bound = bound.map_err(|error| match error.kind() {
        std::io::ErrorKind::AddrInUse => ZenohError::Busy(endpoint.to_owned()),
        _ => wrong(error.to_string()),
    })?;
    Ok(format!("{protocol}/{host}:{}{rest}", bound.port()))
}

/// Whether it may be listened on.
fn fits(reach: Reach, protocol: &str, address: SocketAddr, rest: &str) -> Result<(), &'static str> {
    match reach {
        Reach::ThisMachine if protocol != "tcp" => Err("without --lan it is tcp/HOST:PORT"),
        Reach::ThisMachine if !address.ip().is_loopback() => {
            Err("without --lan only this machine is served (127.0.0.1 or [::1]): anyone who reaches it may work")
        }
        Reach::LocalNetwork if protocol != "quic" => {
            Err("with --lan it is quic/HOST:PORT: nothing else is encrypted and asks for a certificate")
        }
        // Certificates are checked against the text of an address, for which Zenoh takes the one with brackets.
        Reach::LocalNetwork if matches!(address.ip(), IpAddr::V6(_)) => Err("with --lan it is an IPv4 address"),
        Reach::LocalNetwork if !rest.is_empty() => Err("with --lan nothing may follow the port"),
        _ => Ok(()),
    }
}

/// Protocol, host, port, and what follows: `tcp/[::]:0#iface=eth0`.
pub(crate) fn split(endpoint: &str) -> Result<(&str, &str, u16, &str), String> {
    const FORM: &str = "an endpoint is written `tcp/HOST:PORT` or `quic/HOST:PORT`";
    let (protocol, rest) = endpoint.split_once('/').ok_or(FORM)?;
    if !matches!(protocol, "tcp" | "quic" | "tls" | "udp" | "ws") {
        return Err(format!("`{protocol}` is no known protocol; {FORM}"));
    }
    let (address, rest) = rest.find(['?', '#']).map_or((rest, ""), |at| rest.split_at(at));
    let (host, port) = address.rsplit_once(':').ok_or(FORM)?;
    let port = port.parse().map_err(|_| format!("`{port}` is no port, 0 to 65535"))?;
    if host.is_empty() { Err(FORM.to_owned()) } else { Ok((protocol, host, port, rest)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn port_0_becomes_a_free_port() {
        let endpoints = ZenohConfig::default().endpoints().unwrap();
        let port: u16 = endpoints[0].strip_prefix("tcp/127.0.0.1:").unwrap().parse().unwrap();
        assert_ne!(port, 0);
    }

    #[test]
    fn a_busy_port_is_named() {
        let taken = TcpListener::bind("127.0.0.1:0").unwrap();
        let endpoint = format!("tcp/{}", taken.local_addr().unwrap());
        let error = ZenohConfig::on(&endpoint).endpoints().unwrap_err();
        assert_eq!(error, ZenohError::Busy(endpoint.clone()));
        assert!(error.to_string().contains(&endpoint));
    }

    #[test]
    fn what_is_no_endpoint_is_named() {
        for endpoint in ["", "tcp", "tcp/", "tcp/127.0.0.1", "tcp/127.0.0.1:70000", "pigeon/loft:1", "tcp/:1"] {
            let error = ZenohConfig::on(endpoint).endpoints().unwrap_err();
            assert!(matches!(&error, ZenohError::Endpoint { .. }), "{endpoint}: {error}");
        }
    }

    #[test]
    fn this_machine_alone_is_served_unless_a_local_network_is_asked_for() {
        for endpoint in ["tcp/0.0.0.0:0", "tcp/[::]:0", "quic/127.0.0.1:0", "tls/127.0.0.1:0", "udp/127.0.0.1:0"] {
            let error = ZenohConfig::on(endpoint).endpoints().unwrap_err().to_string();
            assert!(error.contains(endpoint) && error.contains("--lan"), "{error}");
        }
        let lan = |endpoint: &str| with_free_port(endpoint, Reach::LocalNetwork);
        for endpoint in ["tcp/127.0.0.1:0", "tls/127.0.0.1:0", "quic/[::1]:0", "quic/127.0.0.1:0#enable_mtls=false"] {
            let error = lan(endpoint).unwrap_err().to_string();
            assert!(error.contains(endpoint) && error.contains("--lan"), "{error}");
        }
        assert!(lan("quic/0.0.0.0:0").is_ok());
    }

    #[test]
    fn an_endpoint_keeps_its_host_and_parameters() {
        assert_eq!(split("tcp/[::1]:0#iface=lo"), Ok(("tcp", "[::1]", 0, "#iface=lo")));
    }

    #[test]
    fn a_namespace_is_one_plain_word() {
        for (namespace, good) in [("default", true), ("lab-2", true), ("", false), ("a/b", false), ("*", false)] {
            let config = ZenohConfig { namespace: namespace.to_owned(), ..Default::default() };
            assert_eq!(config.check_namespace().is_ok(), good, "{namespace}");
        }
    }

    #[test]
    fn zenoh_knows_every_setting() {
        for scouting in [Scouting::Off, Scouting::ThisMachine] {
            session(&["tcp/127.0.0.1:1".to_owned()], scouting, Vec::new()).unwrap();
        }
    }
}
