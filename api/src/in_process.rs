//! Coordinator and worker in one process: the same questions and answers, without a network.

use std::sync::Arc;

use async_trait::async_trait;
use furrow_coordinator::{Coordinator, Store};
use furrow_schema::protocol::{Call, Claim, Hello, Leases, Recorded, Renew, Renewed, Reply, Report, Welcome};
use furrow_worker::{Config, Link, LinkError, Summary, Worker, WorkerError};
use tokio::sync::watch;
use tokio::task::{JoinError, JoinHandle};
use tokio_util::sync::CancellationToken;

/// A worker's link to a coordinator in the same process.
#[derive(Debug, Clone)]
pub struct InProcess(pub Coordinator);

#[async_trait]
impl Link for InProcess {
    async fn hello(&self, call: Call<Hello>) -> Result<Reply<Welcome>, LinkError> {
        Ok(self.0.hello(call).await)
    }

    async fn claim(&self, call: Call<Claim>) -> Result<Reply<Leases>, LinkError> {
        Ok(self.0.claim(call).await)
    }

    async fn result(&self, call: Call<Report>) -> Result<Reply<Recorded>, LinkError> {
        Ok(self.0.result(call).await)
    }

    async fn renew(&self, call: Call<Renew>) -> Result<Reply<Renewed>, LinkError> {
        Ok(self.0.renew(call).await)
    }

    fn changes(&self) -> Option<watch::Receiver<u64>> {
        Some(self.0.changed())
    }
}

/// A coordinator with its own worker.
pub struct Farm {
    coordinator: Coordinator,
    stop: CancellationToken,
    worker: Option<Running>,
}

impl Farm {
    /// Starts a coordinator on `store`, and beside it a worker with `threads` threads, or none for 0.
    ///
    /// # Panics
    /// Outside a tokio runtime.
    #[must_use]
    pub fn start(store: Store, config: furrow_coordinator::Config, threads: usize) -> Self {
        let engine = config.engine;
        let coordinator = Coordinator::start(store, config);
        let stop = CancellationToken::new();
        let worker = (threads > 0).then(|| {
            let config = Config { threads, engine, ..Config::of_this_host() };
            let worker = Worker::new(Arc::new(InProcess(coordinator.clone())), config);
            tokio::spawn(worker.run(stop.clone()))
        });
        Self { coordinator, stop, worker }
    }

    /// The coordinator.
    #[must_use]
    pub fn coordinator(&self) -> &Coordinator {
        &self.coordinator
    }

    /// Waits until the coordinator or the worker ends by itself: for ever if all is well.
    pub async fn ended(&mut self) -> FarmEnd {
        let ended = tokio::select! {
            () = self.coordinator.ended() => return FarmEnd::Coordinator,
            ended = end_of(&mut self.worker) => ended,
        };
        self.worker = None;
        let reason = match ended {
            Ok(Ok(_)) => "it was told to".to_owned(),
            Ok(Err(error)) => error.to_string(),
            Err(error) => error.to_string(),
        };
        FarmEnd::Worker(reason)
    }

    /// Stops the worker, which hands back what it has not finished, then the coordinator.
    pub async fn stop(self) {
        self.stop.cancel();
        if let Some(worker) = self.worker {
            match worker.await {
                Ok(Ok(_)) => {}
                Ok(Err(error)) => tracing::warn!(%error, "the worker ended badly"),
                Err(error) => tracing::error!(%error, "the worker ended badly"),
            }
        }
        self.coordinator.shutdown().await;
    }
}

type Running = JoinHandle<Result<Summary, WorkerError>>;

/// Waits until the worker ends: for ever if there is none.
async fn end_of(worker: &mut Option<Running>) -> Result<Result<Summary, WorkerError>, JoinError> {
    match worker {
        Some(worker) => worker.await,
        None => std::future::pending().await,
    }
}

/// A part of the process that ended by itself.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum FarmEnd {
    /// The coordinator, as its log says. The caller gives up.
    #[error("the coordinator of this process ended: its log says why")]
    Coordinator,
    /// The worker, for this reason, as when it was revoked. Whoever has others may go on.
    #[error("the worker of this process ended: {0}")]
    Worker(String),
}
