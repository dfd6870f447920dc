//! Which of two levels has the larger metric.

use serde::Serialize;

use crate::paired::{MetricComparison, Outline, PairedError, Question, SweepRuns, compare, holm};

/// What is said of two levels.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Order {
    /// One level.
    pub a: String,
    /// The other.
    pub b: String,
    /// Pairs of runs.
    pub pairs: u64,
    /// The mean of a - b, or the difference of the ratios.
    pub difference: Option<f64>,
    /// The two-sided p value, corrected for all pairs of levels.
    pub p_holm: Option<f64>,
    /// The look at which it was decided.
    pub decided_at: Option<u32>,
    /// The level with the larger metric, once that is decided.
    pub larger: Option<String>,
}

/// Compares every two levels of `factor` by `metric` at the error rate `error` of look `look`. What `before` has decided
/// stays.
///
/// # Errors
/// The sweep has no such factor or metric.
pub fn order(
    outline: &Outline,
    runs: &SweepRuns,
    [factor, metric]: [&str; 2],
    (look, error): (u32, f64),
    before: &[Order],
) -> Result<Vec<Order>, PairedError> {
    let mut orders = Vec::new();
    for [a, b] in pairs(outline, factor)? {
        let [side_a, side_b] = [&a, &b].map(|label| Some(label.clone()));
        let (of, by) = (Some(factor.to_owned()), Some(metric.to_owned()));
        let question = Question { factor: of, a: side_a, b: side_b, metric: by, group_by: None };
        let answer = compare(&question.resolve(outline, None)?, runs, runs);
        let said = &answer.groups[0].metrics[metric];
        let sign = direction(said);
        orders.push((Order::of([a, b], said.n, said.difference, said.p), sign));
    }
    correct(&mut orders);
    let settled = orders.into_iter().map(|(mut order, sign)| {
        let earlier = before.iter().find(|other| (&other.a, &other.b) == (&order.a, &order.b));
        let earlier = earlier.filter(|other| other.decided_at.is_some());
        if let Some(earlier) = earlier {
            (order.decided_at, order.larger) = (earlier.decided_at, earlier.larger.clone());
        } else if order.p_holm.is_some_and(|p| p <= error) && sign != 0.0 {
            order.decided_at = Some(look);
            order.larger = Some(if sign > 0.0 { order.a.clone() } else { order.b.clone() });
        }
        order
    });
    Ok(settled.collect())
}

impl Order {
    fn of([a, b]: [String; 2], pairs: u64, difference: Option<f64>, p: Option<f64>) -> Self {
        Self { a, b, pairs, difference, p_holm: p, decided_at: None, larger: None }
    }
}

/// Every two levels of the factor, in the plan's order.
fn pairs(outline: &Outline, factor: &str) -> Result<Vec<[String; 2]>, PairedError> {
    let labels = outline.levels(factor)?;
    let mut pairs = Vec::new();
    for (i, a) in labels.iter().enumerate() {
        pairs.extend(labels[i + 1..].iter().map(|b| [(*a).to_owned(), (*b).to_owned()]));
    }
    Ok(pairs)
}

/// The sign of a - b; 0 where the ranks say otherwise. A ratio with nothing below the line is larger than any other.
fn direction(said: &MetricComparison) -> f64 {
    let sign = |value: f64| if value == 0.0 { 0.0 } else { value.signum() };
    match (said.difference.map(sign), said.rank_biserial.map(sign)) {
        (Some(difference), Some(ranks)) if difference != ranks => 0.0,
        (Some(difference), _) => difference,
        (None, _) => f64::from(i8::from(said.b.is_some()) - i8::from(said.a.is_some())),
    }
}

fn correct(orders: &mut [(Order, f64)]) {
    let p: Vec<f64> = orders.iter().map(|(order, _)| order.p_holm.unwrap_or(1.0)).collect();
    for ((order, _), corrected) in orders.iter_mut().zip(holm(&p)) {
        order.p_holm = order.p_holm.map(|_| corrected);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::paired::test_sweep;
    use crate::sequential::{error_rate_of, next_seeds};
    use crate::table::Draws;

    /// What the looks at up to 60 seeds say of three levels whose runs succeed with these chances.
    fn search(chances: [f64; 3], draws: &mut Draws) -> Vec<Order> {
        let mut runs: [Vec<[f64; 2]>; 3] = Default::default();
        let (mut before, mut seeds) = (Vec::new(), 5);
        for look in 1.. {
            for (runs, chance) in runs.iter_mut().zip(chances) {
                while runs.len() < seeds as usize {
                    let hit = f64::from(u8::from((draws.below(1_000_000) as f64) < chance * 1e6));
                    runs.push([draws.below(1_000) as f64 * 0.01, hit]);
                }
            }
            let (outline, sweep) = test_sweep([("a", &runs[0]), ("b", &runs[1]), ("c", &runs[2])]);
            before = order(&outline, &sweep, ["algorithm", "success"], (look, error_rate_of(look)), &before).unwrap();
            if seeds == 60 || before.iter().all(|order| order.larger.is_some()) {
                return before;
            }
            seeds = next_seeds(seeds, 60);
        }
        unreachable!("seeds grow to 60")
    }

    #[test]
    fn what_differs_is_put_in_order() {
        let orders = search([0.98, 0.5, 0.02], &mut Draws::new());
        let larger: Vec<_> = orders.iter().map(|order| order.larger.as_deref()).collect();
        assert_eq!(larger, [Some("a"), Some("a"), Some("b")], "{orders:?}");
        assert!(orders.iter().all(|order| order.decided_at.unwrap() > 1), "five runs a level decide nothing");
    }

    #[test]
    fn what_does_not_differ_is_put_in_order_less_than_one_time_in_twenty() {
        let mut draws = Draws::new();
        let wrong = |chance: f64, draws: &mut Draws| {
            (0..120).filter(|_| search([chance; 3], draws).iter().any(|order| order.larger.is_some())).count()
        };
        for chance in [0.5, 0.9] {
            let wrong = wrong(chance, &mut draws);
            assert!(wrong <= 6, "{wrong} of 120 at {chance}");
        }
    }

    #[test]
    fn ranks_that_point_the_other_way_decide_nothing() {
        let said =
            |difference, rank_biserial| MetricComparison { difference, rank_biserial, ..MetricComparison::default() };
        assert_eq!(direction(&said(Some(0.2), Some(-0.1))), 0.0);
        assert_eq!((direction(&said(Some(0.2), None)), direction(&said(Some(-3.0), Some(-0.5)))), (1.0, -1.0));
        assert_eq!(direction(&said(None, None)), 0.0);
    }

    #[test]
    fn a_ratio_with_nothing_below_the_line_is_the_larger_one() {
        let said = |a, b| MetricComparison { a, b, ..MetricComparison::default() };
        assert_eq!((direction(&said(None, Some(5.0))), direction(&said(Some(5.0), None))), (1.0, -1.0));
    }
}
