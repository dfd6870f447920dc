//! Every decoder of what comes from elsewhere meets arbitrary and nearly right bytes: none panics, hangs or believes them.
//!
//! `mutation` spoils a valid message; `wire` is what workers and coordinators tell each other, `http` what users send.
//! `PROPTEST_CASES` sets how many cases each claim gets. The files of a worker's spool have such tests beside their code.
#![allow(clippy::unwrap_used, reason = "all of this is test code")]

mod http;
mod mutation;
mod wire;
