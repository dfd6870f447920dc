//! Two parallel lines at the rows' known distance, by random sample consensus.
//!
//! Vintu (2018), section 3.3.2. The second line is laid on that side of the first one on which the robot is (ours: the
//! thesis does not say), lines that are no rows by their direction are not tried, and the best pair is fitted to its points
//! at the end, as the library does with single lines.

use super::{DetectedRows, PlantPoints, RowDetector, RowLine};
use crate::localization::PlantingMap;
use crate::random::Stream;

super::row_parameters! {
    /// Parameters of [`ParallelLines`].
    pub struct ParallelLinesParams {
        /// A point nearer than this to either line supports both. Paper: 0.3, table 4.4.
        pub dist_threshold_m: f64 = 0.3, "m", [0.001, 5.0];
        /// Pairs of points that are tried. Paper: 20, table 4.4.
        pub max_iteration: u32 = 20, "1", [1, 10000];
    }
}

/// The detector.
#[derive(Debug, Clone)]
pub struct ParallelLines {
    params: ParallelLinesParams,
    row_distance_m: f64,
    points: Vec<[f64; 2]>,
    folded: Vec<[f64; 2]>,
    supports: [Vec<[f64; 2]>; 2],
}

/// Two lines, the left one first.
type Pair = [RowLine; 2];

impl ParallelLines {
    /// A detector for rows as far apart as those of `map`.
    #[must_use]
    pub fn new(params: ParallelLinesParams, map: &PlantingMap) -> Self {
        let (points, folded) = (Vec::new(), Vec::new());
        Self { params, row_distance_m: map.row_distance_m, points, folded, supports: Default::default() }
    }

    /// The pair with most points near it; none if no two points differ.
    fn best(&self, random: &mut Stream) -> Option<Pair> {
        let n = self.points.len() as u32;
        let mut best = (0, None);
        let tries = if n < 2 { 0 } else { self.params.max_iteration };
        for _ in 0..tries {
            let [a, b] = [random.below(n), random.below(n)].map(|i| self.points[i as usize]);
            let line = RowLine::along(a, [b[0] - a[0], b[1] - a[1]]).filter(RowLine::runs_ahead);
            let Some(line) = line else { continue };
            let pair = self.pair(line);
            let support = self.points.iter().filter(|point| self.side(&pair, **point).is_some()).count();
            if support > best.0 {
                best = (support, Some(pair));
            }
        }
        best.1
    }

    /// `line` and its parallel on the robot's side.
    fn pair(&self, line: RowLine) -> Pair {
        if line.left_of([0.0, 0.0]) >= 0.0 {
            [line.shifted(self.row_distance_m), line]
        } else {
            [line, line.shifted(-self.row_distance_m)]
        }
    }

    /// Which of the two lines a point supports.
    fn side(&self, pair: &Pair, point: [f64; 2]) -> Option<usize> {
        let [left, right] = pair.each_ref().map(|line| line.left_of(point).abs());
        let (side, distance_m) = if left <= right { (0, left) } else { (1, right) };
        (distance_m < self.params.dist_threshold_m).then_some(side)
    }

    /// Collects the points of each line.
    fn take_supports(&mut self, pair: &Pair) {
        self.supports.iter_mut().for_each(Vec::clear);
        for i in 0..self.points.len() {
            if let Some(side) = self.side(pair, self.points[i]) {
                self.supports[side].push(self.points[i]);
            }
        }
    }

    /// The pair of least squared distances to the points of both lines, each moved to the middle between them.
    fn refitted(&mut self, pair: &Pair) -> Option<Pair> {
        let half_m = 0.5 * self.row_distance_m;
        let [dx, dy] = pair[0].direction;
        self.folded.clear();
        for (side, towards_middle_m) in [(0, -half_m), (1, half_m)] {
            let [x, y] = [-towards_middle_m * dy, towards_middle_m * dx];
            self.folded.extend(self.supports[side].iter().map(|point| [point[0] + x, point[1] + y]));
        }
        let middle = RowLine::through(self.folded.iter().copied())?;
        Some([middle.shifted(half_m), middle.shifted(-half_m)])
    }
}

impl RowDetector for ParallelLines {
    fn detect(&mut self, view: PlantPoints<'_>, random: &mut Stream) -> DetectedRows<'_> {
        self.points.clear();
        self.points.extend(view.points.iter().map(|point| [point.x, point.y]));
        let Some(best) = self.best(random) else { return DetectedRows::default() };
        self.take_supports(&best);
        let pair = self.refitted(&best).unwrap_or(best);
        self.take_supports(&pair);
        let [left, right] = &self.supports;
        DetectedRows { lines: pair.map(Some), supports: [left, right], plants: &[] }
    }
}
