//! Drawings of a run.

use crate::{Pose, RunResult, Scenario, Seed};

/// Field, weeds, damaged plants and the path of a run, seen from above, as an SVG document.
#[must_use]
pub fn trajectory(_scenario: &Scenario, _seed: Seed, _path: &[Pose], _result: &RunResult) -> String {
    String::new()
}
