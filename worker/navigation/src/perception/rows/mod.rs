//! From plant points to the two rows beside the robot, a file per row detector: Vintu (2018), section 3.3.
//!
//! A new row detector is one new file, and here three lines: its module, its variant of [`RowDetectorSpec`] and its arm
//! in [`RowDetectorSpec::build`].

pub mod centroid_lines;
mod grid;
mod line;
pub mod map_lines;
pub mod parallel_lines;
pub mod pcl_lines;

#[cfg(test)]
mod conformance;

pub use line::RowLine;

use crate::Pose;
use crate::localization::PlantingMap;
use crate::perception::cloud::{FrontEndParams, Point3};
use crate::random::Stream;

/// Declares the parameters of a row detector: its own, and those of the front end before it.
macro_rules! row_parameters {
    ($(#[doc = $about:literal])* pub struct $name:ident { $($own:tt)* }) => {
        $crate::parameters! {
            $(#[doc = $about])*
            pub struct $name {
                $($own)*
                /// Statistical outlier removal: neighbours whose mean distance counts. Ours.
                pub outlier_neighbours: u32 = 10, "1", [1, 100];
                /// How many standard deviations above the mean a point's may be. Ours: what is far is sparse, and should stay.
                pub outlier_deviations: f64 = 3.0, "1", [0.0, 100.0];
                /// Radius outlier removal: neighbours that a point must have. Ours.
                pub radius_neighbours: u32 = 3, "1", [0, 100];
                /// Within this distance. Ours: as far apart as neighbouring rays are at the LiDAR's full range, 15 m.
                pub radius_m: f64 = 0.35, "m", [0.001, 10.0];
                /// Ground plane: triples of points that are tried at most. Ours.
                pub ground_iterations: u32 = 100, "1", [1, 10000];
                /// Points nearer to it belong to the ground, plants stand higher. Ours.
                pub ground_threshold_m: f64 = 0.05, "m", [0.001, 1.0];
                /// Planes that are averaged. Paper: 10.
                pub ground_mean_of: u32 = 10, "1", [1, 1000];
                /// Planes with more tilt are none. Paper: 45 degrees.
                pub ground_max_tilt_rad: f64 = std::f64::consts::FRAC_PI_4, "rad", [0.01, 1.5];
            }
        }

        impl $name {
            /// Those of the front end.
            pub(super) const fn front_end(&self) -> $crate::perception::cloud::FrontEndParams {
                $crate::perception::cloud::FrontEndParams {
                    outlier_neighbours: self.outlier_neighbours,
                    outlier_deviations: self.outlier_deviations,
                    radius_neighbours: self.radius_neighbours,
                    radius_m: self.radius_m,
                    ground_iterations: self.ground_iterations,
                    ground_threshold_m: self.ground_threshold_m,
                    ground_mean_of: self.ground_mean_of,
                    ground_max_tilt_rad: self.ground_max_tilt_rad,
                }
            }
        }
    };
}
pub(super) use row_parameters;

/// What a row detector gets of one scan.
#[derive(Debug, Clone, Copy)]
pub struct PlantPoints<'a> {
    /// Points above the ground in the frame of the ground plane \[m\]: the origin below the robot's centre, x ahead, z up.
    pub points: &'a [Point3],
    /// Where the robot is by its wheels alone, in the odometry's frame.
    pub odometry_from_robot: Pose,
}

/// What a row detector found in a scan, in the robot's frame \[m\].
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct DetectedRows<'a> {
    /// Lines along the rows beside the robot, at most two, in the order in which they were found.
    pub lines: [Option<RowLine>; 2],
    /// The points that each line was found in; of a map of the surroundings only what this scan hit.
    pub supports: [&'a [[f64; 2]]; 2],
    /// Centres of single plants that this scan hit, where the detector tells plants apart.
    pub plants: &'a [[f64; 2]],
}

/// Finds the rows beside the robot; may carry points over from scan to scan.
pub trait RowDetector: Send {
    /// The rows in `view`.
    fn detect(&mut self, view: PlantPoints<'_>, random: &mut Stream) -> DetectedRows<'_>;
}

crate::kinds! {
    /// Which row detector to run, with its parameters.
    pub enum RowDetectorSpec {
        /// A line by random sampling, and another one in what is left.
        PclLines(pcl_lines::PclLinesParams) = "pcl-lines",
        /// Two parallel lines at the known distance of the rows, found together.
        ParallelLinesRansac(parallel_lines::ParallelLinesParams) = "parallel-lines-ransac",
        /// Lines through the centroids of plants in the last scans.
        CentroidLines(centroid_lines::CentroidLinesParams) = "centroid-lines",
        /// The planting grid in a map of the robot's surroundings.
        MapLines(map_lines::MapLinesParams) = "map-lines",
    }
}

impl RowDetectorSpec {
    /// Parameters of the front end before it.
    #[must_use]
    pub fn front_end(&self) -> FrontEndParams {
        match self {
            Self::PclLines(params) => params.front_end(),
            Self::ParallelLinesRansac(params) => params.front_end(),
            Self::CentroidLines(params) => params.front_end(),
            Self::MapLines(params) => params.front_end(),
        }
    }

    /// A detector that has seen no scan yet; of `map` it may know the distances.
    #[must_use]
    pub fn build(&self, map: &PlantingMap) -> Box<dyn RowDetector> {
        match self {
            Self::PclLines(params) => Box::new(pcl_lines::PclLines::new(params.clone())),
            Self::ParallelLinesRansac(params) => Box::new(parallel_lines::ParallelLines::new(params.clone(), map)),
            Self::CentroidLines(params) => Box::new(centroid_lines::CentroidLines::new(params.clone(), map)),
            Self::MapLines(params) => Box::new(map_lines::MapLines::new(params.clone(), map)),
        }
    }
}
