//! Names of things: small integers for rows, 32-byte hashes for content, random words for parties.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use utoipa::openapi::schema::{ObjectBuilder, Schema, Type};
use utoipa::openapi::{KnownFormat, RefOr, SchemaFormat};
use utoipa::{PartialSchema, ToSchema};

/// A text that is not the identifier it should be.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is not {expected}")]
pub struct IdError {
    /// The text as it was given, cut to 80 characters.
    pub text: String,
    /// The form that was expected, in words.
    pub expected: &'static str,
}

impl IdError {
    fn new(text: &str, expected: &'static str) -> Self {
        Self { text: text.chars().take(80).collect(), expected }
    }
}

macro_rules! row_id {
    ($(#[$doc:meta])* $name:ident, $expected:literal) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[serde(transparent)]
        pub struct $name(pub i64);

        impl PartialSchema for $name {
            fn schema() -> RefOr<Schema> {
                let number = ObjectBuilder::new().schema_type(Type::Integer).description(Some($expected));
                number.format(Some(SchemaFormat::KnownFormat(KnownFormat::Int64))).minimum(Some(1)).build().into()
            }
        }

        impl ToSchema for $name {}

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        }

        impl FromStr for $name {
            type Err = IdError;

            fn from_str(text: &str) -> Result<Self, IdError> {
                text.parse().ok().filter(|id| *id > 0).map(Self).ok_or_else(|| IdError::new(text, $expected))
            }
        }
    };
}

row_id!(
    /// A sweep: what one submission asked for.
    SweepId,
    "a sweep's number"
);
row_id!(
    /// A job: one scenario with one seed.
    JobId,
    "a job's number"
);
row_id!(
    /// A cell: one combination of factor labels in one sweep.
    CellId,
    "a cell's number"
);
row_id!(
    /// A scenario, stored once per content.
    ScenarioId,
    "a scenario's number"
);

macro_rules! hash_id {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(pub [u8; 32]);

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                blake3::Hash::from(self.0).to_hex().fmt(f)
            }
        }

        impl fmt::Debug for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                fmt::Display::fmt(self, f)
            }
        }

        impl FromStr for $name {
            type Err = IdError;

            fn from_str(text: &str) -> Result<Self, IdError> {
                blake3::Hash::from_hex(text)
                    .map(|hash| Self(hash.into()))
                    .map_err(|_| IdError::new(text, "64 hexadecimal digits"))
            }
        }

        impl Serialize for $name {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.collect_str(self)
            }
        }

        impl<'de> Deserialize<'de> for $name {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                let text = std::borrow::Cow::<'de, str>::deserialize(deserializer)?;
                text.parse().map_err(serde::de::Error::custom)
            }
        }
    };
}

hash_id!(
    /// Which simulation code computes a result: equal engines give equal bits.
    EngineId
);
hash_id!(
    /// What a run is: engine, scenario and seed. The same key is not run twice.
    JobKey
);
hash_id!(
    /// What came out of a run, as bits: trajectory, outcome and metrics.
    Digest
);
hash_id!(
    /// The content of a scenario's canonical JSON.
    ScenarioHash
);

hash_id!(
    /// The public half of an Ed25519 key: a worker's on a local network, or a join secret's.
    PublicKey
);

impl JobKey {
    /// The key of `scenario_json` (canonical form) run with `seed` by `engine`.
    ///
    /// A timing run measures the machine, so no earlier result may stand in for it: its key also holds
    /// the sweep that asked.
    #[must_use]
    pub fn new(engine: EngineId, scenario_json: &str, seed: u64, timing: Option<SweepId>) -> Self {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&engine.0).update(scenario_json.as_bytes()).update(&seed.to_le_bytes());
        if let Some(sweep) = timing {
            hasher.update(b"timing").update(&sweep.0.to_le_bytes());
        }
        Self(hasher.finalize().into())
    }
}

impl ScenarioHash {
    /// The hash of a scenario's canonical JSON.
    #[must_use]
    pub fn of(scenario_json: &str) -> Self {
        Self(blake3::hash(scenario_json.as_bytes()).into())
    }
}

/// A worker process, by a name it draws once: 32 hexadecimal digits.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct WorkerId(String);

impl PartialSchema for WorkerId {
    fn schema() -> RefOr<Schema> {
        let text = ObjectBuilder::new().schema_type(Type::String).pattern(Some("^[0-9a-f]{32}$"));
        text.description(Some("a worker's name: 32 hexadecimal digits")).build().into()
    }
}

impl ToSchema for WorkerId {}

/// One request of a worker; the same id again is the same request again.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct RequestId(String);

/// A secret that a worker proves itself with. Never printed.
#[derive(Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Credential(String);

const RANDOM_WORD: &str = "32 hexadecimal digits";

fn random_word() -> String {
    format!("{:032x}", rand::random::<u128>())
}

macro_rules! random_id {
    ($name:ident) => {
        impl $name {
            /// A fresh one, from the operating system's randomness.
            #[must_use]
            pub fn random() -> Self {
                Self(random_word())
            }

            /// The 32 hexadecimal digits.
            #[must_use]
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }

        impl TryFrom<String> for $name {
            type Error = IdError;

            fn try_from(text: String) -> Result<Self, IdError> {
                let good = text.len() == 32 && text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f'));
                if good { Ok(Self(text)) } else { Err(IdError::new(&text, RANDOM_WORD)) }
            }
        }

        impl From<$name> for String {
            fn from(id: $name) -> String {
                id.0
            }
        }
    };
}
random_id!(WorkerId);
random_id!(RequestId);
random_id!(Credential);

impl fmt::Display for WorkerId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl fmt::Debug for Credential {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Credential(..)")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_job_key_changes_with_engine_scenario_seed_and_timing() {
        let engine = EngineId([1; 32]);
        let keys = [
            JobKey::new(engine, "{}", 1, None),
            JobKey::new(EngineId([2; 32]), "{}", 1, None),
            JobKey::new(engine, "[]", 1, None),
            JobKey::new(engine, "{}", 2, None),
            JobKey::new(engine, "{}", 1, Some(SweepId(1))),
            JobKey::new(engine, "{}", 1, Some(SweepId(2))),
        ];
        for (i, key) in keys.iter().enumerate() {
            assert!(keys[i + 1..].iter().all(|other| other != key));
        }
        assert_eq!(key_text(&keys[0]).len(), 64);
    }

    fn key_text(key: &JobKey) -> String {
        key.to_string()
    }

    #[test]
    fn identifiers_survive_a_round_trip_and_refuse_other_texts() {
        let key = JobKey::new(EngineId([7; 32]), "{}", 3, None);
        assert_eq!(key_text(&key).parse(), Ok(key));
        assert!("zz".parse::<JobKey>().is_err());
        assert!("0".parse::<SweepId>().is_err());
        assert!(WorkerId::try_from("not a worker".to_owned()).is_err());
        let id = WorkerId::random();
        assert_eq!(WorkerId::try_from(String::from(id.clone())), Ok(id));
    }

    #[test]
    fn a_credential_is_never_printed() {
        let secret = Credential::random();
        assert!(!format!("{secret:?}").contains(secret.as_str()));
    }
}
