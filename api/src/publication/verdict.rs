//! How a published value and ours agree. The rules are in the documentation of [`super`].

use serde::Serialize;

use super::Ours;
use super::reference::ProgramValue;
use crate::table::student_interval;

/// How a published value and ours agree.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// The published value lies within our 95 % interval.
    Inside,
    /// It does not, but the row keeps its place among the others.
    SameRanking,
    /// Neither.
    Different,
    /// We have no run to compare.
    NotRun,
    /// Of a claim: our 95 % interval lies on its side.
    Holds,
    /// Of a claim: our 95 % interval lies on the other side.
    DoesNotHold,
    /// Of a claim: our 95 % interval lies on both sides, or there is none.
    Undecided,
}

impl Verdict {
    /// Its word in JSON.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Inside => "inside",
            Self::SameRanking => "same-ranking",
            Self::Different => "different",
            Self::NotRun => "not-run",
            Self::Holds => "holds",
            Self::DoesNotHold => "does-not-hold",
            Self::Undecided => "undecided",
        }
    }
}

/// A row's published value and our mean.
pub(super) type Pair = (f64, f64);

/// The verdict on `published` and `ours`, with the other rows that have both in the same column.
pub(super) fn judge(published: f64, ours: &Ours, others: &[Pair]) -> Verdict {
    if inside(published, ours) {
        Verdict::Inside
    } else if keeps_its_place((published, ours.mean), others) {
        Verdict::SameRanking
    } else {
        Verdict::Different
    }
}

fn inside(published: f64, ours: &Ours) -> bool {
    match ours.ci95 {
        Some([low, high]) if low < high => (low..=high).contains(&published),
        _ => (published - ours.mean).abs() <= 1e-9 * published.abs(),
    }
}

/// Whether each other row whose published value differs is on the same side of this one in ours.
fn keeps_its_place((published, ours): Pair, others: &[Pair]) -> bool {
    let agrees = |(their_published, their_ours): &Pair| {
        let order = published.total_cmp(their_published);
        order.is_eq() || order == ours.total_cmp(their_ours)
    };
    !others.is_empty() && others.iter().all(agrees)
}

/// The 95 % interval of the authors' program's value: its own where it is known, else as wide as ours would be
/// with as many runs, or wider where the program's mean and median are far apart: no deviation is less than their
/// distance. None where ours has no interval.
pub(super) fn interval_of_program(program: &ProgramValue, ours: &Ours) -> Option<[f64; 2]> {
    if program.ci95.is_some() {
        return program.ci95;
    }
    let [low, high] = ours.ci95?;
    let scaled = (high - low) / 2.0 * (ours.n as f64 / program.runs as f64).sqrt();
    let distance = program.median.map_or(0.0, |median| (program.value - median).abs());
    let least = student_interval(0.0, distance, program.runs).map_or(0.0, |[_, high]| high);
    let half = scaled.max(least);
    Some([program.value - half, program.value + half])
}

/// Whether two independent means agree: the 95 % interval of their difference, from both intervals as in
/// [`interval_of_means`], holds 0.
pub(super) fn agree(a: (f64, [f64; 2]), b: (f64, [f64; 2])) -> bool {
    let (low, high) = if a.0 <= b.0 { (a, b) } else { (b, a) };
    high.0 - low.0 <= (low.1[1] - low.0).hypot(high.0 - high.1[0])
}

