//! Finished runs on disk, until a coordinator has acknowledged them.
//!
//! A folder for one worker at a time, with its identity and one file of records (`frame`). Runs that end together
//! are appended and synced together; an acknowledgement is a record, too, which need not be synced, since a run that
//! is reported again is recorded once all the same. The file is emptied when everything in it is acknowledged, and
//! written anew when most of it is.
//!
//! A run belongs to the coordinator that handed it out and to the engine that computed it: jobs are numbered by each
//! coordinator for itself. Runs of another coordinator wait until that one is back; those of another engine are
//! dropped, since no coordinator takes them from this build.

mod folder;
mod frame;

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use furrow_schema::id::{EngineId, JobId};
use furrow_schema::protocol::RunReport;
use serde::{Deserialize, Serialize};

use folder::Folder;
pub use folder::{Identity, default_place};

use crate::lan::Enrolment;

/// The records.
const RUNS: &str = "runs";
/// What was found between records and is none, end to end.
const DAMAGED: &str = "damaged";
/// A file shorter than this is not worth writing anew \[bytes\].
const SMALL: u64 = 8 << 20;

/// Why the spool does not do what is asked of it.
#[derive(Debug, thiserror::Error)]
pub enum SpoolError {
    /// The folder cannot be made, opened or locked. The user names another.
    #[error("--spool: `{}` cannot be used: {reason}", place.display())]
    Folder {
        /// As it was given.
        place: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// No home directory is known. The user names a folder.
    #[error("--spool: no folder is given, and neither $XDG_STATE_HOME nor $HOME says where one could be")]
    NoPlace,
    /// There is no more room. The caller keeps the runs in memory, and takes on no more.
    #[error("the spool is full ({} MB)", limit_bytes >> 20)]
    Full {
        /// The file grows no longer than this \[bytes\].
        limit_bytes: u64,
    },
    /// The disk fails, or is full. The caller keeps the runs in memory, and takes on no more.
    #[error("the spool cannot be read or written: {0}")]
    Disk(#[from] io::Error),
}

/// One record.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[expect(clippy::large_enum_variant, reason = "there is one of them at a time")]
enum Entry<'a> {
    /// A run ended.
    Ended { coordinator: Cow<'a, str>, engine: EngineId, run: Cow<'a, RunReport> },
    /// Its coordinator acknowledged these.
    Acknowledged { coordinator: Cow<'a, str>, runs: Vec<(JobId, u32)> },
}

/// Which run: whose, which job, which attempt.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
struct Key {
    coordinator: String,
    job: JobId,
    attempt: u32,
}

impl Key {
    fn new(coordinator: &str, job: JobId, attempt: u32) -> Self {
        Self { coordinator: coordinator.to_owned(), job, attempt }
    }
}

/// Where a record lies in the file \[bytes\].
#[derive(Debug, Clone, Copy)]
struct Span {
    begin: u64,
    length: u64,
}

/// See the module.
#[derive(Debug)]
pub struct Spool {
    folder: Folder,
    identity: Identity,
    enrolment: Option<Enrolment>,
    engine: EngineId,
    limit_bytes: u64,
    file: File,
    /// The file's length up to the last whole record \[bytes\].
    length: u64,
    /// Runs without an acknowledgement.
    live: BTreeMap<Key, Span>,
    /// Length of their records together \[bytes\].
    live_bytes: u64,
}

impl Spool {
    /// The file grows no longer than this, unless told otherwise \[bytes\].
    pub const DEFAULT_LIMIT_BYTES: u64 = 256 << 20;

    /// Opens the first folder in `place` that no other worker uses (`1`, `2`, ..), for runs of `engine`.
    ///
    /// # Errors
    /// [`SpoolError::Folder`] and [`SpoolError::Disk`].
    pub fn open(place: &Path, engine: EngineId, limit_bytes: u64) -> Result<Self, SpoolError> {
        let folder = Folder::take(place)?;
        let (identity, enrolment) = (folder.identity()?, folder.enrolment()?);
        let mut file = folder.open(RUNS)?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes)?;
        let (live, live_bytes) = (BTreeMap::new(), 0);
        let mut spool = Self { folder, identity, enrolment, engine, limit_bytes, file, length: 0, live, live_bytes };
        spool.take_in(&bytes)?;
        if !spool.live.is_empty() {
            tracing::info!(runs = spool.live.len(), "the spool holds runs that were not acknowledged");
        }
        Ok(spool)
    }

    /// Who the worker of this folder is.
    #[must_use]
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// Who it is at `coordinator`: one that it enrolled at gave it another secret.
    #[must_use]
    pub fn identity_at(&self, coordinator: &str) -> Identity {
        let enrolled = self.enrolment.as_ref().filter(|enrolment| enrolment.coordinator == coordinator);
        let credential = enrolled.map_or(&self.identity.credential, |enrolment| &enrolment.credential);
        Identity { worker: self.identity.worker.clone(), credential: credential.clone() }
    }

    /// What it has from the coordinator that it enrolled at, if any.
    #[must_use]
    pub fn enrolment(&self) -> Option<&Enrolment> {
        self.enrolment.as_ref()
    }

    /// Keeps what it has from a coordinator, in place of what it had.
    ///
    /// # Errors
    /// [`SpoolError::Disk`]: it has what it had before.
    pub fn keep_enrolment(&mut self, enrolment: Enrolment) -> Result<(), SpoolError> {
        self.folder.keep_enrolment(&enrolment)?;
        self.enrolment = Some(enrolment);
        Ok(())
    }

    /// Its private key (PEM), drawn when it is first asked for. It is the same at all coordinators.
    ///
    /// # Errors
    /// [`SpoolError::Disk`].
    pub fn key_pem(&self) -> Result<String, SpoolError> {
        Ok(self.folder.key_pem()?)
    }

    /// Its own folder.
    #[must_use]
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// The runs that wait for an acknowledgement: of which coordinator, which job, which attempt.
    pub fn waiting(&self) -> impl ExactSizeIterator<Item = (&str, JobId, u32)> {
        self.live.keys().map(|key| (key.coordinator.as_str(), key.job, key.attempt))
    }

    /// Keeps runs that `coordinator` handed out: those that fit, from the first on. They are on disk when this
    /// returns. Says how many, and what is wrong if these are not all.
    pub fn keep(&mut self, coordinator: &str, runs: &[RunReport]) -> (usize, Result<(), SpoolError>) {
        let records: Vec<_> = runs.iter().map(|run| self.record_of(coordinator, run)).collect();
        let n = self.fit(&records);
        if let Err(error) = self.append_for_good(&records[..n].concat()) {
            return (0, Err(error.into()));
        }
        self.list(coordinator, &runs[..n], &records[..n]);
        let full = SpoolError::Full { limit_bytes: self.limit_bytes };
        (n, if n == runs.len() { Ok(()) } else { Err(full) })
    }

    /// How many of these records there is room for, from the first on.
    fn fit(&self, records: &[Vec<u8>]) -> usize {
        let mut left = self.limit_bytes.saturating_sub(self.length);
        let fits = |record: &&Vec<u8>| match left.checked_sub(record.len() as u64) {
            Some(less) => {
                left = less;
                true
            }
            None => false,
        };
        records.iter().take_while(fits).count()
    }

    /// `coordinator` has these runs on record, or wants to hear no more of them.
    ///
    /// # Errors
    /// [`SpoolError::Disk`]: they are forgotten all the same, but will be reported once more after a restart.
    pub fn acknowledge(&mut self, coordinator: &str, runs: &[(JobId, u32)]) -> Result<(), SpoolError> {
        let known: Vec<_> =
            runs.iter().copied().filter(|&(job, attempt)| self.forget(coordinator, job, attempt)).collect();
        if known.is_empty() {
            return Ok(());
        }
        let entry = Entry::Acknowledged { coordinator: coordinator.into(), runs: known };
        Ok(if self.is_worth_writing_anew() { self.write_anew() } else { self.append(&record(&entry)) }?)
    }

    /// Whether nothing in the file is needed, or little of a long one, or it is nearly full of what is not.
    fn is_worth_writing_anew(&self) -> bool {
        let mostly_dead = self.length > SMALL && self.live_bytes < self.length / 2;
        let dead = self.length - self.live_bytes;
        let full_of_dead = self.length > self.limit_bytes / 2 && dead > self.limit_bytes / 8;
        self.live.is_empty() || mostly_dead || full_of_dead
    }

    /// The first runs that wait for an acknowledgement of `coordinator`: at most `most`, of together `most_bytes`
    /// or one.
    ///
    /// # Errors
    /// [`SpoolError::Disk`].
    pub fn waiting_for(
        &mut self,
        coordinator: &str,
        most: usize,
        most_bytes: u64,
    ) -> Result<Vec<RunReport>, SpoolError> {
        let mut bytes = 0;
        let first = Key::new(coordinator, JobId(i64::MIN), 0);
        let of_it = self.live.range(first..).take_while(|(key, _)| key.coordinator == coordinator);
        let fit = of_it.take(most).take_while(|(_, span)| {
            bytes += span.length;
            bytes <= most_bytes || bytes == span.length
        });
        let found: Vec<(Key, Span)> = fit.map(|(key, span)| (key.clone(), *span)).collect();
        let mut runs = Vec::with_capacity(found.len());
        for (key, span) in found {
            match frame::content(&self.read(span)?).map(serde_json::from_slice) {
                Some(Ok(Entry::Ended { run, .. })) => runs.push(run.into_owned()),
                _ => {
                    tracing::warn!(job = %key.job, "a run in the spool can no longer be read: it is given up");
                    self.forget(&key.coordinator, key.job, key.attempt);
                }
            }
        }
        Ok(runs)
    }

    /// Reads a file that was found, and puts right what is wrong with it.
    fn take_in(&mut self, bytes: &[u8]) -> Result<(), SpoolError> {
        let mut scanned = frame::scan(bytes);
        self.length = scanned.end as u64;
        if scanned.end < bytes.len() {
            tracing::warn!(
                bytes = bytes.len() - scanned.end,
                "the last record in the spool is incomplete: it is cut off"
            );
            self.file.set_len(self.length)?;
        }
        let mut of_other_engines = BTreeSet::new();
        for record in scanned.records {
            match frame::content(&bytes[record.clone()]).map(serde_json::from_slice) {
                Some(Ok(entry)) => self.replay(entry, &record, &mut of_other_engines),
                _ => scanned.damaged.push(record),
            }
        }
        if !of_other_engines.is_empty() {
            tracing::warn!(runs = of_other_engines.len(), "the spool holds runs of another engine: they are dropped");
        }
        if !scanned.damaged.is_empty() {
            self.keep_aside(scanned.damaged.iter().map(|damaged| &bytes[damaged.clone()]))?;
        }
        if self.live_bytes < self.length {
            self.write_anew()?;
        }
        Ok(())
    }

    /// Notes what a record says.
    fn replay(&mut self, entry: Entry<'_>, at: &Range<usize>, of_other_engines: &mut BTreeSet<Key>) {
        match entry {
            Entry::Ended { coordinator, engine, run } => {
                let key = Key::new(&coordinator, run.job, run.attempt);
                if engine == self.engine {
                    self.insert(key, Span { begin: at.start as u64, length: at.len() as u64 });
                } else {
                    of_other_engines.insert(key);
                }
            }
            Entry::Acknowledged { coordinator, runs } => {
                for (job, attempt) in runs {
                    self.forget(&coordinator, job, attempt);
                    of_other_engines.remove(&Key::new(&coordinator, job, attempt));
                }
            }
        }
    }

    fn keep_aside<'a>(&self, damaged: impl Iterator<Item = &'a [u8]>) -> io::Result<()> {
        let mut aside = self.folder.open(DAMAGED)?;
        aside.seek(SeekFrom::End(0))?;
        let mut bytes = 0;
        for piece in damaged {
            aside.write_all(piece)?;
            bytes += piece.len();
        }
        let kept_in = self.folder.path().join(DAMAGED);
        tracing::warn!(bytes, kept_in = %kept_in.display(), "records in the spool are damaged: they are skipped");
        aside.sync_all()
    }

