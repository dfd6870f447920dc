//! How far perception is from the labels.

use serde::Serialize;

use super::LabelledScan;
use crate::control::Twist;
use crate::localization::LaneEstimator;
use crate::perception::{LaneEstimate, LaneFinder, LaneView};
use crate::random::Stream;

/// A scan is bad if the cross-track error is off by more \[m\], ..
pub const BAD_CROSS_TRACK_M: f64 = 0.15;
/// .. or the heading \[rad\].
pub const BAD_HEADING_RAD: f64 = 15.0 * std::f64::consts::PI / 180.0;

/// What is judged.
pub enum Subject {
    /// By its view of each scan.
    Finder(Box<dyn LaneFinder>),
    /// By its estimate after each scan, of which it gets the points and no view.
    Estimator(Box<dyn LaneEstimator>),
}

/// What the subject knows before each scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Feed {
    /// The lane's middle, along it; nothing of earlier scans.
    Alone,
    /// The lane's middle and the label's heading with normal noise; nothing of earlier scans.
    HeadingPrior {
        /// Standard deviation \[rad\].
        noise_rad: f64,
    },
    /// What it makes of the scans before, unlabelled ones too. How the robot moved between them is not known.
    Sequence {
        /// Time from scan to scan \[s\].
        period_s: f64,
    },
}

/// Errors over all labelled scans; absolute values, quantiles by the nearest rank.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Errors {
    /// Labelled scans.
    pub scans: usize,
    /// Of the cross-track error \[m\].
    pub cross_track_median_m: f64,
    /// 90 % are within \[m\].
    pub cross_track_p90_m: f64,
    /// Of the heading \[deg\].
    pub heading_median_deg: f64,
    /// 90 % are within \[deg\].
    pub heading_p90_deg: f64,
    /// Share of scans off by more than 0.15 m or 15 degrees.
    pub bad_share: f64,
}

/// A subject and how it is fed.
pub struct Evaluation {
    /// What is judged.
    pub subject: Subject,
    /// What it knows before each scan.
    pub feed: Feed,
    /// Nominal width of the lane \[m\].
    pub lane_width_m: f64,
    /// Of the streams `line-finder` and `prior`.
    pub seed: u64,
}

impl Evaluation {
    /// Errors over `scans`; none if no scan is labelled.
    #[must_use]
    pub fn errors(mut self, scans: &[LabelledScan]) -> Option<Errors> {
        let (mut random, mut noise) = (Stream::new(self.seed, "line-finder"), Stream::new(self.seed, "prior"));
        let middle = LaneEstimate::middle(self.lane_width_m);
        let mut estimate = middle;
        self.subject.restart(middle);
        let mut errors = Vec::new();
        for scan in scans {
            if !matches!(self.feed, Feed::Sequence { .. }) {
                estimate = middle;
                if let (Feed::HeadingPrior { noise_rad }, Some(label)) = (self.feed, scan.label) {
                    estimate.heading_rad = label.heading_rad + noise_rad * noise.normal();
                }
                self.subject.restart(estimate);
            }
            estimate = self.subject.see(scan, estimate, self.feed, &mut random);
            errors.extend(scan.label.map(|label| {
                let cross_track_m = (estimate.cross_track_m() - label.cross_track_m()).abs();
                (cross_track_m, (estimate.heading_rad - label.heading_rad).abs())
            }));
        }
        summary(&errors)
    }
}

impl Subject {
    fn restart(&mut self, start: LaneEstimate) {
        match self {
            Self::Finder(finder) => finder.restart(start),
            Self::Estimator(estimator) => estimator.restart(start),
        }
    }

    fn see(&mut self, scan: &LabelledScan, prior: LaneEstimate, feed: Feed, random: &mut Stream) -> LaneEstimate {
        match self {
            Self::Finder(finder) => {
                let view = finder.find(&scan.points, prior, random);
                LaneEstimate {
                    left_m: view.left.distance_m,
                    right_m: view.right.distance_m,
                    heading_rad: view.heading_rad,
                }
            }
            Self::Estimator(estimator) => {
                if let Feed::Sequence { period_s } = feed {
                    estimator.predict(Twist::default(), period_s);
                }
                estimator.correct(&scan.points, LaneView::nothing(prior), random);
                estimator.estimate()
            }
        }
    }
}

