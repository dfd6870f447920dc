//! The product of a plan's levels.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::sync::Arc;

use furrow_schema::sweep::NewCell;
use furrow_sim::plan::Plan;
use serde_json::{Value, json};

use super::error::PlanError;
use super::factor::{Change, Choice, Dimension, dimensions};
use super::path::{is_path, nearest};
use super::resolve::{document, resolve};
use super::source::{PlanSource, check_seeds};
use super::{Expansion, NotApplied, Request};

/// A sweep holds at most this many jobs: scenarios times seeds.
pub const MAX_JOBS: u64 = 10_000_000;

/// A sweep holds at most this many scenarios.
pub const MAX_SCENARIOS: u64 = 100_000;

/// The distinct scenarios of a sweep hold at most this much text [bytes].
const MAX_SCENARIO_BYTES: u64 = 256 << 20;

/// Multiplies a request out.
///
/// # Errors
/// Names what is wrong with the plan or the request and what is allowed; nothing has been stored.
pub fn expand(request: &Request) -> Result<Expansion, PlanError> {
    let plan = request.plan.load()?;
    let seeds = check_seeds(request.seeds.unwrap_or(plan.seeds))?;
    check_paths(request)?;
    let dimensions = dimensions(&plan.factors, request)?;
    check_size(&dimensions, seeds)?;
    let mut product = Product::new(&plan, &dimensions, request);
    product.run()?;
    let not_applied = product.not_applied()?;
    let cells = product.cells;
    Ok(Expansion {
        request: as_json(request, &plan, seeds),
        factors: dimensions.iter().map(|dimension| dimension.name.clone()).collect(),
        plan,
        cells,
        seeds,
        not_applied,
    })
}

fn check_paths(request: &Request) -> Result<(), PlanError> {
    for path in request.set.keys() {
        let at = || format!("set.{path}");
        if !is_path(path) {
            return Err(PlanError::malformed(at(), "must be a dotted path, such as `perception.iterations`"));
        }
        if request.vary.contains_key(path) {
            return Err(PlanError::malformed(at(), "is varied too: either set a path or vary it"));
        }
    }
    Ok(())
}

fn check_size(dimensions: &[Dimension], seeds: u64) -> Result<(), PlanError> {
    let of_one = |dimension: &Dimension| dimension.choices.iter().map(|choice| choice.changes.len() as u64).sum();
    let scenarios = dimensions.iter().map(of_one).fold(1, u64::saturating_mul);
    let jobs = scenarios.saturating_mul(seeds);
    if scenarios > MAX_SCENARIOS {
        return Err(PlanError::TooLarge { what: format!("{scenarios} scenarios"), limit: MAX_SCENARIOS });
    }
    if jobs > MAX_JOBS {
        return Err(PlanError::TooLarge { what: format!("{jobs} jobs"), limit: MAX_JOBS });
    }
    Ok(())
}

/// What was asked, in the form of a request's body.
fn as_json(request: &Request, plan: &Plan, seeds: u64) -> Value {
    let named = match &request.plan {
        PlanSource::Named(name) => json!(name),
        PlanSource::File(_) | PlanSource::Inline(_) => json!(plan),
    };
    let mut body = json!({"plan": named, "seeds": seeds});
    if !request.only.is_empty() {
        body["only"] = json!(request.only);
    }
    if !request.set.is_empty() {
        body["set"] = json!(request.set);
    }
    if !request.vary.is_empty() {
        body["vary"] = json!(request.vary);
    }
    if let Some(field) = &request.field {
        body["field"] = field.request_part();
    }
    body
}

/// The product while it is made.
struct Product<'a> {
    plan: &'a Plan,
    dimensions: &'a [Dimension],
    request: &'a Request,
    cells: Vec<NewCell>,
    texts: HashSet<Arc<str>>,
    bytes: u64,
    /// By path of `set` and `vary`, how many scenarios have it.
    hits: BTreeMap<String, u64>,
    /// By path, the cells with a scenario that does not have it.
    misses: BTreeMap<String, BTreeSet<usize>>,
}

impl<'a> Product<'a> {
    fn new(plan: &'a Plan, dimensions: &'a [Dimension], request: &'a Request) -> Self {
        let paths = request.set.keys().chain(request.vary.keys());
        Self {
            plan,
            dimensions,
            request,
            cells: Vec::new(),
            texts: HashSet::new(),
            bytes: 0,
            misses: BTreeMap::new(),
            hits: paths.map(|path| (path.clone(), 0)).collect(),
        }
    }

