//! A coordinator's store on SQLite in memory, with a thread that waits for it while simulated time stands still.

use std::pin::Pin;
use std::sync::mpsc;

use furrow_coordinator::{Failure, Store};

type Work = Pin<Box<dyn Future<Output = ()> + Send>>;

/// See the module. One serves many schedules, one after the other.
pub(super) struct Database {
    work: mpsc::Sender<Work>,
    pub(super) store: Store,
}

impl Database {
    pub(super) fn new() -> Self {
        let (work, queue) = mpsc::channel::<Work>();
        std::thread::spawn(move || {
            let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
            for work in queue {
                runtime.block_on(work);
            }
        });
        let store = wait_for(&work, async { Store::in_memory().await.unwrap() });
        Self { work, store }
    }

    /// Does something with the store and waits for it.
    pub(super) fn wait<T: Send + 'static>(&self, work: impl Future<Output = T> + Send + 'static) -> T {
        wait_for(&self.work, work)
    }

    /// The same while the database fails.
    pub(super) fn wait_during<T: Send + 'static>(
        &self,
        failure: Failure,
        work: impl Future<Output = T> + Send + 'static,
    ) -> T {
        let store = self.store.clone();
        self.wait(async move {
            store.fail(Some(failure)).await.unwrap();
            let outcome = work.await;
            store.fail(None).await.unwrap();
            outcome
        })
    }
}

fn wait_for<T: Send + 'static>(to: &mpsc::Sender<Work>, work: impl Future<Output = T> + Send + 'static) -> T {
    let (answer, answered) = mpsc::channel();
    let work = async move { _ = answer.send(work.await) };
    to.send(Box::pin(work)).expect("the thread goes on as long as there is anyone to ask");
    answered.recv().expect("the database's thread panicked")
}
