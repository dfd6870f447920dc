//! The answer: per metric, over all pairs and by group.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use serde::Serialize;

use super::bootstrap::{self, Row};
use super::difference::{Difference, mean_of};
use super::holm::holm;
use super::pairing::{Cells, Pair, Side, SweepRuns, pair};
use super::question::Resolved;
use super::sign_flip::sign_flip;
use super::signed_rank::signed_rank;
use super::{mcnemar, seeds, tango};
use crate::table::{Metric, OfSums};

/// Two levels of a factor, or two sweeps, compared in pairs of runs that differ in nothing else.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
#[schema(as = PairedComparison)]
pub struct Comparison {
    /// The factor of which two levels are compared; null where two sweeps are compared in all cells.
    pub factor: Option<String>,
    /// The label on side a.
    pub a: Option<String>,
    /// The label on side b.
    pub b: Option<String>,
    /// The factors whose labels make a pair, beside the seed.
    pub paired_by: Vec<String>,
    /// The factors of the groups.
    pub group_by: Vec<String>,
    /// The metrics, with titles and units.
    pub metrics: Vec<Metric>,
    /// So many tests the values `p_holm` are corrected for.
    pub tests: u64,
    /// All pairs, with no factors; behind that the groups, in the plan's order.
    pub groups: Vec<GroupComparison>,
}

/// The pairs of one group.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct GroupComparison {
    /// Label by factor; none for all pairs.
    pub factors: BTreeMap<String, String>,
    /// How many pairs there are.
    #[serde(flatten)]
    pub counts: PairCounts,
    /// What is said, by metric.
    pub metrics: BTreeMap<String, MetricComparison>,
}

/// Pairs, and what kept runs from being in one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, utoipa::ToSchema)]
pub struct PairCounts {
    /// Pairs with a result on both sides.
    pub pairs: u64,
    /// Different seeds among them.
    pub seeds: u64,
    /// Pairs of which a side has no result, or both have none.
    pub incomplete: u64,
    /// Of these, those with a result of a.
    pub only_a: u64,
    /// Of these, those with a result of b.
    pub only_b: u64,
    /// Jobs of a that were given up on.
    pub failed_a: u64,
    /// Jobs of b that were given up on.
    pub failed_b: u64,
    /// Runs that are in no pair since nothing says to which others they belong: of pools that vary something else.
    pub ambiguous: u64,
}

/// What is said of one metric.
#[derive(Debug, Clone, PartialEq, Default, Serialize, utoipa::ToSchema)]
pub struct MetricComparison {
    /// Pairs in which both runs have a value.
    pub n: u64,
    /// Pairs with results in which a value is missing.
    pub undefined: u64,
    /// The mean of a, or its ratio of sums, over these pairs.
    pub a: Option<f64>,
    /// That of b.
    pub b: Option<f64>,
    /// The mean of a - b, or the difference of the ratios.
    pub difference: Option<f64>,
    /// The 95 % interval of the difference; null where it is not defined, or has an open end.
    #[schema(value_type = Option<Vec<f64>>)]
    pub ci95: Option<[f64; 2]>,
    /// What kind of interval that is: `student`, `tango` or `bootstrap`.
    pub interval: &'static str,
    /// Beside Student's interval, that of the bootstrap over pairs.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<Vec<f64>>)]
    pub bootstrap_ci95: Option<[f64; 2]>,
    /// The test: `mcnemar-exact`, `wilcoxon-exact`, `wilcoxon-normal`, `sign-flip-exact`, `sign-flip-thrown` or
    /// `sign-flip-normal`; null where there is none.
    pub test: Option<&'static str>,
    /// Its two-sided p value.
    pub p: Option<f64>,
    /// The same, corrected for all tests of the answer (Holm).
    pub p_holm: Option<f64>,
    /// Differences of 0, which Wilcoxon's test drops.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub zeros: Option<u64>,
    /// How success falls on the two sides.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub two_by_two: Option<TwoByTwo>,
    /// The odds ratio of matched pairs, `only_a` over `only_b`; null if b alone never succeeds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub odds_ratio: Option<f64>,
    /// Its exact 95 % interval; an end that is null is open.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<Vec<Option<f64>>>)]
    pub odds_ratio_ci95: Option<[Option<f64>; 2]>,
    /// Cohen's d_z: mean over standard deviation of the differences.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub d_z: Option<f64>,
    /// Matched-pairs rank-biserial correlation, -1 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rank_biserial: Option<f64>,
    /// About how many more seeds per cell until the interval of the difference excludes 0, if all stays as it is; 0 if
    /// it does, null where no number can be named.
    pub more_seeds: Option<u64>,
}

