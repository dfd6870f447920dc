//! Drives the real `furrow` processes, as users and workers do.
//!
//! `process` starts them, `server` is a running `furrow serve` seen through its HTTP interface, `plan` writes small
//! plans, `mount` makes file systems that are full or read-only, `machine` is a worker's side of a local network, spoken to by
//! hand; the other modules are the claims. The binary `furrow` must have been built before, in the same profile:
//! `cargo build` and `cargo test`.
#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "all of this is test code")]

mod backup;
mod bad_input;
mod bad_requests;
mod browser;
mod control;
mod dashboard;
mod database;
mod deploy;
mod full_disk;
mod kills;
mod lan;
mod lanes;
mod liveliness;
mod machine;
mod mount;
mod network;
mod pauses;
mod plan;
mod process;
mod same_bits;
mod server;
mod stopping;
mod strangers;
mod survival;
mod tokens;
mod use_of_results;
mod verification;
