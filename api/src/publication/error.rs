//! What can be wrong with a question for a published table.

/// A question for a published table that cannot be answered.
///
/// The user's to mend: the caller answers "not found" with the message, which lists what there is.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PublicationError {
    /// No publication of this name is known.
    #[error("unknown publication `{source_name}`: there are {}", .known.join(", "))]
    UnknownSource {
        /// The name as it was given.
        source_name: String,
        /// The names there are.
        known: Vec<&'static str>,
    },
    /// The publication has no such table.
    #[error("{source_name} has no `{table}` here: there are {}", .known.join(", "))]
    UnknownTable {
        /// The publication.
        source_name: &'static str,
        /// The table as it was given.
        table: String,
        /// The tables there are.
        known: Vec<&'static str>,
    },
}
