//! Fresh lines through three random points each.

use super::Points;
use super::lanes::Sieve;
use super::line::{Line, intercept_tolerance_m, slope_tolerance};
use crate::random::Stream;

/// At most so many fresh lines at a time.
const MOST_FRESH: usize = 64;
/// Lines are looked at in groups of this many; there is room for a whole group behind the last one.
const GROUP: usize = 8;
const ROOM: usize = MOST_FRESH + GROUP;

/// Lines fitted to three random points each, which have no points of their own yet.
#[derive(Debug, Clone)]
pub(super) struct Fresh {
    n: usize,
    /// Coordinates of the first, second and third point of each line \[m\].
    x_m: [[f64; ROOM]; 3],
    y_m: [[f64; ROOM]; 3],
    slopes: [f64; ROOM],
    intercepts_m: [f64; ROOM],
    /// How far another line may be to be the same.
    slope_tolerances: [f64; ROOM],
    intercept_tolerances_m: [f64; ROOM],
    /// 1 while the line is new, 0 once it is the same as another one, or none at all.
    new: [f64; ROOM],
}

impl Default for Fresh {
    fn default() -> Self {
        const ZEROS: [f64; ROOM] = [0.0; ROOM];
        Self {
            n: 0,
            x_m: [ZEROS; 3],
            y_m: [ZEROS; 3],
            slopes: ZEROS,
            intercepts_m: ZEROS,
            slope_tolerances: ZEROS,
            intercept_tolerances_m: ZEROS,
            new: ZEROS,
        }
    }
}

impl Fresh {
    pub(super) fn clear(&mut self) {
        self.n = 0;
    }

    /// Draws three distinct points out of those `among` all, `lines` times; none if there are fewer than three.
    pub(super) fn draw(&mut self, points: &Points, among: &[u32], lines: usize, random: &mut Stream) {
        if among.len() < 3 {
            return;
        }
        let end = (self.n + lines).min(MOST_FRESH);
        for line in self.n..end {
            for (corner, pick) in three_distinct(among.len() as u32, random).into_iter().enumerate() {
                let point = among[pick as usize] as usize;
                self.x_m[corner][line] = points.x_m[point];
                self.y_m[corner][line] = points.y_m[point];
            }
        }
        self.n = end;
    }

    /// Draws half of `lines` through points on the left, the rest through points on the right; a side with fewer
    /// than three points gives none.
    pub(super) fn draw_each_side(
        &mut self,
        points: &Points,
        (left, right): (&[u32], &[u32]),
        lines: usize,
        random: &mut Stream,
    ) {
        self.draw(points, left, lines / 2, random);
        self.draw(points, right, lines - lines / 2, random);
    }

    /// Fits each line to its points by least squares of y on x; points one above the other give none.
    pub(super) fn fit(&mut self) {
        let [x0, x1, x2] = &self.x_m;
        let [y0, y1, y2] = &self.y_m;
        for i in 0..self.n.next_multiple_of(GROUP) {
            let x = x0[i] + x1[i] + x2[i];
            let y = y0[i] + y1[i] + y2[i];
            let xx = x0[i] * x0[i] + x1[i] * x1[i] + x2[i] * x2[i];
            let xy = x0[i] * y0[i] + x1[i] * y1[i] + x2[i] * y2[i];
            let spread = 3.0 * xx - x * x;
            let slope = (3.0 * xy - x * y) / spread;
            let intercept_m = (y - slope * x) / 3.0;
            self.slopes[i] = slope;
            self.intercepts_m[i] = intercept_m;
            self.slope_tolerances[i] = slope_tolerance(slope);
            self.intercept_tolerances_m[i] = intercept_tolerance_m(intercept_m);
            self.new[i] = if spread > 9e-12 { 1.0 } else { 0.0 };
        }
    }

    /// Lets go of the lines that are the same as `first`.
    pub(super) fn sieve(&mut self, first: Line) {
        self.sieve_from(0, first);
    }