    /// Makes all cells, the last factor running fastest.
    fn run(&mut self) -> Result<(), PlanError> {
        let sizes: Vec<usize> = self.dimensions.iter().map(|dimension| dimension.choices.len()).collect();
        for index in 0..sizes.iter().product() {
            let picked = digits(index, &sizes);
            let dimensions = self.dimensions;
            let choices: Vec<&Choice> = dimensions.iter().zip(picked).map(|(d, at)| &d.choices[at]).collect();
            self.cell(&choices)?;
        }
        Ok(())
    }

    fn cell(&mut self, choices: &[&Choice]) -> Result<(), PlanError> {
        let sizes: Vec<usize> = choices.iter().map(|choice| choice.changes.len()).collect();
        let mut scenarios = Vec::new();
        let mut seen = HashSet::new();
        for index in 0..sizes.iter().product() {
            let changes: Vec<&Change> =
                choices.iter().zip(digits(index, &sizes)).map(|(choice, at)| &choice.changes[at]).collect();
            let scenario = self.scenario(choices, &changes)?;
            if seen.insert(Arc::clone(&scenario)) {
                scenarios.push(scenario);
            }
        }
        let names = self.dimensions.iter().map(|dimension| dimension.name.clone());
        let factors = names.zip(choices.iter().map(|choice| choice.label.clone())).collect();
        self.cells.push(NewCell { factors, scenarios });
        Ok(())
    }

    fn scenario(&mut self, choices: &[&Choice], changes: &[&Change]) -> Result<Arc<str>, PlanError> {
        let resolved = resolve(&self.plan.base, changes, &self.request.set)
            .map_err(|error| PlanError::scenario(self.name(choices).join(", "), error))?;
        for (path, hits) in &mut self.hits {
            if resolved.missed.contains(path) {
                self.misses.entry(path.clone()).or_default().insert(self.cells.len());
            } else {
                *hits += 1;
            }
        }
        self.intern(resolved.text)
    }

    fn intern(&mut self, text: String) -> Result<Arc<str>, PlanError> {
        if let Some(known) = self.texts.get(text.as_str()) {
            return Ok(Arc::clone(known));
        }
        self.bytes += text.len() as u64;
        if self.bytes > MAX_SCENARIO_BYTES {
            let what = format!("more than {MAX_SCENARIO_BYTES} bytes of scenarios");
            return Err(PlanError::TooLarge { what, limit: MAX_SCENARIO_BYTES });
        }
        let text: Arc<str> = text.into();
        self.texts.insert(Arc::clone(&text));
        Ok(text)
    }

    /// `factor=label` for each factor.
    fn name(&self, choices: &[&Choice]) -> Vec<String> {
        self.dimensions.iter().zip(choices).map(|(d, choice)| format!("{}={}", d.name, choice.label)).collect()
    }

    fn not_applied(&self) -> Result<Vec<NotApplied>, PlanError> {
        if let Some((path, _)) = self.hits.iter().find(|(_, hits)| **hits == 0) {
            return Err(self.unknown_path(path));
        }
        let said = |(path, cells): (&String, &BTreeSet<usize>)| NotApplied {
            path: path.clone(),
            levels: where_missed(&self.cells, self.dimensions, cells),
        };
        Ok(self.misses.iter().map(said).collect())
    }

    fn unknown_path(&self, path: &str) -> PlanError {
        const LOOKED_AT: usize = 200;
        let documents: Vec<Value> = self.texts.iter().take(LOOKED_AT).filter_map(|text| document(text).ok()).collect();
        let part = if self.request.set.contains_key(path) { "set" } else { "vary" };
        PlanError::UnknownPath { part, path: path.to_owned(), near: nearest(documents.iter(), path) }
    }
}

/// `index` in the mixed base of `sizes`, the last digit running fastest.
fn digits(mut index: usize, sizes: &[usize]) -> Vec<usize> {
    let mut digits: Vec<usize> = sizes
        .iter()
        .rev()
        .map(|size| {
            let digit = index % size;
            index /= size;
            digit
        })
        .collect();
    digits.reverse();
    digits
}

/// The shortest way to name `missed`: whole levels where these make it up, else the cells one by one.
fn where_missed(cells: &[NewCell], dimensions: &[Dimension], missed: &BTreeSet<usize>) -> Vec<String> {
    let mut left = missed.clone();
    let mut levels = Vec::new();
    for Dimension { name, choices } in dimensions {
        let label = |index: usize| cells[index].factors[name].as_str();
        let hit: HashSet<&str> = (0..cells.len()).filter(|index| !missed.contains(index)).map(label).collect();
        for choice in choices.iter().filter(|choice| !hit.contains(choice.label.as_str())) {
            if left.iter().any(|index| label(*index) == choice.label) {
                levels.push(format!("{name}={}", choice.label));
            }
        }
        left.retain(|index| hit.contains(label(*index)));
    }
    if left.is_empty() { levels } else { missed.iter().map(|index| full_name(&cells[*index], dimensions)).collect() }
}

