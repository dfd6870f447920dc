//! Processor time and memory of this process, as Linux tells them.

use std::fs;
use std::io;

/// What this process used so far.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Usage {
    /// Processor time of all its threads \[s\], in steps of 10 ms.
    pub cpu_s: f64,
    /// Resident memory \[MB\].
    pub rss_mb: f64,
    /// The most it ever was \[MB\].
    pub peak_rss_mb: f64,
}

/// Ticks of `/proc/PID/stat` in a second: a constant of Linux on all machines that it is built for here.
const TICKS_PER_S: f64 = 100.0;

/// What this process used so far.
///
/// # Errors
/// There is no `/proc`, or it has another form.
pub fn usage() -> io::Result<Usage> {
    let (stat, status) = (fs::read_to_string("/proc/self/stat")?, fs::read_to_string("/proc/self/status")?);
    let megabytes = |key| status_kb(&status, key).map(|kb| kb * 1_024.0 / 1e6);
    let usage =
        || Some(Usage { cpu_s: cpu_s(&stat)?, rss_mb: megabytes("VmRSS:")?, peak_rss_mb: megabytes("VmHWM:")? });
    usage().ok_or_else(|| io::Error::new(io::ErrorKind::InvalidData, "/proc/self has another form"))
}

/// The processor time that the calling thread used \[ns\].
///
/// # Errors
/// There is no `/proc/thread-self/schedstat`, or it has another form.
pub fn thread_cpu_ns() -> io::Result<u64> {
    let text = fs::read_to_string("/proc/thread-self/schedstat")?;
    let first = text.split_whitespace().next().and_then(|word| word.parse().ok());
    first.ok_or_else(|| io::Error::new(io::ErrorKind::InvalidData, "/proc/thread-self/schedstat has another form"))
}

/// User and system time: fields 14 and 15, counted from the state (field 3), which follows the name in brackets.
fn cpu_s(stat: &str) -> Option<f64> {
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    let ticks = |field: usize| fields.get(field - 3)?.parse::<f64>().ok();
    Some((ticks(14)? + ticks(15)?) / TICKS_PER_S)
}

fn status_kb(status: &str, key: &str) -> Option<f64> {
    let line = status.lines().find_map(|line| line.strip_prefix(key))?;
    line.split_whitespace().next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_read_past_a_name_with_brackets() {
        let stat = "7 (a ) b) S 1 7 7 0 -1 4194560 100 0 0 0 250 50 0 0 20 0 1 0 5 1000 10";
        assert_eq!(cpu_s(stat), Some(3.0));
        assert_eq!(cpu_s("7"), None);
    }

    #[test]
    fn this_process_used_something() {
        let usage = usage().unwrap();
        assert!(usage.rss_mb > 1.0 && usage.peak_rss_mb >= usage.rss_mb * 0.9, "{usage:?}");
        let before = thread_cpu_ns().unwrap();
        while thread_cpu_ns().unwrap() == before {}
    }
}
