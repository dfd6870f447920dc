//! Row after row without ever turning round: follow, leave, change over, follow in the other direction.
//!
//! Guyonneau et al. (2022), section 4; states and constants of the program behind their tables. The first
//! change goes to the left: rotate clockwise, back up, rotate back; the next one forward with the rotations
//! turned round, and so on. Odd inter-rows are driven forward, even ones backward.

use super::{Brief, Step};
use crate::control::{Fuzzy, WheelSpeeds};
use crate::localization::row_filter::{RowFilter, Rows, Tracking};

crate::parameters! {
    /// Parameters of [`RowByRow`].
    pub struct RowByRowParams {
        /// A row has ended when its last point lies this far behind the robot's centre: half the body and a margin. Program: 0.8 + 0.55.
        pub end_distance_m: f64 = 1.35, "m", [0.0, 10.0];
        /// In so many cycles of the row, not necessarily in a row. Program: 3.
        pub end_cycles: u32 = 3, "1", [1, 100];
        /// The robot leaves a row at this angle to it. Program: pi / 4.5, 40 degrees.
        pub leave_angle_rad: f64 = std::f64::consts::PI / 4.5, "rad", [0.05, 1.5];
        /// It is back in line at this angle; the controller does the rest. Program: pi / 10, 18 degrees.
        pub enter_angle_rad: f64 = std::f64::consts::PI / 10.0, "rad", [0.0, 1.5];
        /// Wheels while rotating, as controller output. Program: 0.2.
        pub rotate_speed: f64 = 0.2, "1", [0.01, 1.0];
        /// Wheels while changing over, as controller output. Program: 0.3.
        pub change_speed: f64 = 0.3, "1", [0.01, 1.0];
        /// Changed over when the intercepts of the new pair add up to this at most. Program: 0.6.
        pub centred_m: f64 = 0.6, "m", [0.0, 10.0];
        /// Likewise, as a share of the row spacing: the smaller bound holds. Ours, for narrow rows.
        pub centred_share: f64 = 0.6, "1", [0.0, 1.0];
        /// A stop lasts until both wheels are slower than this. Ours; the program waits for two like lines.
        pub standing_rad_s: f64 = 0.01, "rad/s", [0.0001, 1.0];
    }
}

/// Which way the robot drives along a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Travel {
    Forward,
    Backward,
}

impl Travel {
    const fn turned(self) -> Self {
        match self {
            Self::Forward => Self::Backward,
            Self::Backward => Self::Forward,
        }
    }