/// Pairs by which side succeeds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, utoipa::ToSchema)]
pub struct TwoByTwo {
    /// Both.
    pub both: u64,
    /// Only a.
    pub only_a: u64,
    /// Only b.
    pub only_b: u64,
    /// Neither.
    pub neither: u64,
}

/// Compares the runs of side `a` with those of side `b`; within one sweep both are of that.
#[must_use]
pub fn compare(question: &Resolved, a: &SweepRuns, b: &SweepRuns) -> Comparison {
    let cells = pair(question, a, b);
    let all: Vec<&Cells<'_>> = cells.iter().collect();
    let mut groups = vec![group(question, BTreeMap::new(), &all)];
    if !question.group_by.is_empty() {
        groups.extend(by_labels(question, &cells).into_iter().map(|(factors, cells)| group(question, factors, &cells)));
    }
    let tests = correct(&mut groups, &question.metrics);
    let [a, b] = question.labels.clone().map_or([None, None], |labels| labels.map(Some));
    Comparison {
        factor: question.factor.clone(),
        a,
        b,
        paired_by: question.paired.clone(),
        group_by: question.group_by.clone(),
        metrics: question.metrics.clone(),
        tests,
        groups,
    }
}

type Group<'a, 'b> = (BTreeMap<String, String>, Vec<&'b Cells<'a>>);

/// The cells with the same labels of the factors to group by, in the plan's order of levels.
fn by_labels<'a, 'b>(question: &Resolved, cells: &'b [Cells<'a>]) -> Vec<Group<'a, 'b>> {
    let place = |factor: &String| question.paired.iter().position(|other| other == factor);
    let places: Vec<usize> = question.group_by.iter().filter_map(place).collect();
    let mut ranks: Vec<HashMap<&str, usize>> = vec![HashMap::new(); places.len()];
    let mut groups: BTreeMap<Vec<usize>, Group<'_, '_>> = BTreeMap::new();
    for cell in cells {
        let rank = |(ranks, place): (&mut HashMap<&'a str, usize>, &usize)| {
            let next = ranks.len();
            *ranks.entry(cell.labels[*place]).or_insert(next)
        };
        let key: Vec<usize> = ranks.iter_mut().zip(&places).map(rank).collect();
        let labels = || places.iter().map(|place| (question.paired[*place].clone(), cell.labels[*place].to_owned()));
        groups.entry(key).or_insert_with(|| (labels().collect(), Vec::new())).1.push(cell);
    }
    groups.into_values().collect()
}

