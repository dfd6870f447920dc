//! How far the robot was from the lane's middle, and how wrong about it.

use std::collections::BTreeMap;

use super::{Heard, spectrum};

/// Sums of a run.
#[derive(Default)]
pub(super) struct Errors {
    /// Cross-track error at 20 Hz \[m\], positive to the left.
    cross_track_m: Vec<f64>,
    /// Where stretches without an intervention begin in it.
    stretches: Vec<usize>,
    scans: f64,
    /// Sums of the squares of errors of both distances and the heading.
    squares: [f64; 3],
    /// Scans in which the finder calls each side, and the heading, valid.
    valid: [u32; 3],
}

impl Errors {
    pub(super) fn begin_stretch(&mut self) {
        self.stretches.push(self.cross_track_m.len());
    }

    pub(super) fn observe(&mut self, across_m: f64) {
        self.cross_track_m.push(across_m);
    }

    pub(super) fn hear(&mut self, heard: &Heard<'_>) {
        let Heard { place, view, estimate, .. } = heard;
        let off = [
            estimate.left_m - place.left_m,
            estimate.right_m - place.right_m,
            libm::remainder(estimate.heading_rad - place.heading_rad, std::f64::consts::TAU),
        ];
        self.scans += 1.0;
        for (square, off) in self.squares.iter_mut().zip(off) {
            *square += off * off;
        }
        for (count, valid) in self.valid.iter_mut().zip([view.left.valid, view.right.valid, view.heading_valid]) {
            *count += u32::from(valid);
        }
    }

    pub(super) fn report(&self, metrics: &mut BTreeMap<&'static str, f64>) {
        let mut off_m: Vec<_> = self.cross_track_m.iter().map(|off_m| off_m.abs()).collect();
        off_m.sort_by(f64::total_cmp);
        let n = off_m.len() as f64;
        metrics.insert("cross_track_mean_m", off_m.iter().sum::<f64>() / n);
        metrics.insert("cross_track_rms_m", (off_m.iter().map(|off_m| off_m * off_m).sum::<f64>() / n).sqrt());
        // The smallest value that is not below 99 % of them.
        let rank = (0.99 * n).ceil().max(1.0) as usize - 1;
        metrics.extend(off_m.get(rank).map(|off_m| ("cross_track_p99_m", *off_m)));
        metrics.extend(spectrum::dominant_hz(&self.cross_track_m, &self.stretches).map(|hz| ("oscillation_hz", hz)));
        let rms = self.squares.map(|squares| (squares / self.scans).sqrt());
        metrics.insert("left_distance_error_rms_m", rms[0]);
        metrics.insert("right_distance_error_rms_m", rms[1]);
        metrics.insert("heading_error_rms_rad", rms[2]);
        let percent = self.valid.map(|valid| 100.0 * f64::from(valid) / self.scans);
        metrics.insert("view_valid_left_percent", percent[0]);
        metrics.insert("view_valid_right_percent", percent[1]);
        metrics.insert("view_valid_heading_percent", percent[2]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hundred_offsets_have_the_mean_rms_and_percentile_that_they_should() {
        let mut errors = Errors::default();
        errors.begin_stretch();
        (1..=100).for_each(|i| errors.observe(if i % 2 == 0 { 0.01 } else { -0.01 } * f64::from(i)));
        let mut metrics = BTreeMap::new();
        errors.report(&mut metrics);
        assert!((metrics["cross_track_mean_m"] - 0.505).abs() < 1e-12);
        assert!((metrics["cross_track_rms_m"] - f64::sqrt(0.33835)).abs() < 1e-12);
        assert!((metrics["cross_track_p99_m"] - 0.99).abs() < 1e-12);
    }
}
