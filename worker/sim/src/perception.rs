//! Perception in the simulator: navigation's line finders, and the oracle that sees the truth.
//!
//! The oracle replaces perception only: it hands out the rows' true lines in place of found ones, beside the
//! same points. Merging, filter, control and row ends stay. It is the ceiling, and the test of the world.

mod nursery;

use furrow_navigation::parameters::{Choice, Kinds, NoParams, Parameter, ParameterError, list};
use furrow_navigation::perception::lane::Side;
use furrow_navigation::perception::rows::RowDetectorSpec;
use furrow_navigation::perception::{
    Found, LaneEstimate, LaneFinder, LaneFinderSpec, LaneView, Line, LineFinder, LineFinderSpec, Points, Scan,
};
use furrow_navigation::random::Stream;
pub(crate) use nursery::RowPerception;
use serde::Serialize;
use serde_json::{Map, Value};

use crate::Pose;
use crate::field::Field;
use crate::field::lane::Place;

/// Rows farther from the LiDAR than this are not seen by the oracle either \[m\]: its range.
const SIGHT_M: f64 = 4.0;
/// A row steeper than this is not a line y = a x + b any more.
const STEEPEST: f64 = 20.0;
/// Neighbouring returns closer than this become one point, as for the finders on Z* \[m\].
const FUSE_DISTANCE_M: f64 = 0.05;

/// What turns scans into lines.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum PerceptionSpec {
    /// A choice that exists in the simulator alone.
    Simulated(SimulatedPerception),
    /// A line finder.
    LineFinder(LineFinderSpec),
    /// A lane finder.
    LaneFinder(LaneFinderSpec),
    /// A row detector.
    RowDetector(RowDetectorSpec),
}

furrow_navigation::kinds! {
    /// Perception that exists in the simulator alone.
    pub enum SimulatedPerception {
        /// The true rows in place of found lines, or of a lane.
        Oracle(NoParams) = "oracle",
        /// No perception: for missions that read no lines.
        None(NoParams) = "none",
    }
}

impl Kinds for PerceptionSpec {
    fn kinds() -> Vec<&'static str> {
        [SimulatedPerception::kinds(), LineFinderSpec::kinds(), LaneFinderSpec::kinds(), RowDetectorSpec::kinds()]
            .concat()
    }

    fn choices() -> Vec<Choice> {
        [
            SimulatedPerception::choices(),
            LineFinderSpec::choices(),
            LaneFinderSpec::choices(),
            RowDetectorSpec::choices(),
        ]
        .concat()
    }

    fn table(kind: &str) -> Option<&'static [Parameter]> {
        let of_2d = || LineFinderSpec::table(kind).or_else(|| LaneFinderSpec::table(kind));
        SimulatedPerception::table(kind).or_else(of_2d).or_else(|| RowDetectorSpec::table(kind))
    }

    fn read_kind(kind: &str, parameters: Map<String, Value>) -> Result<Self, ParameterError> {
        if SimulatedPerception::table(kind).is_some() {
            SimulatedPerception::read_kind(kind, parameters).map(Self::Simulated)
        } else if LineFinderSpec::table(kind).is_some() {
            LineFinderSpec::read_kind(kind, parameters).map(Self::LineFinder)
        } else if LaneFinderSpec::table(kind).is_some() {
            LaneFinderSpec::read_kind(kind, parameters).map(Self::LaneFinder)
        } else if RowDetectorSpec::table(kind).is_some() {
            RowDetectorSpec::read_kind(kind, parameters).map(Self::RowDetector)
        } else {
            let reason = format!("`{kind}` is unknown, allowed is {}", list(&Self::kinds()));
            Err(ParameterError::new("kind", reason))
        }
    }
}

/// The perception of one LiDAR.
pub(crate) enum Perception {
    Finder(Box<dyn LineFinder>),
    Oracle(Oracle),
}

impl Perception {
    /// None where the scenario has no perception of rows.
    pub(crate) fn new(spec: &PerceptionSpec) -> Option<Self> {
        match spec {
            PerceptionSpec::Simulated(SimulatedPerception::Oracle(_)) => Some(Self::Oracle(Oracle::default())),
            PerceptionSpec::LineFinder(spec) => Some(Self::Finder(spec.build())),
            _ => None,
        }
    }

