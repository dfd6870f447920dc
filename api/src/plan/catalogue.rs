//! The plans that come with Furrow, as a user chooses among them.

use std::collections::{BTreeMap, BTreeSet};

use furrow_sim::plan::{Level, Plan};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::Request;
use super::error::PlanError;
use super::factor::dimensions;
use super::source::{PlanSource, builtin_plans};

/// A plan in short.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct PlanSummary {
    /// What it is called by.
    pub name: String,
    /// One sentence about it.
    pub title: String,
    /// Where it comes from: publication and section.
    pub source: String,
    /// Every scenario runs with seeds 1 to this.
    pub seeds: u64,
    /// Its factors in the order of its tables.
    pub factors: Vec<FactorSummary>,
    /// The kinds of each part that occur in its scenarios, sorted: whose parameters there are to set and to vary.
    pub kinds: BTreeMap<String, BTreeSet<String>>,
}

/// A factor in short.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct FactorSummary {
    /// Its name.
    pub name: String,
    /// The labels of its levels, ranges written out.
    pub labels: Vec<String>,
}

impl PlanSummary {
    /// `plan` in short.
    ///
    /// # Errors
    /// When a factor of it is malformed; a checked plan has none.
    pub fn of(plan: &Plan) -> Result<Self, PlanError> {
        let whole = Request::all_of(PlanSource::Named(plan.name.clone()));
        let factors = dimensions(&plan.factors, &whole)?.into_iter().map(|dimension| FactorSummary {
            name: dimension.name,
            labels: dimension.choices.into_iter().map(|choice| choice.label).collect(),
        });
        Ok(Self {
            name: plan.name.clone(),
            title: plan.title.clone(),
            source: plan.source.clone(),
            seeds: plan.seeds,
            factors: factors.collect(),
            kinds: kinds(plan),
        })
    }

    /// Cells of its tables: the product of its factors.
    #[must_use]
    pub fn cells(&self) -> u64 {
        self.factors.iter().map(|factor| factor.labels.len() as u64).fold(1, u64::saturating_mul)
    }
}

fn kinds(plan: &Plan) -> BTreeMap<String, BTreeSet<String>> {
    let levels = plan.factors.iter().flat_map(|factor| &factor.levels);
    let patches = levels.flat_map(|level| match level {
        Level::Patch(level) => std::slice::from_ref(&level.patch),
        Level::Pool(level) => &level.pool[..],
        Level::Range(_) => &[],
    });
    let mut kinds: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for (part, value) in std::iter::once(&plan.base).chain(patches).filter_map(Value::as_object).flatten() {
        if let Some(kind) = value.get("kind").and_then(Value::as_str) {
            kinds.entry(part.clone()).or_default().insert(kind.to_owned());
        }
    }
    kinds
}

/// All plans that come with Furrow, in short, sorted by name.
///
/// # Errors
/// When one of them is malformed, which the tests of this crate rule out.
pub fn catalogue() -> Result<Vec<PlanSummary>, PlanError> {
    builtin_plans()?.iter().map(PlanSummary::of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plan_says_whose_parameters_there_are_to_set() {
        let plans = catalogue().unwrap();
        let bounds = plans.iter().find(|plan| plan.name == "guyonneau2022/bounds").unwrap();
        let of = |part: &str| bounds.kinds[part].iter().map(String::as_str).collect::<Vec<_>>();
        assert_eq!(of("perception"), ["none", "oracle", "rgop"]);
        assert_eq!(of("mission"), ["heading-hold", "row-by-row"]);
        assert_eq!(bounds.kinds.len(), furrow_sim::scenario::PARTS.len());
    }
}
