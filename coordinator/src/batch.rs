//! What waits for the writer, and what shares a transaction.

use furrow_schema::id::{SweepId, WorkerId};
use furrow_schema::protocol::{
    Call, Claim, Hello, Leases, Recorded, Refusal, Renew, Renewed, Reply, Report, RunEnd, RunReport, Welcome,
};
use furrow_schema::sweep::{NewSweep, Submitted};
use tokio::sync::oneshot;

use crate::error::StoreError;
use crate::store::admission::{self, Admitted};
use crate::store::control::Control;
use crate::store::tally::Tally;
use crate::store::worker::{Known, Newcomers};

/// Where an answer to a worker goes.
pub(crate) type Answer<T> = oneshot::Sender<Reply<T>>;

/// Where an answer to anybody else goes.
pub(crate) type Outcome<T> = oneshot::Sender<Result<T, StoreError>>;

/// What is asked about admission may be refused, as a worker's question.
pub(crate) type Admission = Result<Admitted, Refusal>;

/// A worker that presents itself, and what becomes of it if it is new.
pub(crate) type Greeting = (Call<Hello>, Newcomers);

/// Something that changes the database.
#[derive(Debug)]
pub(crate) enum Command {
    Admission(admission::Request, Outcome<Admission>),
    Hello(Greeting, Answer<Welcome>),
    Claim(Call<Claim>, Answer<Leases>),
    Result(Call<Report>, Answer<Recorded>),
    Renew(Call<Renew>, Answer<Renewed>),
    Submit(Box<NewSweep>, Outcome<Submitted>),
    KeepHouse(Outcome<()>),
    Absence(Absence, Outcome<Option<i64>>),
    /// Takes as many transactions as it needs, and shares none.
    Errand(Errand),
}

/// A worker is said to be away.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Absence {
    pub(crate) worker: WorkerId,
    /// It was not heard of since, as far as whoever says so knows [ms since 1970].
    pub(crate) since_ms: i64,
}

/// Something that is done in steps of its own, between the batches.
#[derive(Debug)]
pub(crate) enum Errand {
    Submit(Box<NewSweep>, Outcome<Submitted>),
    /// Answered with whether there is such a sweep.
    Control(SweepId, Control, Outcome<bool>),
    /// Lifts a worker's bar. Answered with whether there is such a worker.
    Allow(WorkerId, Outcome<bool>),
}

/// The commands that share a transaction, by kind.
#[derive(Debug, Default)]
pub(crate) struct Batch {
    pub(crate) admissions: Vec<(admission::Request, Outcome<Admission>)>,
    pub(crate) hellos: Vec<(Greeting, Answer<Welcome>)>,
    pub(crate) results: Vec<(Call<Report>, Answer<Recorded>)>,
    pub(crate) renewals: Vec<(Call<Renew>, Answer<Renewed>)>,
    pub(crate) housekeeping: Vec<Outcome<()>>,
    pub(crate) absences: Vec<(Absence, Outcome<Option<i64>>)>,
    pub(crate) submissions: Vec<(Box<NewSweep>, Outcome<Submitted>)>,
    pub(crate) claims: Vec<(Call<Claim>, Answer<Leases>)>,
    /// Not of this transaction.
    pub(crate) errands: Vec<Errand>,
}

/// What a batch's commands are answered, in its order, and what it changed.
#[derive(Debug, Default)]
pub(crate) struct Answers {
    pub(crate) admissions: Vec<Result<Admission, StoreError>>,
    pub(crate) hellos: Vec<Reply<Welcome>>,
    pub(crate) results: Vec<Reply<Recorded>>,
    pub(crate) renewals: Vec<Reply<Renewed>>,
    pub(crate) absences: Vec<Result<Option<i64>, StoreError>>,
    pub(crate) submissions: Vec<Result<Submitted, StoreError>>,
    pub(crate) claims: Vec<Reply<Leases>>,
    pub(crate) tally: Tally,
    /// Whether a user could see a difference.
    pub(crate) visible: bool,
    /// Whether there may be jobs for idle workers now.
    pub(crate) work: bool,
}

impl Batch {
    pub(crate) fn push(&mut self, command: Command) {
        match command {
            Command::Admission(request, outcome) => self.admissions.push((request, outcome)),
            Command::Hello(hello, answer) => self.hellos.push((hello, answer)),
            Command::Claim(call, answer) => self.claims.push((call, answer)),
            Command::Result(call, answer) => self.results.push((call, answer)),
            Command::Renew(call, answer) => self.renewals.push((call, answer)),
            Command::Submit(sweep, answer) => self.submissions.push((sweep, answer)),
            Command::KeepHouse(answer) => self.housekeeping.push(answer),
            Command::Absence(absence, answer) => self.absences.push((absence, answer)),
            Command::Errand(errand) => self.errands.push(errand),
        }
    }

    pub(crate) fn len(&self) -> usize {
        let of_workers = self.hellos.len() + self.results.len() + self.renewals.len() + self.claims.len();
        let of_time = self.housekeeping.len() + self.absences.len();
        of_workers + self.admissions.len() + of_time + self.submissions.len()
    }

    pub(crate) fn callers(&self) -> Vec<&str> {
        let results = self.results.iter().map(|(call, _)| call.worker.as_str());
        let renewals = self.renewals.iter().map(|(call, _)| call.worker.as_str());
        let claims = self.claims.iter().map(|(call, _)| call.worker.as_str());
        results.chain(renewals).chain(claims).collect()
    }