    const fn sign(self) -> f64 {
        match self {
            Self::Forward => 1.0,
            Self::Backward => -1.0,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    /// The row spacing is being measured.
    Starting,
    Following {
        end_cycles: u32,
    },
    /// Rotates out of the row.
    Leaving,
    /// Drives until the next pair of rows is the middle one.
    Changing,
    /// Rotates into the row.
    Entering,
    /// Stands still, then goes on.
    Stopping(Next),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Next {
    Finish,
    Leave,
    Change,
    Enter,
    Follow,
}

/// The mission.
#[derive(Debug, Clone)]
pub struct RowByRow {
    params: RowByRowParams,
    brief: Brief,
    filter: RowFilter,
    fuzzy: Fuzzy,
    state: State,
    /// Of the row being followed; of the last one while changing.
    travel: Travel,
    /// Counted from 1.
    inter_row: u32,
}

impl RowByRow {
    /// A mission that stands at the beginning of the first inter-row.
    #[must_use]
    pub const fn new(params: RowByRowParams, brief: Brief, filter: RowFilter, fuzzy: Fuzzy) -> Self {
        Self { params, brief, filter, fuzzy, state: State::Starting, travel: Travel::Forward, inter_row: 1 }
    }

    /// Where scans go in.
    pub const fn filter_mut(&mut self) -> &mut RowFilter {
        &mut self.filter
    }

    /// Ends a control cycle; `wheels` is what the encoders say.
    pub fn step(&mut self, wheels: WheelSpeeds) -> Step {
        match self.filter.cycle() {
            Tracking::Measuring | Tracking::Nothing => Step::Drive(WheelSpeeds::STOP),
            Tracking::Lost => Step::Lost,
            Tracking::Rows(rows) => self.step_among(&rows, wheels),
        }
    }

    fn step_among(&mut self, rows: &Rows, wheels: WheelSpeeds) -> Step {
        let angle_rad = libm::atan(rows.slope());
        match self.state {
            State::Starting => {
                self.state = State::Following { end_cycles: 0 };
                Step::Drive(WheelSpeeds::STOP)
            }
            State::Following { end_cycles } => self.follow(rows, end_cycles),
            State::Stopping(next) if self.stands(wheels) => self.go_on(next),
            State::Stopping(_) => Step::Drive(WheelSpeeds::STOP),
            State::Leaving if self.turn() * angle_rad < self.params.leave_angle_rad => self.rotate(self.turn()),
            State::Leaving => self.stop_then(Next::Change),
            State::Changing => self.change(rows),
            State::Entering if self.turn() * angle_rad > self.params.enter_angle_rad => self.rotate(-self.turn()),
            State::Entering => {
                self.inter_row += 1;
                self.travel = self.travel.turned();
                self.stop_then(Next::Follow)
            }
        }
    }

    fn follow(&mut self, rows: &Rows, end_cycles: u32) -> Step {
        let end_cycles = end_cycles + u32::from(self.behind(rows));
        self.state = State::Following { end_cycles };
        if end_cycles >= self.params.end_cycles {
            return self.stop_then(if self.inter_row >= self.brief.inter_rows { Next::Finish } else { Next::Leave });
        }
        Step::Drive(self.fuzzy.follow(rows.left().line, rows.right().line, self.travel == Travel::Forward))
    }

    /// Whether all points of the rows lie behind the robot, in its direction of travel.
    fn behind(&self, rows: &Rows) -> bool {
        rows.extent_m().is_some_and(|(first_m, last_m)| match self.travel {
            Travel::Forward => last_m <= -self.params.end_distance_m,
            Travel::Backward => first_m >= self.params.end_distance_m,
        })
    }

    /// Drives at the leaving angle until the pair of rows on the new side is the middle one.
    fn change(&mut self, rows: &Rows) -> Step {
        // Both kinds of change go to the left: the left row and the one beyond it become the middle pair.
        let spacing_m = self.filter.spacing_m().unwrap_or(f64::INFINITY);
        let beyond_m = match rows.slots.len() / 2 {
            1 => rows.left().line.intercept_m + spacing_m * rows.left().line.slant(),
            side => rows.slots[side - 2].line.intercept_m,
        };
        let sum_m = beyond_m + rows.left().line.intercept_m;
        if sum_m.abs() <= self.params.centred_m.min(self.params.centred_share * spacing_m) {
            self.filter.shift_left();
            return self.stop_then(Next::Enter);
        }
        let speed = -self.travel.sign() * self.params.change_speed;
        Step::Drive(self.fuzzy.scale(speed, speed))
    }

    /// 1 where the robot rotates clockwise out of the row (after driving forward), -1 counter-clockwise.
    const fn turn(&self) -> f64 {
        self.travel.sign()
    }

    fn rotate(&self, clockwise: f64) -> Step {
        let speed = clockwise * self.params.rotate_speed;
        Step::Drive(self.fuzzy.scale(speed, -speed))
    }

    fn stands(&self, wheels: WheelSpeeds) -> bool {
        wheels.left_rad_s.abs().max(wheels.right_rad_s.abs()) <= self.params.standing_rad_s
    }

    const fn stop_then(&mut self, next: Next) -> Step {
        self.state = State::Stopping(next);
        Step::Drive(WheelSpeeds::STOP)
    }

    const fn go_on(&mut self, next: Next) -> Step {
        self.state = match next {
            Next::Finish => return Step::Finished,
            Next::Leave => State::Leaving,
            Next::Change => State::Changing,
            Next::Enter => State::Entering,
            Next::Follow => State::Following { end_cycles: 0 },
        };
        Step::Drive(WheelSpeeds::STOP)
    }
}
