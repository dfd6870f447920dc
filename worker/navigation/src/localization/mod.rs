//! From the lines of many scans to the rows around the robot; in [`lane`] to the place in one lane; in [`graph`] to the
//! pose on a map of plants.

pub mod graph;
pub mod lane;
pub mod merge;
pub mod planting_map;
pub mod row_filter;

pub use graph::{GraphLocalization, GraphParams};
pub use lane::LaneEstimator;
pub use merge::MergedLines;
pub use planting_map::PlantingMap;
pub use row_filter::{RowFilter, RowFilterParams, Rows};

use crate::parameters::NoParams;
use crate::perception::LaneEstimate;

crate::kinds! {
    /// How the robot places itself among the rows.
    pub enum LocalizationSpec {
        /// The rows around the robot, kept by the filter of Guyonneau et al. (2022), algorithm 4.
        RowFilter(RowFilterParams) = "row-filter",
        /// The lane as the last scan showed it.
        View(NoParams) = "view",
        /// Its distances and heading by an extended Kalman filter: Velasquez et al. (2022), section 3.3.
        Ekf(lane::ekf::EkfParams) = "ekf",
        /// None: rows are followed as they are seen.
        None(NoParams) = "none",
        /// The pose in the map of a nursery by a graph of poses: Vintu (2018), section 3.4.
        PoseGraph(GraphParams) = "pose-graph",
        /// Offset, heading and lane width by particles that are weighted by the points alone: a baseline.
        ParticleFilter(lane::particle_filter::ParticleFilterParams) = "particle-filter",
    }
}

impl LocalizationSpec {
    /// An estimator in the middle of a lane of nominally `lane_width_m`; none for what places no robot in a lane.
    #[must_use]
    pub fn lane_estimator(&self, lane_width_m: f64) -> Option<Box<dyn LaneEstimator>> {
        let start = LaneEstimate::middle(lane_width_m);
        match self {
            Self::RowFilter(_) | Self::None(_) | Self::PoseGraph(_) => None,
            Self::View(_) => Some(Box::new(lane::LastView::new(start))),
            Self::Ekf(params) => Some(Box::new(lane::ekf::Ekf::new(params, start))),
            Self::ParticleFilter(params) => Some(Box::new(lane::particle_filter::ParticleFilter::new(params, start))),
        }
    }
}