    fn sieve_from(&mut self, start: usize, first: Line) {
        let group = start..start + self.n.saturating_sub(start).next_multiple_of(GROUP);
        let lines = [&self.slopes, &self.slope_tolerances, &self.intercepts_m, &self.intercept_tolerances_m]
            .map(|all| &all[group.clone()]);
        Sieve { slope: first.slope, intercept_m: first.intercept_m, lines, new: &mut self.new[group] }.run();
    }

    /// Lets go of the lines that are the same as an earlier one.
    pub(super) fn fuse(&mut self) {
        for i in 0..self.n {
            if self.new[i] > 0.0 {
                self.sieve_from(i + 1, Line::new(self.slopes[i], self.intercepts_m[i]));
            }
        }
    }

    /// The lines that are still new.
    pub(super) fn remaining(&self) -> impl Iterator<Item = Line> + '_ {
        (0..self.n).filter(|i| self.new[*i] > 0.0).map(|i| Line::new(self.slopes[i], self.intercepts_m[i]))
    }
}

/// Puts those of `among` with y >= 0 into `sides`, then those with y < 0; returns how many there are of the first.
pub(super) fn split_by_side(sides: &mut Vec<u32>, points: &Points, among: impl Iterator<Item = u32> + Clone) -> usize {
    let is_left = |point: &u32| points.y_m[*point as usize] >= 0.0;
    sides.clear();
    sides.extend(among.clone().filter(is_left));
    let left = sides.len();
    sides.extend(among.filter(|point| !is_left(point)));
    left
}

/// Three distinct numbers in 0..`n`; `n` is at least 3.
pub(super) fn three_distinct(n: u32, random: &mut Stream) -> [u32; 3] {
    let first = random.below(n);
    let second = random.below(n - 1);
    let second = second + u32::from(second >= first);
    let third = random.below(n - 2);
    let third = third + u32::from(third >= first.min(second));
    let third = third + u32::from(third >= first.max(second));
    [first, second, third]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::line::LineFit;

    #[test]
    fn triples_are_distinct_and_all_equally_likely() {
        let mut random = Stream::new(1, "line-finder");
        let mut seen = std::collections::BTreeMap::new();
        for _ in 0..60_000 {
            let triple = three_distinct(5, &mut random);
            assert!(triple[0] != triple[1] && triple[0] != triple[2] && triple[1] != triple[2]);
            assert!(triple.iter().all(|i| *i < 5));
            *seen.entry(triple).or_insert(0) += 1;
        }
        // 60 ordered triples, 1000 each with a deviation of about 32.
        assert!(seen.len() == 60 && seen.values().all(|n| (850..1150).contains(n)), "{seen:?}");
    }

    #[test]
    fn fresh_lines_are_least_squares_and_same_ones_give_way() {
        let mut points = Points::default();
        for (x, y) in [(0.0, 0.0), (1.0, 0.3), (3.0, 0.2)] {
            points.push(x, y);
        }
        let mut fresh = Fresh::default();
        fresh.draw(&points, &[0, 1, 2], 5, &mut Stream::new(1, "line-finder"));
        fresh.fit();
        fresh.fuse();
        let lines: Vec<Line> = fresh.remaining().collect();
        let mut fit = LineFit::default();
        points.iter().for_each(|(x, y)| fit.add(x, y));
        let expected = fit.line().unwrap();
        assert_eq!(lines.len(), 1);
        assert!((lines[0].slope - expected.slope).abs() < 1e-14);
        assert!((lines[0].intercept_m - expected.intercept_m).abs() < 1e-14);
        fresh.sieve(Line::new(expected.slope + 0.05, expected.intercept_m - 0.1));
        assert_eq!(fresh.remaining().count(), 0);
    }

    #[test]
    fn points_one_above_the_other_and_too_few_points_give_no_line() {
        let mut points = Points::default();
        for y in [0.0, 1.0, 2.0] {
            points.push(1.5, y);
        }
        let mut fresh = Fresh::default();
        fresh.draw(&points, &[0, 1], 5, &mut Stream::new(1, "line-finder"));
        fresh.draw(&points, &[0, 1, 2], 5, &mut Stream::new(1, "line-finder"));
        fresh.fit();
        assert_eq!((fresh.n, fresh.remaining().count()), (5, 0));
    }
}
