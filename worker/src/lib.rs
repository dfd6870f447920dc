//! Pulls jobs, runs them on all cores, reports.
//!
//! Read in this order: [`link`] is what a worker can ask of a coordinator, over the network ([`zenoh_link`]) or
//! within one process; [`worker`] puts its loops together; `board` is its memory, a plain state machine of queued,
//! running and finished runs; `pool` empties the board on all cores; `claims`, `reports` and `renewals` are the three
//! conversations that go on meanwhile; [`spool`] keeps finished runs on disk until they are acknowledged, and
//! `spooling` is how they get there; [`runner`] is one run, with its stopwatch ([`timing`]) and its recorder
//! ([`trajectory`]). [`lan`] is how a worker gets in at a coordinator on a local network. [`replay`] runs a finished job
//! again to see its path and, in `scans`, what its LiDARs saw. With a [`Pace`] a worker lives in simulated time.

mod backoff;
mod board;
mod claims;
mod conversation;
mod gathering;
pub mod lan;
pub mod link;
pub mod pace;
mod pool;
mod renewals;
pub mod replay;
mod reports;
pub mod runner;
mod scans;
mod scenarios;
pub mod spool;
mod spooling;
pub mod timing;
pub mod trajectory;
pub mod worker;
pub mod zenoh_link;

#[cfg(test)]
mod scripted;

pub use link::{Link, LinkError};
pub use pace::Pace;
pub use runner::{Order, Runner, Simulator};
pub use spool::{Spool, SpoolError};
pub use worker::{Config, Summary, Worker, WorkerError};
pub use zenoh_link::{ConnectConfig, ConnectError, ZenohLink};
