//! Graph localization: the robot's pose on the planting map. Vintu (2018), section 3.4.
//!
//! Nodes are poses; odometry ties each to the one before, points of detected lines tie it to the map's rows and, where
//! the detector tells plants apart, plants to the map's planting positions. Lines alone leave the place along the rows to
//! the odometry.
//!
//! Ours, where the thesis is silent: the points of one line share what their line is off by, so together they count as
//! one point. Plants repeat every planting distance, so they are taken only while the place along the rows is known to
//! half their gate (one standard deviation), and only within the gate.

mod chain;
mod edges;
mod matching;
mod measurement;
mod odometry;

#[cfg(test)]
mod tests;

use nalgebra::Matrix3;

use super::PlantingMap;
use crate::Pose;
use crate::odometry::OdometryNoise;
use crate::perception::rows::DetectedRows;
use chain::{Chain, LinearPrior};
use edges::wrap;
use matching::{MOST_PLANTS, Matcher};
use measurement::MeasurementNoise;
use odometry::Travel;

pub use measurement::Measurement;

crate::parameters! {
    /// Parameters of [`GraphLocalization`].
    pub struct GraphParams {
        /// Way after which a node is due. Ours.
        pub node_distance_m: f64 = 0.25, "m", [0.01, 10.0];
        /// Turn after which a node is due: 5 degrees. Ours.
        pub node_turn_rad: f64 = 0.087_266_462_599_716_48, "rad", [0.001, 3.2];
        /// Nodes that are optimised together; what older ones knew stays as a prior. Ours.
        pub window_nodes: u32 = 40, "1", [2, 1000];
        /// Gauss-Newton steps per node at most. Ours.
        pub iterations: u32 = 3, "1", [1, 100];
        /// Standard deviations beyond which a match counts less, by Huber's kernel. Ours.
        pub huber: f64 = 1.0, "1", [0.1, 100.0];
        /// Standard deviation of the start pose's place, in each direction. Ours.
        pub start_sd_m: f64 = 0.05, "m", [0.001, 10.0];
        /// Standard deviation of the start pose's heading: 1 degree. Ours.
        pub start_sd_rad: f64 = 0.017_453_292_519_943_295, "rad", [0.001, 3.2];
        /// Odometry: standard deviation of the distance per distance. Ours.
        pub odometry_distance_sd: f64 = 0.05, "m/m", [0.0, 10.0];
        /// Odometry: standard deviation of the drift across per distance. Ours.
        pub odometry_drift_sd: f64 = 0.02, "m/m", [0.0, 10.0];
        /// Odometry: standard deviation of the drift across per turn. Ours.
        pub odometry_drift_turn_sd: f64 = 0.06, "m/rad", [0.0, 10.0];
        /// Odometry: standard deviation of the heading per distance. Ours.
        pub odometry_heading_sd: f64 = 0.02, "rad/m", [0.0, 10.0];
        /// Odometry: standard deviation of the heading per turn. Ours.
        pub odometry_heading_turn_sd: f64 = 0.10, "rad/rad", [0.0, 10.0];
        /// Standard deviation of a line at a node; large, as the next nodes see the same plants. Ours.
        pub line_sd_m: f64 = 0.07, "m", [0.001, 10.0];
        /// Standard deviation of a plant at a node, in each direction; large for the same reason. Ours.
        pub plant_sd_m: f64 = 0.1, "m", [0.001, 10.0];
        /// Points taken of each line. Ours.
        pub line_points: u32 = 20, "1", [1, 1000];
        /// A line and its points are no further from their row. Ours.
        pub line_gate_m: f64 = 0.5, "m", [0.0, 10.0];
        /// A line is turned no further from the rows: 15 degrees. Ours.
        pub line_gate_rad: f64 = 0.261_799_387_799_149_4, "rad", [0.0, 1.6];
        /// A plant is no further from its planting position. Ours.
        pub plant_gate_m: f64 = 0.35, "m", [0.0, 10.0];
        /// Nor further than this share of the planting distance. Ours.
        pub plant_gate_share: f64 = 0.4, "1", [0.0, 0.5];
        /// Further beyond the rows' ends no line is matched. Ours.
        pub beyond_rows_m: f64 = 1.0, "m", [0.0, 100.0];
    }
}

impl GraphParams {
    /// A plant is no further from its planting position \[m\]: the tighter of both gates.
    fn plant_gate(&self, map: &PlantingMap) -> f64 {
        self.plant_gate_m.min(self.plant_gate_share * map.planting_distance_m)
    }

    fn odometry_noise(&self) -> OdometryNoise {
        OdometryNoise {
            distance_sd: self.odometry_distance_sd,
            drift_sd: self.odometry_drift_sd,
            drift_turn_sd: self.odometry_drift_turn_sd,
            heading_sd: self.odometry_heading_sd,
            heading_turn_sd: self.odometry_heading_turn_sd,
        }
    }

