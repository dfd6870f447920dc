//! How the coordinator's Zenoh session is set up: what it listens on and how workers find it.

/// Settings of the Zenoh service.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ZenohConfig {
    /// Endpoints to listen on; port 0 takes any free one. Nothing else is listened on.
    pub listen: Vec<String>,
    /// Separates coordinators and workers that share a network: one word of a key.
    pub namespace: String,
    /// Whether workers on this machine may find the coordinator by scouting on the loopback interface.
    pub scouting: bool,
}

impl Default for ZenohConfig {
    /// Any free port of this machine alone, found by scouting on it alone.
    fn default() -> Self {
        Self {
            listen: vec!["tcp/127.0.0.1:0".to_owned()],
            namespace: furrow_schema::protocol::DEFAULT_NAMESPACE.to_owned(),
            scouting: true,
        }
    }
}
