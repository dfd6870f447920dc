//! Which run belongs to which: the same labels but the compared one, the same seed, and in pools the same variant.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};

use furrow_coordinator::view::{CellValues, UnfinishedRun};
use furrow_schema::id::ScenarioId;
use furrow_schema::job::JobState;
use serde_json::Value;

use super::question::Resolved;

/// The runs of one cell.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Runs {
    /// Those with a result.
    pub values: CellValues,
    /// Those without.
    pub unfinished: Vec<UnfinishedRun>,
}

/// The runs of a sweep by cell.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SweepRuns {
    /// The cells, in the plan's order.
    pub cells: Vec<Runs>,
    /// The texts of those scenarios that share a cell with others.
    pub scenarios: HashMap<ScenarioId, String>,
}

impl SweepRuns {
    /// The runs of a sweep from the store's answers. `unfinished` is to be asked for before `values`: what ended in
    /// between is in both, and counts as ended.
    #[must_use]
    pub fn new(values: Vec<CellValues>, unfinished: Vec<UnfinishedRun>) -> Self {
        let mut by_position: BTreeMap<u64, Vec<UnfinishedRun>> = BTreeMap::new();
        unfinished.into_iter().for_each(|run| by_position.entry(run.position).or_default().push(run));
        let cell = |values: CellValues| {
            let unfinished = by_position.remove(&values.position).unwrap_or_default();
            Runs { values, unfinished }
        };
        Self { cells: values.into_iter().map(cell).collect(), scenarios: HashMap::new() }
    }

    /// The scenarios that share a cell with others: their texts tell which run belongs to which.
    #[must_use]
    pub fn pooled(&self) -> Vec<ScenarioId> {
        let scenarios = self.cells.iter().map(Runs::scenarios).filter(|scenarios| scenarios.len() > 1);
        scenarios.flatten().collect::<BTreeSet<_>>().into_iter().collect()
    }
}

impl Runs {
    fn scenarios(&self) -> BTreeSet<ScenarioId> {
        self.values.scenarios.iter().copied().chain(self.unfinished.iter().map(|run| run.scenario)).collect()
    }

    /// Seed, scenario and state of each run.
    fn all(&self) -> Vec<(u64, ScenarioId, Side)> {
        let keys = self.values.seeds.iter().copied().zip(self.values.scenarios.iter().copied());
        let done: HashSet<(u64, ScenarioId)> = keys.clone().collect();
        let ended = keys.enumerate().map(|(row, (seed, scenario))| (seed, scenario, Side::Done(row)));
        let rest = self.unfinished.iter().filter(|run| !done.contains(&(run.seed, run.scenario)));
        let rest = rest.map(|run| {
            let side = if run.state == JobState::Failed { Side::Failed } else { Side::Open };
            (run.seed, run.scenario, side)
        });
        ended.chain(rest).collect()
    }
}

/// What there is on one side of a pair.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    /// A result, in this row of the cell's values.
    Done(usize),
    /// A job that was given up on.
    Failed,
    /// A job without a result (yet).
    Open,
    /// No such job.
    Absent,
}

/// Two runs that differ in the compared factor only.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Pair {
    pub(super) seed: u64,
    pub(super) a: Side,
    pub(super) b: Side,
}

/// Two cells that differ in the compared factor only; one of them may be missing.
#[derive(Debug)]
pub(super) struct Cells<'a> {
    /// The labels of the paired factors, in their order.
    pub(super) labels: Vec<&'a str>,
    pub(super) a: Option<&'a Runs>,
    pub(super) b: Option<&'a Runs>,
    pub(super) pairs: Vec<Pair>,
    /// Runs that belong to several others, so that nobody can tell which.
    pub(super) ambiguous: u64,
}

