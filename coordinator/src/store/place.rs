//! Where a database is: one name for a file that may be named in several ways.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::open::cannot_open;
use crate::error::StoreError;

/// The one path, free of links, under which SQLite keeps its log and we our lock beside the file.
pub(super) fn place(path: &Path) -> Result<PathBuf, StoreError> {
    let path = std::path::absolute(path).map_err(|error| cannot_open(path, error.to_string()))?;
    let refused = |reason: String| Err(cannot_open(&path, reason));
    match path.metadata() {
        Ok(found) if found.is_dir() => return refused("it is a folder: name a file in it".to_owned()),
        Ok(found) if !found.is_file() => return refused("it is not a regular file".to_owned()),
        Ok(found) if found.nlink() > 1 => {
            let names = found.nlink();
            return refused(format!("it has {names} names (hard links), and a log beside each of them: use a copy"));
        }
        Ok(_) => return path.canonicalize().map_err(|error| cannot_open(&path, error.to_string())),
        Err(_) if path.is_symlink() => return refused("it is a link to a file that is not there".to_owned()),
        Err(_) => {}
    }
    let (Some(folder), Some(name)) = (path.parent(), path.file_name()) else {
        return refused("it is no name of a file".to_owned());
    };
    let Ok(folder) = folder.canonicalize() else {
        return refused(format!("the folder `{}` does not exist: make it first", folder.display()));
    };
    Ok(folder.join(name))
}
