//! How far perception is from the labels.

use serde::Serialize;

use super::{LabelledScan, Subject};
use crate::perception::LaneEstimate;
use crate::random::Stream;

/// A scan is bad if the cross-track error is off by more \[m\], ..
pub const BAD_CROSS_TRACK_M: f64 = 0.15;
/// .. or the heading \[rad\].
pub const BAD_HEADING_RAD: f64 = 15.0 * std::f64::consts::PI / 180.0;

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
    /// Of the random streams: the subject's, and the prior's.
    pub seed: u64,
}

impl Evaluation {
    /// Errors over `scans`; none if no scan is labelled.
    #[must_use]
    pub fn errors(mut self, scans: &[LabelledScan]) -> Option<Errors> {
        let (mut random, mut noise) = (Stream::new(self.seed, "subject"), Stream::new(self.seed, "prior"));
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
            let moved_s = if let Feed::Sequence { period_s } = self.feed { period_s } else { 0.0 };
            estimate = self.subject.see(&scan.points, estimate, moved_s, &mut random);
            errors.extend(scan.label.map(|label| {
                let cross_track_m = (estimate.cross_track_m() - label.cross_track_m()).abs();
                (cross_track_m, (estimate.heading_rad - label.heading_rad).abs())
            }));
        }
        summary(&errors)
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

    fn errors(kind: &str, feed: Feed, lane_width_m: f64, scans: &[LabelledScan]) -> Option<Errors> {
        let subject = Subject::read(kind, Default::default(), lane_width_m).unwrap();
        Evaluation { subject, feed, lane_width_m, seed: 1 }.errors(scans)
    }

    fn prior(degrees: f64) -> Feed {
        Feed::HeadingPrior { noise_rad: degrees.to_radians() }
    }

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
        assert_eq!(errors("pl", Feed::Alone, 0.75, &super::super::read("1;;0,1000\n2;;").unwrap()), None);
    }

    #[test]
    fn who_sees_nothing_is_off_by_the_labels_place_and_the_priors_noise() {
        let scans = super::super::read("1;-300,0,-300,900,500,0,500,900;\n2;-300,0,-300,900,500,0,500,900;").unwrap();
        let blind = errors("pl", prior(0.0), 0.75, &scans).unwrap();
        assert!((blind.cross_track_median_m - 0.1).abs() < 1e-12 && blind.heading_p90_deg == 0.0);
        let noisy = errors("pl", prior(5.0), 0.75, &scans).unwrap();
        assert!(noisy.heading_median_deg > 0.0 && noisy.heading_p90_deg < 25.0);
    }

    #[test]
    fn simulated_scans_are_seen_rightly_by_all_subjects() {
        let scans = super::super::read(include_str!("../../benches/scans/lane.csv")).unwrap();
        for kind in Subject::kinds() {
            let errors = errors(kind, prior(3.0), 0.75, &scans).unwrap();
            assert_eq!((errors.scans, errors.bad_share), (12, 0.0), "{kind}: {errors:?}");
            assert!(errors.cross_track_median_m < 0.03 && errors.heading_median_deg < 2.0, "{kind}: {errors:?}");
        }
    }
}
