//! Queue, leases, store and Zenoh service.
//!
//! Read in this order: [`coordinator`] is what all others talk to; `writer` is the one task that changes the
//! database, many questions to a transaction; `validate` looks at what came in before it gets there; [`store`]
//! holds the SQL, one file a concern, and the `migrations` folder beside the crates draws the job's state
//! machine; [`moments`] over [`exact_sum`] are the statistics kept per cell; [`wire`] turns bytes into
//! questions and [`zenoh_service`] brings them in from the network; on a local network [`gate`] lets workers in, with
//! what [`authority`] signs. [`view`] is what users get to see.
//!
//! A worker in the same process calls the coordinator's methods, one elsewhere sends the same questions as
//! JSON: there is no other difference. [`token`] says who may ask over HTTP, [`figures`] what the writer did.

pub mod authority;
mod batch;
pub mod config;
pub mod coordinator;
pub mod error;
pub mod exact_sum;
pub mod figures;
pub mod gate;
pub mod moments;
mod rate;
mod security;
pub mod store;
pub mod token;
mod validate;
pub mod view;
pub mod wire;
mod writer;
mod zenoh_config;
pub mod zenoh_service;

#[cfg(test)]
mod testing;

pub use authority::{Authority, AuthorityError};
pub use config::{Clock, ClockHand, Config, Verify};
pub use coordinator::Coordinator;
pub use error::StoreError;
pub use gate::Gate;
pub use store::admission::SecretTerms;
pub use store::rehearsal::Failure;
pub use store::{Backup, Store};
pub use view::{
    Attempt, AttemptEnd, Bar, CellSummary, CellValues, Census, Incident, JobCell, JobCursor, JobDetail, JobFilter,
    JobItem, JobPage, JobRef, JobResult, KeyPrefix, Opinion, RunValue, SweepChange, Verification, VerificationCounts,
    VerificationState, WorkerChange, WorkerInfo,
};
