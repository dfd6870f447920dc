//! Poses in the plane.

/// Position \[m\] and heading [rad, counter-clockwise] in the plane: `world_from_robot`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pose {
    /// \[m\]
    pub x_m: f64,
    /// \[m\]
    pub y_m: f64,
    /// \[rad\]
    pub heading_rad: f64,
}

impl Pose {
    /// The pose after an arc of length `distance_m` that turns by `turn_rad`.
    #[must_use]
    pub fn moved(self, distance_m: f64, turn_rad: f64) -> Self {
        let half = 0.5 * turn_rad;
        // Chord over arc: sin(h) / h, by its series for the small turns of a step.
        let chord = if half.abs() < 1e-3 { 1.0 - half * half / 6.0 } else { libm::sin(half) / half };
        let (sin, cos) = libm::sincos(self.heading_rad + half);
        Self {
            x_m: self.x_m + distance_m * chord * cos,
            y_m: self.y_m + distance_m * chord * sin,
            heading_rad: self.heading_rad + turn_rad,
        }
    }

    /// The pose of a sensor `ahead_m` ahead on the robot's x axis, looking forward or back.
    #[must_use]
    pub fn sensor(self, ahead_m: f64, looks_back: bool) -> Self {
        let (sin, cos) = libm::sincos(self.heading_rad);
        let turned = if looks_back { std::f64::consts::PI } else { 0.0 };
        Self { x_m: self.x_m + ahead_m * cos, y_m: self.y_m + ahead_m * sin, heading_rad: self.heading_rad + turned }
    }

    /// A point of the world in this pose's frame \[m\].
    #[must_use]
    pub fn local(&self, x_m: f64, y_m: f64) -> (f64, f64) {
        self.locals()(x_m, y_m)
    }

    /// What takes points of the world into this pose's frame \[m\]: [`local`](Self::local) for many points.
    pub fn locals(self) -> impl Fn(f64, f64) -> (f64, f64) {
        let (sin, cos) = libm::sincos(self.heading_rad);
        move |x_m, y_m| {
            let (dx, dy) = (x_m - self.x_m, y_m - self.y_m);
            (cos * dx + sin * dy, cos * dy - sin * dx)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn a_quarter_circle_ends_where_it_should() {
        let pose = Pose::default().moved(0.5 * PI, 0.5 * PI);
        assert!((pose.x_m - 1.0).abs() < 1e-12 && (pose.y_m - 1.0).abs() < 1e-12);
        assert!((pose.heading_rad - 0.5 * PI).abs() < 1e-15);
    }

    #[test]
    fn the_series_for_small_turns_meets_the_exact_arc() {
        let (below, above) = (Pose::default().moved(1.0, 1.999e-3), Pose::default().moved(1.0, 2.001e-3));
        assert!((below.x_m - above.x_m).abs() < 1e-8);
    }

    #[test]
    fn a_sensor_that_looks_back_sees_the_front_behind_it() {
        let lidar = Pose { x_m: 1.0, y_m: 2.0, heading_rad: 0.5 * PI }.sensor(-0.5, true);
        assert!((lidar.x_m - 1.0).abs() < 1e-12 && (lidar.y_m - 1.5).abs() < 1e-12);
        let (x, y) = lidar.local(1.0, 1.0);
        assert!((x - 0.5).abs() < 1e-12 && y.abs() < 1e-12);
    }
}
