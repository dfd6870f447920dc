//! What workers and the coordinator say to each other.
//!
//! Four questions, each with one answer that is sent after the commit: `hello`, `claim`, `result` and
//! `renew`; on a local network `enrol` comes before them, and `refresh` now and then. Every question carries its own id and the worker's credential and may be repeated: the same id
//! is the same question, and is answered alike. No answer at all means an unknown outcome: ask again.

use serde::{Deserialize, Serialize};

use crate::id::{Credential, EngineId, JobId, PublicKey, RequestId, ScenarioId, WorkerId};
use crate::job::RunRecord;

/// First words of every key, with the protocol's version.
pub const KEY_PREFIX: &str = "furrow/v1";

/// The namespace where none is chosen.
pub const DEFAULT_NAMESPACE: &str = "default";

/// A worker's lease on a job lasts this long without a renewal \[ms\].
pub const LEASE_MS: i64 = 30_000;

/// Workers renew this often \[ms\].
pub const RENEW_EVERY_MS: u64 = 1_000;

/// A claim asks for at most this many jobs.
pub const MAX_CLAIM: u32 = 256;

/// A worker holds at most this many scenarios, and names no more in a claim.
pub const MAX_KNOWN_SCENARIOS: usize = 1_024;

/// The key expression of `method` at `coordinator` in `namespace`.
#[must_use]
pub fn key(namespace: &str, coordinator: &str, method: Method) -> String {
    format!("{KEY_PREFIX}/{namespace}/{coordinator}/{}", method.as_str())
}

/// The key of the liveliness token that `coordinator` holds in `namespace` while it serves.
///
/// With `*` for the coordinator it is the key expression that finds all of them: the last word but one of
/// each answer's key is a coordinator's id.
#[must_use]
pub fn coordinator_key(namespace: &str, coordinator: &str) -> String {
    format!("{KEY_PREFIX}/{namespace}/{coordinator}/coordinator")
}

/// The key of the liveliness token that `worker` holds on its session with `coordinator`.
///
/// With `*` for the worker it is the key expression of all of them: the last word is a worker's id. It only tells a
/// coordinator sooner that a worker died; leases decide.
#[must_use]
pub fn worker_key(namespace: &str, coordinator: &str, worker: &str) -> String {
    format!("{KEY_PREFIX}/{namespace}/{coordinator}/worker/{worker}")
}

/// The key on which `coordinator` puts an empty hint when there may be jobs for idle workers. It may be lost.
#[must_use]
pub fn work_key(namespace: &str, coordinator: &str) -> String {
    format!("{KEY_PREFIX}/{namespace}/{coordinator}/hint/work")
}

/// The questions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Method {
    /// Who I am: [`Hello`], answered by [`Welcome`].
    Hello,
    /// Give me work: [`Claim`], answered by [`Leases`].
    Claim,
    /// What came out: [`Report`], answered by [`Recorded`].
    Result,
    /// I am still at it: [`Renew`], answered by [`Renewed`].
    Renew,
    /// Let me in: [`Enrol`], answered by [`Enrolled`]. On local networks only.
    Enrol,
    /// My certificate ends soon: [`Refresh`], answered by [`Certificate`]. On local networks only.
    Refresh,
}

impl Method {
    /// All of them.
    pub const ALL: [Self; 6] = [Self::Hello, Self::Claim, Self::Result, Self::Renew, Self::Enrol, Self::Refresh];
    /// The four that every coordinator answers.
    pub const OF_WORK: [Self; 4] = [Self::Hello, Self::Claim, Self::Result, Self::Renew];

    /// The last word of its key.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Hello => "hello",
            Self::Claim => "claim",
            Self::Result => "result",
            Self::Renew => "renew",
            Self::Enrol => "enrol",
            Self::Refresh => "refresh",
        }
    }
}

/// A question with who asks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Call<T> {
    /// This question; repeated, it is the same question.
    pub request: RequestId,
    /// Who asks.
    pub worker: WorkerId,
    /// The proof: chosen by the worker at its first hello, or given to it when it was enrolled.
    pub credential: Credential,
    /// What is asked.
    pub body: T,
}

/// An answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reply<T> {
    /// Done, and durable.
    Ok(T),
    /// Not done, and asking again will not help before the reason is gone.
    Refused(Refusal),
}

