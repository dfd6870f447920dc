//! The filter: slots for the rows around the robot, from left to right, kept from cycle to cycle.
//!
//! Guyonneau et al. (2022), sections 3.1 (the row spacing, measured while the robot stands) and 3.2
//! (algorithm 4); the points of the slots after the program behind their tables.
//!
//! Deviation: the paper leaves the number of slots and the threshold of a match open. The program keeps two rows
//! on each side, matches from a tolerance of 0.05 upward until anything matches, lets a later line overwrite
//! an earlier one, and unsets all slots when nothing matches. One line of weeds that happens to match at the
//! smallest tolerance then moves all rows, and in a crop with holes there may be no plant in any of four rows:
//! on drawn fields of crop 4 that fails in every second run. The defaults here keep three rows on each side, match
//! the nearest line within 0.15, then 0.30, and keep the slots as the paper's text says. The program's values
//! are named with each parameter; the plan `guyonneau2022/filter` shows what the difference does.

use super::merge::{MergedLines, RobotFromLidar};
use crate::perception::line::{Line, same_slope, slant};
use crate::perception::{Found, Points};

/// At most so many rows on each side of the robot.
const MOST_ROWS: usize = 4;

crate::words! {
    /// Which of several lines within the tolerance a slot takes.
    pub enum Matching {
        /// The nearest.
        Nearest = "nearest",
        /// The last one; all of them enter the mean slope: the program behind the tables.
        Last = "last",
    }
}

crate::words! {
    /// What becomes of the slots in a cycle in which no line matches any.
    pub enum NoMatch {
        /// They stay as they were: the paper's text.
        Keep = "keep",
        /// They are unset, so nothing can match afterwards either: the program behind the tables.
        Unset = "unset",
    }
}

crate::parameters! {
    /// Parameters of [`RowFilter`].
    pub struct RowFilterParams {
        /// Rows kept on each side of the robot, half of the paper's n. Ours; program: 2.
        pub rows_per_side: u32 = 3, "1", [1, 4];
        /// Cycles over which the row spacing is averaged before the robot moves. Program: 10.
        pub spacing_cycles: u32 = 10, "1", [1, 1000];
        /// While measuring the spacing, the pair's first line is within this slope. Program: 0.05.
        pub spacing_slope: f64 = 0.05, "1", [0.0, 1.0];
        /// While measuring the spacing, the pair's intercepts differ by at most this (or 20 %). Program: 0.2.
        pub spacing_offset_m: f64 = 0.2, "m", [0.0, 2.0];
        /// First and smallest slope tolerance of a match; it grows in steps of the same size. Ours; program: 0.05.
        pub match_step: f64 = 0.15, "1", [0.001, 1.0];
        /// Largest number of such steps, to a tolerance of 0.30. Ours; program: 6.
        pub match_steps: u32 = 2, "1", [1, 100];
        /// Tolerance of the intercept per tolerance of the slope. Program: 1.2.
        pub match_intercept_m: f64 = 1.2, "m", [0.01, 10.0];
        /// Which of several matching lines a slot takes. Ours; program: `last`.
        pub matching: Matching = Matching::Nearest, "";
        /// A point closer than this to a found row is one of its points. Program: 0.2.
        pub attach_distance_m: f64 = 0.2, "m", [0.001, 2.0];
        /// What becomes of the slots when nothing matches. Paper: `keep`; program: `unset`.
        pub no_match: NoMatch = NoMatch::Keep, "";
        /// Cycles without a match after which the robot is lost. Ours, for `keep`; program: 3.
        pub lost_after: u32 = 12, "1", [1, 1000];
    }
}

/// One row in a slot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    /// In the robot's frame.
    pub line: Line,
    /// Whether it was computed from another row because no line matched it.
    pub computed: bool,
    /// Smallest and largest x of its points \[m\]; of all found rows' points if computed; none without points.
    pub extent_m: Option<(f64, f64)>,
}

