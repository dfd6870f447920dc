//! The folder of one worker: found, locked, and with its identity in it.

use std::ffi::OsString;
use std::fs::{DirBuilder, File, OpenOptions, TryLockError};
use std::io::{self, Write};
use std::os::unix::fs::{DirBuilderExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use furrow_schema::id::{Credential, WorkerId};
use rcgen::{KeyPair, PKCS_ED25519};
use serde::{Deserialize, Serialize};

use super::SpoolError;
use crate::lan::Enrolment;

/// So many workers may share a place.
const MOST_WORKERS: u32 = 1_024;
/// Only its owner looks into the folder, and reads what is in it.
const FOLDER_MODE: u32 = 0o700;
const FILE_MODE: u32 = 0o600;
/// Held locked by the worker that uses the folder.
const LOCK: &str = "lock";
/// Who the worker is.
const IDENTITY: &str = "identity.json";
/// What it has from the coordinator of a local network.
const ENROLMENT: &str = "enrolment.json";
/// The private key for it.
const KEY: &str = "key.pem";

/// Who a worker is, and what it proves that with.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Identity {
    /// Its name at coordinators.
    pub worker: WorkerId,
    /// Its secret.
    pub credential: Credential,
}

impl Identity {
    /// A worker that nobody knows yet.
    #[must_use]
    pub fn random() -> Self {
        Self { worker: WorkerId::random(), credential: Credential::random() }
    }
}

/// Where workers of this user keep their spools unless told otherwise: `furrow/spool` in `$XDG_STATE_HOME`, or in
/// `~/.local/state` without it.
///
/// # Errors
/// [`SpoolError::NoPlace`] if neither is known.
pub fn default_place() -> Result<PathBuf, SpoolError> {
    place_in(std::env::var_os("XDG_STATE_HOME"), std::env::var_os("HOME")).ok_or(SpoolError::NoPlace)
}

fn place_in(state_home: Option<OsString>, home: Option<OsString>) -> Option<PathBuf> {
    let absolute = |path: OsString| Some(PathBuf::from(path)).filter(|path| path.is_absolute());
    let state = state_home.and_then(absolute).or_else(|| Some(home.and_then(absolute)?.join(".local/state")))?;
    Some(state.join("furrow").join("spool"))
}

/// A folder that is this process's until dropped, or until the process dies.
#[derive(Debug)]
pub(super) struct Folder {
    path: PathBuf,
    _lock: File,
}

