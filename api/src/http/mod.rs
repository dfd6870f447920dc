//! The HTTP service.

pub mod problem;
