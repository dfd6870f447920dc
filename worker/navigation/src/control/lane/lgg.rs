//! The local goal generator: how far off the lane's middle the robot is, to the heading it should have.
//!
//! Velasquez et al. (2022), section 3.4.
//!
//! Deviation: equations 10 and 11 as printed lose a division. The path that is meant is f(x) = (b / |x / e|)^c, how
//! far along the lane the path stands at the error x; the heading is the angle of its tangent to the lane,
//! phi_r = arctan(e_d |e_d|^c / (c (b e)^c)).

/// The reference heading.
#[derive(Debug, Clone)]
pub struct Lgg {
    exponent: f64,
    /// 1 / (c (b e)^c)
    factor: f64,
}

impl Lgg {
    /// The curve of smoothness `b`, dead band `c` and width `e` \[m\], all positive.
    #[must_use]
    pub fn new(b: f64, c: f64, e: f64) -> Self {
        Self { exponent: c, factor: 1.0 / (c * libm::pow(b * e, c)) }
    }

    /// The heading \[rad\] for the error distance e_d = -0.5 (d_R - d_L) \[m\]: positive, to the left, right of the middle.
    #[must_use]
    pub fn heading_rad(&self, error_m: f64) -> f64 {
        libm::atan(error_m * libm::pow(error_m.abs(), self.exponent) * self.factor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn published() -> Lgg {
        Lgg::new(3.8, 0.55, 0.7)
    }

    #[test]
    fn headings_are_those_of_the_consistent_curve() {
        for (error_m, degrees) in [(0.0, 0.0), (0.1, 1.7), (0.2, 5.0), (0.375, 13.1), (1.0, 46.7)] {
            for sign in [-1.0, 1.0] {
                let heading = published().heading_rad(sign * error_m).to_degrees();
                assert!((heading - sign * degrees).abs() < 0.05, "{error_m}: {heading}");
            }
        }
    }

    #[test]
    fn the_heading_is_the_angle_of_the_paths_tangent_to_the_lane() {
        let (b, c, e) = (3.8, 0.55, 0.7);
        let along_m = |x: f64| libm::pow(b / (x / e), c);
        for error_m in [0.05, 0.2, 0.6] {
            let slope = (along_m(error_m + 1e-6) - along_m(error_m - 1e-6)) / 2e-6;
            let angle = std::f64::consts::FRAC_PI_2 - libm::atan(slope.abs());
            assert!((published().heading_rad(error_m) - angle).abs() < 1e-7, "{error_m}");
        }
    }

    #[test]
    fn far_off_it_heads_straight_across_and_no_further() {
        assert!((published().heading_rad(1e9) - std::f64::consts::FRAC_PI_2).abs() < 1e-6);
        assert!(published().heading_rad(f64::MAX) <= std::f64::consts::FRAC_PI_2);
    }
}
