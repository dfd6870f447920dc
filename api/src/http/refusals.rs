//! Errors of the layers below as problems.

use axum::http::StatusCode;
use furrow_coordinator::StoreError;

use super::problem::Problem;
use crate::paired::PairedError;
use crate::plan::PlanError;
use crate::publication::PublicationError;
use crate::table::TableError;

impl From<PlanError> for Problem {
    fn from(error: PlanError) -> Self {
        Self::unprocessable(error.to_string()).at(error.key()).allowing(error.allowed().iter().cloned())
    }
}

impl From<TableError> for Problem {
    fn from(error: TableError) -> Self {
        Self::unprocessable(error.to_string()).at(error.key).allowing(error.known)
    }
}

impl From<PairedError> for Problem {
    fn from(error: PairedError) -> Self {
        Self::unprocessable(error.to_string()).at(error.key).allowing(error.known)
    }
}

impl From<PublicationError> for Problem {
    fn from(error: PublicationError) -> Self {
        let (key, known) = match &error {
            PublicationError::UnknownSource { known, .. } => ("source", known),
            PublicationError::UnknownTable { known, .. } => ("table", known),
        };
        Self::new(StatusCode::NOT_FOUND, error.to_string()).at(key).allowing(known.iter().copied())
    }
}

impl From<StoreError> for Problem {
    fn from(error: StoreError) -> Self {
        match error {
            StoreError::Invalid(reason) => Self::unprocessable(reason),
            StoreError::Ambiguous(_) => Self::bad_request(error.to_string()).at("job"),
            StoreError::Conflict { .. } => Self::new(StatusCode::CONFLICT, error.to_string()).at("Idempotency-Key"),
            StoreError::OtherEngine { .. } | StoreError::Cancelled(_) => {
                Self::new(StatusCode::CONFLICT, error.to_string())
            }
            StoreError::Full => Self::unavailable(error.to_string()),
            StoreError::NotWritten(_) | StoreError::Database(_) | StoreError::Closed => {
                tracing::error!(%error, "a request failed");
                Self::unavailable("the server cannot do this at the moment; nothing was changed")
            }
            StoreError::Open { .. }
            | StoreError::NotOurs { .. }
            | StoreError::Newer { .. }
            | StoreError::InUse { .. }
            | StoreError::Corrupt { .. }
            | StoreError::Target { .. }
            | StoreError::Broken(_)
            | StoreError::Damaged(_) => Self::internal(&error),
        }
    }
}
