//! Fresh lines through three random points each.

use super::Points;
use super::lanes::{FitTriples, GROUP, SameLines};
use super::line::Line;
use crate::random::Stream;

/// At most so many fresh lines at a time: with the 64 lines at most that finders keep there are no more than 128.
const MOST_FRESH: usize = 64;
/// Whole groups, so that there is no odd one.
const ROOM: usize = MOST_FRESH.next_multiple_of(GROUP);
/// 0, 1, 2, ..
const PLACES: [f32; ROOM] = {
    let mut places = [0.0; ROOM];
    let mut i = 0;
    while i < ROOM {
        places[i] = i as f32;
        i += 1;
    }
    places
};

/// Lines fitted to three random points each, which have no points of their own yet.
#[derive(Debug)]
pub(super) struct Fresh {
    n: usize,
    /// Random words, three a line.
    words: [u32; 3 * MOST_FRESH],
    /// Coordinates of the first, second and third point of each line \[m\].
    x_m: [[f64; ROOM]; 3],
    y_m: [[f64; ROOM]; 3],
    slopes: [f64; ROOM],
    intercepts_m: [f64; ROOM],
    /// Slope, how far another one may be to be the same, intercept \[m\] and likewise.
    compared: [[f32; ROOM]; 4],
    /// 1 while the line is new, 0 once it is the same as another one, or none at all.
    new: [f32; ROOM],
    /// Scratch: slopes and intercepts \[m\] of other lines.
    others: Vec<[f32; 2]>,
}

impl Default for Fresh {
    fn default() -> Self {
        const ZEROS: [f64; ROOM] = [0.0; ROOM];
        Self {
            n: 0,
            words: [0; 3 * MOST_FRESH],
            x_m: [ZEROS; 3],
            y_m: [ZEROS; 3],
            slopes: ZEROS,
            intercepts_m: ZEROS,
            compared: [[0.0; ROOM]; 4],
            new: [0.0; ROOM],
            others: Vec::new(),
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
        let lines = lines.min(MOST_FRESH - self.n);
        let words = &mut self.words[..3 * lines];
        random.words(words);
        for (line, words) in (self.n..).zip(words.as_chunks().0) {
            for (corner, pick) in three_distinct(among.len() as u32, *words).into_iter().enumerate() {
                let point = among[pick as usize] as usize;
                self.x_m[corner][line] = points.x_m[point];
                self.y_m[corner][line] = points.y_m[point];
            }
        }
        self.n += lines;
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
        let n = self.n;
        FitTriples {
            x_m: self.x_m.each_ref().map(|all| &all[..n]),
            y_m: self.y_m.each_ref().map(|all| &all[..n]),
            slopes: &mut self.slopes[..n],
            intercepts_m: &mut self.intercepts_m[..n],
            compared: self.compared.each_mut().map(|all| &mut all[..n]),
            new: &mut self.new[..n],
        }
        .fit();
    }

    /// Slopes and intercepts \[m\] of the lines that are the same neither as one of `others` nor as an earlier one.
    ///
    /// Takes them out: after this there are no fresh lines.
    pub(super) fn distinct_from(&mut self, others: &[Line]) -> (&[f64], &[f64]) {
        self.others.clear();
        self.others.extend(others.iter().map(|line| [line.slope as f32, line.intercept_m as f32]));
        let lines = self.compared.each_ref().map(|all| all.as_slice());
        SameLines { lines, places: &PLACES, n: self.n, before: &self.others, new: &mut self.new }.find();
        // Without a branch: which lines are left is hard to predict.
        let mut n = 0;
        for i in 0..self.n {
            self.slopes[n] = self.slopes[i];
            self.intercepts_m[n] = self.intercepts_m[i];
            n += usize::from(self.new[i] > 0.0);
        }
        self.n = 0;
        (&self.slopes[..n], &self.intercepts_m[..n])
    }
}

/// Puts those of `among` with y >= 0 into `sides`, then those with y < 0; returns how many there are of the first.
pub(super) fn split_by_side(sides: &mut Vec<u32>, points: &Points, among: impl ExactSizeIterator<Item = u32>) -> usize {
    let n = among.len();
    sides.resize(n, 0);
    let mut left = 0;
    for (i, point) in among.enumerate() {
        let is_left = points.y_m[point as usize] >= 0.0;
        // The points to the right are put down from the end.
        sides[if is_left { left } else { n - 1 - (i - left) }] = point;
        left += usize::from(is_left);
    }
    sides[left..].reverse();
    left
}

/// Three distinct numbers in 0..`n` from as many random words; `n` is at least 3.
fn three_distinct(n: u32, words: [u32; 3]) -> [u32; 3] {
    let below = |n: u32, word: u32| ((u64::from(word) * u64::from(n)) >> 32) as u32;
    let first = below(n, words[0]);
    let second = below(n - 1, words[1]);
    let second = second + u32::from(second >= first);
    let third = below(n - 2, words[2]);
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
            let mut words = [0; 3];
            random.words(&mut words);
            let triple = three_distinct(5, words);
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
        let (slopes, intercepts_m) = fresh.distinct_from(&[]);
        let mut fit = LineFit::default();
        points.iter().for_each(|(x, y)| fit.add(x, y));
        let expected = fit.line().unwrap();
        assert_eq!((slopes.len(), intercepts_m.len()), (1, 1));
        assert!((slopes[0] - expected.slope).abs() < 1e-14);
        assert!((intercepts_m[0] - expected.intercept_m).abs() < 1e-14);
    }

    #[test]
    fn fresh_lines_give_way_to_those_before_them() {
        let mut points = Points::default();
        (0..12).for_each(|i| points.push(0.3 * f64::from(i), 0.5));
        let among: Vec<u32> = (0..12).collect();
        let remaining = |before: &[Line]| {
            let mut fresh = Fresh::default();
            fresh.draw(&points, &among, 20, &mut Stream::new(1, "line-finder"));
            fresh.fit();
            fresh.distinct_from(before).0.len()
        };
        assert_eq!(remaining(&[]), 1);
        assert_eq!(remaining(&[Line::new(0.05, 0.4)]), 0);
        assert_eq!(remaining(&[Line::new(0.05, 0.1)]), 1);
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
        assert_eq!(fresh.n, 5);
        assert!(fresh.distinct_from(&[]).0.is_empty());
    }
}
