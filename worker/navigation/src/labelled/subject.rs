//! What is judged: a lane finder by its views, or an estimator that works on points.

use serde_json::{Map, Value};

use crate::control::Twist;
use crate::localization::{LaneEstimator, LocalizationSpec};
use crate::parameters::{Kinds, ParameterError, list};
use crate::perception::{LaneEstimate, LaneFinder, LaneFinderSpec, LaneView, Points};
use crate::random::Stream;

/// The one estimator that needs no finder.
const PARTICLE_FILTER: &str = "particle-filter";

/// What is judged.
pub enum Subject {
    /// By its view of each scan.
    Finder(Box<dyn LaneFinder>),
    /// By its estimate after each scan, of which it gets the points and no view.
    Estimator(Box<dyn LaneEstimator>),
}

impl Subject {
    /// The words that [`read`](Self::read) knows.
    #[must_use]
    pub fn kinds() -> Vec<&'static str> {
        [LaneFinderSpec::kinds(), vec![PARTICLE_FILTER]].concat()
    }

    /// The part of a scenario that `kind` is a choice for.
    #[must_use]
    pub fn part(kind: &str) -> &'static str {
        if kind == PARTICLE_FILTER { "localization" } else { "perception" }
    }

    /// The subject called `kind`, for lanes of nominally `lane_width_m`.
    ///
    /// # Errors
    /// Names the unknown kind, or the parameter at fault.
    pub fn read(kind: &str, parameters: Map<String, Value>, lane_width_m: f64) -> Result<Self, ParameterError> {
        if LaneFinderSpec::table(kind).is_some() {
            return LaneFinderSpec::read_kind(kind, parameters).map(|spec| Self::Finder(spec.build(lane_width_m)));
        }
        let unknown = || ParameterError::new("", format!("`{kind}` is unknown, allowed is {}", list(&Self::kinds())));
        if kind != PARTICLE_FILTER {
            return Err(unknown());
        }
        let spec = LocalizationSpec::read_kind(kind, parameters)?;
        spec.lane_estimator(lane_width_m).map(Self::Estimator).ok_or_else(unknown)
    }

    /// Forgets all scans and starts at `start`.
    pub(super) fn restart(&mut self, start: LaneEstimate) {
        match self {
            Self::Finder(finder) => finder.restart(start),
            Self::Estimator(estimator) => estimator.restart(start),
        }
    }

    /// What it makes of a scan that comes `moved_s` \[s\] after the last one.
    pub(super) fn see(
        &mut self,
        points: &Points,
        prior: LaneEstimate,
        moved_s: f64,
        random: &mut Stream,
    ) -> LaneEstimate {
        match self {
            Self::Finder(finder) => finder.find(points, prior, moved_s, random).into(),
            Self::Estimator(estimator) => {
                estimator.predict(Twist::default(), moved_s);
                estimator.correct(points, LaneView::nothing(prior), random);
                estimator.estimate()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn refused(kind: &str, parameters: Value) -> String {
        let Value::Object(parameters) = parameters else { panic!("an object") };
        Subject::read(kind, parameters, 0.75).err().unwrap().to_string()
    }

    #[test]
    fn unknown_kinds_and_parameters_are_refused() {
        assert!(refused("ekf", json!({})).contains("`pl`, `joint-fit`, `particle-filter`"));
        assert!(refused("pl", json!({"bin_m": 9})).starts_with("bin_m: 9 is out of range"));
        assert!(refused("particle-filter", json!({"eyes": 2})).contains("eyes"));
    }
}
