//! Intervals of 95 % for ratios of sums, and for what is made of several of them, by the bootstrap over runs.
//!
//! Each group's runs are drawn anew with replacement, 2,000 times, by a generator of our own with a fixed seed from runs
//! in the order of their values: the interval is a function of the set of runs. Its ends are the bias-corrected and
//! accelerated ones (BCa; Efron 1987), with the acceleration from the empirical influence of each run, which does not
//! depend on the scale (Davison and Hinkley 1997, sections 5.3.2 and 5.4.1).
//!
//! # Nothing below the line
//! A resample whose denominators sum up to nothing, as one without an intervention, counts as infinite: if there are
//! enough of them the interval is open above. One that has nothing above the line either says nothing and is left out.
//! Where the runs themselves have nothing below the line there is no interval: no resample can differ.
//!
//! From 2,000 runs on, where the bootstrap takes long and the distribution is normal, the interval is the mean plus and
//! minus 1.96 standard errors, the latter from the same influences.

use statrs::distribution::{ContinuousCDF, Normal};

use super::pairs::Pairs;

/// Resamples.
pub(crate) const RESAMPLES: usize = 2_000;

/// From so many runs on the interval is the normal one.
pub(crate) const NORMAL_FROM: usize = 2_000;

/// The 97.5 % quantile of the standard normal distribution.
pub(crate) const Z_975: f64 = 1.959_963_984_540_054;

/// What is made of the ratios of groups of runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Contrast {
    /// The ratio of the only group.
    Alone,
    /// The ratio of the first group over that of the second.
    Quotient,
    /// By how much the ratio of the first group is above the largest of the others.
    Lead,
}

impl Contrast {
    /// The figure for these groups; none where a denominator is nothing.
    pub(crate) fn of(self, groups: &[&Pairs]) -> Option<f64> {
        let ratios: Option<Vec<f64>> = groups.iter().map(|group| group.ratio()).collect();
        Some(self.value(&ratios?)).filter(|value| value.is_finite())
    }

    fn value(self, ratios: &[f64]) -> f64 {
        match self {
            Self::Alone => ratios[0],
            Self::Quotient => ratios[0] / ratios[1],
            Self::Lead => ratios[0] - ratios[largest(&ratios[1..]) + 1],
        }
    }

    /// The slope of the figure over the ratio of each group.
    fn slopes(self, ratios: &[f64]) -> Vec<f64> {
        match self {
            Self::Alone => vec![1.0],
            Self::Quotient => vec![1.0 / ratios[1], -ratios[0] / (ratios[1] * ratios[1])],
            Self::Lead => {
                let mut slopes = vec![0.0; ratios.len()];
                slopes[0] = 1.0;
                slopes[largest(&ratios[1..]) + 1] = -1.0;
                slopes
            }
        }
    }
}

/// The place of the largest.
fn largest(ratios: &[f64]) -> usize {
    (0..ratios.len()).max_by(|a, b| ratios[*a].total_cmp(&ratios[*b])).unwrap_or_default()
}

/// The 95 % interval of a figure, of which an end may be infinite. None where the figure is, and where a group has
/// fewer than two runs.
pub(crate) fn interval(contrast: Contrast, groups: &[&Pairs]) -> Option<[f64; 2]> {
    let estimate = contrast.of(groups)?;
    if groups.iter().any(|group| group.n() < 2) {
        return None;
    }
    let influences = influences(contrast, groups)?;
    if groups.iter().map(|group| group.runs().len()).sum::<usize>() >= NORMAL_FROM {
        let half = Z_975 * influences.iter().map(|influence| influence * influence).sum::<f64>().sqrt();
        return Some([estimate - half, estimate + half]);
    }
    let mut figures = resampled(contrast, groups);
    figures.sort_by(f64::total_cmp);
    accelerated_ends(&figures, estimate, estimate.abs(), acceleration(&influences))
}

