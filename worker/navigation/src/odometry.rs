//! How far odometry may be off: the model of Eliazar and Parr (2004), as Vintu (2018), eqs. 3.2 and 3.3, uses it.
//!
//! What the robot reports is drawn around what it did. The variance of a draw is quadratic in its length, so the noise of
//! a given path would depend on the step: it is drawn once per chunk of 0.1 m or 0.1 rad. Chunks are independent.

/// Noise is drawn per so much distance \[m\] or turn \[rad\].
pub const CHUNK: f64 = 0.1;

/// Standard deviations per distance or turn: those of a chunk are [`CHUNK`] times these.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdometryNoise {
    /// Of the distance per distance \[m/m\].
    pub distance_sd: f64,
    /// Of the drift across per distance \[m/m\].
    pub drift_sd: f64,
    /// Of the drift across per turn \[m/rad\].
    pub drift_turn_sd: f64,
    /// Of the heading per distance \[rad/m\].
    pub heading_sd: f64,
    /// Of the heading per turn \[rad/rad\].
    pub heading_turn_sd: f64,
}
