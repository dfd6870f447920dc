//! The HTTP service.

mod extract;
mod layers;
pub mod problem;

pub use layers::{BODY_LIMIT, TIMEOUT};
