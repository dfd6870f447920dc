//! Statistical and radius outlier removal, as the point cloud library has them, with the nearest neighbours exact.

use pulp::Arch;

use super::buckets::Buckets;
use super::nearest::{Accompanied, MeanDistances};
use super::{FrontEndParams, Point3};

/// Removes outliers from clouds of points in any frame; its buffers are kept from cloud to cloud.
///
/// Points that are not finite go first. The others keep their order.
#[derive(Debug, Default)]
pub struct OutlierRemoval {
    buckets: Buckets,
    least: Vec<f64>,
    mean_m: Vec<f64>,
    keep: Vec<bool>,
}

impl OutlierRemoval {
    /// Statistical removal, then radius removal, with the parameters of the front end: as if one after the other, but the
    /// points are sorted only once.
    pub fn remove(&mut self, points: &mut Vec<Point3>, params: &FrontEndParams) {
        self.start(points);
        self.lose_far(params.outlier_neighbours as usize, params.outlier_deviations);
        self.find_accompanied(params.radius_neighbours as usize, params.radius_m);
        self.keep_marked(points);
    }

    /// Removes the points whose mean distance to their `k` nearest others exceeds the mean of all these distances by more
    /// than `m` of their standard deviations. A cloud of `k` points or fewer is left as it is.
    pub fn statistical(&mut self, points: &mut Vec<Point3>, k: usize, m: f64) {
        self.start(points);
        self.lose_far(k, m);
        for place in 0..self.buckets.len() {
            self.keep[self.buckets.index(place)] = !self.buckets.is_lost(place);
        }
        self.keep_marked(points);
    }

    /// Removes the points that have fewer than `k` others within `radius_m` \[m\].
    pub fn radius(&mut self, points: &mut Vec<Point3>, k: usize, radius_m: f64) {
        self.start(points);
        self.find_accompanied(k, radius_m);
        self.keep_marked(points);
    }

    fn start(&mut self, points: &mut Vec<Point3>) {
        points.retain(|point| point.is_finite());
        self.buckets.sort(points);
        self.mean_m.resize(points.len(), 0.0);
        self.keep.resize(points.len(), false);
    }

    fn lose_far(&mut self, k: usize, m: f64) {
        if k == 0 || self.buckets.len() <= k {
            return;
        }
        let (cloud, least, mean_m) = (&self.buckets, &mut self.least, &mut self.mean_m[..]);
        Arch::new().dispatch(MeanDistances { cloud, k, least, mean_m });
        let limit_m = limit(&self.mean_m, m);
        for place in 0..self.buckets.len() {
            // Not so where distances are too large to have a mean.
            if self.mean_m[self.buckets.index(place)] > limit_m {
                self.buckets.lose(place);
            }
        }
    }

    fn find_accompanied(&mut self, k: usize, radius_m: f64) {
        let (cloud, accompanied) = (&self.buckets, &mut self.keep[..]);
        Arch::new().dispatch(Accompanied { cloud, k, radius_m, accompanied });
    }

    fn keep_marked(&self, points: &mut Vec<Point3>) {
        let mut keep = self.keep.iter();
        points.retain(|_| keep.next().is_some_and(|keep| *keep));
    }
}

