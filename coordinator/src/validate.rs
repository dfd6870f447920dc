//! What a worker may say: limits on everything that comes over the wire, checked before it meets the database.

use std::collections::BTreeMap;

use furrow_schema::job::{RunRecord, Timings};
use furrow_schema::protocol::{Claim, Hello, MAX_CLAIM, MAX_KNOWN_SCENARIOS, Refusal, Renew, Report, RunEnd};

use crate::moments::METRIC_LIMIT;

const MAX_NAME_BYTES: usize = 200;
const MAX_THREADS: u32 = 65_536;
const MAX_HELD: usize = 4 * MAX_CLAIM as usize;
const MAX_OUTCOME_BYTES: usize = 40;
const MAX_METRICS: usize = 64;
const MAX_METRIC_NAME_BYTES: usize = 64;
const MAX_PARTS: usize = 64;
const MAX_TRAJECTORY_DIGITS: usize = 8 << 20;
const MAX_PANIC_BYTES: usize = 64 << 10;

/// A panic's message is stored up to this length \[characters\].
pub(crate) const PANIC_CHARS_KEPT: usize = 2_000;

type Checked = Result<(), Refusal>;

pub(crate) fn hello(hello: &Hello) -> Checked {
    ensure(hello.name.len() <= MAX_NAME_BYTES, || format!("`name` is longer than {MAX_NAME_BYTES} bytes"))?;
    ensure((1..=MAX_THREADS).contains(&hello.threads), || format!("`threads` is not in 1 to {MAX_THREADS}"))
}

pub(crate) fn claim(claim: &Claim) -> Checked {
    ensure((1..=MAX_CLAIM).contains(&claim.want), || format!("`want` is not in 1 to {MAX_CLAIM}"))?;
    let known = claim.known_scenarios.len();
    ensure(known <= MAX_KNOWN_SCENARIOS, || format!("`known_scenarios` names more than {MAX_KNOWN_SCENARIOS}"))
}

pub(crate) fn renew(renew: &Renew) -> Checked {
    ensure(renew.held.len() <= MAX_HELD, || format!("`held` names more than {MAX_HELD} jobs"))
}

pub(crate) fn report(report: &Report) -> Checked {
    ensure(report.runs.len() <= MAX_CLAIM as usize, || format!("`runs` holds more than {MAX_CLAIM}"))?;
    for run in &report.runs {
        match &run.ended {
            RunEnd::Done(record) => check_record(record)?,
            RunEnd::Panicked { message } => {
                ensure(message.len() <= MAX_PANIC_BYTES, || format!("`message` is over {MAX_PANIC_BYTES} bytes"))?;
            }
            RunEnd::HandedBack => {}
        }
    }
    Ok(())
}

fn check_record(record: &RunRecord) -> Checked {
    ensure(is_kebab(&record.outcome, MAX_OUTCOME_BYTES), || {
        format!("`outcome` is not a kebab-case word of at most {MAX_OUTCOME_BYTES} characters")
    })?;
    check_metrics("metrics", &record.metrics)?;
    check_timings(&record.timings)?;
    record.trajectory.as_deref().map_or(Ok(()), check_trajectory)
}

fn check_metrics(place: &str, metrics: &BTreeMap<String, f64>) -> Checked {
    ensure(metrics.len() <= MAX_METRICS, || format!("`{place}` holds more than {MAX_METRICS}"))?;
    for (name, value) in metrics {
        ensure(is_metric_name(name), || {
            format!("`{place}` holds a name that is not snake_case of at most {MAX_METRIC_NAME_BYTES} characters")
        })?;
        ensure(value.abs() <= METRIC_LIMIT, || format!("`{place}.{name}` is not a number up to {METRIC_LIMIT:e}"))?;
    }
    Ok(())
}

fn check_timings(timings: &Timings) -> Checked {
    check_metrics("timings.metrics", &timings.metrics)?;
    ensure(timings.cpu_model.len() <= MAX_NAME_BYTES, || {
        format!("`timings.cpu_model` is longer than {MAX_NAME_BYTES} bytes")
    })?;
    ensure(timings.parts.len() <= MAX_PARTS, || format!("`timings.parts` holds more than {MAX_PARTS}"))?;
    let names = timings.parts.iter().all(|part| is_kebab(&part.part, MAX_OUTCOME_BYTES));
    ensure(names, || "`timings.parts` holds a part that is not a kebab-case word".to_owned())?;
    let mut figures = timings.parts.iter().flat_map(|part| [part.mean_us, part.p50_us, part.p99_us]);
    let finite = timings.wall_ms.is_finite() && timings.load.is_finite() && figures.all(f64::is_finite);
    ensure(finite, || "`timings` holds a figure that is not finite".to_owned())
}