/// The cells of both sides, in the order of a's, then of those that only b has.
pub(super) fn pair<'a>(question: &Resolved, a: &'a SweepRuns, b: &'a SweepRuns) -> Vec<Cells<'a>> {
    let side = |sweep: &'a SweepRuns, at: usize| {
        let wanted = question.factor.as_deref().zip(question.labels.as_ref().map(|labels| labels[at].as_str()));
        let fits = move |runs: &&Runs| wanted.is_none_or(|(factor, label)| label_of(runs, factor) == label);
        sweep.cells.iter().filter(fits)
    };
    let labels = |runs: &'a Runs| question.paired.iter().map(|factor| label_of(runs, factor)).collect::<Vec<_>>();
    let mut order: Vec<Vec<&str>> = Vec::new();
    let mut cells: HashMap<Vec<&str>, [Option<&Runs>; 2]> = HashMap::new();
    for (at, runs) in side(a, 0).map(|runs| (0, runs)).chain(side(b, 1).map(|runs| (1, runs))) {
        let labels = labels(runs);
        let entry = cells.entry(labels.clone()).or_insert_with(|| {
            order.push(labels);
            [None, None]
        });
        entry[at] = Some(runs);
    }
    let cell = |labels: Vec<&'a str>| {
        let [own, other] = cells[&labels];
        let (pairs, ambiguous) = match_runs(own, other, &a.scenarios, &b.scenarios);
        Cells { labels, a: own, b: other, pairs, ambiguous }
    };
    order.into_iter().map(cell).collect()
}

fn label_of<'a>(runs: &'a Runs, factor: &str) -> &'a str {
    runs.values.factors.get(factor).map_or("", String::as_str)
}

fn match_runs(
    a: Option<&Runs>,
    b: Option<&Runs>,
    texts_a: &HashMap<ScenarioId, String>,
    texts_b: &HashMap<ScenarioId, String>,
) -> (Vec<Pair>, u64) {
    let variants = [a, b].map(|runs| runs.map(Runs::scenarios).unwrap_or_default());
    let pooled = variants.iter().any(|scenarios| scenarios.len() > 1);
    let [keys_a, keys_b] = if pooled { keys(&variants, [texts_a, texts_b]) } else { Default::default() };
    let mut places: BTreeMap<(u64, &str), [Vec<Side>; 2]> = BTreeMap::new();
    for (at, runs, keys) in [(0, a, &keys_a), (1, b, &keys_b)] {
        for (seed, scenario, side) in runs.map(Runs::all).unwrap_or_default() {
            let key = keys.get(&scenario).map_or("", String::as_str);
            places.entry((seed, key)).or_default()[at].push(side);
        }
    }
    let mut ambiguous = 0;
    let mut pairs = Vec::new();
    for ((seed, _), [a, b]) in places {
        match (a.as_slice(), b.as_slice()) {
            ([], [b]) => pairs.push(Pair { seed, a: Side::Absent, b: *b }),
            ([a], []) => pairs.push(Pair { seed, a: *a, b: Side::Absent }),
            ([a], [b]) => pairs.push(Pair { seed, a: *a, b: *b }),
            (a, b) => ambiguous += (a.len() + b.len()) as u64,
        }
    }
    (pairs, ambiguous)
}

/// What each scenario holds in those places where the scenarios of both cells differ among themselves.
fn keys(
    scenarios: &[BTreeSet<ScenarioId>; 2],
    texts: [&HashMap<ScenarioId, String>; 2],
) -> [HashMap<ScenarioId, String>; 2] {
    let flat = [0, 1].map(|at| -> BTreeMap<ScenarioId, Flat> {
        let read = |id: &ScenarioId| (*id, texts[at].get(id).map(|text| flatten(text)).unwrap_or_default());
        scenarios[at].iter().map(read).collect()
    });
    let [varied_a, varied_b] = [varied(&flat[0]), varied(&flat[1])];
    let common: Vec<&String> = varied_a.intersection(&varied_b).copied().collect();
    [&flat[0], &flat[1]].map(|flat| {
        let key = |place: &Flat| common.iter().map(|path| format!("{:?};", place.get(*path))).collect::<String>();
        flat.iter().map(|(id, places)| (*id, key(places))).collect()
    })
}

