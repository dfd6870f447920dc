//! The ground in a cloud: a plane by random sample consensus, averaged over the last scans. Vintu (2018), section 3.2.1.

use std::collections::VecDeque;

use super::eigen::shortest_axis;
use super::line::iterations;
use super::{FrontEndParams, Point3};
use crate::random::Stream;

/// A plane n . p + d = 0 with a unit normal that points up.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// Unit normal, upward.
    pub normal: [f64; 3],
    /// The plane's height below the origin along the normal \[m\].
    pub d_m: f64,
}

impl Plane {
    /// The robot's own ground: z = 0.
    pub const LEVEL: Self = Self { normal: [0.0, 0.0, 1.0], d_m: 0.0 };

    fn through(point: [f64; 3], normal: [f64; 3]) -> Option<Self> {
        let length = normal.iter().map(|part| part * part).sum::<f64>().sqrt();
        let up = if normal[2] < 0.0 { -length } else { length };
        let normal = normal.map(|part| part / up);
        let d_m = -(normal[0] * point[0] + normal[1] * point[1] + normal[2] * point[2]);
        (length > 0.0 && d_m.is_finite()).then_some(Self { normal, d_m })
    }

    fn through_three(a: &Point3, b: &Point3, c: &Point3) -> Option<Self> {
        let (u, v) = ([b.x - a.x, b.y - a.y, b.z - a.z], [c.x - a.x, c.y - a.y, c.z - a.z]);
        let normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        Self::through([a.x, a.y, a.z], normal)
    }

    /// Distance of a point \[m\], positive above.
    #[must_use]
    pub fn above(&self, point: &Point3) -> f64 {
        let [a, b, c] = self.normal;
        a * point.x + b * point.y + c * point.z + self.d_m
    }

    /// Angle between its normal and the vertical \[rad\].
    #[must_use]
    pub fn tilt_rad(&self) -> f64 {
        libm::acos(self.normal[2].clamp(-1.0, 1.0))
    }

    /// What takes points into the plane's frame: its origin below the robot's centre, x as far ahead as the robot's, z along the normal.
    pub fn plane_from_robot(self) -> impl Fn(&Point3) -> Point3 {
        let n = self.normal;
        // The robot's x axis without its part along the normal; the normal is never along it within 45 degrees.
        let x = [1.0 - n[0] * n[0], -n[0] * n[1], -n[0] * n[2]];
        let length = x.iter().map(|part| part * part).sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
        let x = x.map(|part| part / length);
        let y = [n[1] * x[2] - n[2] * x[1], n[2] * x[0] - n[0] * x[2], n[0] * x[1] - n[1] * x[0]];
        let dot = move |axis: [f64; 3], point: &Point3| axis[0] * point.x + axis[1] * point.y + axis[2] * point.z;
        // The origin lies along the normal, so it has no part along x and y.
        move |point| Point3 { x: dot(x, point), y: dot(y, point), z: self.above(point) }
    }
}

/// The plane that most of `points` lie nearer to than `threshold_m`, fitted to them; none if there is none.
///
/// `max_iterations` triples are tried at most, fewer as more inliers are found.
#[must_use]
pub fn find(points: &[Point3], threshold_m: f64, max_iterations: u32, random: &mut Stream) -> Option<Plane> {
    let n = points.len() as u32;
    let (mut best, mut most, mut needed) = (None, 0, f64::from(max_iterations));
    let mut tried = 0;
    while n >= 3 && tried < max_iterations && f64::from(tried) < needed {
        tried += 1;
        let [a, b, c] = [random.below(n), random.below(n), random.below(n)].map(|i| &points[i as usize]);
        let Some(plane) = Plane::through_three(a, b, c) else { continue };
        let inliers: u32 = points.iter().map(|point| u32::from(plane.above(point).abs() < threshold_m)).sum();
        if inliers > most {
            (best, most) = (Some(plane), inliers);
            needed = iterations(f64::from(inliers) / f64::from(n), 3);
        }
    }
    let sampled = best?;
    let inliers = points.iter().filter(|point| sampled.above(point).abs() < threshold_m).copied();
    let fitted = shortest_axis(inliers).and_then(|[centre, normal]| Plane::through(centre, normal));
    Some(fitted.unwrap_or(sampled))
}

/// Takes the ground out of one scan after the other.
#[derive(Debug, Clone)]
pub struct GroundFilter {
    params: FrontEndParams,
    good: VecDeque<Plane>,
}

impl GroundFilter {
    /// A filter that has seen no ground yet.
    #[must_use]
    pub fn new(params: &FrontEndParams) -> Self {
        Self { params: params.clone(), good: VecDeque::with_capacity(params.ground_mean_of as usize + 1) }
    }

