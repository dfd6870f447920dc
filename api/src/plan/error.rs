//! What can be wrong with a plan or with what is asked of it.

use furrow_sim::ScenarioError;

/// A plan or a request that cannot be expanded.
///
/// All of these are the user's to mend: the caller refuses the request and shows the message, which names the
/// key and what is allowed there. Nothing has been stored.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PlanError {
    /// No plan of this name comes with Furrow.
    #[error("unknown plan `{name}`: {}", allowed(.known))]
    UnknownPlan {
        /// The name as it was given.
        name: String,
        /// The names there are.
        known: Vec<String>,
    },
    /// A file cannot be read.
    #[error("{file}: {reason}")]
    File {
        /// Its path as it was given.
        file: String,
        /// Why not.
        reason: String,
    },
    /// A file is not the JSON it should be.
    #[error("{file}, line {line}, column {column}: {reason}")]
    Json {
        /// Its path as it was given.
        file: String,
        /// From 1.
        line: usize,
        /// From 1.
        column: usize,
        /// What is wrong there.
        reason: String,
    },
    /// A plan, or a part of a request, does not have the form it must have.
    #[error("{at}: {reason}")]
    Malformed {
        /// The key, such as `factors[1].levels[0].label` or `field.name`.
        at: String,
        /// What is wrong and what is allowed.
        reason: String,
    },
    /// `only` names a factor that the plan does not have.
    #[error("only: unknown factor `{factor}`: {}", allowed(.known))]
    UnknownFactor {
        /// The name as it was given.
        factor: String,
        /// The factors there are.
        known: Vec<String>,
    },
    /// `only` names a level that the factor does not have.
    #[error("only.{factor}: unknown level `{level}`: {}", allowed(.known))]
    UnknownLevel {
        /// The factor.
        factor: String,
        /// The label as it was given.
        level: String,
        /// The labels there are.
        known: Vec<String>,
    },
    /// A path of `set` or `vary` that no selected scenario has.
    #[error("{part}: no selected scenario has `{path}`{}", nearest(.near))]
    UnknownPath {
        /// `set` or `vary`.
        part: &'static str,
        /// The path as it was given.
        path: String,
        /// Paths there are, the most similar first.
        near: Vec<String>,
    },
    /// A number of seeds outside 1 to 1,000,000.
    #[error("seeds: {seeds} is out of range: allowed are 1 to 1000000")]
    Seeds {
        /// The number as it was given.
        seeds: u64,
    },
    /// More than a sweep may hold.
    #[error("this is {what}: a sweep holds at most {limit}; take fewer levels or seeds")]
    TooLarge {
        /// What there is too much of, with the number.
        what: String,
        /// The limit.
        limit: u64,
    },
    /// A scenario cannot be run.
    #[error("{}{path}: {reason}", prefix(.cell))]
    Scenario {
        /// The cell's labels: `algorithm=rgop, field=crop-1`.
        cell: String,
        /// Dotted path of the offending key.
        path: String,
        /// What is wrong and what is allowed.
        reason: String,
    },
}

impl PlanError {
    pub(super) fn malformed(at: impl Into<String>, reason: impl Into<String>) -> Self {
        Self::Malformed { at: at.into(), reason: reason.into() }
    }

    pub(super) fn scenario(cell: String, error: ScenarioError) -> Self {
        Self::Scenario { cell, path: error.path, reason: error.reason }
    }

    /// The key that is wrong, as the user wrote it.
    #[must_use]
    pub fn key(&self) -> &str {
        match self {
            Self::UnknownPlan { .. } => "plan",
            Self::File { file, .. } | Self::Json { file, .. } => file,
            Self::Malformed { at, .. } => at,
            Self::UnknownFactor { factor, .. } | Self::UnknownLevel { factor, .. } => factor,
            Self::UnknownPath { path, .. } | Self::Scenario { path, .. } => path,
            Self::Seeds { .. } | Self::TooLarge { .. } => "seeds",
        }
    }

    /// The values that are allowed at that key, where they can be listed.
    #[must_use]
    pub fn allowed(&self) -> &[String] {
        match self {
            Self::UnknownPlan { known, .. } | Self::UnknownFactor { known, .. } | Self::UnknownLevel { known, .. } => {
                known
            }
            Self::UnknownPath { near, .. } => near,
            _ => &[],
        }
    }
}

/// A list of names for a message, cut where it gets long.
fn allowed(known: &[String]) -> String {
    const SHOWN: usize = 24;
    let rest = known.len().saturating_sub(SHOWN);
    let shown = known[..known.len() - rest].join(", ");
    match (known.len(), rest) {
        (0, _) => "there are none".to_owned(),
        (_, 0) => format!("allowed are {shown}"),
        _ => format!("allowed are {shown} and {rest} more"),
    }
}

fn nearest(near: &[String]) -> String {
    if near.is_empty() { String::new() } else { format!("; near are {}", near.join(", ")) }
}

fn prefix(cell: &str) -> String {
    if cell.is_empty() { String::new() } else { format!("{cell}: ") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_name_the_key_and_the_allowed_values() {
        let error = PlanError::UnknownLevel {
            factor: "field".into(),
            level: "crop-9".into(),
            known: vec!["crop-1".into(), "crop-2".into()],
        };
        assert_eq!(error.to_string(), "only.field: unknown level `crop-9`: allowed are crop-1, crop-2");
        assert_eq!((error.key(), error.allowed().len()), ("field", 2));
    }

    #[test]
    fn a_long_list_is_cut_and_says_so() {
        let known = (0..100).map(|i| format!("nursery-{i:03}")).collect();
        let text = PlanError::UnknownFactor { factor: "x".into(), known }.to_string();
        assert!(text.ends_with("nursery-023 and 76 more"), "{text}");
    }
}