    fn record_of(&self, coordinator: &str, run: &RunReport) -> Vec<u8> {
        record(&Entry::Ended { coordinator: coordinator.into(), engine: self.engine, run: Cow::Borrowed(run) })
    }

    /// Lists runs whose records are the last in the file.
    fn list(&mut self, coordinator: &str, runs: &[RunReport], records: &[Vec<u8>]) {
        let mut end = self.length;
        for (run, record) in runs.iter().zip(records).rev() {
            let length = record.len() as u64;
            end -= length;
            self.insert(Key::new(coordinator, run.job, run.attempt), Span { begin: end, length });
        }
    }

    fn insert(&mut self, key: Key, span: Span) {
        let before = self.live.insert(key, span);
        self.live_bytes += span.length;
        self.live_bytes -= before.map_or(0, |span| span.length);
    }

    /// Whether it was there.
    fn forget(&mut self, coordinator: &str, job: JobId, attempt: u32) -> bool {
        let span = self.live.remove(&Key::new(coordinator, job, attempt));
        self.live_bytes -= span.map_or(0, |span| span.length);
        span.is_some()
    }

    /// Writes to the end, without syncing.
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        let written = self.file.write_all_at(bytes, self.length);
        self.lengthen(bytes, written)
    }

    /// Writes to the end, and does not return before it is on disk.
    fn append_for_good(&mut self, bytes: &[u8]) -> io::Result<()> {
        let written = self.file.write_all_at(bytes, self.length).and_then(|()| self.file.sync_data());
        self.lengthen(bytes, written)
    }

    /// After an error the file is as long as before.
    fn lengthen(&mut self, bytes: &[u8], written: io::Result<()>) -> io::Result<()> {
        if written.is_ok() {
            self.length += bytes.len() as u64;
        } else {
            // Should this fail, too, then what stays of it is written over by the next record.
            let _ = self.file.set_len(self.length);
        }
        written
    }

    fn read(&self, span: Span) -> io::Result<Vec<u8>> {
        let length = usize::try_from(span.length).map_err(io::Error::other)?;
        let mut bytes = vec![0; length];
        self.file.read_exact_at(&mut bytes, span.begin)?;
        Ok(bytes)
    }

    /// Leaves only runs without an acknowledgement in the file.
    fn write_anew(&mut self) -> io::Result<()> {
        if self.live.is_empty() {
            self.file.set_len(0)?;
            self.length = 0;
            return Ok(());
        }
        let mut length = 0;
        let mut moved = self.live.clone();
        let file = self.folder.replace(RUNS, |file| {
            for span in moved.values_mut() {
                file.write_all(&self.read(*span)?)?;
                span.begin = length;
                length += span.length;
            }
            Ok(())
        })?;
        (self.file, self.length, self.live) = (file, length, moved);
        Ok(())
    }
}

fn record(entry: &Entry<'_>) -> Vec<u8> {
    let content = serde_json::to_vec(entry).expect("entries are structures of numbers and texts");
    let mut record = Vec::new();
    frame::append(&mut record, &content);
    record
}

#[cfg(test)]
mod tests;
