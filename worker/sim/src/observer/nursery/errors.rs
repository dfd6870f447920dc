//! The distance between the robot and the middle of its lane.

/// All samples of one run.
#[derive(Debug, Clone, Default)]
pub(super) struct Errors(Vec<f64>);

/// What the thesis reports of them \[m\].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Summary {
    pub(super) mean_m: f64,
    /// Needs two samples.
    pub(super) std_m: Option<f64>,
    /// The largest of the smaller 99 %.
    pub(super) p99_m: f64,
    pub(super) max_m: f64,
}

impl Errors {
    /// A sample \[m\], of either sign.
    pub(super) fn add(&mut self, across_m: f64) {
        self.0.push(across_m.abs());
    }

    /// None without samples.
    pub(super) fn summary(mut self) -> Option<Summary> {
        let n = self.0.len();
        let mean_m = self.0.iter().sum::<f64>() / n as f64;
        let squares: f64 = self.0.iter().map(|error| (error - mean_m) * (error - mean_m)).sum();
        self.0.sort_unstable_by(f64::total_cmp);
        let max_m = *self.0.last()?;
        let p99_m = self.0[(n * 99).div_ceil(100).max(1) - 1];
        Some(Summary { mean_m, std_m: (n > 1).then(|| (squares / (n - 1) as f64).sqrt()), p99_m, max_m })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_largest_hundredth_is_no_part_of_the_p99() {
        let mut errors = Errors::default();
        (1..=200).for_each(|i| errors.add(0.01 * f64::from(i) * if i % 2 == 0 { 1.0 } else { -1.0 }));
        let summary = errors.summary().unwrap();
        assert_eq!((summary.p99_m, summary.max_m), (1.98, 2.0));
        assert!((summary.mean_m - 1.005).abs() < 1e-12);
        assert!((summary.std_m.unwrap() - 0.01 * (200.0_f64 * 201.0 / 12.0).sqrt()).abs() < 1e-12);
    }

    #[test]
    fn one_sample_has_no_deviation_and_none_no_summary() {
        let mut errors = Errors::default();
        errors.add(-0.3);
        assert_eq!(errors.summary(), Some(Summary { mean_m: 0.3, std_m: None, p99_m: 0.3, max_m: 0.3 }));
        assert_eq!(Errors::default().summary(), None);
    }
}
