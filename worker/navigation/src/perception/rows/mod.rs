//! From plant points to the two rows beside the robot, a file per row detector: Vintu (2018), section 3.3.

use crate::Pose;
use crate::perception::cloud::Point3;
use crate::random::Stream;

/// What a row detector gets of one scan.
#[derive(Debug, Clone, Copy)]
pub struct PlantPoints<'a> {
    /// Points above the ground in the frame of the ground plane \[m\]: the origin below the robot's centre, x ahead, z up.
    pub points: &'a [Point3],
    /// Where the robot is by its wheels alone, in the odometry's frame.
    pub odometry_from_robot: Pose,
}

/// A line on the ground in the robot's frame: a point \[m\] and a unit direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RowLine {
    /// A point of the line \[m\].
    pub point: [f64; 2],
    /// Unit vector along it, in the half plane ahead of the robot.
    pub direction: [f64; 2],
}

/// What a row detector found in a scan, in the robot's frame \[m\].
#[derive(Debug, Clone, Copy, Default)]
pub struct DetectedRows<'a> {
    /// Lines along the rows beside the robot, at most two, in the order in which they were found.
    pub lines: [Option<RowLine>; 2],
    /// The points that each line was found in.
    pub supports: [&'a [[f64; 2]]; 2],
    /// Centres of single plants, where the detector tells plants apart.
    pub plants: &'a [[f64; 2]],
}

/// Finds the rows beside the robot; may carry points over from scan to scan.
pub trait RowDetector: Send {
    /// The rows in `view`.
    fn detect(&mut self, view: PlantPoints<'_>, random: &mut Stream) -> DetectedRows<'_>;
}
