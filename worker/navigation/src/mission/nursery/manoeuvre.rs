//! The blind drive from one lane into the next: Vintu (2018), figure 3.12.

use std::f64::consts::{FRAC_PI_4, PI, SQRT_2};

use super::NurseryParams;
use crate::Pose;
use crate::control::Twist;

/// A turn is done when it is this near \[rad\]: half a degree.
const TURNED_RAD: f64 = 0.5 * PI / 180.0;
/// A drive is done when it is this near \[m\].
const DRIVEN_M: f64 = 0.01;
/// Speed and yaw rate per what is left: slow enough for a robot that lags a fifth of a second \[1/s\].
const APPROACH_PER_S: f64 = 1.5;
/// Not slower than this, so that it ends \[m/s\], \[rad/s\].
const SLOWEST: f64 = 0.05;

/// One part of the manoeuvre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Leg {
    /// Turns on the spot.
    Turn,
    /// Drives so far ahead; backward if negative \[m\].
    Drive(f64),
}

/// The five legs, driven by a pose that may drift.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Manoeuvre {
    legs: [(Leg, f64); 5],
    leg: usize,
    /// Where the present leg began.
    from: Option<Pose>,
}

impl Manoeuvre {
    /// From the end of a lane that was driven with `heading_rad` to the lane beside it, `row_distance_m` away.
    pub(super) fn new(heading_rad: f64, next_is_left: bool, row_distance_m: f64) -> Self {
        let side = if next_is_left { 1.0 } else { -1.0 };
        let back_rad = heading_rad + side * PI;
        // Facing the field the next lane lies on the other side.
        let slanted_rad = back_rad - side * FRAC_PI_4;
        let legs = [
            (Leg::Turn, back_rad),
            (Leg::Drive(-row_distance_m), back_rad),
            (Leg::Turn, slanted_rad),
            (Leg::Drive(row_distance_m * SQRT_2), slanted_rad),
            (Leg::Turn, back_rad),
        ];
        Self { legs, leg: 0, from: None }
    }

    /// Takes in a pose; whether all legs are driven.
    pub(super) fn is_done(&mut self, pose: Pose) -> bool {
        while let Some((leg, heading_rad)) = self.legs.get(self.leg).copied() {
            let from = *self.from.get_or_insert(pose);
            let left = left(leg, heading_rad, from, pose);
            let is_done = match leg {
                Leg::Turn => left.abs() <= TURNED_RAD,
                // Also if it went too far.
                Leg::Drive(distance_m) => left * distance_m.signum() <= DRIVEN_M,
            };
            if !is_done {
                return false;
            }
            self.leg += 1;
            self.from = None;
        }
        true
    }

    /// How to drive on.
    pub(super) fn drive(&self, pose: Pose, params: &NurseryParams) -> Twist {
        let Some((leg, heading_rad)) = self.legs.get(self.leg).copied() else { return Twist::default() };
        let left = left(leg, heading_rad, self.from.unwrap_or(pose), pose);
        let limit = params.max_yaw_rate_rad_s;
        match leg {
            Leg::Turn => Twist { linear_m_s: 0.0, angular_rad_s: approach(left, limit) },
            Leg::Drive(_) => Twist {
                linear_m_s: approach(left, params.blind_speed_m_s),
                angular_rad_s: (APPROACH_PER_S * (heading_rad - pose.heading_rad)).clamp(-limit, limit),
            },
        }
    }
}

/// What is left of a leg: an angle \[rad\], or a way ahead \[m\].
fn left(leg: Leg, heading_rad: f64, from: Pose, pose: Pose) -> f64 {
    match leg {
        Leg::Turn => heading_rad - pose.heading_rad,
        Leg::Drive(distance_m) => {
            let along = Pose { heading_rad, ..from };
            distance_m - along.local(pose.x_m, pose.y_m).0
        }
    }
}

/// Fast while far, slow when near.
fn approach(left: f64, limit: f64) -> f64 {
    (APPROACH_PER_S * left.abs()).clamp(SLOWEST.min(limit), limit).copysign(left)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_ends_in_the_lane_beside_turned_round_from_either_side() {
        for (next_is_left, side) in [(true, 1.0), (false, -1.0)] {
            for heading_rad in [0.0, PI, 0.3] {
                let mut manoeuvre = Manoeuvre::new(heading_rad, next_is_left, 1.3);
                let start = Pose { x_m: 9.0, y_m: 0.1, heading_rad };
                let mut pose = start;
                let mut steps = 0;
                while !manoeuvre.is_done(pose) {
                    let twist = manoeuvre.drive(pose, &NurseryParams::default());
                    pose = pose.moved(0.1 * twist.linear_m_s, 0.1 * twist.angular_rad_s);
                    steps += 1;
                    assert!(steps < 400, "{manoeuvre:?} {pose:?}");
                }
                let end = start.relative(pose);
                assert!(end.x_m.abs() < 0.1 && (end.y_m - side * 1.3).abs() < 0.1, "{end:?}");
                assert!((end.heading_rad.abs() - PI).abs() < 0.02, "{end:?}");
            }
        }
    }
}
