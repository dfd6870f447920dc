//! A line on the ground by random sample consensus, as the point cloud library fits one.
//!
//! 99 % sure of a sample without outliers, the search ends early; a line replaces the best one only with more inliers; at the end it is fitted
//! to its inliers, which are then taken again. A point supports a line that it is nearer to than the threshold. Ours: lines that are no rows by
//! their direction are not tried.

use super::Point3;
use super::eigen::{Axis, longest_axis};
use crate::perception::rows::RowLine;
use crate::random::Stream;

/// How sure the search must be of one sample without outliers.
const CONFIDENCE: f64 = 0.99;

/// Searches lines, and keeps the room that it takes.
#[derive(Debug, Clone, Default)]
pub struct LineSearch {
    inliers: Vec<usize>,
}

impl LineSearch {
    /// The line that most of `points` \[m\] lie nearer to than `threshold_m`; `max_iterations` pairs are tried at most.
    /// [`inliers`](Self::inliers) then are its points. None if there are fewer than two different points.
    pub fn find(
        &mut self,
        points: &[[f64; 2]],
        threshold_m: f64,
        max_iterations: u32,
        random: &mut Stream,
    ) -> Option<RowLine> {
        self.inliers.clear();
        let sampled = sample(points.len(), max_iterations, random, |[a, b]| {
            let line = RowLine::along(points[a], [points[b][0] - points[a][0], points[b][1] - points[a][1]])?;
            if !line.runs_ahead() {
                return None;
            }
            Some((line, points.iter().filter(|point| line.left_of(**point).abs() < threshold_m).count()))
        })?;
        self.take(points, |point| sampled.left_of(*point).abs() < threshold_m);
        let fitted = RowLine::through(self.inliers.iter().map(|i| points[*i])).unwrap_or(sampled);
        self.take(points, |point| fitted.left_of(*point).abs() < threshold_m);
        Some(fitted)
    }

    /// As [`find`](Self::find) in space; what is left is the line's course over the ground, none where it stands upright.
    pub fn find_in_space(
        &mut self,
        points: &[Point3],
        threshold_m: f64,
        max_iterations: u32,
        random: &mut Stream,
    ) -> Option<RowLine> {
        self.inliers.clear();
        let near = |line: &Axis, point: &Point3| squared_distance(line, point) < threshold_m * threshold_m;
        let sampled = sample(points.len(), max_iterations, random, |[a, b]| {
            let line = through(&points[a], &points[b])?;
            Some((line, points.iter().filter(|point| near(&line, point)).count()))
        })?;
        self.take(points, |point| near(&sampled, point));
        let fitted = longest_axis(self.inliers.iter().map(|i| points[*i])).unwrap_or(sampled);
        self.take(points, |point| near(&fitted, point));
        let [[x, y, _], [dx, dy, _]] = fitted;
        RowLine::along([x, y], [dx, dy])
    }

    /// Indices of the points of the last line, in rising order.
    #[must_use]
    pub fn inliers(&self) -> &[usize] {
        &self.inliers
    }

    fn take<P>(&mut self, points: &[P], is_near: impl Fn(&P) -> bool) {
        self.inliers.clear();
        self.inliers.extend((0..points.len()).filter(|i| is_near(&points[*i])));
    }
}

/// The model with most inliers among those that pairs of `n` points give.
fn sample<T>(
    n: usize,
    max_iterations: u32,
    random: &mut Stream,
    model: impl Fn([usize; 2]) -> Option<(T, usize)>,
) -> Option<T> {
    if n < 2 {
        return None;
    }
    let (mut best, mut most, mut needed) = (None, 0, f64::from(max_iterations));
    let mut tried = 0;
    while tried < max_iterations && f64::from(tried) < needed {
        tried += 1;
        let a = random.below(n as u32) as usize;
        // Another point: one of the others, all alike.
        let b = (a + 1 + random.below(n as u32 - 1) as usize) % n;
        let Some((found, inliers)) = model([a, b]) else { continue };
        if inliers > most {
            (best, most) = (Some(found), inliers);
            needed = iterations(inliers as f64 / n as f64, 2);
        }
    }
    best
}

