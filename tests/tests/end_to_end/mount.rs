//! File systems of their own: small ones that fill up, and read-only ones. `./test` gives the tests a place to mount them.

use std::fs::{self, File};
use std::io::{ErrorKind, Write};
use std::path::PathBuf;
use std::process::Command;

use tempfile::TempDir;

/// Must be 1 to pass over the tests that mount.
const SKIP: &str = "FURROW_TESTS_SKIP_MOUNT";

/// A small file system in memory. It is unmounted when dropped.
pub(crate) struct Mount {
    at: TempDir,
}

impl Mount {
    /// Room for so many MiB; none if the user wants to do without.
    pub(crate) fn of_mib(size: u32) -> Option<Self> {
        if std::env::var_os(SKIP).is_some_and(|skip| skip == "1") {
            eprintln!("skipped: {SKIP}=1");
            return None;
        }
        let at = tempfile::tempdir().unwrap();
        mount(&["-t", "tmpfs", "-o", &format!("size={size}m"), "furrow-tests", &at.path().to_string_lossy()]);
        Some(Self { at })
    }

    /// Lets nothing be written there any more.
    pub(crate) fn make_read_only(&self) {
        mount(&["-o", "remount,ro", &self.at.path().to_string_lossy()]);
    }

    /// The same for one file only.
    pub(crate) fn make_file_read_only(&self, name: &str) {
        let file = self.path(name);
        mount(&["--bind", &file, &file]);
        mount(&["-o", "remount,bind,ro", &file]);
    }

    /// Takes all the room that is left.
    pub(crate) fn fill(&self) {
        let mut filler = File::options().append(true).create(true).open(self.filler()).unwrap();
        let page = [0; 4_096];
        loop {
            match filler.write_all(&page) {
                Ok(()) => {}
                Err(error) if error.kind() == ErrorKind::StorageFull => return,
                Err(error) => panic!("{error}"),
            }
        }
    }

    /// Gives it back.
    pub(crate) fn make_room(&self) {
        fs::remove_file(self.filler()).unwrap();
    }

    /// A path in it, as text.
    pub(crate) fn path(&self, name: &str) -> String {
        self.at.path().join(name).into_os_string().into_string().unwrap()
    }

    /// The names of what is in it.
    pub(crate) fn names(&self) -> Vec<String> {
        let entries = self.at.path().read_dir().unwrap();
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
    }

    fn filler(&self) -> PathBuf {
        self.at.path().join("filler")
    }
}

impl Drop for Mount {
    fn drop(&mut self) {
        // Lazily: a process that the test kills may still be at it.
        let _ = Command::new("umount").arg("--lazy").arg(self.at.path()).status();
    }
}

fn mount(args: &[&str]) {
    let tried = Command::new("mount").args(args).output();
    let why = match &tried {
        Ok(output) if output.status.success() => return,
        Ok(output) => String::from_utf8_lossy(&output.stderr).into_owned(),
        Err(error) => error.to_string(),
    };
    panic!("this test mounts file systems: run it by ./test or as root, or set {SKIP}=1 to do without it: {why}");
}
