//! What a worker can ask of a coordinator.

use async_trait::async_trait;
use furrow_schema::protocol::{Call, Claim, Hello, Leases, Recorded, Renew, Renewed, Reply, Report, Welcome};
use tokio::sync::watch;

/// The way to one coordinator: over the network, or within the process. It never leads to another one, since jobs are
/// numbered by each coordinator for itself.
///
/// Every question may be asked again with the same request id and is then the same question. An implementation
/// asks once and answers within a bounded time; repeating is the worker's business.
#[async_trait]
pub trait Link: Send + Sync + 'static {
    /// Presents the worker.
    ///
    /// # Errors
    /// See [`LinkError`].
    async fn hello(&self, call: Call<Hello>) -> Result<Reply<Welcome>, LinkError>;

    /// Asks for jobs.
    ///
    /// # Errors
    /// See [`LinkError`].
    async fn claim(&self, call: Call<Claim>) -> Result<Reply<Leases>, LinkError>;

    /// Says what became of jobs.
    ///
    /// # Errors
    /// See [`LinkError`].
    async fn result(&self, call: Call<Report>) -> Result<Reply<Recorded>, LinkError>;

    /// Renews leases.
    ///
    /// # Errors
    /// See [`LinkError`].
    async fn renew(&self, call: Call<Renew>) -> Result<Reply<Renewed>, LinkError>;

    /// Changes whenever there may be new work, where the link can tell: an idle worker then asks at once. Elsewhere
    /// it asks again when the coordinator said.
    fn changes(&self) -> Option<watch::Receiver<u64>> {
        None
    }
}

/// Why a question has no answer.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LinkError {
    /// No answer came: whether the question was acted on is unknown.
    ///
    /// The coordinator is away, or the connection broke on the way there or back. The caller asks again with the
    /// same request id, after a pause.
    #[error("no answer from the coordinator: {0}")]
    NoAnswer(String),
    /// An answer came that cannot be read: the two sides are of different versions.
    ///
    /// The caller asks again with the same request id, after a pause, and says so in its log.
    #[error("the coordinator's answer cannot be read: {0}")]
    Unreadable(String),
    /// Another coordinator serves where this one did. The caller gives up; what it was handed by the old one is not
    /// for the new one, which a new link leads to.
    #[error("another coordinator, {0}, serves where the worker's own one did")]
    OtherCoordinator(String),
    /// The link is closed and stays closed. The caller gives up.
    #[error("the link to the coordinator is closed")]
    Closed,
}
