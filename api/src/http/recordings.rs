//! A run again as an MCAP file, written while it is simulated and sent on the way.

use std::io::{self, BufWriter, Write};
use std::sync::Arc;

use axum::body::{Body, Bytes};
use furrow_coordinator::view::JobDetail;
use furrow_sim::Scenario;
use futures::stream;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};

use super::problem::Problem;
use super::replays::Replay;
use crate::recording::{RecordError, Run, record};

/// Recordings at a time: each takes a core for as long as its reader takes it.
const AT_ONCE: usize = 2;

/// Bytes that are sent at a time.
const PIECE: usize = 256 << 10;

/// Pieces that wait for a slow reader before the simulation does.
const WAITING: usize = 4;

/// The media type that is registered for MCAP.
pub(super) const MCAP: &str = "application/vnd.mcap";

type Piece = io::Result<Bytes>;

/// Whose turn it is.
pub(super) struct Recordings(Arc<Semaphore>);

impl Default for Recordings {
    fn default() -> Self {
        Self(Arc::new(Semaphore::new(AT_ONCE)))
    }
}

impl Recordings {
    /// The file of a finished `job`, whose `replay` has the digest on record.
    ///
    /// What goes wrong on the way breaks the body off: a file that ends is whole.
    ///
    /// # Errors
    /// The job's scenario cannot be read.
    pub(super) async fn stream(&self, job: JobDetail, replay: Arc<Replay>) -> Result<Body, Problem> {
        let scenario = super::trajectories::scenario(&job)?;
        let busy = |_| Problem::unavailable("too many runs are being recorded; ask again in a moment");
        let turn = Arc::clone(&self.0).acquire_owned().await.map_err(busy)?;
        let (pieces, sent) = mpsc::channel(WAITING);
        tokio::task::spawn_blocking(move || write(&job, &scenario, &replay, &pieces, turn));
        Ok(Body::from_stream(stream::unfold(sent, async |mut sent| Some((sent.recv().await?, sent)))))
    }
}

fn write(
    job: &JobDetail,
    scenario: &Scenario,
    replay: &Replay,
    pieces: &mpsc::Sender<Piece>,
    _turn: OwnedSemaphorePermit,
) {
    let run = Run {
        job: job.id,
        key: job.key,
        scenario_json: &job.scenario_json,
        scenario,
        seed: job.seed,
        result: &replay.result,
    };
    let Err(error) = record(&run, BufWriter::with_capacity(PIECE, Pipe(pieces))) else { return };
    if pieces.is_closed() {
        tracing::debug!(job = job.id.0, "nobody reads a recording any more");
    } else {
        tracing::error!(job = job.id.0, %error, "a recording broke off");
        broken_off(pieces, &error);
    }
}

fn broken_off(pieces: &mpsc::Sender<Piece>, error: &RecordError) {
    // Nobody is left to tell if this cannot be sent.
    let _ = pieces.blocking_send(Err(io::Error::other(error.to_string())));
}

/// Sends what is written.
struct Pipe<'a>(&'a mpsc::Sender<Piece>);

impl Write for Pipe<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let gone = |_| io::Error::from(io::ErrorKind::BrokenPipe);
        self.0.blocking_send(Ok(Bytes::copy_from_slice(bytes))).map_err(gone)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
