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

    /// Whether position and heading are finite.
    #[must_use]
    pub const fn is_finite(self) -> bool {
        self.x_m.is_finite() && self.y_m.is_finite() && self.heading_rad.is_finite()
    }

    /// This pose's frame in which `other` is given, seen from where this pose is given: `a_from_b` with `b_from_c` is `a_from_c`.
    #[must_use]
    pub fn compose(self, other: Self) -> Self {
        let [x_m, y_m] = self.world(other.x_m, other.y_m);
        Self { x_m, y_m, heading_rad: self.heading_rad + other.heading_rad }
    }

    /// `b_from_a` of `a_from_b`.
    #[must_use]
    pub fn inverse(self) -> Self {
        let (x_m, y_m) = self.local(0.0, 0.0);
        Self { x_m, y_m, heading_rad: -self.heading_rad }
    }

    /// `other` in this pose's frame; both are given in the same frame.
    #[must_use]
    pub fn relative(self, other: Self) -> Self {
        let (x_m, y_m) = self.local(other.x_m, other.y_m);
        Self { x_m, y_m, heading_rad: other.heading_rad - self.heading_rad }
    }

    /// A point of this pose's frame in the world \[m\].
    #[must_use]
    pub fn world(&self, x_m: f64, y_m: f64) -> [f64; 2] {
        self.worlds()(x_m, y_m)
    }

    /// What takes points of this pose's frame into the world \[m\]: [`world`](Self::world) for many points.
    pub fn worlds(self) -> impl Fn(f64, f64) -> [f64; 2] {
        let (sin, cos) = libm::sincos(self.heading_rad);
        move |x_m, y_m| [self.x_m + cos * x_m - sin * y_m, self.y_m + sin * x_m + cos * y_m]
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
    fn poses_compose_and_invert() {
        let a = Pose { x_m: 1.0, y_m: -2.0, heading_rad: 0.7 };
        let b = Pose { x_m: 0.3, y_m: 0.5, heading_rad: -1.1 };
        let there_and_back = a.compose(b).compose(b.inverse());
        for (left, right) in
            [(there_and_back, a), (a.compose(a.relative(b)), b), (a.compose(a.inverse()), Pose::default())]
        {
            let apart = [left.x_m - right.x_m, left.y_m - right.y_m, left.heading_rad - right.heading_rad];
            assert!(apart.iter().all(|d| d.abs() < 1e-12), "{left:?} {right:?}");
        }
        let [x, y] = a.world(0.3, 0.5);
        let (x, y) = a.local(x, y);
        assert!((x - 0.3).abs() < 1e-12 && (y - 0.5).abs() < 1e-12);
    }

    #[test]
    fn a_sensor_that_looks_back_sees_the_front_behind_it() {
        let lidar = Pose { x_m: 1.0, y_m: 2.0, heading_rad: 0.5 * PI }.sensor(-0.5, true);
        assert!((lidar.x_m - 1.0).abs() < 1e-12 && (lidar.y_m - 1.5).abs() < 1e-12);
        let (x, y) = lidar.local(1.0, 1.0);
        assert!((x - 0.5).abs() < 1e-12 && y.abs() < 1e-12);
    }
}