/// The 95 % interval of the mean of several independent means, by adding up the squared distances of each one's
/// interval to its mean, each end by itself (Zou and Donner 2008). It holds for ratios near the ends of the
/// scale too, where a normal interval does not. None where one of them has no interval.
pub(super) fn interval_of_means(means: &[Ours]) -> Option<[f64; 2]> {
    let n = means.len() as f64;
    let centre = means.iter().map(|ours| ours.mean).sum::<f64>() / n;
    let mut squares = [0.0, 0.0];
    for ours in means {
        let ends = ours.ci95?;
        squares[0] += (ours.mean - ends[0]).powi(2);
        squares[1] += (ends[1] - ours.mean).powi(2);
    }
    Some([centre - squares[0].sqrt() / n, centre + squares[1].sqrt() / n])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ours(mean: f64, ci95: Option<[f64; 2]>) -> Ours {
        Ours { mean, median: None, ci95, n: 5 }
    }

    #[test]
    fn a_value_on_the_end_of_the_interval_is_inside() {
        let ours = ours(1.0, Some([0.8, 1.0]));
        assert_eq!(judge(0.8, &ours, &[]), Verdict::Inside);
        assert_eq!(judge(1.0, &ours, &[]), Verdict::Inside);
        assert_eq!(judge(0.79, &ours, &[]), Verdict::Different);
    }

    #[test]
    fn without_an_interval_only_the_same_value_is_inside() {
        for interval in [None, Some([40.1, 40.1])] {
            assert_eq!(judge(40.1, &ours(40.1, interval), &[]), Verdict::Inside);
            assert_eq!(judge(40.0, &ours(40.1, interval), &[]), Verdict::Different);
        }
    }

    #[test]
    fn a_finder_keeps_its_place_if_no_pair_it_is_in_is_turned_round() {
        let mine = ours(70.0, Some([69.0, 71.0]));
        assert_eq!(judge(65.0, &mine, &[(430.0, 300.0), (60.0, 61.0)]), Verdict::SameRanking);
        assert_eq!(judge(65.0, &mine, &[(430.0, 69.0), (60.0, 61.0)]), Verdict::Different);
        assert_eq!(judge(65.0, &mine, &[]), Verdict::Different);
    }

    #[test]
    fn published_ties_allow_any_order_but_our_ties_do_not_stand_for_one() {
        let mine = ours(0.5, Some([0.4, 0.6]));
        assert_eq!(judge(1.0, &mine, &[(1.0, 0.9)]), Verdict::SameRanking);
        assert_eq!(judge(1.0, &mine, &[(0.8, 0.5)]), Verdict::Different);
    }

    #[test]
    fn the_interval_of_a_mean_of_means_adds_up_in_squares() {
        let four = [ours(1.0, Some([0.8, 1.0])); 4];
        let [low, high] = interval_of_means(&four).unwrap();
        assert!((low - 0.9).abs() < 1e-12 && high == 1.0);
        assert_eq!(interval_of_means(&[ours(1.0, None), ours(1.0, Some([0.0, 1.0]))]), None);
    }

    #[test]
    fn means_agree_if_their_difference_may_be_nothing() {
        assert!(agree((1.0, [0.0, 2.0]), (2.0, [1.0, 3.0])));
        assert!(agree((2.0, [1.0, 3.0]), (1.0, [0.0, 2.0])));
        assert!(!agree((1.0, [0.5, 1.5]), (2.0, [1.5, 2.5])), "0.71 is less than 1");
        assert!(agree((0.0, [0.0, 1.2]), (1.0, [0.9, 1.0])));
        assert!(!agree((1.0, [1.0, 1.0]), (2.0, [2.0, 2.0])));
    }

    #[test]
    fn the_program_is_as_uncertain_as_its_runs_are_few() {
        let program = ProgramValue { value: 10.0, median: None, runs: 20, ci95: None };
        assert_eq!(interval_of_program(&program, &ours(3.0, Some([1.0, 5.0]))), Some([9.0, 11.0]));
        assert_eq!(interval_of_program(&program, &ours(3.0, None)), None);
        let skewed = ProgramValue { median: Some(0.0), runs: 4, ..program };
        let [low, high] = interval_of_program(&skewed, &ours(3.0, Some([2.9, 3.1]))).unwrap();
        assert!((low + 5.91).abs() < 0.01 && (high - 25.91).abs() < 0.01, "[{low}, {high}]: 3.18 x 10 / 2");
        let ratio = ProgramValue { ci95: Some([0.0, 1.0]), ..program };
        assert_eq!(interval_of_program(&ratio, &ours(3.0, None)), Some([0.0, 1.0]));
    }
}