fn full_name(cell: &NewCell, dimensions: &[Dimension]) -> String {
    let label = |dimension: &Dimension| format!("{}={}", dimension.name, cell.factors[&dimension.name]);
    dimensions.iter().map(label).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::source::builtin_plans;

    fn dimension(name: &str, labels: &[&str]) -> Dimension {
        let choice = |label: &&str| Choice { label: (*label).to_owned(), changes: vec![Change::Merge(json!({}))] };
        Dimension { name: name.to_owned(), choices: labels.iter().map(choice).collect() }
    }

    fn cells(dimensions: &[Dimension]) -> Vec<NewCell> {
        let sizes: Vec<usize> = dimensions.iter().map(|dimension| dimension.choices.len()).collect();
        let label = |(d, at): (&Dimension, usize)| (d.name.clone(), d.choices[at].label.clone());
        (0..sizes.iter().product())
            .map(|index| dimensions.iter().zip(digits(index, &sizes)).map(label).collect())
            .map(|factors| NewCell { factors, scenarios: Vec::new() })
            .collect()
    }

    #[test]
    fn the_last_factor_runs_fastest() {
        let all: Vec<Vec<usize>> = (0..6).map(|index| digits(index, &[2, 3])).collect();
        assert_eq!(all, [[0, 0], [0, 1], [0, 2], [1, 0], [1, 1], [1, 2]]);
        assert_eq!(digits(0, &[]), Vec::<usize>::new());
    }

    #[test]
    fn where_a_path_was_missed_is_said_in_levels_if_they_suffice() {
        let dimensions = [dimension("algorithm", &["oracle", "rgop"]), dimension("field", &["crop-1", "crop-2"])];
        let cells = cells(&dimensions);
        let said = |missed: &[usize]| where_missed(&cells, &dimensions, &missed.iter().copied().collect());
        assert_eq!(said(&[0, 1]), ["algorithm=oracle"]);
        assert_eq!(said(&[1, 3]), ["field=crop-2"]);
        assert_eq!(said(&[0, 1, 3]), ["algorithm=oracle", "field=crop-2"]);
        assert_eq!(said(&[2]), ["algorithm=rgop field=crop-1"]);
    }

    #[test]
    fn more_than_a_sweep_may_hold_is_refused_before_it_is_made() {
        let factors: Vec<Dimension> = ["a", "b", "c"].iter().map(|name| dimension(name, &["x"; 100])).collect();
        let error = check_size(&factors, 1).unwrap_err().to_string();
        assert!(error.contains("1000000 scenarios") && error.contains("at most 100000"), "{error}");
        let error = check_size(&factors[..2], 1_001).unwrap_err().to_string();
        assert!(error.contains("10010000 jobs") && error.contains("at most 10000000"), "{error}");
        assert!(check_size(&factors[..2], 1_000).is_ok());
    }

    #[test]
    fn seeds_out_of_range_are_refused_with_the_range() {
        for seeds in [0, 1_000_001, u64::MAX] {
            assert!(check_seeds(seeds).unwrap_err().to_string().contains("allowed are 1 to 1000000"));
        }
        assert_eq!(check_seeds(1_000_000), Ok(1_000_000));
    }

    #[test]
    fn a_path_is_either_set_or_varied() {
        let mut request = Request::all_of(PlanSource::Named("x".into()));
        request.set.insert("a.b".into(), json!(1));
        assert!(check_paths(&request).is_ok());
        request.vary.insert("a.b".into(), vec![json!(1)]);
        assert!(check_paths(&request).unwrap_err().to_string().starts_with("set.a.b: "));
        request.set = BTreeMap::from([("a..b".into(), json!(1))]);
        assert!(check_paths(&request).unwrap_err().to_string().starts_with("set.a..b: "));
    }

    #[test]
    fn every_plan_that_comes_with_furrow_expands_to_the_product_of_its_levels() {
        for plan in builtin_plans().unwrap() {
            let expansion = expand(&Request::all_of(PlanSource::Named(plan.name.clone()))).unwrap();
            let names: Vec<&String> = plan.factors.iter().map(|factor| &factor.name).collect();
            assert_eq!(expansion.factors.iter().collect::<Vec<_>>(), names);
            assert!(expansion.cells.iter().all(|cell| cell.factors.len() == names.len()));
            assert!(expansion.jobs() >= expansion.cells.len() as u64 * plan.seeds);
            assert!(expansion.not_applied.is_empty());
        }
    }
}