    /// Writes those of `points`, in the robot's frame, that stand above the ground into `plants`, in the ground plane's frame.
    ///
    /// The ground is the mean of the last good planes; without one it is level.
    pub fn plants(&mut self, points: &[Point3], plants: &mut Vec<Point3>, random: &mut Stream) {
        let (threshold_m, iterations) = (self.params.ground_threshold_m, self.params.ground_iterations);
        let found = find(points, threshold_m, iterations, random);
        if let Some(plane) = found.filter(|plane| plane.tilt_rad() <= self.params.ground_max_tilt_rad) {
            self.good.push_back(plane);
            if self.good.len() > self.params.ground_mean_of as usize {
                self.good.pop_front();
            }
        }
        let plane_from_robot = self.ground().plane_from_robot();
        plants.clear();
        plants.extend(points.iter().map(plane_from_robot).filter(|point| point.z >= threshold_m));
    }

    /// The mean of the last good planes.
    #[must_use]
    pub fn ground(&self) -> Plane {
        let n = self.good.len() as f64;
        let mean = |of: fn(&Plane) -> f64| self.good.iter().map(of).sum::<f64>() / n;
        let normal = [mean(|plane| plane.normal[0]), mean(|plane| plane.normal[1]), mean(|plane| plane.normal[2])];
        let d_m = mean(|plane| plane.d_m);
        // Through the point of the mean plane that is nearest to the origin.
        let square = normal.iter().map(|part| part * part).sum::<f64>();
        Plane::through(normal.map(|part| -d_m * part / square), normal).unwrap_or(Plane::LEVEL)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::rows::RowDetectorSpec;
    use proptest::prelude::*;

    fn front_end() -> FrontEndParams {
        RowDetectorSpec::MapLines(Default::default()).front_end()
    }

    /// Ground z = `slope` x + `height_m` with 1 cm of noise, and a third of the points up to 1 m above it.
    fn scene(slope: f64, height_m: f64, seed: u64) -> Vec<Point3> {
        let mut random = Stream::new(seed, "scene");
        (0..600)
            .map(|i| {
                let (x, y) = (random.between(0.7, 6.0), random.between(-2.0, 2.0));
                let above = if i % 3 == 0 { random.between(0.1, 1.0) } else { 0.01 * random.normal() };
                Point3 { x, y, z: slope * x + height_m + above }
            })
            .collect()
    }

    #[test]
    fn the_ground_is_found_below_plants_and_its_signs_are_right() {
        for seed in 0..20 {
            let plane = find(&scene(0.1, -0.05, seed), 0.05, 100, &mut Stream::new(seed, "plane")).unwrap();
            assert!((plane.tilt_rad() - libm::atan(0.1)).abs() < 0.01, "{plane:?}");
            assert!((plane.above(&Point3 { x: 2.0, y: 0.3, z: 0.15 })).abs() < 0.02);
            assert!(plane.above(&Point3 { x: 2.0, y: 0.0, z: 0.65 }) > 0.4);
            assert!(plane.normal[0] < 0.0, "ground that rises ahead leans its normal back");
        }
    }

    #[test]
    fn in_the_planes_frame_heights_count_from_the_ground_and_x_runs_ahead() {
        let (params, mut plants) = (front_end(), Vec::new());
        let mut filter = GroundFilter::new(&params);
        for seed in 0..10 {
            filter.plants(&scene(0.1, -0.05, seed), &mut plants, &mut Stream::new(seed, "plane"));
        }
        assert!((190..=205).contains(&plants.len()), "{}", plants.len());
        assert!(plants.iter().all(|point| (0.05..1.02).contains(&point.z)));
        let below = filter.ground().plane_from_robot()(&Point3::default());
        assert!(below.x.abs() < 1e-12 && below.y.abs() < 1e-12 && (below.z - 0.05).abs() < 0.01, "{below:?}");
        let ahead = filter.ground().plane_from_robot()(&Point3 { x: 2.0, y: 0.0, z: 0.15 });
        assert!((ahead.x - 2.0 * libm::hypot(1.0, 0.1)).abs() < 0.03 && ahead.y.abs() < 0.03 && ahead.z.abs() < 0.03);
    }

    #[test]
    fn a_wall_is_not_taken_for_the_ground() {
        let wall: Vec<_> =
            (0..400).map(|i| Point3 { x: 2.0, y: 0.01 * f64::from(i % 20), z: 0.05 * f64::from(i / 20) }).collect();
        let mut filter = GroundFilter::new(&front_end());
        let mut plants = Vec::new();
        filter.plants(&wall, &mut plants, &mut Stream::new(1, "plane"));
        assert_eq!(filter.ground(), Plane::LEVEL);
        assert_eq!(plants.len(), 380, "all but the lowest row stands on level ground");
    }

    proptest! {
        #[test]
        fn any_points_give_finite_plants(points in prop::collection::vec((-9.0..9.0_f64, -9.0..9.0_f64, -9.0..9.0_f64), 0..40), same in 0..5_usize) {
            let mut points: Vec<_> = points.into_iter().map(|(x, y, z)| Point3 { x, y, z }).collect();
            if let Some(first) = points.first().copied() {
                points.extend(std::iter::repeat_n(first, same));
            }
            let mut plants = Vec::new();
            GroundFilter::new(&front_end()).plants(&points, &mut plants, &mut Stream::new(1, "plane"));
            prop_assert!(plants.iter().all(|point| point.is_finite()) && plants.len() <= points.len());
        }
    }
}
