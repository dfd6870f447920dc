//! Clouds of points of a 3D LiDAR: outliers, the ground, lines, clusters, a map of the surroundings.
//!
//! What the point cloud library does that Vintu (2018), sections 3.2.1 and 3.3, builds upon, with its exact semantics.

mod buckets;
mod cells;
pub mod clusters;
mod eigen;
pub mod front_end;
pub mod line;
pub mod local_map;
mod nearest;
#[cfg(test)]
mod oracle;
pub mod outliers;
pub mod plane;
pub mod scan;

pub use clusters::Clusters;
pub use front_end::{FrontEnd, FrontEndParams};
pub use local_map::LocalMap;
pub use scan::{CloudMount, CloudScan};

/// A point in space \[m\]: x ahead, y to the left, z up, in the frame that its owner says.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Point3 {
    /// \[m\]
    pub x: f64,
    /// \[m\]
    pub y: f64,
    /// \[m\]
    pub z: f64,
}

impl Point3 {
    /// Whether all coordinates are finite.
    #[must_use]
    pub const fn is_finite(self) -> bool {
        self.x.is_finite() && self.y.is_finite() && self.z.is_finite()
    }

    /// Squared distance of another point \[m^2\].
    #[must_use]
    pub fn squared_distance(&self, other: &Self) -> f64 {
        let (dx, dy, dz) = (self.x - other.x, self.y - other.y, self.z - other.z);
        dx * dx + dy * dy + dz * dz
    }
}
