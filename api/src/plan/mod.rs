//! From a plan and what a user asks of it to the cells of a sweep.
//!
//! Read in this order: `source` finds and checks a plan, `custom_field` is a user's own field, `factor`
//! turns the plan's levels into changes and picks those asked for, `merge` and `path` are the two kinds of
//! change, `resolve` makes one scenario, `expand` multiplies the factors out, `error` is what a user can
//! get wrong, `catalogue` lists the plans there are.

mod catalogue;
mod custom_field;
mod error;
mod expand;
mod factor;
mod label;
mod merge;
mod path;
mod resolve;
mod source;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use furrow_schema::sweep::NewCell;
use furrow_sim::plan::Plan;
use serde::{Deserialize, Serialize};
use serde_json::Value;

pub use catalogue::{FactorSummary, PlanSummary, catalogue};
pub use custom_field::CustomField;
pub use error::PlanError;
pub use expand::{MAX_JOBS, MAX_SCENARIOS, expand};
pub use source::{PlanSource, builtin_plans, find, from_value, read};

/// What a user asks of a plan.
#[derive(Debug, Clone, PartialEq)]
pub struct Request {
    /// The plan.
    pub plan: PlanSource,
    /// Levels to keep, by factor; factors that are not named keep all of theirs.
    pub only: BTreeMap<String, Vec<String>>,
    /// Values by dotted path in the resolved scenario, applied after all levels.
    pub set: BTreeMap<String, Value>,
    /// Further factors: the values that a dotted path takes. The factor is named by the path's last word.
    pub vary: BTreeMap<String, Vec<Value>>,
    /// The user's own field in place of the plan's factor `field`.
    pub field: Option<CustomField>,
    /// Seeds 1 to this in place of the plan's number.
    pub seeds: Option<u64>,
}

impl Request {
    /// All of `plan`, as it stands.
    #[must_use]
    pub fn all_of(plan: PlanSource) -> Self {
        Self { plan, only: BTreeMap::new(), set: BTreeMap::new(), vary: BTreeMap::new(), field: None, seeds: None }
    }
}

/// A request, multiplied out: what a sweep is made of.
#[derive(Debug, Clone)]
pub struct Expansion {
    /// The plan.
    pub plan: Plan,
    /// What was asked as JSON, with the plan's content in place of a file's path: enough to ask again.
    pub request: Value,
    /// Names of the factors, in the plan's order, varied ones last.
    pub factors: Vec<String>,
    /// The combinations of labels with their scenarios, the last factor running fastest.
    pub cells: Vec<NewCell>,
    /// Every scenario runs with seeds 1 to this.
    pub seeds: u64,
    /// Paths of `set` and `vary` that some of the scenarios do not have.
    pub not_applied: Vec<NotApplied>,
}

impl Expansion {
    /// Jobs of this sweep: scenarios times seeds.
    #[must_use]
    pub fn jobs(&self) -> u64 {
        self.seeds.saturating_mul(self.cells.iter().map(|cell| cell.scenarios.len() as u64).sum())
    }
}

/// A path that some of the selected scenarios do not have.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct NotApplied {
    /// The dotted path.
    pub path: String,
    /// Where it changed nothing: `factor=label`, several joined by a blank where it takes more than one to say it.
    pub levels: Vec<String>,
}
