//! From a scan to the lane between two rows: one file per lane finder.
//!
//! The frame of the lane {P} has x along the lane's middle and y to the left; the robot's frame {R} is {P} turned by
//! the robot's heading. Both have their origin in the robot's reference point, the middle of the LiDAR in
//! Velasquez et al. (2022), figure 3.
//!
//! A new lane finder is one new file, and here three lines: its module, its variant of [`LaneFinderSpec`] and its arm
//! in [`LaneFinderSpec::build`].

pub mod joint_fit;
pub mod pl;
pub(crate) mod thinned;

#[cfg(test)]
mod conformance;
#[cfg(test)]
pub(crate) mod simulated;

use super::Points;
use crate::random::Stream;

/// The virtual wall on one side of the robot, as a finder sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Side {
    /// Orthogonal distance of the robot's reference point to the row \[m\], not negative.
    pub distance_m: f64,
    /// Whether this scan says so; an invalid side hands an older or assumed distance on.
    pub valid: bool,
}

/// What one scan says about the lane. All numbers are finite.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LaneView {
    /// The row to the left.
    pub left: Side,
    /// The row to the right.
    pub right: Side,
    /// The robot's heading in {P} \[rad\], counter-clockwise.
    pub heading_rad: f64,
    /// Whether this scan says so; otherwise an older heading.
    pub heading_valid: bool,
}

impl LaneView {
    /// The view of who sees nothing: `estimate`, all of it invalid.
    #[must_use]
    pub const fn nothing(estimate: LaneEstimate) -> Self {
        Self {
            left: Side { distance_m: estimate.left_m, valid: false },
            right: Side { distance_m: estimate.right_m, valid: false },
            heading_rad: estimate.heading_rad,
            heading_valid: false,
        }
    }
}

/// Where the robot is in its lane, as it believes. All numbers are finite.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LaneEstimate {
    /// Distance of the robot's reference point to the row on the left \[m\].
    pub left_m: f64,
    /// Likewise, on the right \[m\].
    pub right_m: f64,
    /// The robot's heading in {P} \[rad\], counter-clockwise.
    pub heading_rad: f64,
}

impl LaneEstimate {
    /// In the middle of a lane of `width_m`, along it.
    #[must_use]
    pub const fn middle(width_m: f64) -> Self {
        Self { left_m: 0.5 * width_m, right_m: 0.5 * width_m, heading_rad: 0.0 }
    }

    /// How far the robot is to the left of the lane's middle \[m\]: 0.5 (d_R - d_L), section 4.
    #[must_use]
    pub const fn cross_track_m(&self) -> f64 {
        0.5 * (self.right_m - self.left_m)
    }

    /// Width of the lane \[m\].
    #[must_use]
    pub const fn width_m(&self) -> f64 {
        self.left_m + self.right_m
    }
}

impl From<LaneView> for LaneEstimate {
    fn from(view: LaneView) -> Self {
        Self { left_m: view.left.distance_m, right_m: view.right.distance_m, heading_rad: view.heading_rad }
    }
}

/// Finds the lane in the scans of one LiDAR; may carry something over from scan to scan.
pub trait LaneFinder: Send {
    /// The lane in one scan.
    ///
    /// `points` are the returns in the robot's frame {R} \[m\]; `prior` is what the robot believes just before;
    /// `dt_s` \[s\] has passed since the last scan.
    fn find(&mut self, points: &Points, prior: LaneEstimate, dt_s: f64, random: &mut Stream) -> LaneView;

    /// Forgets all earlier scans: the robot stands at `start` now.
    fn restart(&mut self, start: LaneEstimate);
}

crate::kinds! {
    /// Which lane finder to run, with its parameters.
    pub enum LaneFinderSpec {
        /// Histogram and least squares per side: Velasquez et al. (2022), section 3.2.
        Pl(pl::PlParams) = "pl",
        /// Two parallel rows at once, over all headings: a baseline that needs no prior.
        JointFit(joint_fit::JointFitParams) = "joint-fit",
    }
}

impl LaneFinderSpec {
    /// A finder that has seen no scan yet, for lanes of nominally `lane_width_m`.
    #[must_use]
    pub fn build(&self, lane_width_m: f64) -> Box<dyn LaneFinder> {
        match self {
            Self::Pl(params) => Box::new(pl::Pl::new(params.clone(), lane_width_m)),
            Self::JointFit(params) => Box::new(joint_fit::JointFit::new(params.clone(), lane_width_m)),
        }
    }
}