/// Mean and `m` standard deviations. Summed from the first on, so that equal distances have exactly themselves as mean.
fn limit(mean_m: &[f64], m: f64) -> f64 {
    let (first, n) = (mean_m[0], mean_m.len() as f64);
    let mean = first + mean_m.iter().map(|distance| distance - first).sum::<f64>() / n;
    let squares = mean_m.iter().map(|distance| (distance - mean) * (distance - mean));
    mean + m * (squares.sum::<f64>() / (n - 1.0)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::super::oracle::{cloud_with_bad_points, clouds};
    use super::*;
    use crate::perception::rows::RowDetectorSpec;
    use proptest::prelude::*;

    fn squared(a: Point3, b: Point3) -> f64 {
        let (x, y, z) = (a.x - b.x, a.y - b.y, a.z - b.z);
        x * x + y * y + z * z
    }

    /// Mean distances by looking at all pairs.
    fn mean_distances(points: &[Point3], k: usize) -> Vec<f64> {
        let mean = |(i, point): (usize, &Point3)| {
            let others = points.iter().enumerate().filter(|(j, _)| *j != i);
            let mut distances: Vec<_> = others.map(|(_, other)| squared(*point, *other).sqrt()).collect();
            distances.sort_by(f64::total_cmp);
            distances[..k].iter().sum::<f64>() / k as f64
        };
        points.iter().enumerate().map(mean).collect()
    }

    proptest! {
        #[test]
        fn neighbours_are_exact(points in clouds(), k in prop_oneof![Just(10_usize), 1..25_usize]) {
            let mut removal = OutlierRemoval::default();
            let mut kept = points.clone();
            removal.statistical(&mut kept, k, 1.0);
            if points.len() <= k {
                prop_assert_eq!(kept, points);
                return Ok(());
            }
            let expected = mean_distances(&points, k);
            prop_assert_eq!(&removal.mean_m, &expected, "to the last bit");
            let limit = limit(&expected, 1.0);
            let inside = points.iter().zip(&expected).filter(|(_, mean)| **mean <= limit).map(|(point, _)| *point);
            prop_assert_eq!(kept, inside.collect::<Vec<_>>());
        }

        #[test]
        fn a_point_stays_when_enough_others_are_within_the_radius(
            points in clouds(), k in 0..8_usize, radius_m in prop_oneof![Just(0.5), 0.01..3.0_f64],
        ) {
            let company = |point: &Point3| {
                points.iter().filter(|other| squared(*point, **other) <= radius_m * radius_m).count() - 1
            };
            let expected: Vec<_> = points.iter().filter(|point| company(point) >= k).copied().collect();
            let mut kept = points.clone();
            OutlierRemoval::default().radius(&mut kept, k, radius_m);
            prop_assert_eq!(kept, expected);
        }

        #[test]
        fn both_at_once_are_one_after_the_other(points in clouds()) {
            let front_end = RowDetectorSpec::MapLines(Default::default()).front_end();
            let params = FrontEndParams { outlier_neighbours: 5, outlier_deviations: 0.5, radius_m: 0.5, ..front_end };
            let mut removal = OutlierRemoval::default();
            let (mut at_once, mut in_turn) = (points.clone(), points);
            removal.remove(&mut at_once, &params);
            removal.statistical(&mut in_turn, 5, 0.5);
            removal.radius(&mut in_turn, 3, 0.5);
            prop_assert_eq!(at_once, in_turn);
        }

        #[test]
        fn bad_points_go_and_nothing_panics(points in cloud_with_bad_points(), k in 0..5_usize, m in -1.0..2.0_f64) {
            let mut removal = OutlierRemoval::default();
            let (mut statistical, mut radius) = (points.clone(), points);
            removal.statistical(&mut statistical, k, m);
            removal.radius(&mut radius, k, 0.5);
            prop_assert!(statistical.iter().chain(&radius).all(|point| point.is_finite()));
        }
    }

    #[test]
    fn a_lone_point_is_removed_and_equal_distances_are_kept() {
        let at = |x: f64, y: f64| Point3 { x, y, z: 0.1 };
        let ring: Vec<_> = [(0.1, 0.1), (0.1, 0.2), (0.2, 0.1), (0.2, 0.2)].map(|(x, y)| at(x, y)).to_vec();
        let mut removal = OutlierRemoval::default();
        let mut kept = ring.clone();
        removal.statistical(&mut kept, 1, 0.0);
        assert_eq!(kept, ring);
        let mut kept = [&ring[..], &[at(5.0, 5.0)]].concat();
        removal.statistical(&mut kept, 2, 1.0);
        assert_eq!(kept, ring);
        let mut kept = [&ring[..], &[at(0.3, 0.3)]].concat();
        removal.radius(&mut kept, 2, 0.101);
        assert_eq!(kept, ring);
    }

    #[test]
    fn a_warm_removal_allocates_nothing() {
        let points: Vec<_> = (0..500).map(at_random).collect();
        let (mut removal, mut cloud) = (OutlierRemoval::default(), points.clone());
        let mut remove = || {
            cloud.clone_from(&points);
            removal.statistical(&mut cloud, 10, 1.0);
            removal.radius(&mut cloud, 3, 0.3);
        };
        remove();
        assert_eq!(allocation_counter::measure(remove).count_total, 0);
    }

    fn at_random(i: u32) -> Point3 {
        let c = |k: u32| f64::from(i.wrapping_mul(k) % 997) / 300.0;
        Point3 { x: c(7919), y: c(104_729), z: c(1_299_709) }
    }
}
