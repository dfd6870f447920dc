//! How far a sweep is: a bar on a terminal, a line now and then elsewhere.

use std::io::IsTerminal;
use std::time::{Duration, Instant};

use furrow_schema::sweep::Sweep;
use indicatif::{ProgressBar, ProgressStyle};

use super::output;

const LINE_EVERY: Duration = Duration::from_secs(10);

/// Shows progress on standard error.
pub(super) enum Progress {
    /// On a terminal.
    Bar(ProgressBar),
    /// In a log or a pipe.
    Lines(Lines),
}

impl Progress {
    /// Starts showing `total` runs, `cached` of which are there already.
    pub(super) fn start(name: &str, total: u64, cached: u64) -> Self {
        if !std::io::stderr().is_terminal() {
            output::note(&format!("{name}: {total} runs, {cached} of them cached"));
            return Self::Lines(Lines::new(Instant::now()));
        }
        let bar = ProgressBar::new(total).with_message(name.to_owned());
        let form = "{msg} {wide_bar} {pos}/{len} {prefix}";
        bar.set_style(ProgressStyle::with_template(form).unwrap_or_else(|_| ProgressStyle::default_bar()));
        bar.enable_steady_tick(Duration::from_millis(200));
        Self::Bar(bar)
    }

    /// Shows where the sweep is now.
    pub(super) fn show(&mut self, sweep: &Sweep) {
        match self {
            Self::Bar(bar) => {
                bar.set_prefix(pace(sweep));
                bar.set_position(ended(sweep));
            }
            Self::Lines(lines) => {
                if let Some(line) = lines.line(sweep, Instant::now()) {
                    output::note(&line);
                }
            }
        }
    }

    /// Takes the bar away, or writes the last line, after `elapsed_s` in all.
    pub(super) fn finish(self, elapsed_s: f64) {
        match self {
            Self::Bar(bar) => bar.finish_and_clear(),
            Self::Lines(_) => output::note(&format!("ended after {}", span(elapsed_s))),
        }
    }
}

/// When to write the next line.
pub(super) struct Lines {
    last: Instant,
    tenths: u64,
}

impl Lines {
    fn new(now: Instant) -> Self {
        Self { last: now, tenths: 0 }
    }

    /// A line, when a further tenth is done or the last line is old.
    fn line(&mut self, sweep: &Sweep, now: Instant) -> Option<String> {
        let tenths = (ended(sweep) * 10).checked_div(sweep.total).unwrap_or(10);
        if ended(sweep) == sweep.total || (tenths <= self.tenths && now.duration_since(self.last) < LINE_EVERY) {
            return None;
        }
        (self.last, self.tenths) = (now, tenths);
        Some(format!("{}/{} {}", ended(sweep), sweep.total, pace(sweep)))
    }
}

fn ended(sweep: &Sweep) -> u64 {
    sweep.done + sweep.failed + sweep.cancelled
}

fn pace(sweep: &Sweep) -> String {
    let rate = sweep.rate_per_s.map(|rate| format!("{rate:.1} runs/s")).unwrap_or_default();
    let left = sweep.eta_s.filter(|left| left.is_finite()).map(|left| format!(", {} left", span(left)));
    let failed = if sweep.failed > 0 { format!(", {} failed", sweep.failed) } else { String::new() };
    format!("{rate}{}{failed}", left.unwrap_or_default()).trim_start_matches(", ").to_owned()
}

/// A time span in seconds for people: `0.3 s`, `42 s`, `3 min 05 s`, `2 h 10 min`.
pub(super) fn span(seconds: f64) -> String {
    if (0.0..9.95).contains(&seconds) {
        return format!("{seconds:.1} s");
    }
    let whole = seconds.max(0.0).round() as u64;
    match whole {
        0..60 => format!("{whole} s"),
        60..3_600 => format!("{} min {:02} s", whole / 60, whole % 60),
        _ => format!("{} h {:02} min", whole / 3_600, whole % 3_600 / 60),
    }
}

#[cfg(test)]
pub(super) mod tests {
    use furrow_schema::id::{EngineId, SweepId};
    use furrow_schema::sweep::SweepState;

    use super::*;

    pub(in crate::cli) fn sweep(done: u64, total: u64) -> Sweep {
        Sweep {
            id: SweepId(1),
            name: "night".to_owned(),
            plan: "bounds".to_owned(),
            state: SweepState::Active,
            priority: 0,
            total,
            done,
            failed: 0,
            queued: total - done,
            leased: 0,
            cancelled: 0,
            cached: 0,
            disputed: 0,
            rate_per_s: Some(2.0),
            eta_s: Some(185.0),
            engine: EngineId([0; 32]),
            seeds: 1,
            factors: Vec::new(),
            record: false,
            timing: false,
            created_ms: 0,
            finished_ms: None,
        }
    }

    #[test]
    fn a_line_comes_with_a_further_tenth_or_after_a_while() {
        let start = Instant::now();
        let mut lines = Lines::new(start);
        assert_eq!(lines.line(&sweep(9, 100), start), None);
        assert_eq!(lines.line(&sweep(10, 100), start).unwrap(), "10/100 2.0 runs/s, 3 min 05 s left");
        assert_eq!(lines.line(&sweep(11, 100), start), None);
        assert!(lines.line(&sweep(12, 100), start + LINE_EVERY).is_some());
        assert_eq!(lines.line(&sweep(100, 100), start + 2 * LINE_EVERY), None);
        assert_eq!(lines.line(&sweep(0, 0), start), None);
    }

    #[test]
    fn spans_are_written_for_people() {
        assert_eq!(span(41.6), "42 s");
        assert_eq!(span(185.0), "3 min 05 s");
        assert_eq!(span(7_800.0), "2 h 10 min");
        assert_eq!(span(0.26), "0.3 s");
        assert_eq!(span(9.96), "10 s");
        assert_eq!(span(-1.0), "0 s");
    }
}