impl<T> Reply<T> {
    /// The answer as a result.
    ///
    /// # Errors
    /// The refusal, if it is one.
    pub fn into_result(self) -> Result<T, Refusal> {
        match self {
            Self::Ok(value) => Ok(value),
            Self::Refused(refusal) => Err(refusal),
        }
    }
}

/// Why a question was refused.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, thiserror::Error)]
#[serde(rename_all = "kebab-case", tag = "reason", deny_unknown_fields)]
pub enum Refusal {
    /// The worker said no hello to this coordinator. The worker says hello.
    #[error("the coordinator does not know this worker")]
    UnknownWorker,
    /// The credential is not this worker's. The worker gives up.
    #[error("the credential is not this worker's")]
    BadCredential,
    /// The coordinator's sweeps are for another engine. The worker idles or gives up.
    #[error("the coordinator runs engine {coordinator}, this worker {worker}")]
    OtherEngine {
        /// The engine of the coordinator.
        coordinator: EngineId,
        /// The engine of the worker.
        worker: EngineId,
    },
    /// Nobody is taken in by a hello here. The worker gives up; its user gives it a join secret.
    #[error("this worker is not enrolled here: start it with a join secret (--join)")]
    NotEnrolled,
    /// Its user was told no. The worker gives up.
    #[error("this worker was revoked; with another --spool and a join secret it may enrol as a new one")]
    Revoked,
    /// It was let in for a time that is over. The worker gives up.
    #[error(
        "this worker was let in for a time that is over; with another --spool and a join secret it may enrol as a new one"
    )]
    Expired,
    /// It cannot be enrolled. The worker gives up; its user gets another join secret, or none.
    #[error("not enrolled: {detail}")]
    Enrolment {
        /// Why not.
        detail: String,
    },
    /// Other machines had another result than this worker. The worker ends; a user finds out why.
    #[error("this worker is barred: {detail}")]
    Barred {
        /// What speaks against it.
        detail: String,
    },
    /// The question could not be read or breaks a limit. The worker reports it as a fault of its own.
    #[error("malformed request: {detail}")]
    Malformed {
        /// What is wrong with it.
        detail: String,
    },
    /// The coordinator cannot write at the moment. The worker backs off and asks again.
    #[error("the coordinator cannot serve this now: {detail}")]
    Unavailable {
        /// What is wrong with it.
        detail: String,
    },
}

impl Refusal {
    /// Whether the coordinator will not have this worker, whatever it asks.
    #[must_use]
    pub fn turns_away(&self) -> bool {
        matches!(self, Self::BadCredential | Self::NotEnrolled | Self::Revoked | Self::Expired | Self::Barred { .. })
    }
}

/// A worker presents itself. Repeated after every reconnection.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Hello {
    /// A name for people, such as the host's.
    pub name: String,
    /// The simulation code it runs.
    pub engine: EngineId,
    /// Runs at a time.
    pub threads: u32,
}

/// The answer to a hello.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Welcome {
    /// A lease lasts this long without a renewal \[ms\].
    pub lease_ms: i64,
    /// Renew this often \[ms\].
    pub renew_every_ms: u64,
}

/// A worker asks to be taken in, on the word of a join secret.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Enrol {
    /// How it presents itself.
    pub hello: Hello,
    /// Its own key; nobody else has the private half.
    pub public_key: PublicKey,
    /// The join secret's key.
    pub join: PublicKey,
    /// The join secret's signature under [`enrolment_statement`], as 128 hexadecimal digits.
    pub signature: String,
    /// The same with the worker's own key: that it has it.
    pub proof: String,
}

/// What both keys sign: that this worker may come in at this coordinator with this key. Whoever overhears
/// it can do nothing else with it.
#[must_use]
pub fn enrolment_statement(coordinator: &str, worker: &WorkerId, public_key: PublicKey) -> Vec<u8> {
    format!("furrow/v1 enrol {coordinator} {worker} {public_key}").into_bytes()
}

/// The answer to an enrolment; asked again with the same key it is the same.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Enrolled {
    /// What lets it connect.
    pub certificate: Certificate,
    /// What every further question must carry.
    pub credential: Credential,
}

/// A worker asks for a new certificate in place of one that ends soon.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Refresh {}

/// A worker's certificate, for the key it enrolled with.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Certificate {
    /// The certificate (PEM).
    pub pem: String,
    /// When it ends [ms since 1970].
    pub until_ms: i64,
}

