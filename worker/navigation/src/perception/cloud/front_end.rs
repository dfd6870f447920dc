//! From a scan to the points that stand above the ground: Vintu (2018), section 3.2.1.

use super::outliers::OutlierRemoval;
use super::plane::GroundFilter;
use super::{CloudMount, Point3};
use crate::random::Stream;

/// Parameters of [`FrontEnd`]; those of each row detector hold them.
#[derive(Debug, Clone, PartialEq)]
pub struct FrontEndParams {
    /// Statistical outlier removal: neighbours.
    pub outlier_neighbours: u32,
    /// Standard deviations above the mean distance that a point's may be.
    pub outlier_deviations: f64,
    /// Radius outlier removal: neighbours that a point must have.
    pub radius_neighbours: u32,
    /// Within this distance \[m\].
    pub radius_m: f64,
    /// Ground plane: triples that are tried at most.
    pub ground_iterations: u32,
    /// A point nearer than this to it belongs to it; plants stand higher \[m\].
    pub ground_threshold_m: f64,
    /// Planes that are averaged.
    pub ground_mean_of: u32,
    /// A plane with more tilt is none \[rad\].
    pub ground_max_tilt_rad: f64,
}

/// Takes outliers and the ground out of one scan after the other.
#[derive(Debug)]
pub struct FrontEnd {
    params: FrontEndParams,
    mount: CloudMount,
    outliers: OutlierRemoval,
    ground: GroundFilter,
    points: Vec<Point3>,
    plants: Vec<Point3>,
}

impl FrontEnd {
    /// Behind a LiDAR that is mounted so.
    #[must_use]
    pub fn new(params: &FrontEndParams, mount: CloudMount) -> Self {
        Self {
            params: params.clone(),
            mount,
            outliers: OutlierRemoval::default(),
            ground: GroundFilter::new(params),
            points: Vec::new(),
            plants: Vec::new(),
        }
    }

    /// Takes in the returns of a scan, in the LiDAR's frame \[m\], and removes outliers.
    pub fn filter(&mut self, returns: &[Point3]) {
        self.points.clear();
        self.points.extend(returns.iter().filter(|point| point.is_finite()));
        self.outliers.remove(&mut self.points, &self.params);
        let robot_from_lidar = self.mount.robot_from_lidar();
        self.points.iter_mut().for_each(|point| *point = robot_from_lidar(*point));
    }

    /// Finds the ground in what is left, and the points above it.
    pub fn find_ground(&mut self, random: &mut Stream) {
        self.ground.plants(&self.points, &mut self.plants, random);
    }

    /// The points above the ground, in the ground plane's frame \[m\].
    #[must_use]
    pub fn plants(&self) -> &[Point3] {
        &self.plants
    }
}
