//! What a person who knows stems from leaves sees of the lane in a scan: the manual ground truth of table 5.

use std::collections::BTreeMap;

use furrow_navigation::perception::Scan;

use super::{Heard, OperatorParams};

/// The rectangle in which rows are looked for: from here to there ahead, and to either side \[m\]. Paper, section 3.2;
/// the width is the nominal lane's.
const AHEAD_M: [f64; 2] = [0.1, 1.9];
const SIDE_M: f64 = 0.75;
/// Nominal width of a lane, from which table 5 counts \[m\].
const NOMINAL_M: f64 = 0.75;

/// Distance to the stems of the row on the left and on the right \[m\]; none where fewer than `points` returns show.
pub(crate) fn label(scan: &Scan<'_>, from_stem: &[bool], heading_rad: f64, points: u32) -> [Option<f64>; 2] {
    let (sin, cos) = libm::sincos(heading_rad);
    let mut sides = [(0.0, 0_u32); 2];
    let beams = scan.beams.cos.iter().zip(&scan.beams.sin);
    for ((range_m, is_stem), (beam_cos, beam_sin)) in scan.ranges_m.iter().zip(from_stem).zip(beams) {
        if !is_stem || !range_m.is_finite() {
            continue;
        }
        let (x, y) = (range_m * beam_cos, range_m * beam_sin);
        let (x, y) = (cos * x - sin * y, sin * x + cos * y);
        if x > AHEAD_M[0] && x < AHEAD_M[1] && y.abs() < SIDE_M {
            let (sum_m, n) = &mut sides[usize::from(y < 0.0)];
            *sum_m += y.abs();
            *n += 1;
        }
    }
    sides.map(|(sum_m, n)| (n >= points).then(|| sum_m / f64::from(n)))
}

/// Labels of a run.
pub(super) struct Labels {
    every: u32,
    points: u32,
    scans: u32,
    labelled: u32,
    /// Labelled scans in which each side shows.
    valid: [u32; 2],
    width: [f64; 3],
    within: [u32; 2],
}

impl Labels {
    pub(super) const fn new(params: &OperatorParams) -> Self {
        let (every, points) = (params.label_every, params.label_points);
        Self { every, points, scans: 0, labelled: 0, valid: [0; 2], width: [0.0; 3], within: [0; 2] }
    }

    pub(super) fn hear(&mut self, heard: &Heard<'_>) {
        self.scans += 1;
        if !self.scans.is_multiple_of(self.every) {
            return;
        }
        self.labelled += 1;
        let sides = label(&heard.scan, heard.from_stem, heard.place.heading_rad, self.points);
        for (valid, side) in self.valid.iter_mut().zip(sides) {
            *valid += u32::from(side.is_some());
        }
        if let [Some(left_m), Some(right_m)] = sides {
            let width_m = left_m + right_m;
            self.width[0] += 1.0;
            self.width[1] += width_m;
            self.width[2] += width_m * width_m;
            for (within, limit_m) in self.within.iter_mut().zip([0.05, 0.1]) {
                *within += u32::from((width_m - NOMINAL_M).abs() <= limit_m);
            }
        }
    }

    /// The columns of table 5, and the standard deviation of the width.
    pub(super) fn report(&self, metrics: &mut BTreeMap<&'static str, f64>) {
        let percent = |part: u32, whole: f64| 100.0 * f64::from(part) / whole;
        let [n, sum, squares] = self.width;
        metrics.insert("valid_left_percent", percent(self.valid[0], f64::from(self.labelled)));
        metrics.insert("valid_right_percent", percent(self.valid[1], f64::from(self.labelled)));
        metrics.insert("mean_lane_width_m", sum / n);
        metrics.insert("std_lane_width_m", ((squares - sum * sum / n) / (n - 1.0)).max(0.0).sqrt());
        metrics.insert("within_0.05m_percent", percent(self.within[0], n));
        metrics.insert("within_0.1m_percent", percent(self.within[1], n));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use furrow_navigation::perception::Beams;

    #[test]
    fn five_stems_a_side_make_a_width_and_leaves_do_not_count() {
        let beams = Beams::new(181, std::f64::consts::PI);
        // Walls of stems at 0.4 m to the left, 0.3 m to the right; the beams ahead see a leaf.
        let range = |sin: &f64| {
            if *sin > 0.1 {
                0.4 / sin
            } else if *sin < -0.1 {
                -0.3 / sin
            } else {
                0.5
            }
        };
        let ranges: Vec<_> = beams.sin.iter().map(range).collect();
        let scan = Scan { beams: &beams, ranges_m: &ranges };
        let stems: Vec<_> = beams.sin.iter().map(|sin| sin.abs() > 0.1).collect();
        let [left, right] = label(&scan, &stems, 0.0, 5);
        assert!((left.unwrap() - 0.4).abs() < 1e-12 && (right.unwrap() - 0.3).abs() < 1e-12);
        assert_eq!(label(&scan, &[false; 181], 0.0, 5), [None, None]);
    }
}
