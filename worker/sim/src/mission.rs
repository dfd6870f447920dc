//! Missions in the simulator: navigation's, and one that reads no lines, the floor of every comparison.

use furrow_navigation::control::{Fuzzy, WheelSpeeds};
use furrow_navigation::mission::{LaneParams, NurseryParams, RowByRowParams, Step};
use furrow_navigation::perception::Line;

use crate::Pose;

furrow_navigation::kinds! {
    /// What the robot sets out to do.
    pub enum MissionSpec {
        /// Row after row by the rows that are seen.
        RowByRow(RowByRowParams) = "row-by-row",
        /// Row after row by odometry alone.
        HeadingHold(HeadingHoldParams) = "heading-hold",
        /// Along one lane.
        Lane(LaneParams) = "lane",
        /// All lanes of a nursery, with blind turns between them.
        Nursery(NurseryParams) = "nursery",
    }
}

furrow_navigation::parameters! {
    /// Parameters of [`HeadingHold`]; angles and speeds are those of `row-by-row`.
    pub struct HeadingHoldParams {
        /// Drives this far beyond a row's end before it turns. Ours.
        pub end_distance_m: f64 = 1.35, "m", [0.0, 10.0];
        /// Leaves a row at this angle. Program: pi / 4.5.
        pub leave_angle_rad: f64 = std::f64::consts::PI / 4.5, "rad", [0.05, 1.5];
        /// Wheels while rotating, as controller output. Program: 0.2.
        pub rotate_speed: f64 = 0.2, "1", [0.01, 1.0];
        /// Wheels while changing over, as controller output. Program: 0.3.
        pub change_speed: f64 = 0.3, "1", [0.01, 1.0];
    }
}

/// What heading-hold is told beforehand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Layout {
    /// From the start to the end of the first row \[m\].
    pub row_length_m: f64,
    /// \[m\]
    pub row_spacing_m: f64,
    /// Inter-rows to drive through.
    pub inter_rows: u32,
}

/// Drives by odometry alone: straight ahead at full speed, then a change of rows by angle and distance.
///
/// It starts at once and sees nothing. Steering straight is left to the same controller, which is shown two
/// rows beside the robot that run where its odometry says "straight ahead".
#[derive(Debug, Clone)]
pub struct HeadingHold {
    params: HeadingHoldParams,
    layout: Layout,
    fuzzy: Fuzzy,
    state: State,
    /// Counted from 0; even ones are driven forward.
    inter_row: u32,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    Following,
    Leaving,
    Changing,
    Entering,
}

impl HeadingHold {
    /// A mission that stands at the beginning of the first inter-row.
    #[must_use]
    pub const fn new(params: HeadingHoldParams, layout: Layout, fuzzy: Fuzzy) -> Self {
        Self { params, layout, fuzzy, state: State::Following, inter_row: 0 }
    }

    /// One control cycle at `odometry`, the pose relative to the start by the wheels alone.
    pub fn step(&mut self, odometry: Pose) -> Step {
        let sign = if self.inter_row.is_multiple_of(2) { 1.0 } else { -1.0 };
        match self.state {
            State::Following if !self.row_ended(odometry) => Step::Drive(self.straight(odometry, sign > 0.0)),
            State::Following if self.inter_row + 1 >= self.layout.inter_rows => Step::Finished,
            State::Following => self.go_on(State::Leaving),
            State::Leaving if -sign * odometry.heading_rad < self.params.leave_angle_rad => self.rotate(sign),
            State::Leaving => self.go_on(State::Changing),
            State::Changing if odometry.y_m < f64::from(self.inter_row + 1) * self.layout.row_spacing_m => {
                let speed = -sign * self.params.change_speed;
                Step::Drive(self.fuzzy.scale(speed, speed))
            }
            State::Changing => self.go_on(State::Entering),
            State::Entering if -sign * odometry.heading_rad > 0.0 => self.rotate(-sign),
            State::Entering => {
                self.inter_row += 1;
                self.go_on(State::Following)
            }
        }
    }

    fn row_ended(&self, odometry: Pose) -> bool {
        if self.inter_row.is_multiple_of(2) {
            odometry.x_m >= self.layout.row_length_m + self.params.end_distance_m
        } else {
            odometry.x_m <= -self.params.end_distance_m
        }
    }

    fn straight(&self, odometry: Pose, forward: bool) -> WheelSpeeds {
        let slope = libm::tan((-odometry.heading_rad).clamp(-1.2, 1.2));
        let half_m = 0.5 * self.layout.row_spacing_m;
        self.fuzzy.follow(Line::new(slope, half_m), Line::new(slope, -half_m), forward)
    }

    fn rotate(&self, clockwise: f64) -> Step {
        let speed = clockwise * self.params.rotate_speed;
        Step::Drive(self.fuzzy.scale(speed, -speed))
    }

    const fn go_on(&mut self, state: State) -> Step {
        self.state = state;
        Step::Drive(WheelSpeeds::STOP)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use furrow_navigation::control::FuzzyParams;

    fn mission() -> HeadingHold {
        let layout = Layout { row_length_m: 10.0, row_spacing_m: 1.0, inter_rows: 2 };
        HeadingHold::new(HeadingHoldParams::default(), layout, Fuzzy::new(FuzzyParams::default()))
    }

    fn at(x_m: f64, y_m: f64, heading_rad: f64) -> Pose {
        Pose { x_m, y_m, heading_rad }
    }

    fn wheels(step: Step) -> WheelSpeeds {
        match step {
            Step::Drive(wheels) => wheels,
            other => panic!("not driving: {other:?}"),
        }
    }

    #[test]
    fn it_starts_at_once_at_full_speed_and_steers_back_to_its_heading() {
        let straight = wheels(mission().step(at(0.0, 0.0, 0.0)));
        assert!((straight.left_rad_s - 0.7 * 0.888_537).abs() < 1e-5 && straight.left_rad_s == straight.right_rad_s);
        let turned = wheels(mission().step(at(1.0, 0.0, 0.2)));
        assert!(turned.left_rad_s > turned.right_rad_s, "turned counter-clockwise, it steers clockwise");
    }

    #[test]
    fn it_changes_rows_to_the_left_and_drives_back() {
        let mut mission = mission();
        assert_eq!(wheels(mission.step(at(11.4, 0.0, 0.0))), WheelSpeeds::STOP);
        let leaving = wheels(mission.step(at(11.4, 0.0, -0.1)));
        assert!(leaving.left_rad_s > 0.0 && leaving.right_rad_s < 0.0);
        mission.step(at(11.4, 0.0, -0.7));
        let changing = wheels(mission.step(at(11.4, 0.0, -0.7)));
        assert!(changing.left_rad_s < 0.0 && changing.left_rad_s == changing.right_rad_s);
        mission.step(at(10.2, 1.0, -0.7));
        let entering = wheels(mission.step(at(10.2, 1.0, -0.7)));
        assert!(entering.left_rad_s < 0.0 && entering.right_rad_s > 0.0);
        mission.step(at(10.2, 1.0, 0.01));
        assert!(wheels(mission.step(at(10.2, 1.0, 0.0))).left_rad_s < 0.0);
        assert_eq!(mission.step(at(-1.4, 1.0, 0.0)), Step::Finished);
    }
}
