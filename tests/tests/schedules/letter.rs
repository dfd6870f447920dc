//! What goes to and fro between workers and the coordinator, and how it is written into the trace.

use furrow_coordinator::Coordinator;
use furrow_schema::protocol::{
    Call, Claim, Hello, Leases, Recorded, Refusal, Renew, Renewed, Reply, Report, RunEnd, Welcome,
};
use tokio::sync::oneshot;

/// One of the four questions.
#[derive(Debug, Clone)]
pub(super) enum Question {
    Hello(Call<Hello>),
    Claim(Call<Claim>),
    Result(Call<Report>),
    Renew(Call<Renew>),
}

/// Its answer.
#[derive(Debug)]
pub(super) enum Answer {
    Hello(Reply<Welcome>),
    Claim(Reply<Leases>),
    Result(Reply<Recorded>),
    Renew(Reply<Renewed>),
}

/// A question that arrived, and where its answer goes.
pub(super) struct Letter {
    pub(super) from: usize,
    pub(super) question: Question,
    pub(super) answer: oneshot::Sender<Answer>,
}

impl Question {
    pub(super) async fn put(self, life: &Coordinator) -> Answer {
        match self {
            Self::Hello(call) => Answer::Hello(life.hello(call).await),
            Self::Claim(call) => Answer::Claim(life.claim(call).await),
            Self::Result(call) => Answer::Result(life.result(call).await),
            Self::Renew(call) => Answer::Renew(life.renew(call).await),
        }
    }
}

impl Answer {
    pub(super) fn is_not_written(&self) -> bool {
        let refusal = match self {
            Self::Hello(Reply::Refused(refusal))
            | Self::Claim(Reply::Refused(refusal))
            | Self::Result(Reply::Refused(refusal))
            | Self::Renew(Reply::Refused(refusal)) => refusal,
            _ => return false,
        };
        matches!(refusal, Refusal::Unavailable { .. })
    }
}

/// Runs as a report tells them.
pub(super) fn runs(report: &Report) -> String {
    let how = |ended: &RunEnd| match ended {
        RunEnd::Done(_) => "done",
        RunEnd::Panicked { .. } => "panicked",
        RunEnd::HandedBack => "handed back",
    };
    let runs = report.runs.iter().map(|run| format!("{}.{} {}", run.job, run.attempt, how(&run.ended)));
    runs.collect::<Vec<_>>().join(", ")
}

/// What is renewed; `+` stands for what runs.
pub(super) fn held(renew: &Renew) -> String {
    let held =
        renew.held.iter().map(|held| format!("{}.{}{}", held.job, held.attempt, if held.running { "+" } else { "" }));
    held.collect::<Vec<_>>().join(", ")
}

/// What is handed out.
pub(super) fn jobs(leases: &Leases) -> String {
    let jobs = leases.jobs.iter().map(|job| format!("{}.{}", job.job, job.attempt));
    jobs.collect::<Vec<_>>().join(", ")
}