fn check_trajectory(digits: &str) -> Checked {
    ensure(digits.len() <= MAX_TRAJECTORY_DIGITS, || {
        format!("`trajectory` is longer than {MAX_TRAJECTORY_DIGITS} digits")
    })?;
    let hexadecimal = digits.len().is_multiple_of(2) && digits.bytes().all(|b| b.is_ascii_hexdigit());
    ensure(hexadecimal, || "`trajectory` is not an even number of hexadecimal digits".to_owned())
}

fn is_kebab(word: &str, max_bytes: usize) -> bool {
    let part = |part: &str| !part.is_empty() && part.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit());
    word.len() <= max_bytes && word.split('-').all(part)
}

/// A decimal point may stand between digits, as in `within_0.05m_percent`.
fn is_metric_name(name: &str) -> bool {
    let good = |b: u8| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'_' || b == b'.';
    let between_digits = |at: &[u8]| at[1] != b'.' || (at[0].is_ascii_digit() && at[2].is_ascii_digit());
    name.len() <= MAX_METRIC_NAME_BYTES
        && name.starts_with(|c: char| c.is_ascii_lowercase())
        && !name.ends_with('.')
        && name.bytes().all(good)
        && name.as_bytes().windows(3).all(between_digits)
}

fn ensure(holds: bool, detail: impl FnOnce() -> String) -> Checked {
    if holds { Ok(()) } else { Err(Refusal::Malformed { detail: detail() }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use furrow_schema::id::{Digest, EngineId, JobId};
    use furrow_schema::protocol::RunReport;

    fn record() -> RunRecord {
        RunRecord {
            digest: Digest([1; 32]),
            outcome: "success".to_owned(),
            metrics: BTreeMap::from([("success".to_owned(), 1.0)]),
            timings: Timings::default(),
            trajectory: None,
        }
    }

    fn refused(change: impl FnOnce(&mut RunRecord)) -> bool {
        let mut record = record();
        change(&mut record);
        let run = RunReport { job: JobId(1), attempt: 1, ended: RunEnd::Done(record) };
        report(&Report { engine: EngineId([0; 32]), runs: vec![run] }).is_err()
    }

    #[test]
    fn a_metric_s_name_may_hold_a_decimal_point_between_digits() {
        assert!(is_metric_name("within_0.05m_percent") && is_metric_name("distance_m"));
        for wrong in ["within_.5m", "a.b", "within_0.", "0.5m", "a_0..5", "Within_m", ""] {
            assert!(!is_metric_name(wrong), "{wrong}");
        }
    }

    #[test]
    fn a_usual_record_passes() {
        assert!(!refused(|_| ()));
        assert!(!refused(|r| r.trajectory = Some("00ff".to_owned())));
        assert!(!refused(|r| r.outcome = "end-of-row-2".to_owned()));
    }

    #[test]
    fn what_breaks_a_limit_is_refused() {
        assert!(refused(|r| r.outcome = String::new()));
        assert!(refused(|r| r.outcome = "Not Kebab".to_owned()));
        assert!(refused(|r| r.outcome = "a".repeat(41)));
        assert!(refused(|r| _ = r.metrics.insert("lost".to_owned(), f64::NAN)));
        assert!(refused(|r| _ = r.metrics.insert("lost".to_owned(), 1e101)));
        assert!(refused(|r| _ = r.metrics.insert("9lives".to_owned(), 1.0)));
        assert!(refused(|r| r.metrics = (0..65).map(|i| (format!("m{i}"), 1.0)).collect()));
        assert!(refused(|r| r.timings.wall_ms = f64::INFINITY));
        assert!(refused(|r| r.trajectory = Some("0".to_owned())));
        assert!(refused(|r| r.trajectory = Some("zz".to_owned())));
    }

    #[test]
    fn counts_have_limits() {
        let engine = EngineId([0; 32]);
        assert!(claim(&Claim { engine, want: 0, known_scenarios: vec![], first: false }).is_err());
        assert!(claim(&Claim { engine, want: MAX_CLAIM + 1, known_scenarios: vec![], first: false }).is_err());
        assert!(claim(&Claim { engine, want: MAX_CLAIM, known_scenarios: vec![], first: false }).is_ok());
        assert!(hello(&Hello { name: String::new(), engine, threads: 0 }).is_err());
    }
}