fn summary(errors: &[(f64, f64)]) -> Option<Errors> {
    let bad = errors
        .iter()
        .filter(|(cross_track_m, heading_rad)| *cross_track_m > BAD_CROSS_TRACK_M || *heading_rad > BAD_HEADING_RAD);
    let sorted = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values
    };
    let cross_track_m = sorted(errors.iter().map(|error| error.0).collect());
    let heading_deg = sorted(errors.iter().map(|error| error.1.to_degrees()).collect());
    Some(Errors {
        scans: errors.len(),
        cross_track_median_m: quantile(&cross_track_m, 0.5)?,
        cross_track_p90_m: quantile(&cross_track_m, 0.9)?,
        heading_median_deg: quantile(&heading_deg, 0.5)?,
        heading_p90_deg: quantile(&heading_deg, 0.9)?,
        bad_share: bad.count() as f64 / errors.len() as f64,
    })
}

/// The nearest rank; none without values.
fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.max(1) - 1).copied()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parameters::Kinds;
    use crate::perception::LaneFinderSpec;

    #[test]
    fn quantiles_are_nearest_ranks_and_either_error_makes_a_scan_bad() {
        let mut errors = vec![(0.01, 0.02); 8];
        errors.extend([(0.2, 0.0), (0.0, 0.3)]);
        let summary = summary(&errors).unwrap();
        assert_eq!((summary.scans, summary.bad_share), (10, 0.2));
        assert_eq!((summary.cross_track_median_m, summary.cross_track_p90_m), (0.01, 0.01));
        assert!((summary.heading_p90_deg - 0.02_f64.to_degrees()).abs() < 1e-12);
    }

    #[test]
    fn scans_without_labels_have_no_errors() {
        let scans = super::super::read("1;;0,1000\n2;;").unwrap();
        let subject = Subject::Finder(LaneFinderSpec::read_kind("pl", Default::default()).unwrap().build(0.75));
        let evaluation = Evaluation { subject, feed: Feed::Alone, lane_width_m: 0.75, seed: 1 };
        assert_eq!(evaluation.errors(&scans), None);
    }

    #[test]
    fn finders_are_right_on_simulated_scans() {
        let scans = super::super::read(include_str!("../../benches/scans/lane.csv")).unwrap();
        let feed = Feed::HeadingPrior { noise_rad: 0.05 };
        for kind in LaneFinderSpec::kinds() {
            let subject = Subject::Finder(LaneFinderSpec::read_kind(kind, Default::default()).unwrap().build(0.75));
            let errors = Evaluation { subject, feed, lane_width_m: 0.75, seed: 1 }.errors(&scans).unwrap();
            assert_eq!((errors.scans, errors.bad_share), (12, 0.0), "{kind}: {errors:?}");
            assert!(errors.cross_track_median_m < 0.03 && errors.heading_median_deg < 1.5, "{kind}: {errors:?}");
        }
    }

    /// Errors on the scans of the file that `FURROW_REAL_SCANS` names, for eyes rather than for a bound.
    #[test]
    #[allow(clippy::print_stderr, clippy::unwrap_used)]
    fn real_scans_are_evaluated_if_there_are_any() {
        let Some(file) = std::env::var_os("FURROW_REAL_SCANS") else {
            return eprintln!("skipped: FURROW_REAL_SCANS names no file of labelled scans");
        };
        let scans = super::super::read(&std::fs::read_to_string(file).unwrap()).unwrap();
        let prior = |degrees: f64| Feed::HeadingPrior { noise_rad: degrees.to_radians() };
        for kind in LaneFinderSpec::kinds() {
            for feed in [Feed::Alone, prior(5.0), Feed::Sequence { period_s: 0.1 }] {
                let finder = LaneFinderSpec::read_kind(kind, Default::default()).unwrap().build(0.6);
                let evaluation = Evaluation { subject: Subject::Finder(finder), feed, lane_width_m: 0.6, seed: 1 };
                eprintln!("{kind} {feed:?} {:?}", evaluation.errors(&scans).unwrap());
            }
        }
    }
}
