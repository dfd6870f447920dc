//! The course of a lane and of its rows: straight or with one curve, each row wandering about its place.

use furrow_navigation::random::Stream;

use super::preset::Preset;
use crate::field::Polyline;

/// The course is integrated in steps of this length \[m\].
const STEP_M: f64 = 0.1;
/// Knots of the rows' centre lines stand this far apart \[m\].
const KNOT_M: f64 = 0.5;
/// Correlation length of a row's wander \[m\]. Ours.
const WANDER_LENGTH_M: f64 = 3.0;
/// The curve begins half-way; its curvature rises over so much, stays and falls \[m\]. Ours: 57 degrees in all.
const CURVE_RISES_M: f64 = 7.0;
const CURVE_STAYS_M: f64 = 1.0;

/// The line that the lane is laid out about, by length along it.
pub(super) struct Course {
    /// Position and direction at every [`STEP_M`].
    knots: Vec<([f64; 2], f64)>,
}

impl Course {
    pub(super) fn new(preset: &Preset) -> Self {
        let steps = (preset.length_m / STEP_M).ceil() as usize + 1;
        let (mut at, mut direction) = ([0.0, 0.0], 0.0);
        let mut knots = Vec::with_capacity(steps + 1);
        for i in 0..=steps {
            knots.push((at, direction));
            let turn = STEP_M * curvature(preset, (i as f64 + 0.5) * STEP_M);
            let (sin, cos) = libm::sincos(direction + 0.5 * turn);
            at = [at[0] + STEP_M * cos, at[1] + STEP_M * sin];
            direction += turn;
        }
        Self { knots }
    }

    /// The point `across_m` to the left of the place `along_m` \[m\].
    pub(super) fn at(&self, along_m: f64, across_m: f64) -> [f64; 2] {
        let knot = ((along_m / STEP_M).max(0.0) as usize).min(self.knots.len() - 2);
        let (from, direction) = self.knots[knot];
        let (_, next) = self.knots[knot + 1];
        let beyond_m = along_m - knot as f64 * STEP_M;
        let (sin, cos) = libm::sincos(direction + (next - direction) * (beyond_m / STEP_M).clamp(0.0, 1.0));
        [from[0] + beyond_m * cos - across_m * sin, from[1] + beyond_m * sin + across_m * cos]
    }
}

fn curvature(preset: &Preset, along_m: f64) -> f64 {
    let Some(radius_m) = preset.curve_radius_m else { return 0.0 };
    let into_m = along_m - 0.5 * preset.length_m;
    let from_ends_m = into_m.min(2.0 * CURVE_RISES_M + CURVE_STAYS_M - into_m);
    (from_ends_m / CURVE_RISES_M).clamp(0.0, 1.0) / radius_m
}

/// A row's centre line.
pub(super) struct Row {
    /// To the left of the course, at every [`KNOT_M`] \[m\].
    across_m: Vec<f64>,
}

impl Row {
    /// A row `across_m` to the left of the course: an Ornstein-Uhlenbeck process about it.
    pub(super) fn new(preset: &Preset, across_m: f64, wander_m: f64, random: &mut Stream) -> Self {
        let keeps = libm::exp(-KNOT_M / WANDER_LENGTH_M);
        let fresh = (1.0 - keeps * keeps).sqrt();
        let mut wander = random.normal();
        let knots = (preset.length_m / KNOT_M).ceil() as usize + 1;
        let across_m = (0..knots).map(|_| {
            let here_m = across_m + wander_m * wander;
            wander = keeps * wander + fresh * random.normal();
            here_m
        });
        Self { across_m: across_m.collect() }
    }

    /// How far to the left of the course the row is \[m\].
    pub(super) fn across_m(&self, along_m: f64) -> f64 {
        let knot = ((along_m / KNOT_M).max(0.0) as usize).min(self.across_m.len() - 2);
        let share = (along_m / KNOT_M - knot as f64).clamp(0.0, 1.0);
        self.across_m[knot] + share * (self.across_m[knot + 1] - self.across_m[knot])
    }

    pub(super) fn line(&self, course: &Course) -> Polyline {
        let knots = self.across_m.iter().enumerate();
        Polyline::new(knots.map(|(i, across_m)| course.at(i as f64 * KNOT_M, *across_m)).collect())
    }

    /// The middle between two rows.
    pub(super) fn middle(right: &Self, left: &Self, course: &Course) -> Polyline {
        let pairs = right.across_m.iter().zip(&left.across_m).map(|(right, left)| f64::midpoint(*right, *left));
        Self { across_m: pairs.collect() }.line(course)
    }
}

#[cfg(test)]
mod tests {
    use super::super::LaneName;
    use super::super::preset::preset;
    use super::*;

    #[test]
    fn the_production_lane_turns_by_57_degrees_at_a_radius_of_eight_metres() {
        let preset = preset(LaneName::Production, 1);
        let course = Course::new(&preset);
        let turned = course.knots.last().unwrap().1;
        assert!((turned - 8.0 / 8.0).abs() < 1e-3, "{turned}");
        let sharpest = course.knots.windows(2).map(|pair| (pair[1].1 - pair[0].1) / STEP_M).fold(0.0, f64::max);
        assert!((sharpest - 0.125).abs() < 1e-9);
    }

    #[test]
    fn a_row_wanders_as_far_as_it_should_and_its_neighbourhood_with_it() {
        let preset = preset(LaneName::Es2, 1);
        let rows: Vec<_> =
            (0..50).map(|seed| Row::new(&preset, 0.4, 0.022, &mut Stream::new(seed, "field-rows"))).collect();
        let mean = |f: &dyn Fn(&Row, f64) -> f64| {
            rows.iter().flat_map(|row| (0..390).map(move |i| f(row, f64::from(i)))).sum::<f64>() / (50.0 * 390.0)
        };
        let variance = mean(&|row, s| (row.across_m(s) - 0.4) * (row.across_m(s) - 0.4));
        let at_3_m = mean(&|row, s| (row.across_m(s) - 0.4) * (row.across_m(s + 3.0) - 0.4));
        assert!((variance.sqrt() - 0.022).abs() < 0.001, "{}", variance.sqrt());
        assert!((at_3_m / variance - libm::exp(-1.0)).abs() < 0.05, "{}", at_3_m / variance);
    }
}
