//! The network between one worker and the coordinator: it loses, doubles, delays and so reorders, and is cut for a while.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

use async_trait::async_trait;
use furrow_schema::protocol::{Call, Claim, Hello, Leases, Recorded, Renew, Renewed, Reply, Report, Welcome};
use furrow_worker::{Link, LinkError};
use tokio::sync::oneshot;
use tokio::time::timeout;

use super::letter::{Answer, Letter, Question};
use super::server::Server;
use super::world::World;

/// How long it takes until a question counts as lost [ms].
const SILENCE_MS: Range<u64> = 100..10_000;
/// Nobody waits longer for an answer.
const PATIENCE: Duration = Duration::from_secs(10);
/// A message usually takes so long, or so long [ms].
const USUAL_MS: Range<u64> = 1..30;
const SLOW_MS: Range<u64> = 30..3_000;
/// Answers without news take longer [ms]: a schedule has fewer steps in which nothing happens.
const NO_NEWS_MS: Range<u64> = 1_000..5_000;
/// A question comes once more after so long [ms].
const ONCE_MORE_MS: Range<u64> = 1..45_000;

/// See the module.
#[derive(Clone)]
pub(super) struct Wire {
    pub(super) world: Arc<World>,
    pub(super) server: Arc<Server>,
    pub(super) worker: usize,
    /// Nothing goes through until then.
    pub(super) cut_until_ms: Arc<AtomicI64>,
}

impl Wire {
    async fn ask(&self, question: Question) -> Result<Answer, LinkError> {
        if self.world.fault(self.world.mood.twice) {
            tokio::spawn(self.clone().once_more(question.clone()));
        }
        self.travel().await?;
        let (answer, answered) = oneshot::channel();
        self.server.deliver(Letter { from: self.worker, question, answer });
        let answer = match timeout(PATIENCE, answered).await {
            Ok(Ok(answer)) => answer,
            _ => return Err(self.silence().await),
        };
        if is_no_news(&answer) {
            self.world.pause(NO_NEWS_MS).await;
        }
        self.travel().await?;
        Ok(answer)
    }

    /// The way there, or back.
    async fn travel(&self) -> Result<(), LinkError> {
        let slow = self.world.fault(self.world.mood.slow);
        self.world.pause(if slow { SLOW_MS } else { USUAL_MS }).await;
        let cut = self.world.now_ms() < self.cut_until_ms.load(Ordering::SeqCst);
        if cut || self.world.fault(self.world.mood.lost) { Err(self.silence().await) } else { Ok(()) }
    }

    async fn silence(&self) -> LinkError {
        self.world.pause(SILENCE_MS).await;
        LinkError::NoAnswer("lost".to_owned())
    }

    async fn once_more(self, question: Question) {
        self.world.pause(ONCE_MORE_MS).await;
        let (answer, _nobody) = oneshot::channel();
        self.server.deliver(Letter { from: self.worker, question, answer });
    }
}

fn is_no_news(answer: &Answer) -> bool {
    match answer {
        Answer::Claim(Reply::Ok(leases)) => leases.jobs.is_empty(),
        Answer::Renew(Reply::Ok(renewed)) => renewed.lost.is_empty(),
        _ => false,
    }
}

macro_rules! asked_as {
    ($self:ident, $kind:ident, $call:ident) => {
        match $self.ask(Question::$kind($call)).await? {
            Answer::$kind(reply) => Ok(reply),
            other => panic!("{other:?} answers another question"),
        }
    };
}

#[async_trait]
impl Link for Wire {
    async fn hello(&self, call: Call<Hello>) -> Result<Reply<Welcome>, LinkError> {
        asked_as!(self, Hello, call)
    }

    async fn claim(&self, call: Call<Claim>) -> Result<Reply<Leases>, LinkError> {
        asked_as!(self, Claim, call)
    }

    async fn result(&self, call: Call<Report>) -> Result<Reply<Recorded>, LinkError> {
        asked_as!(self, Result, call)
    }

    async fn renew(&self, call: Call<Renew>) -> Result<Reply<Renewed>, LinkError> {
        asked_as!(self, Renew, call)
    }
}