fn group(question: &Resolved, factors: BTreeMap<String, String>, cells: &[&Cells<'_>]) -> GroupComparison {
    let counts = count(cells);
    let of = |metric: &Metric| (metric.name.to_string(), of_metric(metric, cells, &counts));
    GroupComparison { factors, counts, metrics: question.metrics.iter().map(of).collect() }
}

fn count(cells: &[&Cells<'_>]) -> PairCounts {
    let mut counts = PairCounts::default();
    let mut seeds = BTreeSet::new();
    for cells in cells {
        counts.ambiguous += cells.ambiguous;
        for Pair { seed, a, b } in &cells.pairs {
            let done = [a, b].map(|side| matches!(side, Side::Done(_)));
            counts.failed_a += u64::from(*a == Side::Failed);
            counts.failed_b += u64::from(*b == Side::Failed);
            match done {
                [true, true] => {
                    counts.pairs += 1;
                    seeds.insert(*seed);
                }
                [in_a, in_b] => {
                    counts.incomplete += 1;
                    counts.only_a += u64::from(in_a);
                    counts.only_b += u64::from(in_b);
                }
            }
        }
    }
    counts.seeds = seeds.len() as u64;
    counts
}

fn of_metric(metric: &Metric, cells: &[&Cells<'_>], counts: &PairCounts) -> MetricComparison {
    let mut said = match metric.of_sums {
        Some(OfSums { numerator, denominator }) => of_sums(values(cells, &[numerator, denominator]), counts.seeds),
        None => {
            let pairs = values(cells, &[&metric.name]).into_iter().map(|values| [values[0][0], values[1][0]]).collect();
            if metric.ratio { of_success(pairs, counts.seeds) } else { of_values(pairs, counts.seeds) }
        }
    };
    said.undefined = counts.pairs - said.n;
    said
}

/// The values of both sides, in the complete pairs that have all of them.
fn values<const N: usize>(cells: &[&Cells<'_>], names: &[&str; N]) -> Vec<[[f64; N]; 2]> {
    let mut found = Vec::new();
    for cells in cells {
        let columns = [cells.a, cells.b].map(|runs| {
            let values = &runs?.values;
            let column = |name: &str| values.metrics.get(name).or_else(|| values.timings.get(name));
            let columns: Option<Vec<&Vec<Option<f64>>>> = names.iter().map(|name| column(name)).collect();
            columns
        });
        let [Some(a), Some(b)] = columns else { continue };
        let row = |columns: &[&Vec<Option<f64>>], row: usize| -> Option<[f64; N]> {
            let values: Option<Vec<f64>> = columns.iter().map(|column| column[row]).collect();
            values?.try_into().ok()
        };
        for pair in &cells.pairs {
            let (Side::Done(in_a), Side::Done(in_b)) = (pair.a, pair.b) else { continue };
            found.extend(row(&a, in_a).zip(row(&b, in_b)).map(|(a, b)| [a, b]));
        }
    }
    found
}

fn of_success(pairs: Vec<[f64; 2]>, seeds: u64) -> MetricComparison {
    let count = |wanted: [bool; 2]| pairs.iter().filter(|pair| pair.map(|value| value > 0.5) == wanted).count() as u64;
    let [both, only_a, only_b] = [[true, true], [true, false], [false, true]].map(count);
    let n = pairs.len() as u64;
    let ci95 = tango::interval(only_a, only_b, n);
    let difference = Difference::of(&differences(&pairs));
    let more = |difference: Difference| seeds::more(difference.mean, difference.standard_error, seeds, ci95);
    MetricComparison {
        ci95,
        interval: "tango",
        test: (n > 0).then_some("mcnemar-exact"),
        p: (n > 0).then(|| mcnemar::exact(only_a, only_b)),
        two_by_two: Some(TwoByTwo { both, only_a, only_b, neither: n - both - only_a - only_b }),
        odds_ratio: mcnemar::odds_ratio(only_a, only_b),
        odds_ratio_ci95: mcnemar::odds_ratio_interval(only_a, only_b),
        more_seeds: difference.and_then(more),
        ..means(&pairs, difference)
    }
}

fn of_values(pairs: Vec<[f64; 2]>, seeds: u64) -> MetricComparison {
    let differences = differences(&pairs);
    let difference = Difference::of(&differences);
    let test = signed_rank(&differences);
    let mut rows: Vec<Row> = pairs.iter().map(|[a, b]| [*a, 1.0, *b, 1.0]).collect();
    let ci95 = difference.and_then(|difference| difference.ci95);
    let more = |difference: Difference| seeds::more(difference.mean, difference.standard_error, seeds, ci95);
    MetricComparison {
        ci95,
        interval: "student",
        bootstrap_ci95: bootstrap::interval(&mut rows).map(|found| found.ci95),
        test: test.map(|test| if test.exact { "wilcoxon-exact" } else { "wilcoxon-normal" }),
        p: test.map(|test| test.p),
        zeros: test.map(|test| test.zeros),
        d_z: difference.and_then(|difference| difference.d_z),
        rank_biserial: test.map(|test| test.rank_biserial),
        more_seeds: difference.and_then(more),
        ..means(&pairs, difference)
    }
}

fn means(pairs: &[[f64; 2]], difference: Option<Difference>) -> MetricComparison {
    MetricComparison {
        n: pairs.len() as u64,
        a: mean_of(pairs.iter().map(|[a, _]| *a)),
        b: mean_of(pairs.iter().map(|[_, b]| *b)),
        difference: difference.map(|difference| difference.mean),
        ..MetricComparison::default()
    }
}

fn differences(pairs: &[[f64; 2]]) -> Vec<f64> {
    pairs.iter().map(|[a, b]| a - b).collect()
}

fn of_sums(pairs: Vec<[[f64; 2]; 2]>, seeds: u64) -> MetricComparison {
    let mut rows: Vec<Row> = pairs.iter().map(|[[n_a, d_a], [n_b, d_b]]| [*n_a, *d_a, *n_b, *d_b]).collect();
    let found = bootstrap::interval(&mut rows);
    let [a, b] = bootstrap::ratios(&rows);
    let difference = a.zip(b).map(|(a, b)| a - b);
    let ci95 = found.map(|found| found.ci95).filter(|ends| ends.iter().all(|end| end.is_finite()));
    let error = found.map(|found| found.standard_error);
    let test = sign_flip(&rows);
    MetricComparison {
        n: rows.len() as u64,
        a,
        b,
        difference,
        ci95,
        interval: "bootstrap",
        test: test.map(|test| test.name),
        p: test.map(|test| test.p),
        more_seeds: difference.and_then(|difference| seeds::more(difference, error, seeds, ci95)),
        ..MetricComparison::default()
    }
}

/// Corrects all p values of an answer for each other, and says how many they are.
fn correct(groups: &mut [GroupComparison], metrics: &[Metric]) -> u64 {
    let place = |metric: &Metric| metric.name.to_string();
    let mut tests: Vec<&mut MetricComparison> = groups
        .iter_mut()
        .flat_map(|group| group.metrics.iter_mut())
        .filter(|(name, said)| said.p.is_some() && metrics.iter().any(|metric| place(metric) == **name))
        .map(|(_, said)| said)
        .collect();
    let p: Vec<f64> = tests.iter().filter_map(|said| said.p).collect();
    for (said, corrected) in tests.iter_mut().zip(holm(&p)) {
        said.p_holm = Some(corrected);
    }
    p.len() as u64
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::pairing::tests::{cell, question};
    use super::*;
    use crate::paired::Runs;

    type Values = Vec<(u64, Option<[f64; 2]>)>;

    fn sweep(fields: &[(&str, Values, Values)]) -> SweepRuns {
        let side = |algorithm: &str, field: &str, scenario: i64, values: &Values| {
            let runs: Vec<_> = values.iter().map(|(seed, value)| (*seed, scenario, *value)).collect();
            cell(&[("algorithm", algorithm), ("field", field)], &runs)
        };
        let cells = fields.iter().enumerate().flat_map(|(i, (field, a, b))| -> [Runs; 2] {
            let scenario = 2 * i as i64;
            [side("rgop", field, scenario, a), side("rg", field, scenario + 1, b)]
        });
        SweepRuns { cells: cells.collect(), ..SweepRuns::default() }
    }

    fn ask(group_by: &[&str], sweep: &SweepRuns) -> Comparison {
        compare(&question(group_by), sweep, sweep)
    }

    /// Ten pairs in one field, with a failed job and a missing one.
    fn ten() -> SweepRuns {
        let run = |x: f64, success: f64| Some([x, success]);
        let a = (1..=10).map(|seed| (seed, run(seed as f64 + 1.0, 1.0))).chain([(11, None), (12, run(99.0, 1.0))]);
        let b = (1..=10).map(|seed| (seed, run(seed as f64 - (seed % 3) as f64, f64::from(u8::from(seed > 4)))));
        let b = b.chain([(11, run(99.0, 1.0))]);
        sweep(&[("crop-1", a.collect(), b.collect())])
    }

    #[test]
    fn failed_and_missing_runs_are_counted_and_in_no_mean() {
        let answer = ask(&[], &ten());
        let all = &answer.groups[0];
        let counts =
            PairCounts { pairs: 10, seeds: 10, incomplete: 2, only_a: 1, only_b: 1, failed_a: 1, ..all.counts };
        assert_eq!(all.counts, counts);
        assert_eq!((all.counts.failed_b, all.counts.ambiguous), (0, 0));
        let x = &all.metrics["x"];
        // a: 2 to 11; b: 1 to 10 less 1, 2, 0, 1, 2, 0, 1, 2, 0, 1.
        assert_eq!((x.n, x.a, x.b, x.difference), (10, Some(6.5), Some(4.5), Some(2.0)));
        assert!(x.test == Some("wilcoxon-normal") && x.zeros == Some(0) && x.rank_biserial == Some(1.0), "{x:?}");
        let success = &all.metrics["success"];
        assert_eq!(success.two_by_two, Some(TwoByTwo { both: 6, only_a: 4, only_b: 0, neither: 0 }));
        assert_eq!((success.p, success.difference, success.odds_ratio), (Some(0.125), Some(0.4), None));
        assert_eq!((success.interval, x.interval, answer.tests), ("tango", "student", 2));
        assert_eq!(success.p_holm, Some(0.125));
        assert!((x.p_holm.unwrap() - 2.0 * x.p.unwrap()).abs() < 1e-15);
    }

    #[test]
    fn groups_stand_behind_the_whole_in_the_plans_order_and_share_the_correction() {
        let values = |shift: f64| (1..=6).map(|seed| (seed, Some([seed as f64 * shift, 1.0]))).collect::<Values>();
        let answer =
            ask(&["field"], &sweep(&[("crop-2", values(2.0), values(1.0)), ("crop-1", values(1.0), values(1.0))]));
        let labels: Vec<_> = answer.groups.iter().map(|group| group.factors.get("field").cloned()).collect();
        assert_eq!(labels, [None, Some("crop-2".to_owned()), Some("crop-1".to_owned())]);
        assert_eq!(answer.groups.iter().map(|group| group.counts.pairs).collect::<Vec<_>>(), [12, 6, 6]);
        assert_eq!((answer.tests, answer.groups[0].counts.seeds), (6, 6));
        let same = &answer.groups[2].metrics["x"];
        assert_eq!((same.difference, same.p, same.zeros, same.more_seeds), (Some(0.0), Some(1.0), Some(6), None));
    }

    #[test]
    fn without_pairs_nothing_is_said() {
        let answer = ask(&[], &sweep(&[("crop-1", vec![(1, Some([1.0, 1.0]))], vec![(2, Some([1.0, 1.0]))])]));
        let all = &answer.groups[0];
        assert_eq!((all.counts.pairs, all.counts.incomplete, answer.tests), (0, 2, 0));
        let x = &all.metrics["x"];
        assert_eq!((x.n, x.a, x.difference, x.ci95, x.p, x.more_seeds), (0, None, None, None, None, None));
    }

    #[test]
    fn a_ratio_of_sums_has_a_difference_and_a_test() {
        let mut sweep = sweep(&[(
            "lane",
            (1..=8).map(|seed| (seed, Some([0.0, 0.0]))).collect(),
            (1..=8).map(|seed| (seed, Some([0.0, 0.0]))).collect(),
        )]);
        for (runs, counts) in sweep.cells.iter_mut().zip([1.0, 2.0]) {
            runs.values.metrics.insert("distance_m".into(), vec![Some(100.0); 8]);
            runs.values.metrics.insert("relevant_interventions".into(), vec![Some(counts); 8]);
        }
        let name = "distance_per_intervention_m";
        let question = Resolved { metrics: vec![crate::table::metric(name)], ..question(&[]) };
        let answer = compare(&question, &sweep, &sweep);
        let said = &answer.groups[0].metrics[name];
        assert_eq!((said.n, said.a, said.b, said.difference), (8, Some(100.0), Some(50.0), Some(50.0)));
        assert_eq!((said.ci95, said.more_seeds, answer.tests), (Some([50.0, 50.0]), Some(0), 1));
        // Of 256 ways to call the sides, two are as far apart.
        assert_eq!((said.test, said.p), (Some("sign-flip-exact"), Some(2.0 / 256.0)));
    }

    fn values() -> impl Strategy<Value = Values> {
        let value = (-20i32..20, any::<bool>()).prop_map(|(x, good)| [f64::from(x) / 4.0, f64::from(u8::from(good))]);
        proptest::collection::btree_map(1u64..30, proptest::option::weighted(0.9, value), 1..25)
            .prop_map(|values| values.into_iter().collect())
    }

    fn negated(ends: Option<[f64; 2]>) -> Option<[f64; 2]> {
        ends.map(|[low, high]| [-high, -low])
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(30))]
        #[test]
        fn swapping_a_and_b_turns_the_signs_and_nothing_else(a in values(), b in values()) {
            let own = ask(&[], &sweep(&[("crop-1", a.clone(), b.clone())]));
            let other = ask(&[], &sweep(&[("crop-1", b, a)]));
            for name in ["x", "success"] {
                let (own, other) = (&own.groups[0].metrics[name], &other.groups[0].metrics[name]);
                prop_assert_eq!((own.a, own.b, own.p, own.p_holm), (other.b, other.a, other.p, other.p_holm));
                prop_assert_eq!(own.difference, other.difference.map(|difference| -difference));
                prop_assert_eq!((own.ci95, own.bootstrap_ci95), (negated(other.ci95), negated(other.bootstrap_ci95)));
                prop_assert_eq!((own.more_seeds, own.d_z), (other.more_seeds, other.d_z.map(|d_z| -d_z)));
            }
        }

        #[test]
        fn the_order_of_the_runs_leaves_no_trace(
            (a, mixed) in values().prop_flat_map(|a| (Just(a.clone()), Just(a).prop_shuffle())), b in values()
        ) {
            let own = ask(&[], &sweep(&[("crop-1", a, b.clone())]));
            prop_assert_eq!(own, ask(&[], &sweep(&[("crop-1", mixed, b)])));
        }
    }
}
