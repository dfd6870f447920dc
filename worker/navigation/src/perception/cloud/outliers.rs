//! Statistical and radius outlier removal, as the point cloud library has them, with the nearest neighbours exact.

use pulp::Arch;

use super::Point3;
use super::buckets::Buckets;
use super::nearest::{Accompanied, MeanDistances};

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
    /// Removes the points whose mean distance to their `k` nearest others exceeds the mean of all these distances by more
    /// than `m` of their standard deviations. A cloud of `k` points or fewer is left as it is.
    pub fn statistical(&mut self, points: &mut Vec<Point3>, k: usize, m: f64) {
        points.retain(|point| point.is_finite());
        if k == 0 || points.len() <= k {
            return;
        }
        self.buckets.sort(points);
        self.mean_m.resize(points.len(), 0.0);
        let (cloud, least, mean_m) = (&self.buckets, &mut self.least, &mut self.mean_m[..]);
        Arch::new().dispatch(MeanDistances { cloud, k, least, mean_m });
        let limit = limit(&self.mean_m, m);
        let mut mean_m = self.mean_m.iter();
        points.retain(|_| mean_m.next().is_some_and(|mean_m| !is_above(*mean_m, limit)));
    }

    /// Removes the points that have fewer than `k` others within `radius_m` \[m\].
    pub fn radius(&mut self, points: &mut Vec<Point3>, k: usize, radius_m: f64) {
        points.retain(|point| point.is_finite());
        self.buckets.sort(points);
        self.keep.resize(points.len(), false);
        let (cloud, accompanied) = (&self.buckets, &mut self.keep[..]);
        Arch::new().dispatch(Accompanied { cloud, k, radius_m, accompanied });
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

/// Where distances are too large to have a mean, none is above it.
fn is_above(distance_m: f64, limit_m: f64) -> bool {
    distance_m > limit_m
}
