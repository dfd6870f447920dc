//! The mean of differences, with Student's interval: what is said of any metric of a run.

use furrow_coordinator::moments::Moments;

use crate::table::student_interval;

/// Mean and spread of differences.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Difference {
    /// Their mean.
    pub(super) mean: f64,
    /// Its standard error; none for one difference.
    pub(super) standard_error: Option<f64>,
    /// Student's 95 % interval; none for one difference.
    pub(super) ci95: Option<[f64; 2]>,
    /// Cohen's d_z: mean over deviation; none where there is no spread.
    pub(super) d_z: Option<f64>,
}

impl Difference {
    /// Of these differences; none without any.
    pub(super) fn of(differences: &[f64]) -> Option<Self> {
        let moments = moments(differences);
        let mean = mean(&moments)?;
        let std = moments.std().map(|std| if moments.min() == moments.max() { 0.0 } else { std });
        Some(Self {
            mean,
            standard_error: std.map(|std| std / (moments.n() as f64).sqrt()),
            ci95: std.and_then(|std| student_interval(mean, std, moments.n())),
            d_z: std.filter(|std| *std > 0.0).map(|std| mean / std),
        })
    }
}

/// The mean of these values; none without any.
pub(super) fn mean_of(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut moments = Moments::default();
    values.into_iter().for_each(|value| moments.add(value));
    mean(&moments)
}

/// Within the extremes, whatever the last digit.
fn mean(moments: &Moments) -> Option<f64> {
    Some(moments.mean()?.clamp(moments.min()?, moments.max()?))
}

fn moments(values: &[f64]) -> Moments {
    let mut moments = Moments::default();
    values.iter().for_each(|value| moments.add(*value));
    moments
}

#[cfg(test)]
mod tests {
    use super::super::signed_rank::tests::DARWIN;
    use super::*;

    #[test]
    fn darwins_maize_has_the_interval_of_scipy() {
        // ttest_1samp(d, 0).confidence_interval(0.95), scipy 1.17.1.
        let found = Difference::of(&DARWIN).unwrap();
        let [low, high] = found.ci95.unwrap();
        assert!((found.mean - 20.933_333_333_333_334).abs() < 1e-12);
        assert!((low - 0.031_193_318_392_976).abs() < 1e-6 && (high - 41.835_473_348_273_7).abs() < 1e-6);
        assert!((found.d_z.unwrap() - 0.554_607_977_706_518_5).abs() < 1e-12);
    }

    #[test]
    fn one_difference_has_no_spread_and_equal_ones_an_interval_of_a_point() {
        let one = Difference::of(&[2.0]).unwrap();
        assert_eq!((one.mean, one.standard_error, one.ci95, one.d_z), (2.0, None, None, None));
        let same = Difference::of(&[0.1; 3]).unwrap();
        assert_eq!((same.ci95, same.standard_error, same.d_z), (Some([0.1, 0.1]), Some(0.0), None));
        assert_eq!(Difference::of(&[]), None);
    }
}
