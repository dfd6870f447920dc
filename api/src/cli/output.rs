//! Standard output for results and standard error for the rest; neither panics when nobody reads it.

use std::io::{self, Write};

use serde::Serialize;

use super::error::CliError;

/// Writes `text` and a line's end to standard output, at once.
///
/// # Errors
/// The output is closed or cannot be written.
pub(super) fn line(text: &str) -> Result<(), CliError> {
    let mut out = io::stdout().lock();
    out.write_all(text.as_bytes())?;
    if !text.ends_with('\n') {
        out.write_all(b"\n")?;
    }
    Ok(out.flush()?)
}

/// Writes `value` as one JSON object to standard output.
///
/// # Errors
/// The output is closed or cannot be written.
pub(super) fn json(value: &impl Serialize) -> Result<(), CliError> {
    line(&serde_json::to_string_pretty(value).map_err(CliError::failed("cannot write JSON"))?)
}

/// Writes a line to standard error; there is nothing to do about it if that fails.
pub(super) fn note(text: &str) {
    let _ = writeln!(io::stderr().lock(), "{text}");
}