/// Samples of `size` points that hold one without outliers as surely as asked for, of which a share `inliers` is none.
pub(super) fn iterations(inliers: f64, size: u32) -> f64 {
    let good = (0..size).fold(1.0, |share, _| share * inliers).clamp(f64::EPSILON, 1.0 - f64::EPSILON);
    libm::log(1.0 - CONFIDENCE) / libm::log(1.0 - good)
}

/// A point and a unit direction; none of points that are one.
fn through(a: &Point3, b: &Point3) -> Option<Axis> {
    let d = [b.x - a.x, b.y - a.y, b.z - a.z];
    let length = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
    (length > 0.0 && length.is_finite()).then(|| [[a.x, a.y, a.z], d.map(|part| part / length)])
}

fn squared_distance([[x, y, z], [ux, uy, uz]]: &Axis, point: &Point3) -> f64 {
    let (dx, dy, dz) = (point.x - x, point.y - y, point.z - z);
    let along = dx * ux + dy * uy + dz * uz;
    (dx * dx + dy * dy + dz * dz - along * along).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 60 points along y = 0.1 x + 0.5 with 2 cm of noise, and 20 anywhere.
    fn points(seed: u64) -> Vec<[f64; 2]> {
        let mut random = Stream::new(seed, "line");
        let on_it = |random: &mut Stream| {
            let x = random.between(0.0, 5.0);
            [x, 0.1 * x + 0.5 + 0.02 * random.normal()]
        };
        let mut points: Vec<_> = (0..60).map(|_| on_it(&mut random)).collect();
        points.extend((0..20).map(|_| [random.between(0.0, 5.0), random.between(-3.0, 3.0)]));
        points
    }

    #[test]
    fn the_line_is_found_among_other_points() {
        for seed in 0..50 {
            let points = points(seed);
            let mut search = LineSearch::default();
            let line = search.find(&points, 0.1, 50, &mut Stream::new(seed, "search")).unwrap();
            assert!((line.direction[1] / line.direction[0] - 0.1).abs() < 0.02, "{line:?}");
            assert!(search.inliers().len() >= 58);
            assert!(search.inliers().iter().all(|i| line.left_of(points[*i]).abs() < 0.1));
        }
    }

    #[test]
    fn in_space_an_upright_line_has_no_course_and_others_have_theirs() {
        let stem: Vec<_> = (0..20).map(|i| Point3 { x: 1.0, y: 0.5, z: 0.1 * f64::from(i) }).collect();
        let mut search = LineSearch::default();
        assert_eq!(search.find_in_space(&stem, 0.1, 20, &mut Stream::new(1, "search")), None);
        let row: Vec<_> = (0..20).map(|i| Point3 { x: f64::from(i), y: 0.5, z: 0.3 }).collect();
        let line = search.find_in_space(&row, 0.1, 20, &mut Stream::new(1, "search")).unwrap();
        assert!((line.direction[0] - 1.0).abs() < 1e-9 && (line.left_of([3.0, 0.7]) - 0.2).abs() < 1e-9);
    }

    #[test]
    fn fewer_points_than_two_or_points_on_a_heap_are_no_line() {
        let mut search = LineSearch::default();
        let mut find = |points: &[[f64; 2]]| search.find(points, 0.1, 20, &mut Stream::new(1, "search"));
        assert_eq!(find(&[]), None);
        assert_eq!(find(&[[1.0, 2.0]]), None);
        assert_eq!(find(&[[1.0, 2.0]; 9]), None);
        assert_eq!(find(&[[f64::NAN, 2.0]; 9]), None);
    }

    #[test]
    fn the_more_inliers_the_fewer_samples() {
        assert!((iterations(0.5, 2) - 16.0).abs() < 0.1);
        assert!((iterations(0.5, 3) - 34.5).abs() < 0.1);
        assert!(iterations(1.0, 2) < 1.0 && iterations(0.0, 2) > 1e9);
    }
}