/// The leaves of a scenario by path.
type Flat = BTreeMap<String, Value>;

fn flatten(text: &str) -> Flat {
    let mut flat = Flat::new();
    if let Ok(value) = serde_json::from_str(text) {
        descend(String::new(), value, &mut flat);
    }
    flat
}

fn descend(path: String, value: Value, flat: &mut Flat) {
    match value {
        Value::Object(object) => {
            object.into_iter().for_each(|(key, value)| descend(format!("{path}.{key}"), value, flat))
        }
        value => drop(flat.insert(path, value)),
    }
}

/// The paths at which not all scenarios hold the same.
fn varied(flat: &BTreeMap<ScenarioId, Flat>) -> BTreeSet<&String> {
    let Some(first) = flat.values().next() else { return BTreeSet::new() };
    let paths: BTreeSet<&String> = flat.values().flat_map(BTreeMap::keys).collect();
    paths.into_iter().filter(|path| flat.values().any(|other| other.get(*path) != first.get(*path))).collect()
}

#[cfg(test)]
pub(crate) mod tests {
    use furrow_coordinator::view::CellSummary;
    use furrow_schema::id::CellId;

    use super::*;
    use crate::paired::Outline;

    /// A cell with these labels and runs: seed, scenario, and the values of `x` and `success`; a run without is failed.
    pub(in super::super) fn cell(labels: &[(&str, &str)], runs: &[(u64, i64, Option<[f64; 2]>)]) -> Runs {
        let factors = labels.iter().map(|(factor, label)| ((*factor).to_owned(), (*label).to_owned())).collect();
        let mut values = CellValues { factors, ..CellValues::default() };
        let mut columns = [Vec::new(), Vec::new()];
        for (seed, scenario, value) in runs {
            let Some(value) = value else { continue };
            values.seeds.push(*seed);
            values.scenarios.push(ScenarioId(*scenario));
            columns.iter_mut().zip(value).for_each(|(column, value)| column.push(Some(*value)));
        }
        let [x, success] = columns;
        values.metrics = BTreeMap::from([("x".to_owned(), x), ("success".to_owned(), success)]);
        let failed = runs.iter().filter(|(.., value)| value.is_none());
        let failed = failed.map(|(seed, scenario, _)| UnfinishedRun {
            position: 0,
            seed: *seed,
            scenario: ScenarioId(*scenario),
            state: JobState::Failed,
        });
        Runs { values, unfinished: failed.collect() }
    }

    /// A sweep of one field with these levels of `algorithm`: the values of `x` and `success` by seed, from 1 on.
    pub(crate) fn test_sweep(levels: [(&str, &[[f64; 2]]); 3]) -> (Outline, SweepRuns) {
        let of = |(scenario, (label, values)): (usize, (&str, &[[f64; 2]]))| {
            let runs: Vec<_> = (1..).zip(values).map(|(seed, value)| (seed, scenario as i64, Some(*value))).collect();
            cell(&[("algorithm", label), ("field", "crop-1")], &runs)
        };
        let cells: Vec<Runs> = levels.into_iter().enumerate().map(of).collect();
        let summary = |cell: &Runs| CellSummary {
            id: CellId(1),
            position: 0,
            factors: cell.values.factors.clone(),
            total: 0,
            done: 0,
            failed: 0,
            metrics: BTreeMap::new(),
        };
        let summaries: Vec<_> = cells.iter().map(summary).collect();
        let factors = ["algorithm", "field"].map(str::to_owned).into();
        (Outline::of(factors, &summaries), SweepRuns { cells, scenarios: HashMap::new() })
    }

