//! A copy of a database in use.
//!
//! SQLite writes a compact copy of one moment into a temporary folder beside the target; it gets the target's name when
//! it is whole, checked and on disk. The folder that a killed backup leaves is named `.NAME.*.partial`, and may be removed.

use std::fs::File;
use std::path::{Path, PathBuf};

use sqlx::{ConnectOptions, Connection};
use tempfile::{NamedTempFile, TempDir, TempPath};

use super::open::{self, quick_check};
use super::unsigned;
use crate::error::StoreError;

/// A whole copy as of one moment.
const COPY: &str = "vacuum into ?1";
/// What users know of: sweeps, jobs and results.
const COUNT: &str = "select (select count(*) from sweep where id not in (select sweep_id from unlisted)),
    (select count(*) from job), (select count(*) from result)";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[COPY, COUNT];

/// A finished backup.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Backup {
    /// How large its file is \[bytes\].
    pub bytes: u64,
    /// The sweeps in it.
    pub sweeps: u64,
    /// The jobs in it, with a result or without.
    pub jobs: u64,
    /// The results in it.
    pub results: u64,
}

/// Copies the database in `from` to the new file `to`.
pub(super) async fn copy(from: &Path, to: &Path) -> Result<Backup, StoreError> {
    let target = Target::beside(to)?;
    let (_, mut source) = open::reader(from).await?;
    let text = target.partial.to_str().ok_or_else(|| refused(to, "its path is not UTF-8"))?;
    let copied = sqlx::query(COPY).bind(text).execute(&mut source).await;
    source.close().await?;
    copied?;
    let backup = look_through(&target.partial).await?;
    target.finish(from)?;
    Ok(backup)
}

/// Checks the copy and counts what is in it.
async fn look_through(copy: &Path) -> Result<Backup, StoreError> {
    let mut conn = open::options().filename(copy).read_only(true).connect().await?;
    quick_check(&mut conn, copy).await?;
    let (sweeps, jobs, results): (i64, i64, i64) = sqlx::query_as(COUNT).fetch_one(&mut conn).await?;
    conn.close().await?;
    Ok(Backup {
        bytes: std::fs::metadata(copy).map_err(|error| refused(copy, error))?.len(),
        sweeps: unsigned("the number of sweeps", sweeps)?,
        jobs: unsigned("the number of jobs", jobs)?,
        results: unsigned("the number of results", results)?,
    })
}

/// A file that gets its name in the end. Dropped before, it is removed.
struct Target {
    to: PathBuf,
    folder: PathBuf,
    partial: TempPath,
    /// Where SQLite works on it.
    _work: TempDir,
}

impl Target {
    fn beside(to: &Path) -> Result<Self, StoreError> {
        let to = std::path::absolute(to).map_err(|error| refused(to, error))?;
        if to.symlink_metadata().is_ok() {
            return Err(refused(&to, "it is there already, and is not overwritten"));
        }
        let (Some(folder), Some(name)) = (to.parent(), to.file_name()) else {
            return Err(refused(&to, "it is no name of a file"));
        };
        let prefix = format!(".{}.", name.to_string_lossy());
        let work = tempfile::Builder::new().prefix(&prefix).suffix(".partial").tempdir_in(folder);
        let work = work.map_err(|error| refused(&to, error))?;
        let partial = NamedTempFile::new_in(work.path()).map_err(|error| refused(&to, error))?.into_temp_path();
        Ok(Self { folder: folder.to_owned(), to, partial, _work: work })
    }

    /// Brings it to disk and gives it its name, with the permissions of what it is a copy of.
    fn finish(self, from: &Path) -> Result<(), StoreError> {
        let Self { to, folder, partial, _work } = self;
        let synced = std::fs::metadata(from)
            .and_then(|source| std::fs::set_permissions(&partial, source.permissions()))
            .and_then(|()| File::open(&partial)?.sync_all());
        synced.map_err(|error| refused(&to, error))?;
        partial.persist_noclobber(&to).map_err(|error| refused(&to, error.error))?;
        File::open(&folder).and_then(|folder| folder.sync_all()).map_err(|error| refused(&to, error))
    }
}

fn refused(to: &Path, reason: impl std::fmt::Display) -> StoreError {
    StoreError::Target { path: to.to_owned(), reason: reason.to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Store;
    use crate::testing::{Bench, done, sweep};

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> =
            folder.read_dir().unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[tokio::test]
    async fn a_backup_of_a_database_in_use_goes_on_where_it_was_made() {
        let folder = tempfile::tempdir().unwrap();
        let (from, copies) = (folder.path().join("furrow.db"), folder.path().join("copies"));
        std::fs::create_dir(&copies).unwrap();
        let to = copies.join("monday.db");
        let bench = Bench::over(Store::open(&from).await.unwrap());
        let id = bench.submit(sweep(&["rgop"], 3)).await.id;
        let worker = bench.worker().await;
        let jobs = worker.claim(2).await;
        worker.ended(&jobs[0], done(1.0)).await;
        let backup = Store::backup(&from, &to).await.unwrap();
        assert_eq!((backup.sweeps, backup.jobs, backup.results), (1, 3, 1));
        assert_eq!(backup.bytes, to.metadata().unwrap().len());
        assert_eq!(names(&copies), ["monday.db"], "nothing else is left");
        worker.ended(&jobs[1], done(2.0)).await;

        let restored = Bench::over(Store::open(&to).await.unwrap());
        assert_eq!(restored.coordinator.id(), bench.coordinator.id());
        assert_eq!(restored.sweep(id).await.done, 1);
        restored.assert_consistent().await;
        bench.coordinator.shutdown().await;
        restored.coordinator.shutdown().await;
    }

    #[tokio::test]
    async fn a_backup_overwrites_nothing_and_leaves_nothing_when_it_fails() {
        let folder = tempfile::tempdir().unwrap();
        let (from, to) = (folder.path().join("furrow.db"), folder.path().join("copy.db"));
        Store::open(&from).await.unwrap().close().await;
        std::fs::write(&to, "mine").unwrap();
        for (target, word) in
            [(&to, "there already"), (&from, "there already"), (&folder.path().join("no/x"), "No such")]
        {
            let refused = Store::backup(&from, target).await.unwrap_err();
            assert!(matches!(refused, StoreError::Target { .. }) && refused.to_string().contains(word), "{refused}");
        }
        assert_eq!(std::fs::read_to_string(&to).unwrap(), "mine");
        let before = names(folder.path());
        let refused = Store::backup(&to, &folder.path().join("other.db")).await.unwrap_err();
        assert!(matches!(refused, StoreError::NotOurs { .. }), "{refused}");
        assert_eq!(names(folder.path()), before);
    }
}
