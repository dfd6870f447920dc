//! How a command can end badly, and with which exit code.

use std::fmt::Display;
use std::io;

use furrow_coordinator::StoreError;

use crate::http::problem::Problem;
use crate::plan::PlanError;

/// Why a command did not end well. Its text is the last line that the user sees.
#[derive(Debug, thiserror::Error)]
pub enum CliError {
    /// The user asked for something that cannot be: the text names the key and what is allowed. Exit code 2.
    #[error("{0}")]
    BadInput(String),
    /// The server refused the request. Exit code 2 if the request is at fault, 1 if the server is.
    #[error("{}", refusal(.0))]
    Refused(Box<Problem>),
    /// The server cannot be reached. Exit code 1.
    #[error("{url} does not answer: {cause}")]
    Unreachable {
        /// Where it was looked for.
        url: String,
        /// Why not.
        cause: String,
    },
    /// Some jobs were given up on; everything else is done. Exit code 1.
    #[error("{0} of the jobs failed")]
    JobsFailed(u64),
    /// The user stopped it. Exit code 1.
    #[error("stopped before the end")]
    Stopped,
    /// It could not be finished. Exit code 1.
    #[error("{0}")]
    Failed(String),
    /// Whoever read the output went away. Nothing is said about it, and the exit code is 0.
    #[error("nobody reads the output")]
    OutputClosed,
}

impl CliError {
    /// What the process ends with.
    #[must_use]
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::OutputClosed => 0,
            Self::BadInput(_) => 2,
            Self::Refused(problem) if problem.status < 500 => 2,
            Self::Refused(_) | Self::Unreachable { .. } | Self::JobsFailed(_) | Self::Stopped | Self::Failed(_) => 1,
        }
    }

    /// Turns a cause into [`CliError::Failed`], with what could not be done.
    pub fn failed<E: Display>(what: impl Display) -> impl FnOnce(E) -> Self {
        move |cause| Self::Failed(format!("{what}: {cause}"))
    }

    /// Turns a cause into [`CliError::BadInput`], with the key at fault.
    pub fn bad_input<E: Display>(key: impl Display) -> impl FnOnce(E) -> Self {
        move |cause| Self::BadInput(format!("{key}: {cause}"))
    }
}

impl From<PlanError> for CliError {
    fn from(error: PlanError) -> Self {
        Self::BadInput(error.to_string())
    }
}

impl From<StoreError> for CliError {
    fn from(error: StoreError) -> Self {
        match error {
            StoreError::Open { .. }
            | StoreError::NotOurs { .. }
            | StoreError::Newer { .. }
            | StoreError::InUse { .. }
            | StoreError::Corrupt { .. }
            | StoreError::Target { .. }
            | StoreError::Ambiguous(_)
            | StoreError::Cancelled(_)
            | StoreError::Conflict { .. }
            | StoreError::Invalid(_)
            | StoreError::OtherEngine { .. } => Self::BadInput(error.to_string()),
            _ => Self::Failed(error.to_string()),
        }
    }
}

impl From<io::Error> for CliError {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::BrokenPipe => Self::OutputClosed,
            _ => Self::Failed(format!("cannot write the output: {error}")),
        }
    }
}

fn refusal(problem: &Problem) -> String {
    let mut text = problem.detail.clone();
    if let Some(key) = problem.key.as_ref().filter(|key| !text.contains(key.as_str())) {
        text = format!("{key}: {text}");
    }
    if problem.allowed.is_empty() || problem.allowed.iter().all(|word| text.contains(word.as_str())) {
        return text;
    }
    format!("{text}; allowed: {}", problem.allowed.join(", "))
}

#[cfg(test)]
mod tests {
    use axum::http::StatusCode;

    use super::*;

    #[test]
    fn exit_codes_tell_bad_input_from_what_could_not_be_finished() {
        let refused = |status| CliError::Refused(Box::new(Problem::new(status, "no"))).exit_code();
        assert_eq!(refused(StatusCode::UNPROCESSABLE_ENTITY), 2);
        assert_eq!(refused(StatusCode::SERVICE_UNAVAILABLE), 1);
        assert_eq!(CliError::BadInput(String::new()).exit_code(), 2);
        assert_eq!(CliError::JobsFailed(1).exit_code(), 1);
        assert_eq!(CliError::from(io::Error::from(io::ErrorKind::BrokenPipe)).exit_code(), 0);
    }

    #[test]
    fn a_refusal_names_key_and_allowed_values_once() {
        let problem = Problem::bad_request("there is no level `x`").at("only.field").allowing(["crop-1", "crop-2"]);
        let text = CliError::Refused(Box::new(problem)).to_string();
        assert_eq!(text, "only.field: there is no level `x`; allowed: crop-1, crop-2");
        let said = Problem::bad_request("`x`: crop-1 or crop-2").allowing(["crop-1", "crop-2"]);
        assert_eq!(CliError::Refused(Box::new(said)).to_string(), "`x`: crop-1 or crop-2");
    }
}
