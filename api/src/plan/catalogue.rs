//! The plans that come with Furrow, as a user chooses among them.

use furrow_sim::plan::Plan;
use serde::{Deserialize, Serialize};

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
        })
    }

    /// Cells of its tables: the product of its factors.
    #[must_use]
    pub fn cells(&self) -> u64 {
        self.factors.iter().map(|factor| factor.labels.len() as u64).fold(1, u64::saturating_mul)
    }
}

/// All plans that come with Furrow, in short, sorted by name.
///
/// # Errors
/// When one of them is malformed, which the tests of this crate rule out.
pub fn catalogue() -> Result<Vec<PlanSummary>, PlanError> {
    builtin_plans()?.iter().map(PlanSummary::of).collect()
}
