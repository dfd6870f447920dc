//! Asking until there is an answer.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use async_trait::async_trait;
use furrow_schema::id::RequestId;
use furrow_schema::protocol::{Call, Claim, Hello, Leases, Recorded, Refusal, Renew, Renewed, Reply, Report, Welcome};
use tokio::sync::{Notify, watch};
use tokio_util::sync::CancellationToken;

use crate::backoff::Backoff;
use crate::link::{Link, LinkError};
use crate::pace::Shares;
use crate::spool::Identity;

/// A question with the method of [`Link`] that carries it.
#[async_trait]
pub(crate) trait Question: Clone + Send + Sync + 'static {
    /// What a good answer holds.
    type Answer: Send;

    /// Asks once.
    async fn ask(link: &dyn Link, call: Call<Self>) -> Result<Reply<Self::Answer>, LinkError>;
}

macro_rules! question {
    ($question:ty, $method:ident, $answer:ty) => {
        #[async_trait]
        impl Question for $question {
            type Answer = $answer;

            async fn ask(link: &dyn Link, call: Call<Self>) -> Result<Reply<$answer>, LinkError> {
                link.$method(call).await
            }
        }
    };
}
question!(Hello, hello, Welcome);
question!(Claim, claim, Leases);
question!(Report, result, Recorded);
question!(Renew, renew, Renewed);

/// Why a question is not asked any more.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(crate) enum AskError {
    /// The coordinator refused for a reason that does not pass. The worker gives up, but see [`Refusal::Malformed`].
    #[error("{0}")]
    Refused(Refusal),
    /// The link is closed for good. The worker gives up.
    #[error("the link to the coordinator is closed")]
    Closed,
    /// Another coordinator is in its place. The worker gives up this life, and may begin one there.
    #[error("another coordinator, {0}, is in its place")]
    OtherCoordinator(String),
    /// The caller lost interest: the outcome of the question is unknown.
    #[error("no answer in time")]
    GivenUp,
}

/// One worker's side of all questions: who it is, and whom it asks.
pub(crate) struct Conversation {
    link: Arc<dyn Link>,
    identity: Identity,
    hello: Hello,
    shares: Shares,
    /// The last question had no answer.
    away: AtomicBool,
    /// Rings when there is an answer again.
    back: Notify,
}

impl Conversation {
    pub(crate) fn new(link: Arc<dyn Link>, identity: Identity, hello: Hello, shares: Shares) -> Self {
        Self { link, identity, hello, shares, away: AtomicBool::new(false), back: Notify::new() }
    }

    /// Waits for the first answer after a silence.
    pub(crate) async fn back(&self) {
        self.back.notified().await;
    }

    /// Presents the worker, until it is welcome.
    pub(crate) async fn say_hello(&self, give_up: &CancellationToken) -> Result<Welcome, AskError> {
        self.ask(self.hello.clone(), give_up).await
    }

    /// Changes whenever there may be new work, where the link can tell.
    pub(crate) fn changes(&self) -> Option<watch::Receiver<u64>> {
        self.link.changes()
    }

    /// Asks once; nothing if there was no answer that helps. A coordinator that does not know the worker (any more)
    /// hears its hello, for the next time.
    ///
    /// # Errors
    /// The refusal of a coordinator that turned the worker away.
    pub(crate) async fn ask_once<Q: Question>(&self, body: Q) -> Result<Option<Q::Answer>, Refusal> {
        match self.put(self.call(body)).await {
            Ok(Reply::Ok(answer)) => Ok(Some(answer)),
            Ok(Reply::Refused(Refusal::UnknownWorker)) => self.introduce().await.map(|_| None),
            Ok(Reply::Refused(refusal)) if refusal.turns_away() => Err(refusal),
            Ok(Reply::Refused(_)) | Err(_) => Ok(None),
        }
    }

    /// Asks, with pauses, until there is an answer or a reason to stop. A coordinator that does not know the
    /// worker (any more) hears its hello first.
    pub(crate) async fn ask<Q: Question>(&self, body: Q, give_up: &CancellationToken) -> Result<Q::Answer, AskError> {
        let call = self.call(body);
        let mut backoff = Backoff::new();
        let mut troubled = false;
        loop {
            let answer = tokio::select! {
                biased;
                answer = self.put(call.clone()) => answer,
                () = give_up.cancelled() => return Err(AskError::GivenUp),
            };
            let trouble = match answer {
                Ok(Reply::Ok(answer)) => {
                    log_end_of_trouble(troubled);
                    return Ok(answer);
                }
                Ok(Reply::Refused(Refusal::UnknownWorker)) => self.introduce().await.map_err(AskError::Refused)?,
                Ok(Reply::Refused(refusal @ Refusal::Unavailable { .. })) => refusal.to_string(),
                Ok(Reply::Refused(refusal)) => return Err(AskError::Refused(refusal)),
                Err(LinkError::Closed) => return Err(AskError::Closed),
                Err(LinkError::OtherCoordinator(other)) => return Err(AskError::OtherCoordinator(other)),
                Err(error) => error.to_string(),
            };
            log_trouble(troubled, &trouble);
            troubled = true;
            tokio::select! {
                biased;
                () = tokio::time::sleep(backoff.pause((self.shares)())) => {}
                () = self.back() => {}
                () = give_up.cancelled() => return Err(AskError::GivenUp),
            }
        }
    }

    /// Asks the link. The first answer after a silence wakes all that wait to ask again.
    async fn put<Q: Question>(&self, call: Call<Q>) -> Result<Reply<Q::Answer>, LinkError> {
        let answer = Q::ask(&*self.link, call).await;
        if self.away.swap(answer.is_err(), Ordering::Relaxed) && answer.is_ok() {
            self.back.notify_waiters();
        }
        answer
    }

    /// Says how it went. A failed introduction shows when the question is asked again, but one that turns the worker away
    /// is an error.
    async fn introduce(&self) -> Result<String, Refusal> {
        match self.put(self.call(self.hello.clone())).await {
            Ok(Reply::Refused(refusal)) if refusal.turns_away() => Err(refusal),
            hello => {
                let answered = if hello.is_ok() { "answered" } else { "no answer" };
                Ok(format!("the worker presented itself again: {answered}"))
            }
        }
    }

    fn call<Q>(&self, body: Q) -> Call<Q> {
        let Identity { worker, credential } = self.identity.clone();
        Call { request: RequestId::random(), worker, credential, body }
    }
}

/// Warns once for one question.
fn log_trouble(troubled: bool, trouble: &str) {
    if troubled {
        tracing::debug!(trouble, "asking the coordinator again");
    } else {
        tracing::warn!(trouble, "asking the coordinator again");
    }
}

fn log_end_of_trouble(troubled: bool) {
    if troubled {
        tracing::info!("the coordinator answers again");
    }
}
