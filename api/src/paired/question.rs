//! What a user asks to be compared, and whether the sweeps have it.

use std::collections::BTreeMap;

use furrow_coordinator::view::CellSummary;

use super::error::PairedError;
use crate::table::{Metric, SUCCESS, list, listed, metric, order};

/// A question for a comparison, in the user's words.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Question {
    /// The factor of which two levels are compared; all factors are paired where none is named, between two sweeps.
    pub factor: Option<String>,
    /// The label on side a.
    pub a: Option<String>,
    /// The label on side b.
    pub b: Option<String>,
    /// Metrics, with commas; `success` if there are none.
    pub metric: Option<String>,
    /// Other factors, with commas, by whose levels the answer is given too.
    pub group_by: Option<String>,
}

/// What a sweep has, before its runs are read.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Outline {
    factors: Vec<String>,
    labels: Vec<BTreeMap<String, String>>,
    metrics: Vec<String>,
}

impl Outline {
    /// Of a sweep with these factors and cells.
    #[must_use]
    pub fn of(factors: Vec<String>, cells: &[CellSummary]) -> Self {
        let metrics = cells.iter().flat_map(|cell| cell.metrics.keys().cloned()).collect();
        Self { factors, labels: cells.iter().map(|cell| cell.factors.clone()).collect(), metrics }
    }

    /// The labels of a factor, in the plan's order.
    ///
    /// # Errors
    /// There is no such factor, or it has one label only.
    pub fn levels(&self, factor: &str) -> Result<Vec<&str>, PairedError> {
        if !self.factors.iter().any(|known| known == factor) {
            return Err(PairedError::unknown("factor", "factor", factor, &self.factors));
        }
        let labels = self.labels(factor);
        match labels.len() {
            0 | 1 => Err(PairedError::new("factor", format!("`{factor}` has one level only"), labels)),
            _ => Ok(labels),
        }
    }

    /// The labels of a factor, in the plan's order.
    fn labels(&self, factor: &str) -> Vec<&str> {
        let mut labels: Vec<&str> = Vec::new();
        for label in self.labels.iter().filter_map(|cell| cell.get(factor)) {
            if !labels.contains(&label.as_str()) {
                labels.push(label);
            }
        }
        labels
    }
}

/// A question that the sweeps can answer.
#[derive(Debug, Clone, PartialEq)]
pub struct Resolved {
    /// The factor of which two levels are compared.
    pub(super) factor: Option<String>,
    /// The labels on both sides; none where all cells are compared.
    pub(super) labels: Option<[String; 2]>,
    /// The factors whose labels make a pair, beside the seed.
    pub(super) paired: Vec<String>,
    pub(super) group_by: Vec<String>,
    pub(super) metrics: Vec<Metric>,
}

impl Resolved {
    /// The metrics whose values it needs.
    #[must_use]
    pub fn wanted(&self) -> Vec<&str> {
        let of = |metric: &Metric| metric.of_sums.map(|of| [of.numerator, of.denominator]);
        let sums = self.metrics.iter().filter_map(of).flatten();
        self.metrics.iter().map(|metric| metric.name.as_ref()).chain(sums).collect()
    }
}

impl Question {
    /// Checks the question against what `one` and, between two sweeps, `other` have.
    ///
    /// # Errors
    /// Names the key at fault and what is allowed.
    pub fn resolve(&self, one: &Outline, other: Option<&Outline>) -> Result<Resolved, PairedError> {
        let labels = self.sides(one, other)?;
        let paired = paired(self.factor.as_deref(), one, other)?;
        let group_by = self.groups(&paired)?;
        let metrics = self.metrics(one, other)?;
        Ok(Resolved { factor: self.factor.clone(), labels, paired, group_by, metrics })
    }

    fn sides(&self, one: &Outline, other: Option<&Outline>) -> Result<Option<[String; 2]>, PairedError> {
        let Some(factor) = &self.factor else {
            return match (other, &self.a, &self.b) {
                (None, ..) => Err(PairedError::new("factor", "is missing", &one.factors)),
                (Some(_), None, None) => Ok(None),
                _ => Err(PairedError::new("factor", "`a` and `b` are its labels, and it is missing", &one.factors)),
            };
        };
        for outline in [Some(one), other].into_iter().flatten() {
            if !outline.factors.contains(factor) {
                return Err(PairedError::unknown("factor", "factor", factor, &outline.factors));
            }
        }
        let a = side("a", self.a.as_deref(), one.labels(factor))?;
        let b = side("b", self.b.as_deref(), other.unwrap_or(one).labels(factor))?;
        if a == b && other.is_none() {
            let others = one.labels(factor).into_iter().filter(|label| *label != a);
            return Err(PairedError::new("b", format!("`{b}` is `a` already"), others));
        }
        Ok(Some([a, b]))
    }

    fn groups(&self, paired: &[String]) -> Result<Vec<String>, PairedError> {
        let mut groups: Vec<String> = Vec::new();
        for factor in self.group_by.as_deref().map(list).unwrap_or_default() {
            if !paired.contains(&factor) {
                return Err(PairedError::unknown("group_by", "factor", &factor, paired));
            }
            if !groups.contains(&factor) {
                groups.push(factor);
            }
        }
        Ok(groups)
    }