    /// Those who asked something but a hello, and are who they say, with their rows.
    pub(crate) fn seen(&self, known: &Known) -> Vec<(i64, &WorkerId)> {
        fn seen<'a, T>(call: &'a Call<T>, known: &Known) -> Option<(i64, &'a WorkerId)> {
            known.check(call).ok().map(|row| (row, &call.worker))
        }
        let results = self.results.iter().filter_map(|(call, _)| seen(call, known));
        let renewals = self.renewals.iter().filter_map(|(call, _)| seen(call, known));
        let claims = self.claims.iter().filter_map(|(call, _)| seen(call, known));
        results.chain(renewals).chain(claims).collect()
    }

    /// The results of each worker that `answers` call recorded.
    pub(crate) fn recorded<'a>(&'a self, answers: &'a Answers) -> impl Iterator<Item = (WorkerId, u64)> + 'a {
        let done = |report: &Report, recorded: &Recorded| {
            let is_done =
                |run: &&RunReport| matches!(run.ended, RunEnd::Done(_)) && !recorded.ignored.contains(&run.job);
            report.runs.iter().filter(is_done).count() as u64
        };
        self.results.iter().zip(&answers.results).filter_map(move |((call, _), reply)| match reply {
            Reply::Ok(recorded) => Some((call.worker.clone(), done(&call.body, recorded))),
            Reply::Refused(_) => None,
        })
    }

    fn commands(self) -> impl Iterator<Item = Command> {
        let admissions = self.admissions.into_iter().map(|(request, outcome)| Command::Admission(request, outcome));
        let hellos = self.hellos.into_iter().map(|(hello, answer)| Command::Hello(hello, answer));
        let results = self.results.into_iter().map(|(call, answer)| Command::Result(call, answer));
        let renewals = self.renewals.into_iter().map(|(call, answer)| Command::Renew(call, answer));
        let housekeeping = self.housekeeping.into_iter().map(Command::KeepHouse);
        let absences = self.absences.into_iter().map(|(absence, answer)| Command::Absence(absence, answer));
        let submissions = self.submissions.into_iter().map(|(sweep, answer)| Command::Submit(sweep, answer));
        let claims = self.claims.into_iter().map(|(call, answer)| Command::Claim(call, answer));
        let (admitted, of_time) = (admissions.chain(hellos), housekeeping.chain(absences));
        admitted.chain(results).chain(renewals).chain(of_time).chain(submissions).chain(claims)
    }

    pub(crate) fn split(self) -> impl Iterator<Item = Self> {
        self.commands().map(|command| {
            let mut single = Self::default();
            single.push(command);
            single
        })
    }

    /// Answers all; whoever no longer waits is passed over.
    pub(crate) fn answer(self, answers: Answers) {
        fn send<Q, A>(asked: Vec<(Q, oneshot::Sender<A>)>, answers: Vec<A>) {
            for ((_, to), answer) in asked.into_iter().zip(answers) {
                let _ = to.send(answer);
            }
        }
        send(self.admissions, answers.admissions);
        send(self.hellos, answers.hellos);
        send(self.results, answers.results);
        send(self.renewals, answers.renewals);
        send(self.absences, answers.absences);
        send(self.submissions, answers.submissions);
        send(self.claims, answers.claims);
        for to in self.housekeeping {
            let _ = to.send(Ok(()));
        }
    }

    pub(crate) fn refuse(self, error: &StoreError) {
        fn unavailable<T>(to: Answer<T>, detail: &str) {
            let _ = to.send(Reply::Refused(Refusal::Unavailable { detail: detail.to_owned() }));
        }
        let detail = error.to_string();
        let not_written = || match error {
            StoreError::Full => StoreError::Full,
            _ => StoreError::NotWritten(detail.clone()),
        };
        for command in self.commands() {
            match command {
                Command::Admission(_, to) => _ = to.send(Err(StoreError::NotWritten(detail.clone()))),
                Command::Hello(_, to) => unavailable(to, &detail),
                Command::Claim(_, to) => unavailable(to, &detail),
                Command::Result(_, to) => unavailable(to, &detail),
                Command::Renew(_, to) => unavailable(to, &detail),
                Command::Submit(_, to) => _ = to.send(Err(not_written())),
                Command::KeepHouse(to) => _ = to.send(Err(not_written())),
                Command::Absence(_, to) => _ = to.send(Err(not_written())),
                Command::Errand(_) => {}
            }
        }
    }
}

impl Answers {
    /// Notes what a batch came to; some leases may have ended in it.
    pub(crate) fn look_back(&mut self, leases_ended: bool, batch: &Batch) {
        self.visible = self.changed_something(leases_ended);
        let gave_back = |run: &RunReport| !matches!(run.ended, RunEnd::Done(_));
        let given_back = batch.results.iter().any(|(call, _)| call.body.runs.iter().any(gave_back));
        self.work = leases_ended || given_back || self.submissions.iter().any(Result::is_ok);
    }

    fn changed_something(&self, expired: bool) -> bool {
        let claimed = |reply: &Reply<Leases>| matches!(reply, Reply::Ok(leases) if !leases.jobs.is_empty());
        let submitted = self.submissions.iter().any(Result::is_ok);
        let admitted = !self.admissions.is_empty();
        expired || submitted || admitted || !self.results.is_empty() || self.claims.iter().any(claimed)
    }
}
