//! What can be wrong with a comparison.

use crate::table::TableError;

/// A comparison that cannot be made.
///
/// The user's to mend: the caller refuses the request with the message, which names the key and what is allowed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{key}: {reason}{}", allowed(.known))]
pub struct PairedError {
    /// The key of the question: `factor`, `a`, `b`, `other`, `metric` or `group_by`.
    pub key: &'static str,
    /// What is wrong with it.
    pub reason: String,
    /// The words that are allowed; none where that is no list.
    pub known: Vec<String>,
}

impl PairedError {
    pub(super) fn new<T: ToString>(
        key: &'static str,
        reason: impl Into<String>,
        known: impl IntoIterator<Item = T>,
    ) -> Self {
        let known = known.into_iter().map(|word| word.to_string()).collect();
        Self { key, reason: reason.into(), known }
    }

    pub(super) fn unknown<T: ToString>(
        key: &'static str,
        what: &str,
        given: &str,
        known: impl IntoIterator<Item = T>,
    ) -> Self {
        let given: String = given.chars().take(80).collect();
        Self::new(key, format!("unknown {what} `{given}`"), known)
    }
}

impl From<TableError> for PairedError {
    fn from(error: TableError) -> Self {
        Self::unknown(error.key, error.what, &error.given, error.known)
    }
}

fn allowed(known: &[String]) -> String {
    if known.is_empty() { String::new() } else { format!(": allowed are {}", known.join(", ")) }
}
