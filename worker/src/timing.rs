//! What a run costs on the clock of the machine that runs it.
//!
//! These figures are no results: they are in no digest and in no comparison of bits. Some of them are metrics:
//!
//! - `line_finding_time_ms`: mean of the first 500 calls of the line finder on the front LiDAR, as the 500 front
//!   scans over which Guyonneau et al. (2022) give theirs in table 4;
//! - `line_finding_time_per_100_points_ms`: 100 times that over the run's `points_processed`, table 6 there; absent
//!   in a run that processed no points;
//! - `lane_finding_time_ms`, `lane_estimation_time_ms` (both halves of the estimator) and `control_time_ms` (goal
//!   generator and controller): means a scan of a robot in a lane, as section 5.4 of Velasquez et al. (2022) has them;
//! - `ray_casting_time_ms`, `filtering_time_ms`, `ground_detection_time_ms`, `row_detection_time_ms`, `localization_time_ms`: means a
//!   cloud of a robot in a nursery, the last four as in table 4.8 of Vintu (2018);
//! - `computation_time_ms`: all finding, estimation and control over the number of control steps, which is the time
//!   that a robot's own computer spends between two scans and a command.

mod histogram;
mod machine;

use std::collections::BTreeMap;
use std::time::Instant;

use furrow_schema::job::{PartTiming, Timings};
use furrow_sim::{Part, Probe};

use self::histogram::Histogram;

/// Calls of the front line finder that `line_finding_time_ms` is the mean of.
const TIMED_LINE_FINDINGS: u64 = 500;
/// Parts whose time is the robot's own computation.
const COMPUTATION: [Part; 10] = [
    Part::LineFindingFront,
    Part::LineFindingBack,
    Part::LaneFinding,
    Part::LanePrediction,
    Part::LaneCorrection,
    Part::Filtering,
    Part::GroundDetection,
    Part::RowDetection,
    Part::Localization,
    Part::Control,
];

/// Times the parts of one run. It costs two readings of the clock a part, and 28 kB.
#[derive(Debug)]
pub struct Stopwatch {
    began: Instant,
    parts: [Meter; Part::ALL.len()],
    first_line_findings: Mean,
}

/// The time of one part.
#[derive(Debug, Default)]
struct Meter {
    began: Option<Instant>,
    calls: Histogram,
}

/// A running mean of durations.
#[derive(Debug, Default)]
struct Mean {
    n: u64,
    sum_ns: u64,
}

impl Stopwatch {
    /// Starts the run's clock.
    #[must_use]
    pub fn start() -> Self {
        Self { began: Instant::now(), parts: Default::default(), first_line_findings: Mean::default() }
    }

    /// The record, at the end of the run; `metrics` are the run's, `alone` tells whether nothing else ran.
    #[must_use]
    pub fn finish(self, metrics: &BTreeMap<String, f64>, alone: bool) -> Timings {
        Timings {
            wall_ms: self.began.elapsed().as_secs_f64() * 1e3,
            alone,
            cpu_model: machine::cpu_model().to_owned(),
            load: machine::load(),
            metrics: self.timing_metrics(metrics),
            parts: Part::ALL.into_iter().filter_map(|part| self.part_timing(part)).collect(),
        }
    }

    fn timing_metrics(&self, metrics: &BTreeMap<String, f64>) -> BTreeMap<String, f64> {
        let line_finding_ms = self.first_line_findings.mean_ms();
        let points = metrics.get("points_processed").copied().filter(|points| *points > 0.0);
        let per_100_points_ms = line_finding_ms.zip(points).map(|(mean_ms, points)| 100.0 * mean_ms / points);
        let named = [
            ("line_finding_time_ms", line_finding_ms),
            ("line_finding_time_per_100_points_ms", per_100_points_ms),
            ("lane_finding_time_ms", self.ms_a_scan(&[Part::LaneFinding])),
            ("lane_estimation_time_ms", self.ms_a_scan(&[Part::LanePrediction, Part::LaneCorrection])),
            ("control_time_ms", self.ms_a_scan(&[Part::Control])),
            ("filtering_time_ms", self.ms_a_cloud(Part::Filtering)),
            ("ground_detection_time_ms", self.ms_a_cloud(Part::GroundDetection)),
            ("row_detection_time_ms", self.ms_a_cloud(Part::RowDetection)),
            ("localization_time_ms", self.ms_a_cloud(Part::Localization)),
            ("ray_casting_time_ms", self.ms_a_cloud(Part::Scan)),
            ("computation_time_ms", self.ms_over(&COMPUTATION, Part::Control)),
        ];
        named.into_iter().filter_map(|(name, value)| Some((name.to_owned(), value?))).collect()
    }

    /// Of a robot in a lane; none of another.
    fn ms_a_scan(&self, parts: &[Part]) -> Option<f64> {
        self.ms_over(parts, Part::LaneFinding)
    }

