//! Plans as data: the form of a plan file, and the plans that come with Furrow.

use serde::{Deserialize, Serialize};
use serde_json::Value;

/// A plan: a base scenario, factors that change it, and a number of seeds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// Its name, such as `guyonneau2022/algorithm-5`.
    pub name: String,
    /// One sentence for people.
    pub title: String,
    /// Where it comes from: publication and section.
    pub source: String,
    /// The scenario that the levels change.
    pub base: Value,
    /// The dimensions of its tables, in order.
    pub factors: Vec<Factor>,
    /// Every scenario runs with seeds 1 to this, unless the user says otherwise.
    pub seeds: u64,
}

/// One dimension.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Factor {
    /// Its name: `algorithm`, `field`, ..
    pub name: String,
    /// What it can be.
    pub levels: Vec<Level>,
}

/// One value of a factor, or an inclusive range of them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Level {
    /// A label and a JSON merge patch on the base.
    Patch(PatchLevel),
    /// A label and several patches: a run per patch and seed, all in this level's cell.
    Pool(PoolLevel),
    /// One level per integer.
    Range(RangeLevel),
}

/// A label and a JSON merge patch on the base.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PatchLevel {
    /// Kebab-case.
    pub label: String,
    /// The patch; an object in it that holds `kind` replaces the whole object instead of merging.
    pub patch: Value,
}

/// A label and several patches.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoolLevel {
    /// Kebab-case.
    pub label: String,
    /// The patches.
    pub pool: Vec<Value>,
}

/// One level per integer of an inclusive range.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RangeLevel {
    /// Label in which a run of `#` stands for the integer with leading zeros, such as `nursery-###`.
    pub label: String,
    /// First and last integer.
    pub range: [u64; 2],
    /// Dotted path in the scenario that is set to the integer.
    pub path: String,
}

/// The plans that come with Furrow, as (name, JSON text), sorted by name.
#[must_use]
pub fn builtin() -> &'static [(&'static str, &'static str)] {
    include!(concat!(env!("OUT_DIR"), "/plans.rs"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ten different ones of a hundred, drawn by seed 1.
    #[test]
    fn the_ten_nurseries_of_the_parameter_tables_are_drawn_by_seed_1() {
        let mut random = furrow_navigation::random::Stream::new(1, "ten-nurseries");
        let mut drawn: Vec<u32> = Vec::new();
        while drawn.len() < 10 {
            let nursery = random.below(100);
            if !drawn.contains(&nursery) {
                drawn.push(nursery);
            }
        }
        drawn.sort_unstable();
        let expected: Vec<_> = drawn.iter().map(|nursery| format!("nursery-{nursery:03}")).collect();
        for name in ["table-4-3", "table-4-4", "table-4-5", "table-4-6", "table-4-7", "table-4-8"] {
            let name = format!("vintu2018/{name}");
            let (_, text) = builtin().iter().find(|(known, _)| **known == name).unwrap();
            let plan: Plan = serde_json::from_str(text).unwrap();
            let fields = &plan.factors.iter().find(|factor| factor.name == "field").unwrap().levels;
            let label = |level: &Level| match level {
                Level::Patch(level) => level.label.clone(),
                other => panic!("{other:?}"),
            };
            assert_eq!(fields.iter().map(label).collect::<Vec<_>>(), expected, "{name}");
        }
    }

    #[test]
    fn every_plan_file_is_a_plan_and_bears_its_name() {
        assert!(!builtin().is_empty());
        for (name, text) in builtin() {
            let plan: Plan = serde_json::from_str(text).unwrap_or_else(|error| panic!("{name}: {error}"));
            assert_eq!(plan.name, *name);
            crate::Scenario::from_value(plan.base).unwrap_or_else(|error| panic!("{name}: {error}"));
        }
    }
}
