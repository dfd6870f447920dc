//! Drives the real `furrow` processes, as users and workers do.
//!
//! `process` starts them, `server` is a running `furrow serve` seen through its HTTP interface, `plan` writes small
//! plans; the other modules are the claims. The binary `furrow` must have been built before, in the same profile:
//! `cargo build` and `cargo test`.
#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "all of this is test code")]

mod bad_input;
mod bad_requests;
mod control;
mod kills;
mod network;
mod pauses;
mod plan;
mod process;
mod same_bits;
mod schedules;
mod server;
mod stopping;
mod survival;
mod use_of_results;
