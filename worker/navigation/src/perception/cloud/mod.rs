//! Clouds of points of a 3D LiDAR: outliers, the ground, clusters.
//!
//! What the point cloud library does that Vintu (2018), sections 3.2.1 and 3.3, builds upon, with its exact semantics.

mod scan;

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
}