    /// One that has a place in tables but no values (yet) is not unknown.
    fn metrics(&self, one: &Outline, other: Option<&Outline>) -> Result<Vec<Metric>, PairedError> {
        let present = [Some(one), other].into_iter().flatten().flat_map(|outline| outline.metrics.iter().cloned());
        let mut known: Vec<String> = listed().map(str::to_owned).chain(present).collect();
        known.sort_by(|a, b| order(a).cmp(&order(b)));
        known.dedup();
        let asked = self.metric.as_deref().map(list).filter(|names| !names.is_empty());
        let mut metrics: Vec<Metric> = Vec::new();
        for name in asked.unwrap_or_else(|| vec![SUCCESS.to_owned()]) {
            let name = if name == "success_ratio" { SUCCESS } else { &name };
            if !known.iter().any(|other| other == name) {
                return Err(PairedError::unknown("metric", "metric", name, known));
            }
            if metrics.iter().all(|other| other.name != name) {
                metrics.push(metric(name));
            }
        }
        Ok(metrics)
    }
}

fn side(key: &'static str, label: Option<&str>, known: Vec<&str>) -> Result<String, PairedError> {
    match label {
        None => Err(PairedError::new(key, "is missing", known)),
        Some(label) if known.contains(&label) => Ok(label.to_owned()),
        Some(label) => Err(PairedError::unknown(key, "label", label, known)),
    }
}

/// The factors that make a pair: all of both sweeps, which must be the same, but the compared one.
fn paired(factor: Option<&str>, one: &Outline, other: Option<&Outline>) -> Result<Vec<String>, PairedError> {
    let rest = |outline: &Outline| -> Vec<String> {
        outline.factors.iter().filter(|name| factor != Some(name.as_str())).cloned().collect()
    };
    let own = rest(one);
    if let Some(other) = other.map(rest) {
        let missing = own.iter().find(|name| !other.contains(name)).or(other.iter().find(|name| !own.contains(name)));
        if let Some(name) = missing {
            let reason = format!("the factor `{name}` is in one of the sweeps only; both must have the same factors");
            return Err(PairedError::new("other", reason, Vec::<String>::new()));
        }
    }
    Ok(own)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outline(factors: &[(&str, &[&str])]) -> Outline {
        let labels = factors.iter().flat_map(|(name, labels)| {
            labels.iter().map(|label| BTreeMap::from([((*name).to_owned(), (*label).to_owned())]))
        });
        let names = factors.iter().map(|(name, _)| (*name).to_owned()).collect();
        Outline { factors: names, labels: labels.collect(), metrics: vec!["soil_torque_nm".to_owned()] }
    }

    fn two_by_two() -> Outline {
        outline(&[("algorithm", &["rgop", "rg"]), ("field", &["crop-1", "crop-2"])])
    }

    fn ask(words: [&str; 5]) -> Question {
        let [factor, a, b, metric, group_by] =
            words.map(|word| Some(word).filter(|word| !word.is_empty()).map(str::to_owned));
        Question { factor, a, b, metric, group_by }
    }

    #[test]
    fn what_is_not_there_is_refused_with_what_is() {
        for (words, error) in [
            (["", "rgop", "rg", "", ""], "factor: is missing: allowed are algorithm, field"),
            (["crop", "rgop", "rg", "", ""], "factor: unknown factor `crop`: allowed are algorithm, field"),
            (["algorithm", "", "rg", "", ""], "a: is missing: allowed are rgop, rg"),
            (["algorithm", "rgop", "ruby", "", ""], "b: unknown label `ruby`: allowed are rgop, rg"),
            (["algorithm", "rgop", "rgop", "", ""], "b: `rgop` is `a` already: allowed are rg"),
            (["algorithm", "rgop", "rg", "", "algorithm"], "group_by: unknown factor `algorithm`: allowed are field"),
        ] {
            assert_eq!(ask(words).resolve(&two_by_two(), None).unwrap_err().to_string(), error);
        }
        let error = ask(["algorithm", "rgop", "rg", "mse", ""]).resolve(&two_by_two(), None).unwrap_err();
        assert!(error.key == "metric" && error.known.contains(&"soil_torque_nm".to_owned()), "{error}");
    }

    #[test]
    fn success_is_asked_for_where_nothing_is_and_ratios_need_their_sums() {
        let resolved = ask(["algorithm", "rgop", "rg", "", "field"]).resolve(&two_by_two(), None).unwrap();
        assert_eq!((resolved.wanted(), &resolved.paired), (vec!["success"], &vec!["field".to_owned()]));
        let asked = "distance_per_intervention_m,soil_torque_nm,success_ratio";
        let resolved = ask(["algorithm", "rgop", "rg", asked, ""]).resolve(&two_by_two(), None).unwrap();
        let sums = ["distance_m", "relevant_interventions"];
        assert_eq!(resolved.wanted()[..3], ["distance_per_intervention_m", "soil_torque_nm", "success"]);
        assert_eq!(resolved.wanted()[3..], sums);
    }

    #[test]
    fn two_sweeps_need_the_same_factors() {
        let other = outline(&[("algorithm", &["ruby"]), ("field", &["crop-1"])]);
        assert_eq!(ask([""; 5]).resolve(&two_by_two(), Some(&other)).unwrap().labels, None);
        let across = ask(["algorithm", "rgop", "ruby", "", ""]).resolve(&two_by_two(), Some(&other)).unwrap();
        assert_eq!(across.labels, Some(["rgop".to_owned(), "ruby".to_owned()]));
        let same = ask(["algorithm", "rgop", "rgop", "", ""]);
        assert!(same.resolve(&two_by_two(), Some(&two_by_two())).is_ok());
        let narrower = outline(&[("algorithm", &["rgop"])]);
        let error = ask([""; 5]).resolve(&two_by_two(), Some(&narrower)).unwrap_err();
        assert_eq!(error.key, "other");
        assert!(error.to_string().contains("`field`"), "{error}");
        let error = ask(["", "rgop", "", "", ""]).resolve(&two_by_two(), Some(&other)).unwrap_err();
        assert_eq!(error.key, "factor");
    }
}