/// The rows around the robot, as many to its left as to its right.
#[derive(Debug, Clone, PartialEq)]
pub struct Rows {
    /// From left to right; never fewer than two.
    pub slots: Vec<Row>,
}

impl Rows {
    /// The row just left of the robot.
    #[must_use]
    pub fn left(&self) -> &Row {
        &self.slots[self.slots.len() / 2 - 1]
    }

    /// The row just right of the robot.
    #[must_use]
    pub fn right(&self) -> &Row {
        &self.slots[self.slots.len() / 2]
    }

    /// Mean slope of the rows just left and right.
    #[must_use]
    pub fn slope(&self) -> f64 {
        0.5 * (self.left().line.slope + self.right().line.slope)
    }

    /// Smallest and largest x of all rows' points \[m\].
    #[must_use]
    pub fn extent_m(&self) -> Option<(f64, f64)> {
        self.slots.iter().filter_map(|row| row.extent_m).reduce(union)
    }
}

fn union(a: (f64, f64), b: (f64, f64)) -> (f64, f64) {
    (a.0.min(b.0), a.1.max(b.1))
}

/// Where the filter stands after a cycle.
#[derive(Debug, Clone, PartialEq)]
pub enum Tracking {
    /// The row spacing is being measured; the robot must stand.
    Measuring,
    /// The rows around the robot.
    Rows(Rows),
    /// No line matched in this cycle.
    Nothing,
    /// No line matched for `lost_after` cycles.
    Lost,
}

/// The filter.
#[derive(Debug, Clone)]
pub struct RowFilter {
    params: RowFilterParams,
    merged: MergedLines,
    /// Newest points of each LiDAR, in the robot's frame.
    points: [Points; 2],
    state: State,
    missed: u32,
}

#[derive(Debug, Clone)]
enum State {
    Measuring {
        cycles: u32,
        spacing_m: f64,
        slope: f64,
    },
    /// The slots' intercepts from left to right; none once they are unset.
    Tracking {
        spacing_m: f64,
        slope: f64,
        intercepts_m: Option<Vec<f64>>,
    },
}

impl RowFilter {
    /// A filter that has seen no line yet.
    #[must_use]
    pub fn new(params: RowFilterParams) -> Self {
        let state = State::Measuring { cycles: 0, spacing_m: 0.0, slope: 0.0 };
        Self { params, merged: MergedLines::default(), points: Default::default(), state, missed: 0 }
    }

    /// The measured distance between rows \[m\], once it is known.
    #[must_use]
    pub fn spacing_m(&self) -> Option<f64> {
        match self.state {
            State::Measuring { .. } => None,
            State::Tracking { spacing_m, .. } => Some(spacing_m),
        }
    }

    /// Takes in what a line finder found in one scan of the LiDAR at `robot_from_lidar`.
    pub fn sense(&mut self, robot_from_lidar: RobotFromLidar, found: Found<'_>) {
        for line in found.lines {
            self.merged.add(robot_from_lidar.line(*line));
        }
        let newest = &mut self.points[usize::from(robot_from_lidar.looks_back)];
        newest.clear();
        for (x, y) in found.points.iter() {
            let (x, y) = robot_from_lidar.point(x, y);
            newest.push(x, y);
        }
    }

    /// Ends a control cycle: the rows after all lines since the last one.
    pub fn cycle(&mut self) -> Tracking {
        let tracking = match self.state.clone() {
            State::Measuring { cycles, spacing_m, slope } => self.measure(cycles, spacing_m, slope),
            State::Tracking { spacing_m, slope, intercepts_m } => self.track(spacing_m, slope, intercepts_m.as_deref()),
        };
        self.merged.clear();
        tracking
    }

    /// The robot has changed to the inter-row on its left: every row is one slot further to the right.
    ///
    /// A new leftmost row is put in at the measured spacing.
    pub fn shift_left(&mut self) {
        let State::Tracking { spacing_m, slope, intercepts_m: Some(intercepts) } = &mut self.state else { return };
        let leftmost = intercepts[0] + *spacing_m * slant(*slope);
        intercepts.rotate_right(1);
        intercepts[0] = leftmost;
    }

