//! The way in: plans become sweeps, results become tables, over HTTP and on the command line.
//!
//! Read in this order: [`plan`] expands and checks what a user asks for, [`table`] turns results into statistics and
//! prints them, [`paired`] compares two levels of a factor, [`sequential`] says when there are enough seeds, [`export`]
//! writes all runs (`columnar` knows Parquet), [`report`] one document and [`recording`] one run as MCAP, [`publication`]
//! puts tables beside published values, [`http`] serves all that, [`cli`] is the command `furrow`, and
//! [`in_process`] joins coordinator and worker without a network.

pub mod bench;
pub mod cli;
mod columnar;
pub mod export;
pub mod http;
pub mod in_process;
pub mod paired;
pub mod plan;
pub mod publication;
pub mod recording;
pub mod report;
pub mod sequential;
pub mod table;

use furrow_schema::id::EngineId;

/// The simulation code that is compiled in.
#[must_use]
pub fn engine() -> EngineId {
    EngineId(furrow_sim::engine::id())
}