/// A worker asks for jobs.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Claim {
    /// The simulation code it runs.
    pub engine: EngineId,
    /// At most this many, 1 to [`MAX_CLAIM`].
    pub want: u32,
    /// Scenarios the worker holds already; their texts are not sent again.
    pub known_scenarios: Vec<ScenarioId>,
    /// The worker's process has claimed nothing yet: it has none of the jobs that the coordinator believes it to hold.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub first: bool,
}

/// The jobs that are the worker's now.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Leases {
    /// The jobs; empty when nothing is queued.
    pub jobs: Vec<LeasedJob>,
    /// Texts of those jobs' scenarios that the worker did not name.
    pub scenarios: Vec<ScenarioText>,
    /// When there are no jobs: ask again after this long \[ms\].
    pub retry_after_ms: u64,
}

/// One job on lease.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LeasedJob {
    /// The job.
    pub job: JobId,
    /// Which handing out of this job this is, from 1: a fence against late messages.
    pub attempt: u32,
    /// What to run.
    pub scenario: ScenarioId,
    /// With which seed.
    pub seed: u64,
    /// Whether to send the trajectory.
    pub record: bool,
    /// Whether it must run alone on the worker.
    pub alone: bool,
}

/// A scenario's canonical JSON.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScenarioText {
    /// Its number.
    pub id: ScenarioId,
    /// Its canonical JSON.
    pub json: String,
}

/// A worker says what became of jobs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Report {
    /// The simulation code that ran them.
    pub engine: EngineId,
    /// At most [`MAX_CLAIM`] of them.
    pub runs: Vec<RunReport>,
}

/// What became of one job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RunReport {
    /// The job.
    pub job: JobId,
    /// The attempt it was leased under.
    pub attempt: u32,
    /// What became of it.
    pub ended: RunEnd,
}

/// How a run ended for the worker.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum RunEnd {
    /// It has a result.
    Done(RunRecord),
    /// The code panicked, or the scenario could not be read: charged to the job.
    Panicked {
        /// The panic's message.
        message: String,
    },
    /// Not begun or not finished: the job is queued again at once, uncharged.
    HandedBack,
}

/// The answer to a report, after the commit: the worker may forget every run in it.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recorded {
    /// Runs whose result is the one on record (this report's, or an equal earlier one).
    pub recorded: Vec<JobId>,
    /// Runs that came too late, or for a job that does not exist: nothing was changed.
    pub ignored: Vec<JobId>,
}

/// A worker renews its leases.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Renew {
    /// All jobs that it holds.
    pub held: Vec<HeldJob>,
}

/// One job that a worker holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HeldJob {
    /// The job.
    pub job: JobId,
    /// The attempt it was leased under.
    pub attempt: u32,
    /// Whether it runs (and is not merely prefetched).
    pub running: bool,
}

/// The answer to a renewal.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Renewed {
    /// Jobs that are no longer the worker's: stop them, their results may still be sent.
    pub lost: Vec<JobId>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn keys_hold_version_namespace_and_coordinator() {
        assert_eq!(key("default", "c0ffee", Method::Claim), "furrow/v1/default/c0ffee/claim");
        assert_eq!(coordinator_key("default", "c0ffee"), "furrow/v1/default/c0ffee/coordinator");
        assert_eq!(worker_key("default", "c0ffee", "*"), "furrow/v1/default/c0ffee/worker/*");
        assert_eq!(work_key("default", "c0ffee"), "furrow/v1/default/c0ffee/hint/work");
    }

    #[test]
    fn a_call_survives_json() {
        let call = Call {
            request: RequestId::random(),
            worker: WorkerId::random(),
            credential: Credential::random(),
            body: Claim { engine: EngineId([3; 32]), want: 8, known_scenarios: vec![ScenarioId(1)], first: false },
        };
        let json = serde_json::to_string(&call).unwrap();
        assert_eq!(serde_json::from_str::<Call<Claim>>(&json).unwrap(), call);
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_are_refused_without_a_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = serde_json::from_slice::<Call<Claim>>(&bytes);
            let _ = serde_json::from_slice::<Call<Report>>(&bytes);
            let _ = serde_json::from_slice::<Call<Renew>>(&bytes);
            let _ = serde_json::from_slice::<Call<Hello>>(&bytes);
            let _ = serde_json::from_slice::<Call<Enrol>>(&bytes);
        }
    }
}