/// By how much each run moves the figure.
pub(super) fn influences(contrast: Contrast, groups: &[&Pairs]) -> Option<Vec<f64>> {
    let ratios: Vec<f64> = groups.iter().map(|group| group.ratio()).collect::<Option<_>>()?;
    let slopes = contrast.slopes(&ratios);
    let mut influences = Vec::new();
    for ((group, ratio), slope) in groups.iter().zip(&ratios).zip(slopes) {
        let [_, denominator] = group.sums();
        let influence = |run: &[f64; 2]| slope * (run[0] - ratio * run[1]) / denominator;
        influences.extend(group.runs().iter().map(influence));
    }
    Some(influences)
}

/// The acceleration of BCa from the influence of each draw.
pub(crate) fn acceleration(influences: &[f64]) -> f64 {
    let squares: f64 = influences.iter().map(|influence| influence * influence).sum();
    let cubes: f64 = influences.iter().map(|influence| influence.powi(3)).sum();
    let acceleration = cubes / (6.0 * squares.powf(1.5));
    if acceleration.is_finite() { acceleration } else { 0.0 }
}

/// The figure of each resample that has one.
fn resampled(contrast: Contrast, groups: &[&Pairs]) -> Vec<f64> {
    let mut draws = Draws::new();
    let mut ratios = vec![0.0; groups.len()];
    let mut figure = || {
        for (ratio, group) in ratios.iter_mut().zip(groups) {
            let runs = group.runs();
            let mut sums = [0.0, 0.0];
            for _ in 0..runs.len() {
                let run = runs[draws.below(runs.len())];
                sums = [sums[0] + run[0], sums[1] + run[1]];
            }
            *ratio = sums[0] / sums[1];
        }
        contrast.value(&ratios)
    };
    (0..RESAMPLES).map(|_| figure()).filter(|figure| !figure.is_nan()).collect()
}

/// The ends of the BCa interval among sorted figures; `magnitude` is that of what they are computed from.
pub(crate) fn accelerated_ends(figures: &[f64], estimate: f64, magnitude: f64, acceleration: f64) -> Option<[f64; 2]> {
    let normal = Normal::new(0.0, 1.0).ok()?;
    let n = figures.len() as f64;
    if figures.is_empty() {
        return None;
    }
    // Sums of the same runs in another order differ in their last digits.
    let slack = 1e-12 * magnitude;
    let below = figures.partition_point(|figure| *figure < estimate - slack) as f64;
    let not_above = figures.partition_point(|figure| *figure <= estimate + slack) as f64;
    let share = (0.5 * (below + not_above) / n).clamp(0.5 / n, 1.0 - 0.5 / n);
    let bias = normal.inverse_cdf(share);
    let level = |z: f64| normal.cdf(bias + (bias + z) / (1.0 - acceleration * (bias + z)));
    let last = figures.len() - 1;
    let at = |place: f64| figures[(place.max(0.0) as usize).min(last)];
    Some([at((level(-Z_975) * n).floor() - 1.0), at((level(Z_975) * n).ceil())])
}

/// SplitMix64 (Steele, Lea and Flood 2014).
pub(crate) struct Draws(u64);