    /// Of a robot in a nursery; none of another.
    fn ms_a_cloud(&self, part: Part) -> Option<f64> {
        self.ms_over(&[part], Part::RowDetection)
    }

    /// The time of `parts` over the calls of `step`.
    fn ms_over(&self, parts: &[Part], step: Part) -> Option<f64> {
        let sum_ns: u64 = parts.iter().map(|part| self.parts[*part as usize].calls.sum_ns()).sum();
        Mean { n: self.parts[step as usize].calls.count(), sum_ns }.mean_ms()
    }

    fn part_timing(&self, part: Part) -> Option<PartTiming> {
        let calls = &self.parts[part as usize].calls;
        Some(PartTiming {
            part: part.name().to_owned(),
            calls: calls.count(),
            mean_us: calls.mean_ns()? / 1e3,
            p50_us: calls.quantile_ns(0.5)? / 1e3,
            p99_us: calls.quantile_ns(0.99)? / 1e3,
        })
    }

    fn record(&mut self, part: Part, duration_ns: u64) {
        self.parts[part as usize].calls.add(duration_ns);
        if part == Part::LineFindingFront && self.first_line_findings.n < TIMED_LINE_FINDINGS {
            self.first_line_findings.n += 1;
            self.first_line_findings.sum_ns += duration_ns;
        }
    }
}

impl Probe for Stopwatch {
    fn begin(&mut self, part: Part) {
        self.parts[part as usize].began = Some(Instant::now());
    }

    fn end(&mut self, part: Part) {
        if let Some(began) = self.parts[part as usize].began.take() {
            let duration_ns = u64::try_from(began.elapsed().as_nanos()).unwrap_or(u64::MAX);
            self.record(part, duration_ns);
        }
    }
}

impl Mean {
    fn mean_ms(&self) -> Option<f64> {
        (self.n > 0).then(|| self.sum_ns as f64 / self.n as f64 / 1e6)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(points: f64) -> BTreeMap<String, f64> {
        BTreeMap::from([("points_processed".to_owned(), points)])
    }

    #[test]
    fn only_the_first_500_line_findings_of_the_front_count() {
        let mut stopwatch = Stopwatch::start();
        (0..500).for_each(|_| stopwatch.record(Part::LineFindingFront, 2_000_000));
        (0..500).for_each(|_| stopwatch.record(Part::LineFindingFront, 90_000_000));
        stopwatch.record(Part::LineFindingBack, 70_000_000);
        let metrics = stopwatch.timing_metrics(&points(40.0));
        assert_eq!(metrics["line_finding_time_ms"], 2.0);
        assert_eq!(metrics["line_finding_time_per_100_points_ms"], 5.0);
    }

    #[test]
    fn computation_is_all_line_finding_and_control_a_control_step() {
        let mut stopwatch = Stopwatch::start();
        for part in [Part::Scan, Part::LineFindingFront, Part::LineFindingBack, Part::Control, Part::Control] {
            stopwatch.record(part, 1_000_000);
        }
        assert_eq!(stopwatch.timing_metrics(&points(1.0))["computation_time_ms"], 2.0);
    }

    #[test]
    fn a_lane_has_a_time_a_scan_for_each_stage() {
        let mut stopwatch = Stopwatch::start();
        for part in [Part::LanePrediction, Part::LaneFinding, Part::LaneCorrection, Part::Control] {
            stopwatch.record(part, 1_000_000);
            stopwatch.record(part, 3_000_000);
        }
        let metrics = stopwatch.timing_metrics(&BTreeMap::new());
        assert_eq!((metrics["lane_finding_time_ms"], metrics["lane_estimation_time_ms"]), (2.0, 4.0));
        assert_eq!((metrics["control_time_ms"], metrics["computation_time_ms"]), (2.0, 8.0));
        assert!(!metrics.contains_key("line_finding_time_ms"));
    }

    #[test]
    fn a_run_without_calls_or_points_has_no_such_metrics() {
        let mut stopwatch = Stopwatch::start();
        assert!(stopwatch.timing_metrics(&points(10.0)).is_empty());
        stopwatch.record(Part::LineFindingFront, 1);
        assert!(!stopwatch.timing_metrics(&points(0.0)).contains_key("line_finding_time_per_100_points_ms"));
        assert!(!stopwatch.timing_metrics(&BTreeMap::new()).contains_key("line_finding_time_per_100_points_ms"));
    }

    #[test]
    fn parts_that_ran_are_listed_and_others_are_not() {
        let mut stopwatch = Stopwatch::start();
        stopwatch.begin(Part::Drive);
        stopwatch.end(Part::Drive);
        stopwatch.end(Part::Observe);
        let timings = stopwatch.finish(&BTreeMap::new(), true);
        assert_eq!(timings.parts.len(), 1);
        assert_eq!((timings.parts[0].part.as_str(), timings.parts[0].calls), ("drive", 1));
        assert!(timings.alone && timings.wall_ms > 0.0 && !timings.cpu_model.is_empty());
    }
}