impl Folder {
    /// Takes the first folder in `place` that no worker uses: `1`, `2`, ..
    pub(super) fn take(place: &Path) -> Result<Self, SpoolError> {
        let refused = |error: io::Error| SpoolError::Folder { place: place.to_owned(), reason: error.to_string() };
        for number in 1..=MOST_WORKERS {
            let path = place.join(number.to_string());
            DirBuilder::new().recursive(true).mode(FOLDER_MODE).create(&path).map_err(refused)?;
            let lock = open(&path.join(LOCK)).map_err(refused)?;
            match lock.try_lock() {
                Ok(()) => return Ok(Self { path, _lock: lock }),
                Err(TryLockError::WouldBlock) => {}
                Err(TryLockError::Error(error)) => return Err(refused(error)),
            }
        }
        Err(refused(io::Error::other(format!("{MOST_WORKERS} workers use it"))))
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Opens a file in it, making it if it is not there.
    pub(super) fn open(&self, name: &str) -> io::Result<File> {
        open(&self.path.join(name))
    }

    /// Puts a file in place of another, for good: after a loss of power there is the one or the other.
    pub(super) fn replace(&self, name: &str, write: impl FnOnce(&mut File) -> io::Result<()>) -> io::Result<File> {
        let new = format!("{name}.new");
        let mut file = self.open(&new)?;
        file.set_len(0)?;
        write(&mut file)?;
        file.sync_all()?;
        std::fs::rename(self.path.join(new), self.path.join(name))?;
        if let Err(error) = File::open(&self.path).and_then(|folder| folder.sync_all()) {
            tracing::warn!(%error, folder = %self.path.display(), "a loss of power may undo the last change");
        }
        Ok(file)
    }

    /// The identity in it; a new one in a new folder. What cannot be read is kept aside.
    pub(super) fn identity(&self) -> io::Result<Identity> {
        let path = self.path.join(IDENTITY);
        let Some(text) = found(std::fs::read(&path))? else { return self.draw_identity() };
        match serde_json::from_slice(&text) {
            Ok(identity) => Ok(identity),
            Err(_) => {
                let aside = path.with_extension("damaged");
                tracing::warn!(
                    kept_as = %aside.display(),
                    "the worker's identity cannot be read: it gets a new one, and what it was handed before is lost to it"
                );
                std::fs::rename(&path, aside)?;
                self.draw_identity()
            }
        }
    }

    /// What the worker has from a coordinator. One that cannot be read is none: the worker has to join again.
    pub(super) fn enrolment(&self) -> io::Result<Option<Enrolment>> {
        let Some(text) = found(std::fs::read(self.path.join(ENROLMENT)))? else { return Ok(None) };
        let enrolment = serde_json::from_slice(&text);
        Ok(enrolment
            .inspect_err(|_| tracing::warn!("the worker's enrolment cannot be read: it has to join again"))
            .ok())
    }

    pub(super) fn keep_enrolment(&self, enrolment: &Enrolment) -> io::Result<()> {
        let text = serde_json::to_vec(enrolment)?;
        self.replace(ENROLMENT, |file| file.write_all(&text)).map(drop)
    }

    /// The key in it; a new one if there is none.
    pub(super) fn key_pem(&self) -> io::Result<String> {
        if let Some(pem) = found(std::fs::read_to_string(self.path.join(KEY)))? {
            return Ok(pem);
        }
        let pem = KeyPair::generate_for(&PKCS_ED25519).map_err(io::Error::other)?.serialize_pem();
        self.replace(KEY, |file| file.write_all(pem.as_bytes()))?;
        Ok(pem)
    }

    fn draw_identity(&self) -> io::Result<Identity> {
        let identity = Identity::random();
        let text = serde_json::to_vec(&identity)?;
        self.replace(IDENTITY, |file| file.write_all(&text))?;
        Ok(identity)
    }
}

/// Nothing if there is no such file.
fn found<T>(read: io::Result<T>) -> io::Result<Option<T>> {
    match read {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        read => read.map(Some),
    }
}

fn open(path: &Path) -> io::Result<File> {
    OpenOptions::new().read(true).write(true).create(true).truncate(false).mode(FILE_MODE).open(path)
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    fn mode(path: &Path) -> u32 {
        path.metadata().unwrap().permissions().mode() & 0o777
    }

    #[test]
    fn a_worker_that_starts_again_is_the_same_and_a_second_one_is_another() {
        let place = tempfile::tempdir().unwrap();
        let first = Folder::take(place.path()).unwrap();
        let second = Folder::take(place.path()).unwrap();
        let identity = first.identity().unwrap();
        assert_ne!(identity, second.identity().unwrap());
        drop(first);
        let again = Folder::take(place.path()).unwrap();
        assert_eq!((again.identity().unwrap(), again.path().file_name().unwrap()), (identity, "1".as_ref()));
    }

    #[test]
    fn only_its_owner_reads_what_is_in_a_folder() {
        let place = tempfile::tempdir().unwrap();
        let folder = Folder::take(&place.path().join("a/b")).unwrap();
        folder.identity().unwrap();
        assert_eq!(mode(folder.path()), FOLDER_MODE);
        assert_eq!(mode(&place.path().join("a/b")), FOLDER_MODE);
        assert_eq!(mode(&folder.path().join(IDENTITY)), FILE_MODE);
    }

    #[test]
    fn a_key_and_an_enrolment_stay_and_are_read_by_their_owner_alone() {
        let place = tempfile::tempdir().unwrap();
        let folder = Folder::take(place.path()).unwrap();
        assert_eq!(folder.enrolment().unwrap(), None);
        let enrolment = Enrolment {
            coordinator: "c0ffee".to_owned(),
            namespace: "default".to_owned(),
            endpoints: vec!["quic/192.0.2.2:7447".to_owned()],
            authority_pem: String::new(),
            certificate_pem: String::new(),
            certificate_ms: [1, 2],
            credential: Credential::random(),
        };
        folder.keep_enrolment(&enrolment).unwrap();
        assert_eq!(folder.enrolment().unwrap().as_ref(), Some(&enrolment));
        assert!(!format!("{enrolment:?}").contains(enrolment.credential.as_str()));
        let key = folder.key_pem().unwrap();
        assert_eq!(folder.key_pem().unwrap(), key);
        for name in [ENROLMENT, KEY] {
            assert_eq!(mode(&folder.path().join(name)), FILE_MODE, "{name}");
        }
        std::fs::write(folder.path().join(ENROLMENT), "{").unwrap();
        assert_eq!(folder.enrolment().unwrap(), None);
    }

    #[test]
    fn an_identity_that_cannot_be_read_is_kept_aside() {
        let place = tempfile::tempdir().unwrap();
        let folder = Folder::take(place.path()).unwrap();
        let before = folder.identity().unwrap();
        std::fs::write(folder.path().join(IDENTITY), "{").unwrap();
        let after = folder.identity().unwrap();
        assert_ne!(before, after);
        assert_eq!(folder.identity().unwrap(), after);
        assert_eq!(std::fs::read(folder.path().join("identity.damaged")).unwrap(), b"{");
    }

    #[test]
    fn a_place_that_cannot_be_used_is_named() {
        let place = tempfile::NamedTempFile::new().unwrap();
        let error = Folder::take(place.path()).unwrap_err().to_string();
        assert!(error.contains(&place.path().display().to_string()), "{error}");
    }

    #[test]
    fn the_default_place_is_in_the_users_state() {
        let some = |text: &str| Some(OsString::from(text));
        assert_eq!(place_in(some("/s"), some("/h")), Some("/s/furrow/spool".into()));
        assert_eq!(place_in(some("relative"), some("/h")), Some("/h/.local/state/furrow/spool".into()));
        assert_eq!(place_in(None, some("/h")), Some("/h/.local/state/furrow/spool".into()));
        assert_eq!(place_in(None, some("")), None);
    }
}