impl Draws {
    /// The draws of every interval.
    pub(crate) fn new() -> Self {
        Self(0x0046_7572_726f_7721)
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Sixty-four random bits.
    pub(crate) fn bits(&mut self) -> u64 {
        self.next()
    }

    /// A number from 0 to below `n`, which is at most 2^32.
    pub(crate) fn below(&mut self, n: usize) -> usize {
        (((self.next() >> 32) * n as u64) >> 32) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn means(values: &[f64]) -> Pairs {
        Pairs::of_values(values)
    }

    #[test]
    fn the_generator_is_splitmix64() {
        let mut draws = Draws(1_234_567);
        assert_eq!([draws.next(), draws.next()], [6_457_827_717_110_365_317, 3_203_168_211_198_807_973]);
    }

    #[test]
    fn runs_that_are_all_alike_have_an_interval_of_one_point() {
        let alike = Pairs::of([[110.0, 2.0]; 7]);
        assert_eq!(interval(Contrast::Alone, &[&alike]), Some([55.0, 55.0]));
    }

    #[test]
    fn two_runs_give_what_the_four_resamples_by_hand_give() {
        // Of (100 m, 1) and (100 m, 4): 100 m in a quarter of the resamples, 40 m in half of them, 25 m in a quarter.
        let two = Pairs::of([[100.0, 1.0], [100.0, 4.0]]);
        assert_eq!(two.ratio(), Some(40.0));
        assert_eq!(interval(Contrast::Alone, &[&two]), Some([25.0, 100.0]));
        let figures = resampled(Contrast::Alone, &[&two]);
        for (figure, share) in [(100.0, 0.25), (40.0, 0.5), (25.0, 0.25)] {
            let found = figures.iter().filter(|other| **other == figure).count() as f64 / RESAMPLES as f64;
            assert!((found - share).abs() < 0.04, "{figure}: {found}");
        }
    }

    #[test]
    fn the_interval_of_a_mean_is_nearly_the_normal_one() {
        let values: Vec<f64> = (0..1000).map(|i| f64::from(i) / 1000.0).collect();
        let [low, high] = interval(Contrast::Alone, &[&means(&values)]).unwrap();
        // The deviation of 1,000 even steps is 0.2887.
        let half = Z_975 * 0.2887 / 1000_f64.sqrt();
        assert!((low - 0.4995 + half).abs() < 0.002 && (high - 0.4995 - half).abs() < 0.002, "[{low}, {high}]");
    }

    #[test]
    fn many_runs_have_the_normal_interval_and_it_is_where_the_bootstrap_s_is() {
        let run = |i: usize| [200.0 + (i % 7) as f64, (i % 3) as f64];
        let (fewer, more) = (Pairs::of((0..NORMAL_FROM - 1).map(run)), Pairs::of((0..NORMAL_FROM + 1).map(run)));
        let (a, b) = (interval(Contrast::Alone, &[&fewer]).unwrap(), interval(Contrast::Alone, &[&more]).unwrap());
        let width = b[1] - b[0];
        assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 0.1 * width), "{a:?} {b:?}");
    }

    #[test]
    fn a_skewed_figure_has_a_skewed_interval() {
        let counts = [1.0, 0.0, 2.0, 1.0, 0.0, 3.0, 1.0, 0.0, 1.0, 1.0];
        let lanes = Pairs::of(counts.map(|count| [220.0, count]));
        let [low, high] = interval(Contrast::Alone, &[&lanes]).unwrap();
        assert!(low < 220.0 && 220.0 < high && high - 220.0 > 220.0 - low, "[{low}, {high}]");
    }

    #[test]
    fn a_quotient_and_a_lead_compare_groups() {
        let (often, seldom) = (Pairs::of([[100.0, 4.0]; 3]), Pairs::of([[100.0, 1.0]; 3]));
        assert_eq!(Contrast::Quotient.of(&[&seldom, &often]), Some(4.0));
        assert_eq!(interval(Contrast::Quotient, &[&seldom, &often]), Some([4.0, 4.0]));
        let (worst, middle, best) = (means(&[9.0, 9.0]), means(&[3.0, 5.0]), means(&[1.0, 1.0]));
        assert_eq!(Contrast::Lead.of(&[&worst, &best, &middle]), Some(5.0));
        assert_eq!(interval(Contrast::Lead, &[&worst, &best, &middle]), Some([4.0, 6.0]));
    }

    #[test]
    fn a_group_without_anything_below_the_line_has_no_interval() {
        let (none, some) = (Pairs::of([[100.0, 0.0]; 3]), Pairs::of([[100.0, 1.0]; 3]));
        assert_eq!(interval(Contrast::Quotient, &[&none, &some]), None);
        assert_eq!(interval(Contrast::Alone, &[&none]), None);
    }

    #[test]
    fn resamples_with_nothing_on_either_side_of_the_line_are_left_out() {
        let shares = Pairs::of([[1.0, 2.0], [0.0, 0.0], [0.0, 0.0], [2.0, 2.0]]);
        assert!(resampled(Contrast::Alone, &[&shares]).len() < RESAMPLES);
        let [low, high] = interval(Contrast::Alone, &[&shares]).unwrap();
        assert!((0.5..=0.75).contains(&low) && (0.75..=1.0).contains(&high), "[{low}, {high}]");
    }
}
