//! Localization in the simulator: navigation's, and the oracle that knows where the robot is in the map of a nursery.

use furrow_navigation::localization::graph::{GraphLocalization, Measurement};
use furrow_navigation::localization::{self, LaneEstimator, PlantingMap};
use furrow_navigation::parameters::{Choice, Kinds, NoParams, Parameter, ParameterError, list};
use furrow_navigation::perception::rows::DetectedRows;
use serde::Serialize;
use serde_json::{Map, Value};

use crate::Pose;
use crate::run::LocatedNode;

/// How the robot places itself.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum LocalizationSpec {
    /// A choice that exists in the simulator alone.
    Simulated(SimulatedLocalization),
    /// What a robot's own computer would run.
    OnBoard(localization::LocalizationSpec),
}

furrow_navigation::kinds! {
    /// Localization that exists in the simulator alone.
    pub enum SimulatedLocalization {
        /// The true pose in the map of a nursery.
        Oracle(NoParams) = "oracle",
    }
}

impl Kinds for LocalizationSpec {
    fn kinds() -> Vec<&'static str> {
        [localization::LocalizationSpec::kinds(), SimulatedLocalization::kinds()].concat()
    }

    fn choices() -> Vec<Choice> {
        [localization::LocalizationSpec::choices(), SimulatedLocalization::choices()].concat()
    }

    fn table(kind: &str) -> Option<&'static [Parameter]> {
        localization::LocalizationSpec::table(kind).or_else(|| SimulatedLocalization::table(kind))
    }

    fn read_kind(kind: &str, parameters: Map<String, Value>) -> Result<Self, ParameterError> {
        if SimulatedLocalization::table(kind).is_some() {
            SimulatedLocalization::read_kind(kind, parameters).map(Self::Simulated)
        } else if localization::LocalizationSpec::table(kind).is_some() {
            localization::LocalizationSpec::read_kind(kind, parameters).map(Self::OnBoard)
        } else {
            Err(ParameterError::new("kind", format!("`{kind}` is unknown, allowed is {}", list(&Self::kinds()))))
        }
    }
}

impl LocalizationSpec {
    /// An estimator in the middle of a lane of nominally `lane_width_m`; none for what places no robot in a lane.
    #[must_use]
    pub fn lane_estimator(&self, lane_width_m: f64) -> Option<Box<dyn LaneEstimator>> {
        match self {
            Self::Simulated(_) => None,
            Self::OnBoard(spec) => spec.lane_estimator(lane_width_m),
        }
    }
}

/// Where a robot believes to be in the map of a nursery.
pub(crate) enum InMap {
    /// It does not know.
    Unknown,
    /// With whether the last scan added a node.
    Graph(Box<GraphLocalization>, bool),
    /// It knows.
    Oracle,
}

impl InMap {
    /// At `start` in `map`.
    pub(crate) fn new(spec: &LocalizationSpec, map: PlantingMap, start: Pose) -> Self {
        match spec {
            LocalizationSpec::Simulated(SimulatedLocalization::Oracle(_)) => Self::Oracle,
            LocalizationSpec::OnBoard(localization::LocalizationSpec::PoseGraph(params)) => {
                Self::Graph(Box::new(GraphLocalization::new(params, map, start)), false)
            }
            LocalizationSpec::OnBoard(_) => Self::Unknown,
        }
    }

    /// Whether a choice places a robot in a map, or says that none does.
    pub(crate) const fn places(spec: &LocalizationSpec) -> bool {
        use localization::LocalizationSpec::{None, PoseGraph};
        matches!(spec, LocalizationSpec::Simulated(_) | LocalizationSpec::OnBoard(None(_) | PoseGraph(_)))
    }

    /// The pose in the map after a scan; only the oracle looks at the truth.
    pub(crate) fn locate(&mut self, odometry: Pose, rows: &DetectedRows<'_>, truth: Pose) -> Option<Pose> {
        match self {
            Self::Unknown => None,
            Self::Graph(graph, is_new) => {
                *is_new = graph.correct(odometry, rows);
                Some(graph.estimate())
            }
            Self::Oracle => Some(truth),
        }
    }

    /// The node that the last scan added to the graph, if it did.
    pub(crate) fn new_node(&self) -> Option<LocatedNode> {
        let Self::Graph(graph, true) = self else { return None };
        let (map_from_robot, measurements) = graph.newest();
        Some(LocatedNode { map_from_robot, matched_m: matched(map_from_robot, measurements) })
    }
}

/// Along each row of the map that was matched, from the first to the last point seen.
fn matched(map_from_robot: Pose, measurements: &[Measurement]) -> Vec<[[f64; 2]; 2]> {
    let mut parts: Vec<[[f64; 2]; 2]> = Vec::new();
    for measurement in measurements {
        let (seen, row_y_m) = match measurement {
            Measurement::RowPoint { seen, row_y_m, .. } => (seen, *row_y_m),
            Measurement::Plant { seen, planted } => (seen, planted[1]),
            Measurement::RowLine { .. } => continue,
        };
        let [x_m, _] = map_from_robot.world(seen[0], seen[1]);
        match parts.iter_mut().find(|part| part[0][1] == row_y_m) {
            Some([from, to]) => (from[0], to[0]) = (from[0].min(x_m), to[0].max(x_m)),
            None => parts.push([[x_m, row_y_m]; 2]),
        }
    }
    parts
}
