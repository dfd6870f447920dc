//! What can be wrong with a question for a table.

/// A question for a table that cannot be answered.
///
/// The user's to mend: the caller refuses the request with the message, which names the key and what is allowed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{key}: unknown {what} `{given}`: {}", list(.known))]
pub struct TableError {
    /// The key of the question: `group_by`, `metric`, `columns`, `statistic` or `format`.
    pub key: &'static str,
    /// What the word should have named: a factor, a metric, ..
    pub what: &'static str,
    /// The word as it was given, cut to 80 characters.
    pub given: String,
    /// The words that are allowed.
    pub known: Vec<String>,
}

impl TableError {
    pub(crate) fn new<T: ToString>(
        key: &'static str,
        what: &'static str,
        given: &str,
        known: impl IntoIterator<Item = T>,
    ) -> Self {
        let known = known.into_iter().map(|word| word.to_string()).collect();
        Self { key, what, given: given.chars().take(80).collect(), known }
    }
}

fn list(known: &[String]) -> String {
    if known.is_empty() { "there are none".to_owned() } else { format!("allowed are {}", known.join(", ")) }
}