    pub(in super::super) fn question(group_by: &[&str]) -> Resolved {
        Resolved {
            factor: Some("algorithm".to_owned()),
            labels: Some(["rgop".to_owned(), "rg".to_owned()]),
            paired: vec!["field".to_owned()],
            group_by: group_by.iter().map(|factor| (*factor).to_owned()).collect(),
            metrics: ["success", "x"].map(crate::table::metric).into(),
        }
    }

    const DONE: Option<[f64; 2]> = Some([1.0, 1.0]);

    fn of(cells: Vec<Runs>, scenarios: &[(i64, &str)]) -> SweepRuns {
        let texts = scenarios.iter().map(|(id, text)| (ScenarioId(*id), (*text).to_owned()));
        SweepRuns { cells, scenarios: texts.collect() }
    }

    #[test]
    fn runs_are_paired_by_seed_and_the_other_labels() {
        let own = cell(&[("algorithm", "rgop"), ("field", "crop-1")], &[(1, 1, DONE), (2, 1, DONE), (3, 1, None)]);
        let other = cell(&[("algorithm", "rg"), ("field", "crop-1")], &[(2, 2, DONE), (3, 2, DONE)]);
        let alone = cell(&[("algorithm", "rg"), ("field", "crop-2")], &[(1, 3, DONE)]);
        let else_where = cell(&[("algorithm", "ruby"), ("field", "crop-1")], &[(1, 4, DONE)]);
        let sweep = of(vec![own, other, alone, else_where], &[]);
        let cells = pair(&question(&[]), &sweep, &sweep);
        assert_eq!(cells.iter().map(|cells| cells.labels.clone()).collect::<Vec<_>>(), [["crop-1"], ["crop-2"]]);
        let expected = [
            Pair { seed: 1, a: Side::Done(0), b: Side::Absent },
            Pair { seed: 2, a: Side::Done(1), b: Side::Done(0) },
            Pair { seed: 3, a: Side::Failed, b: Side::Done(1) },
        ];
        assert_eq!(cells[0].pairs, expected);
        assert_eq!(cells[1].pairs, [Pair { seed: 1, a: Side::Absent, b: Side::Done(0) }]);
    }

    #[test]
    fn runs_of_a_pool_are_paired_by_what_the_pool_varies() {
        let own = cell(&[("algorithm", "rgop"), ("field", "mixed")], &[(1, 1, DONE), (1, 2, DONE)]);
        let other = cell(&[("algorithm", "rg"), ("field", "mixed")], &[(1, 3, DONE), (1, 4, DONE)]);
        let sweep = of(
            vec![own, other],
            &[
                (1, r#"{"field": {"lane": "a"}, "finder": 1}"#),
                (2, r#"{"field": {"lane": "b"}, "finder": 1}"#),
                (3, r#"{"field": {"lane": "b"}, "finder": 2}"#),
                (4, r#"{"field": {"lane": "a"}, "finder": 2}"#),
            ],
        );
        assert_eq!(sweep.pooled().len(), 4);
        let cells = pair(&question(&[]), &sweep, &sweep);
        let rows: Vec<_> = cells[0].pairs.iter().map(|pair| (pair.a, pair.b)).collect();
        assert_eq!(rows, [(Side::Done(0), Side::Done(1)), (Side::Done(1), Side::Done(0))]);
        assert_eq!(cells[0].ambiguous, 0);
    }

    #[test]
    fn a_pool_on_one_side_only_cannot_be_paired() {
        let own = cell(&[("algorithm", "rgop"), ("field", "mixed")], &[(1, 1, DONE), (1, 2, DONE)]);
        let other = cell(&[("algorithm", "rg"), ("field", "mixed")], &[(1, 3, DONE)]);
        let sweep = of(vec![own, other], &[(1, r#"{"rate": 1}"#), (2, r#"{"rate": 2}"#), (3, r#"{"rate": 1}"#)]);
        let cells = pair(&question(&[]), &sweep, &sweep);
        assert_eq!((cells[0].pairs.len(), cells[0].ambiguous), (0, 3));
    }
}