    /// Lines in `scan`; only the oracle looks at the truth.
    pub(crate) fn find(&mut self, scan: &Scan<'_>, random: &mut Stream, truth: (&Field, Pose)) -> Found<'_> {
        match self {
            Self::Finder(finder) => finder.find(scan, random),
            Self::Oracle(oracle) => oracle.find(scan, truth.0, truth.1),
        }
    }
}

/// The perception of a robot in a lane.
pub(crate) enum LanePerception {
    Finder(Box<dyn LaneFinder>),
    Oracle,
}

impl LanePerception {
    /// None where the scenario has no perception of lanes.
    pub(crate) fn new(spec: &PerceptionSpec, lane_width_m: f64) -> Option<Self> {
        match spec {
            PerceptionSpec::Simulated(SimulatedPerception::Oracle(_)) => Some(Self::Oracle),
            PerceptionSpec::LaneFinder(spec) => Some(Self::Finder(spec.build(lane_width_m))),
            _ => None,
        }
    }

    /// The lane in one scan; only the oracle looks at the truth.
    pub(crate) fn find(
        &mut self,
        points: &Points,
        prior: LaneEstimate,
        dt_s: f64,
        random: &mut Stream,
        truth: Place,
    ) -> LaneView {
        match self {
            Self::Finder(finder) => finder.find(points, prior, dt_s, random),
            Self::Oracle => LaneView {
                left: Side { distance_m: truth.left_m, valid: true },
                right: Side { distance_m: truth.right_m, valid: true },
                heading_rad: truth.heading_rad,
                heading_valid: true,
            },
        }
    }

    /// Forgets all earlier scans: the robot stands at `start` now.
    pub(crate) fn restart(&mut self, start: LaneEstimate) {
        if let Self::Finder(finder) = self {
            finder.restart(start);
        }
    }
}

/// Hands out the rows' true lines.
#[derive(Debug, Default)]
pub(crate) struct Oracle {
    points: Points,
    lines: Vec<Line>,
}

impl Oracle {
    fn find(&mut self, scan: &Scan<'_>, field: &Field, world_from_lidar: Pose) -> Found<'_> {
        self.points.read_scan_fused(scan, FUSE_DISTANCE_M);
        self.lines.clear();
        for row in &field.rows {
            let (point, direction) = row.piece_near(world_from_lidar.x_m, world_from_lidar.y_m);
            let (x, y) = world_from_lidar.local(point[0], point[1]);
            let (sin, cos) = libm::sincos(world_from_lidar.heading_rad);
            let (dx, dy) = (cos * direction[0] + sin * direction[1], cos * direction[1] - sin * direction[0]);
            let distance_m = (x * dy - y * dx).abs();
            if distance_m <= SIGHT_M && dy.abs() <= STEEPEST * dx.abs() {
                let slope = dy / dx;
                self.lines.push(Line::new(slope, y - slope * x));
            }
        }
        Found { points: &self.points, lines: &self.lines }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::{FieldSpec, guyonneau2022::Guyonneau2022Params};
    use furrow_navigation::perception::Beams;

    #[test]
    fn the_oracle_gives_the_rows_in_the_lidars_frame() {
        let field = FieldSpec::Guyonneau2022(Guyonneau2022Params { crop: 2, ..Default::default() }).build(1);
        let beams = Beams::new(2, 1.0);
        let scan = Scan { beams: &beams, ranges_m: &[f64::INFINITY; 2] };
        let pose = Pose { x_m: 3.0, y_m: 0.1, heading_rad: 0.2 };
        for looks_back in [false, true] {
            let at = pose.sensor(0.5, looks_back);
            let mut oracle = Oracle::default();
            let found = oracle.find(&scan, &field, at);
            assert!(found.lines.len() >= 4);
            for (line, y) in found.lines.iter().zip([-0.5, 0.5, 1.5]) {
                let (x, y) = at.local(7.0, y);
                assert!(line.distance_m(x, y) < 1e-12);
                assert!(line.slope < 0.0, "turned counter-clockwise means a negative slope");
            }
        }
    }

    #[test]
    fn an_unknown_kind_lists_all_that_are_known() {
        let error = PerceptionSpec::read(serde_json::json!({"kind": "sight"})).unwrap_err();
        assert!(error.to_string().contains("`oracle`, `none`, `pearl`"), "{error}");
    }
}
