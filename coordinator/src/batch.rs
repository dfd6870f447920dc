//! What waits for the writer, and what shares a transaction.

use furrow_schema::id::SweepId;
use furrow_schema::protocol::{Call, Claim, Hello, Leases, Recorded, Refusal, Renew, Renewed, Reply, Report, Welcome};
use furrow_schema::sweep::{NewSweep, Submitted};
use tokio::sync::oneshot;

use crate::error::StoreError;
use crate::store::control::Control;
use crate::store::tally::Tally;
use crate::store::worker::Known;

/// Where an answer to a worker goes.
pub(crate) type Answer<T> = oneshot::Sender<Reply<T>>;

/// Where an answer to anybody else goes.
pub(crate) type Outcome<T> = oneshot::Sender<Result<T, StoreError>>;

/// Something that changes the database.
#[derive(Debug)]
pub(crate) enum Command {
    Hello(Call<Hello>, Answer<Welcome>),
    Claim(Call<Claim>, Answer<Leases>),
    Result(Call<Report>, Answer<Recorded>),
    Renew(Call<Renew>, Answer<Renewed>),
    Submit(Box<NewSweep>, Outcome<Submitted>),
    KeepHouse(Outcome<()>),
    /// Changes nothing but the mark that something can be changed.
    Beat(Outcome<()>),
    /// Takes as many transactions as it needs, and shares none.
    Errand(Errand),
}

/// Something that changes many jobs: it is done in steps, between the batches.
#[derive(Debug)]
pub(crate) enum Errand {
    Submit(Box<NewSweep>, Outcome<Submitted>),
    /// Answered with whether there is such a sweep.
    Control(SweepId, Control, Outcome<bool>),
}

/// The commands that share a transaction, by kind.
#[derive(Debug, Default)]
pub(crate) struct Batch {
    pub(crate) hellos: Vec<(Call<Hello>, Answer<Welcome>)>,
    pub(crate) results: Vec<(Call<Report>, Answer<Recorded>)>,
    pub(crate) renewals: Vec<(Call<Renew>, Answer<Renewed>)>,
    pub(crate) housekeeping: Vec<Outcome<()>>,
    pub(crate) beats: Vec<Outcome<()>>,
    pub(crate) submissions: Vec<(Box<NewSweep>, Outcome<Submitted>)>,
    pub(crate) claims: Vec<(Call<Claim>, Answer<Leases>)>,
    /// Not of this transaction.
    pub(crate) errands: Vec<Errand>,
}

/// What a batch's commands are answered, in its order, and what it changed.
#[derive(Debug, Default)]
pub(crate) struct Answers {
    pub(crate) hellos: Vec<Reply<Welcome>>,
    pub(crate) results: Vec<Reply<Recorded>>,
    pub(crate) renewals: Vec<Reply<Renewed>>,
    pub(crate) submissions: Vec<Result<Submitted, StoreError>>,
    pub(crate) claims: Vec<Reply<Leases>>,
    pub(crate) tally: Tally,
    /// Whether a user could see a difference.
    pub(crate) visible: bool,
}

impl Batch {
    pub(crate) fn push(&mut self, command: Command) {
        match command {
            Command::Hello(call, answer) => self.hellos.push((call, answer)),
            Command::Claim(call, answer) => self.claims.push((call, answer)),
            Command::Result(call, answer) => self.results.push((call, answer)),
            Command::Renew(call, answer) => self.renewals.push((call, answer)),
            Command::Submit(sweep, answer) => self.submissions.push((sweep, answer)),
            Command::KeepHouse(answer) => self.housekeeping.push(answer),
            Command::Beat(answer) => self.beats.push(answer),
            Command::Errand(errand) => self.errands.push(errand),
        }
    }

    pub(crate) fn len(&self) -> usize {
        let of_workers = self.hellos.len() + self.results.len() + self.renewals.len() + self.claims.len();
        of_workers + self.housekeeping.len() + self.beats.len() + self.submissions.len()
    }

    pub(crate) fn callers(&self) -> Vec<&str> {
        let results = self.results.iter().map(|(call, _)| call.worker.as_str());
        let renewals = self.renewals.iter().map(|(call, _)| call.worker.as_str());
        let claims = self.claims.iter().map(|(call, _)| call.worker.as_str());
        results.chain(renewals).chain(claims).collect()
    }

    pub(crate) fn seen(&self, known: &Known) -> Vec<i64> {
        let results = self.results.iter().filter_map(|(call, _)| known.check(call).ok());
        let renewals = self.renewals.iter().filter_map(|(call, _)| known.check(call).ok());
        let claims = self.claims.iter().filter_map(|(call, _)| known.check(call).ok());
        results.chain(renewals).chain(claims).collect()
    }

    fn commands(self) -> impl Iterator<Item = Command> {
        let hellos = self.hellos.into_iter().map(|(call, answer)| Command::Hello(call, answer));
        let results = self.results.into_iter().map(|(call, answer)| Command::Result(call, answer));
        let renewals = self.renewals.into_iter().map(|(call, answer)| Command::Renew(call, answer));
        let housekeeping = self.housekeeping.into_iter().map(Command::KeepHouse);
        let beats = self.beats.into_iter().map(Command::Beat);
        let submissions = self.submissions.into_iter().map(|(sweep, answer)| Command::Submit(sweep, answer));
        let claims = self.claims.into_iter().map(|(call, answer)| Command::Claim(call, answer));
        hellos.chain(results).chain(renewals).chain(housekeeping).chain(beats).chain(submissions).chain(claims)
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
        send(self.hellos, answers.hellos);
        send(self.results, answers.results);
        send(self.renewals, answers.renewals);
        send(self.submissions, answers.submissions);
        send(self.claims, answers.claims);
        for to in self.housekeeping.into_iter().chain(self.beats) {
            let _ = to.send(Ok(()));
        }
    }

    pub(crate) fn refuse(self, error: &StoreError) {
        fn unavailable<T>(to: Answer<T>, detail: &str) {
            let _ = to.send(Reply::Refused(Refusal::Unavailable { detail: detail.to_owned() }));
        }
        let detail = error.to_string();
        for command in self.commands() {
            match command {
                Command::Hello(_, to) => unavailable(to, &detail),
                Command::Claim(_, to) => unavailable(to, &detail),
                Command::Result(_, to) => unavailable(to, &detail),
                Command::Renew(_, to) => unavailable(to, &detail),
                Command::Submit(_, to) => _ = to.send(Err(StoreError::NotWritten(detail.clone()))),
                Command::KeepHouse(to) | Command::Beat(to) => _ = to.send(Err(StoreError::NotWritten(detail.clone()))),
                Command::Errand(_) => {}
            }
        }
    }
}

impl Answers {
    pub(crate) fn changed_something(&self, expired: bool) -> bool {
        let claimed = |reply: &Reply<Leases>| matches!(reply, Reply::Ok(leases) if !leases.jobs.is_empty());
        let submitted = self.submissions.iter().any(Result::is_ok);
        expired || submitted || !self.results.is_empty() || self.claims.iter().any(claimed)
    }
}