    fn start_covariance(&self) -> Matrix3<f64> {
        let (place, heading) = (self.start_sd_m * self.start_sd_m, self.start_sd_rad * self.start_sd_rad);
        Matrix3::from_diagonal(&nalgebra::Vector3::new(place, place, heading))
    }
}

/// The pose on the map, kept by a window of past poses.
#[derive(Debug, Clone)]
pub struct GraphLocalization {
    params: GraphParams,
    map: PlantingMap,
    chain: Chain,
    /// Of the newest node.
    covariance: Matrix3<f64>,
    travel: Travel,
    last_odometry: Option<Pose>,
}

impl GraphLocalization {
    /// At `start` on the map, as sure of it as the parameters say. The first odometry reading belongs to it.
    #[must_use]
    pub fn new(params: &GraphParams, map: PlantingMap, start: Pose) -> Self {
        let covariance = params.start_covariance();
        let information = covariance.map(|variance| if variance > 0.0 { 1.0 / variance } else { 0.0 });
        let start = Pose { heading_rad: wrap(start.heading_rad), ..start };
        let noise = MeasurementNoise { line_m: params.line_sd_m, plant_m: params.plant_sd_m, huber: params.huber };
        let most = 2 * params.line_points as usize + MOST_PLANTS;
        let chain = Chain::new(params.window_nodes as usize, most, noise, LinearPrior::new(start, information));
        Self { params: params.clone(), map, chain, covariance, travel: Travel::default(), last_odometry: None }
    }

    /// Goes on by what the odometry says; a reading that is no place within 1000 km is left out.
    pub fn predict(&mut self, odometry_from_robot: Pose) {
        let Pose { x_m, y_m, heading_rad } = odometry_from_robot;
        if ![x_m, y_m, heading_rad].iter().all(|value| value.abs() < 1e6) {
            return;
        }
        if let Some(last) = self.last_odometry {
            let step = last.relative(odometry_from_robot);
            let step = Pose { heading_rad: wrap(step.heading_rad), ..step };
            self.travel = self.travel.then(step, &self.params.odometry_noise());
        }
        self.last_odometry = Some(odometry_from_robot);
    }

    /// Goes on by what the odometry says, and if a node is due, adds it with what of `rows` matches the map and
    /// optimises the window. Returns whether it did.
    ///
    /// A window that cannot be solved leaves the poses as the odometry predicts them.
    pub fn correct(&mut self, odometry_from_robot: Pose, rows: &DetectedRows<'_>) -> bool {
        self.predict(odometry_from_robot);
        if !self.is_due() {
            return false;
        }
        let (pose, covariance) = (self.estimate(), self.moved_covariance());
        let Some(information) = self.travel.information() else { return false };
        if self.chain.push(self.travel.node_from_robot, information).is_err() {
            return false;
        }
        self.travel = Travel::default();
        self.measure(pose, covariance[(0, 0)].sqrt(), rows);
        self.covariance = self.chain.optimise(self.params.iterations).unwrap_or(covariance);
        true
    }

    /// The robot's pose on the map: the newest node and the odometry since.
    #[must_use]
    pub fn estimate(&self) -> Pose {
        let pose = self.chain.newest().compose(self.travel.node_from_robot);
        Pose { heading_rad: wrap(pose.heading_rad), ..pose }
    }

    /// Covariance of the estimate's x, y \[m\] and heading \[rad\] on the map.
    #[must_use]
    pub fn covariance(&self) -> [[f64; 3]; 3] {
        self.moved_covariance().transpose().into()
    }

    /// The nodes in the window with what was matched at each, oldest first.
    pub fn nodes(&self) -> impl DoubleEndedIterator<Item = (Pose, &[Measurement])> + ExactSizeIterator {
        self.chain.nodes()
    }

    /// The newest node with what was matched there.
    #[must_use]
    pub fn newest(&self) -> (Pose, &[Measurement]) {
        self.nodes().next_back().unwrap_or((self.estimate(), &[]))
    }

    fn is_due(&self) -> bool {
        let Pose { x_m, y_m, heading_rad } = self.travel.node_from_robot;
        (x_m * x_m + y_m * y_m).sqrt() >= self.params.node_distance_m || heading_rad.abs() >= self.params.node_turn_rad
    }

    fn moved_covariance(&self) -> Matrix3<f64> {
        self.travel.covariance_after(self.chain.newest(), self.covariance)
    }

    /// Ties the newest node, at `pose`, to the map.
    fn measure(&mut self, pose: Pose, sd_along_m: f64, rows: &DetectedRows<'_>) {
        let Self { params, map, chain, .. } = self;
        let matcher = Matcher::new(params, map, pose);
        matcher.lines(rows, |one| chain.measure(one));
        if sd_along_m < 0.5 * params.plant_gate(map) {
            matcher.plants(rows, |one| chain.measure(one));
        }
    }
}