    /// Section 3.1: the closest pair of lines to the left and right of the robot, equidistant and straight ahead.
    fn measure(&mut self, cycles: u32, spacing_m: f64, slope: f64) -> Tracking {
        let Some((left, right)) = self.closest_pair() else { return Tracking::Measuring };
        let pair_slope = 0.5 * (left.slope + right.slope);
        let pair_spacing_m = (left.intercept_m - right.intercept_m).abs() / slant(pair_slope);
        let cycles = cycles + 1;
        let spacing_m = spacing_m + (pair_spacing_m - spacing_m) / f64::from(cycles);
        let slope = slope + (pair_slope - slope) / f64::from(cycles);
        if cycles < self.params.spacing_cycles {
            self.state = State::Measuring { cycles, spacing_m, slope };
            return Tracking::Measuring;
        }
        let step = spacing_m * slant(slope);
        let side = self.params.rows_per_side as usize;
        let intercepts_m: Vec<f64> = (0..2 * side)
            .map(|i| {
                if i < side {
                    left.intercept_m + (side - 1 - i) as f64 * step
                } else {
                    right.intercept_m - (i - side) as f64 * step
                }
            })
            .collect();
        let beside = |i: usize| i + 1 == side || i == side;
        let found: Vec<_> =
            intercepts_m.iter().enumerate().map(|(i, b)| beside(i).then(|| Line::new(slope, *b))).collect();
        let rows = self.rows(&found, slope, &intercepts_m);
        self.state = State::Tracking { spacing_m, slope, intercepts_m: Some(intercepts_m) };
        Tracking::Rows(rows)
    }

    fn closest_pair(&self) -> Option<(Line, Line)> {
        let mut best: (Option<Line>, Option<Line>) = (None, None);
        let nearer = |b: f64, than: Option<Line>| than.is_none_or(|line| b.abs() < line.intercept_m.abs());
        let mut lines = self.merged.iter();
        while let Some(first) = lines.next() {
            for second in lines.clone().filter(|second| self.equidistant(first, *second)) {
                if first.intercept_m >= 0.0 && nearer(first.intercept_m, best.0) {
                    best = (Some(first), Some(second));
                } else if first.intercept_m < 0.0 && nearer(first.intercept_m, best.1) {
                    best = (Some(second), Some(first));
                }
            }
        }
        best.0.zip(best.1)
    }

    fn equidistant(&self, first: Line, second: Line) -> bool {
        let (b, other) = (first.intercept_m, second.intercept_m);
        let offset = (b + other).abs();
        first.slope.abs() < self.params.spacing_slope
            && same_slope(first.slope, second.slope)
            && (offset <= self.params.spacing_offset_m || offset <= 0.2 * other.abs())
    }

    /// Algorithm 4: matches lines with the rows of the last cycle, and computes those without a match.
    fn track(&mut self, spacing_m: f64, slope: f64, before: Option<&[f64]>) -> Tracking {
        let matched = before.and_then(|before| self.widen_until_matched(slope, before).map(|m| (before, m)));
        let Some((before, matches)) = matched else { return self.miss() };
        self.missed = 0;
        let slope = matches.slope_sum / matches.count;
        let step = spacing_m * slant(slope);
        let best = matches.best_slot;
        let intercepts_m: Vec<f64> = (0..before.len())
            .map(|i| match matches.slots[i] {
                Some(line) => line.intercept_m,
                None => before[best] + (best as f64 - i as f64) * step,
            })
            .collect();
        let rows = self.rows(&matches.slots[..before.len()], slope, &intercepts_m);
        self.state = State::Tracking { spacing_m, slope, intercepts_m: Some(intercepts_m) };
        Tracking::Rows(rows)
    }

