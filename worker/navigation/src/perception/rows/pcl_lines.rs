//! A line by random sample consensus, then another one in the points that it leaves.
//!
//! Vintu (2018), section 3.3.1.

use super::{DetectedRows, PlantPoints, RowDetector, RowLine};
use crate::perception::cloud::Point3;
use crate::perception::cloud::line::LineSearch;
use crate::random::Stream;

super::row_parameters! {
    /// Parameters of [`PclLines`].
    pub struct PclLinesParams {
        /// A point nearer than this to a line supports it. Paper: 0.3, table 4.3.
        pub dist_threshold_m: f64 = 0.3, "m", [0.001, 5.0];
        /// Pairs of points that are tried per line at most. Paper: 20, table 4.3.
        pub max_iteration: u32 = 20, "1", [1, 10000];
        /// Whether heights are dropped before lines are fitted; else a line may stand upright along a stem. Ours.
        pub flatten_z: bool = true, "";
    }
}

/// The detector.
#[derive(Debug, Clone)]
pub struct PclLines {
    params: PclLinesParams,
    search: LineSearch,
    /// Points that no line has taken yet, and where they are on the ground.
    left: Vec<Point3>,
    flat: Vec<[f64; 2]>,
    supports: [Vec<[f64; 2]>; 2],
}

impl PclLines {
    /// A detector with these parameters.
    #[must_use]
    pub fn new(params: PclLinesParams) -> Self {
        let (left, flat) = (Vec::new(), Vec::new());
        Self { params, search: LineSearch::default(), left, flat, supports: Default::default() }
    }

    /// Takes the next line and its points out of what is left.
    fn take_line(&mut self, number: usize, random: &mut Stream) -> Option<RowLine> {
        let PclLinesParams { dist_threshold_m, max_iteration, flatten_z, .. } = self.params;
        let line = if flatten_z {
            self.flat.clear();
            self.flat.extend(self.left.iter().map(|point| [point.x, point.y]));
            self.search.find(&self.flat, dist_threshold_m, max_iteration, random)
        } else {
            self.search.find_in_space(&self.left, dist_threshold_m, max_iteration, random)
        };
        let mut inliers = self.search.inliers().iter().peekable();
        let (mut i, support) = (0, &mut self.supports[number]);
        self.left.retain(|point| {
            let is_inlier = inliers.next_if(|inlier| **inlier == i).is_some();
            i += 1;
            if is_inlier {
                support.push([point.x, point.y]);
            }
            !is_inlier
        });
        line
    }
}

impl RowDetector for PclLines {
    fn detect(&mut self, view: PlantPoints<'_>, random: &mut Stream) -> DetectedRows<'_> {
        self.supports.iter_mut().for_each(Vec::clear);
        self.left.clear();
        self.left.extend_from_slice(view.points);
        let lines = [0, 1].map(|number| self.take_line(number, random));
        let [first, second] = &self.supports;
        DetectedRows { lines, supports: [first, second], plants: &[] }
    }
}
