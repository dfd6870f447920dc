//! What crosses a process boundary or is stored.
//!
//! Read in this order: [`id`] names things, [`job`] is the unit of work and its states, [`sweep`] is what a
//! user submits and asks about, [`protocol`] is what workers and the coordinator say to each other, [`table`]
//! is a cell of a result table, [`join`] is how a worker gets in on a local network. A scenario is opaque JSON here: this crate knows no simulator.

pub mod id;
pub mod job;
pub mod join;
pub mod protocol;
pub mod sweep;
pub mod table;
