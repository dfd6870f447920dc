//! Processor time and memory of this process, as Linux tells them.

use std::fs;
use std::io;
use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};

/// What this process used so far.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Usage {
    /// Processor time of all its threads \[s\].
    pub cpu_s: f64,
    /// Resident memory \[MB\].
    pub rss_mb: f64,
    /// The most it ever was \[MB\].
    pub peak_rss_mb: f64,
}

/// What this process used so far.
///
/// # Errors
/// There is no `/proc`, or it has another form.
pub fn usage() -> io::Result<Usage> {
    let status = fs::read_to_string("/proc/self/status")?;
    let cpu_s = since_start(ClockId::ProcessCPUTime).as_secs_f64();
    let megabytes = |key| status_kb(&status, key).map(|kb| kb * 1_024.0 / 1e6);
    let usage = || Some(Usage { cpu_s, rss_mb: megabytes("VmRSS:")?, peak_rss_mb: megabytes("VmHWM:")? });
    usage().ok_or_else(|| io::Error::new(io::ErrorKind::InvalidData, "/proc/self has another form"))
}

/// The processor time that the calling thread used.
#[must_use]
pub fn thread_cpu() -> Duration {
    since_start(ClockId::ThreadCPUTime)
}

fn since_start(clock: ClockId) -> Duration {
    // Such a clock begins at nothing and never goes back.
    Duration::try_from(clock_gettime(clock)).unwrap_or_default()
}

fn status_kb(status: &str, key: &str) -> Option<f64> {
    let line = status.lines().find_map(|line| line.strip_prefix(key))?;
    line.split_whitespace().next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_process_used_something() {
        let usage = usage().unwrap();
        assert!(usage.rss_mb > 1.0 && usage.peak_rss_mb >= usage.rss_mb * 0.9, "{usage:?}");
        let before = thread_cpu();
        while thread_cpu() == before {}
    }
}