    fn miss(&mut self) -> Tracking {
        self.missed += 1;
        if let (State::Tracking { intercepts_m, .. }, NoMatch::Unset) = (&mut self.state, self.params.no_match) {
            *intercepts_m = None;
        }
        if self.missed >= self.params.lost_after { Tracking::Lost } else { Tracking::Nothing }
    }

    /// The matches at the smallest tolerance that gives any.
    fn widen_until_matched(&self, slope: f64, before: &[f64]) -> Option<Matches> {
        (1..=self.params.match_steps)
            .map(|step| self.matches(self.params.match_step * f64::from(step), slope, before))
            .find(|matches| matches.count > 0.0)
    }

    fn matches(&self, tolerance: f64, slope: f64, before: &[f64]) -> Matches {
        let mut matches = Matches::default();
        for (i, expected) in before.iter().enumerate() {
            let candidates = self.merged.iter().filter_map(|line| {
                let slope_gap = (line.slope - slope).abs();
                let intercept_gap = (line.intercept_m - expected).abs();
                let close = slope_gap <= tolerance && intercept_gap <= self.params.match_intercept_m * tolerance;
                close.then_some((line, slope_gap + intercept_gap))
            });
            match self.params.matching {
                Matching::Last => candidates.for_each(|(line, gap)| matches.take(i, line, gap)),
                Matching::Nearest => {
                    let nearest = candidates.min_by(|a, b| a.1.total_cmp(&b.1));
                    nearest.into_iter().for_each(|(line, gap)| matches.take(i, line, gap));
                }
            }
        }
        matches
    }

    /// Gives each row its points: a found one those near it, a computed one the extents of all found ones.
    fn rows(&self, found: &[Option<Line>], slope: f64, intercepts_m: &[f64]) -> Rows {
        let extents: Vec<_> = found.iter().map(|line| line.and_then(|line| self.extent(line))).collect();
        let all = extents.iter().filter_map(|extent| *extent).reduce(union);
        let rows = found.iter().zip(intercepts_m).zip(extents).map(|((line, intercept), extent)| Row {
            line: line.unwrap_or(Line::new(slope, *intercept)),
            computed: line.is_none(),
            extent_m: if line.is_some() { extent } else { all },
        });
        Rows { slots: rows.collect() }
    }

    /// Smallest and largest x of the newest points near `line`.
    fn extent(&self, line: Line) -> Option<(f64, f64)> {
        let near = |(x, y): &(f64, f64)| line.distance_m(*x, *y) < self.params.attach_distance_m;
        self.points.iter().flat_map(Points::iter).filter(near).map(|(x, _)| (x, x)).reduce(union)
    }
}

/// Lines matched with slots at one tolerance.
#[derive(Debug, Clone, Copy)]
struct Matches {
    slots: [Option<Line>; 2 * MOST_ROWS],
    slope_sum: f64,
    count: f64,
    best: f64,
    best_slot: usize,
}

impl Default for Matches {
    fn default() -> Self {
        Self { slots: [None; 2 * MOST_ROWS], slope_sum: 0.0, count: 0.0, best: f64::INFINITY, best_slot: 0 }
    }
}

