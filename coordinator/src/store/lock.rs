//! One process at a time changes a database: a lock of the operating system on `FILE.lock`, which goes with the
//! process, however it ends. The file itself stays; it holds the number of the process that locked it last.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use crate::error::StoreError;

/// A database that is this process's to change until it is released or dropped.
#[derive(Debug)]
pub(super) struct Lock(File);

impl Lock {
    /// Takes the database in `path`, which has no links in it: whoever names the file otherwise meets the same lock.
    pub(super) fn take(path: &Path) -> Result<Self, StoreError> {
        let lock = beside(path);
        let refused = |error: std::io::Error| StoreError::Open {
            path: path.to_owned(),
            reason: format!("`{}` cannot be locked: {error}; this user must be able to write there", lock.display()),
        };
        let options = OpenOptions::new().read(true).write(true).create(true).truncate(false).clone();
        let mut file = options.open(&lock).map_err(refused)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                return Err(StoreError::InUse { path: path.to_owned(), pid: pid(&mut file) });
            }
            Err(TryLockError::Error(error)) => return Err(refused(error)),
        }
        // Only for the message that others get: a full disk has no room for it, and that is no harm.
        let _ = file.set_len(0).and_then(|()| writeln!(file, "{}", std::process::id()));
        Ok(Self(file))
    }

    /// Lets others have the database.
    pub(super) fn release(&self) {
        // The end of the process does it otherwise.
        let _ = self.0.unlock();
    }
}

/// The path of a file that belongs to the database in `path`.
fn beside(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".lock");
    name.into()
}

fn pid(file: &mut File) -> Option<u32> {
    let mut text = String::new();
    file.read_to_string(&mut text).ok()?;
    text.trim().parse().ok()
}