impl Matches {
    /// Later lines overwrite earlier ones in the slot; all of them enter the mean slope.
    fn take(&mut self, slot: usize, line: Line, gap: f64) {
        self.slots[slot] = Some(line);
        self.slope_sum += line.slope;
        self.count += 1.0;
        if gap <= self.best {
            self.best = gap;
            self.best_slot = slot;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRONT: RobotFromLidar = RobotFromLidar { x_m: 0.5, looks_back: false };

    fn sense(filter: &mut RowFilter, lines: &[(f64, f64)], points: &[(f64, f64)]) {
        let lines: Vec<Line> = lines.iter().map(|(a, b)| Line::new(*a, *b)).collect();
        let mut set = Points::default();
        for (x, y) in points {
            set.push(*x, *y);
        }
        filter.sense(FRONT, Found { points: &set, lines: &lines });
    }

    fn tracking() -> RowFilter {
        let mut filter = RowFilter::new(RowFilterParams::default());
        for cycle in 0..10 {
            sense(&mut filter, &[(0.0, 0.5), (0.0, -0.5)], &[(1.0, 0.5), (2.0, -0.5)]);
            let tracking = filter.cycle();
            assert_eq!(matches!(tracking, Tracking::Measuring), cycle < 9);
        }
        filter
    }

    fn rows(tracking: Tracking) -> Rows {
        match tracking {
            Tracking::Rows(rows) => rows,
            other => panic!("no rows: {other:?}"),
        }
    }

    #[test]
    fn the_spacing_is_measured_over_ten_cycles() {
        assert!((tracking().spacing_m().unwrap() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_pair_that_is_not_equidistant_gives_no_spacing() {
        let mut filter = RowFilter::new(RowFilterParams::default());
        for _ in 0..20 {
            sense(&mut filter, &[(0.0, 0.9), (0.0, -0.3)], &[]);
            assert_eq!(filter.cycle(), Tracking::Measuring);
        }
    }

    #[test]
    fn missing_rows_are_computed_at_the_measured_spacing() {
        let mut filter = tracking();
        sense(&mut filter, &[(0.0, 0.52)], &[(1.0, 0.5)]);
        let rows = rows(filter.cycle());
        let intercepts: Vec<f64> = rows.slots.iter().map(|row| row.line.intercept_m).collect();
        for (intercept, expected) in intercepts.iter().zip([2.5, 1.5, 0.52, -0.5, -1.5, -2.5]) {
            assert!((intercept - expected).abs() < 1e-12, "{intercepts:?}");
        }
        let computed: Vec<bool> = rows.slots.iter().map(|row| row.computed).collect();
        assert_eq!(computed, [true, true, false, true, true, true]);
    }

    #[test]
    fn a_computed_row_has_the_extent_of_the_found_ones() {
        let mut filter = tracking();
        sense(&mut filter, &[(0.0, 0.5)], &[(1.0, 0.5), (-3.0, 0.6), (9.0, 2.0)]);
        let rows = rows(filter.cycle());
        assert_eq!(rows.left().extent_m, Some((-2.5, 1.5)));
        assert_eq!(rows.right().extent_m, Some((-2.5, 1.5)));
    }

    #[test]
    fn a_slot_takes_the_nearest_line_or_as_in_the_program_the_last_one() {
        for (matching, expected) in [(Matching::Nearest, 0.51), (Matching::Last, 0.53)] {
            let mut filter = tracking();
            filter.params.matching = matching;
            sense(&mut filter, &[(0.0, 0.51), (0.14, 0.6)], &[]);
            assert!((rows(filter.cycle()).left().line.intercept_m - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn nothing_matched_is_soon_lost_when_slots_are_unset_and_later_when_kept() {
        let mut filter = tracking();
        filter.params.no_match = NoMatch::Unset;
        filter.params.lost_after = 3;
        assert_eq!(filter.cycle(), Tracking::Nothing);
        sense(&mut filter, &[(0.0, 0.5)], &[]);
        assert_eq!(filter.cycle(), Tracking::Nothing);
        assert_eq!(filter.cycle(), Tracking::Lost);

        let mut filter = tracking();
        assert_eq!(filter.cycle(), Tracking::Nothing);
        sense(&mut filter, &[(0.0, 0.5)], &[]);
        assert!(matches!(filter.cycle(), Tracking::Rows(_)));
    }

    #[test]
    fn a_shift_makes_the_next_pair_the_middle_one() {
        let mut filter = tracking();
        filter.shift_left();
        let State::Tracking { intercepts_m: Some(intercepts), .. } = filter.state else { panic!("not tracking") };
        for (intercept, expected) in intercepts.iter().zip([3.5, 2.5, 1.5, 0.5, -0.5, -1.5]) {
            assert!((intercept - expected).abs() < 1e-12);
        }
    }
}
