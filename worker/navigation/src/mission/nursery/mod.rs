//! Every lane of a nursery, one after the other: Vintu (2018), section 3.5, figures 3.11 and 3.12.
//!
//! Between two lanes it drives blind: a turn of 180 degrees, back by the row distance D, 45 degrees towards the next
//! lane, ahead by D sqrt(2), 45 degrees back. `guide` chooses the line to follow, `manoeuvre` drives blind.

mod guide;
mod manoeuvre;

use crate::Pose;
use crate::control::{MidLine, MidLineControl, Twist};
use crate::localization::PlantingMap;
use crate::perception::cloud::Point3;
use crate::perception::rows::DetectedRows;

use guide::Guide;
use manoeuvre::Manoeuvre;

crate::parameters! {
    /// Parameters of [`NurseryMission`].
    pub struct NurseryParams {
        /// Forward speed while two lines are awaited. Ours.
        pub search_speed_m_s: f64 = 0.3, "m/s", [0.01, 5.0];
        /// Forward speed out of a row. Ours: as in the rows.
        pub exit_speed_m_s: f64 = 0.8, "m/s", [0.01, 5.0];
        /// Largest speed between rows, ahead and back. Ours.
        pub blind_speed_m_s: f64 = 0.5, "m/s", [0.01, 5.0];
        /// Largest yaw rate to either side. Ours.
        pub max_yaw_rate_rad_s: f64 = 0.8, "rad/s", [0.01, 10.0];
        /// The robot turns when its centre is this far beyond the last plants. Ours.
        pub exit_distance_m: f64 = 1.0, "m", [0.0, 10.0];
        /// A row ends, by perception, at fewer plant points than this. Ours.
        pub end_points: u32 = 15, "1", [1, 100000];
        /// Only points farther than this beyond where the LiDAR's view meets the rows count: a shorter piece of the rows gives no
        /// line. Ours.
        pub end_ahead_m: f64 = 1.0, "m", [0.0, 10.0];
        /// In so many scans one after the other; the row ended at the first of them. Ours.
        pub end_scans: u32 = 3, "1", [1, 1000];
        /// With localization: a lane is entered by the map for so far. Ours; the thesis says a few metres.
        pub enter_distance_m: f64 = 3.0, "m", [0.0, 100.0];
        /// With localization: a detected line farther than this from its row in the map is dropped. Ours: less than half of any
        /// row distance, more than localization is off by.
        pub line_gate_m: f64 = 0.5, "m", [0.01, 10.0];
        /// With localization: so is one at a larger angle to it. Ours: 15 degrees.
        pub line_gate_rad: f64 = 15.0 * std::f64::consts::PI / 180.0, "rad", [0.01, 1.5];
    }
}

/// Yaw rate per angle to the way straight out of a row \[1/s\].
const STRAIGHT_ON_PER_S: f64 = 2.0;

/// What the mission is told at each scan.
#[derive(Debug, Clone, Copy)]
pub struct NurserySight<'a> {
    /// What was detected.
    pub rows: DetectedRows<'a>,
    /// Plant points ahead that count for the end of a row: see [`NurseryMission::points_ahead`].
    pub points_ahead: u32,
    /// Where the robot is by its wheels alone.
    pub odometry_from_robot: Pose,
    /// Where it is in the map, with localization.
    pub map_from_robot: Option<Pose>,
}

/// What the mission wants after a scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NurseryStep {
    /// Drive on.
    Drive(Twist),
    /// All lanes are driven through.
    Finished,
}

/// The states of figure 3.11; the turns, the drive backward and the drive forward are the legs of a manoeuvre.
#[derive(Debug, Clone, Copy, PartialEq)]
enum State {
    Start,
    Search,
    Enter,
    /// In how many scans up to now there were too few plant points, and where the first of them was taken.
    Follow {
        few: Option<(u32, Pose)>,
    },
    Exit {
        from: Pose,
        distance_m: f64,
    },
    Change(Manoeuvre),
    End,
    /// A fault: a pose that is no number. Only a new start leads out.
    Stop,
}

/// The mission.
pub struct NurseryMission {
    params: NurseryParams,
    map: PlantingMap,
    /// From the robot's centre to the nearest points that count for the end of a row \[m\].
    end_m: f64,
    control: Box<dyn MidLineControl>,
    state: State,
    /// The lane that it drives in, or that it will be in next; counted from 0.
    lane: u32,
    /// Of the last pose in the map, so that headings go on across half a turn \[rad\].
    heading_rad: f64,
}

impl NurseryMission {
    /// A mission at the beginning of the first lane of `map`; `view` is where its LiDAR is ahead of the robot's centre \[m\]
    /// and half its horizontal field of view \[rad\].
    #[must_use]
    pub fn new(
        params: NurseryParams,
        map: PlantingMap,
        (lidar_x_m, half_view_rad): (f64, f64),
        control: Box<dyn MidLineControl>,
    ) -> Self {
        let view_from_m = lidar_x_m + 0.5 * map.row_distance_m / libm::tan(half_view_rad);
        let end_m = view_from_m + params.end_ahead_m;
        Self { params, map, end_m, control, state: State::Start, lane: 0, heading_rad: 0.0 }
    }

    /// From the robot's centre to the nearest points that count for the end of a row \[m\].
    #[must_use]
    pub const fn end_m(&self) -> f64 {
        self.end_m
    }

    /// How many of `points` count for the end of a row: ahead, and not beyond the rows beside the robot's own (ours).
    #[must_use]
    pub fn points_ahead(&self, points: &[Point3]) -> u32 {
        let [end_m, reach_m] = [self.end_m, self.map.row_distance_m];
        let counts = |point: &&Point3| point.x > end_m && point.y.abs() <= reach_m;
        points.iter().filter(counts).count() as u32
    }

    /// One scan, `dt_s` \[s\] after the last one.
    pub fn step(&mut self, sight: &NurserySight<'_>, dt_s: f64) -> NurseryStep {
        let sight = &NurserySight { map_from_robot: self.unwound(sight.map_from_robot), ..*sight };
        if !self.pose(sight).is_finite() || !sight.odometry_from_robot.is_finite() {
            self.state = State::Stop;
        }
        self.advance(sight);
        let twist = match self.state {
            State::End => return NurseryStep::Finished,
            State::Start | State::Stop => Twist::default(),
            State::Search => Twist { linear_m_s: self.params.search_speed_m_s, angular_rad_s: 0.0 },
            State::Enter => self.along(self.guide(sight).by_map(), dt_s),
            State::Follow { .. } => self.along(self.guide(sight).line(&sight.rows), dt_s),
            State::Exit { from, .. } => self.exit(from, sight, dt_s),
            State::Change(manoeuvre) => manoeuvre.drive(self.pose(sight), &self.params),
        };
        NurseryStep::Drive(twist)
    }

    /// Goes from state to state as long as one is done.
    fn advance(&mut self, sight: &NurserySight<'_>) {
        match self.state {
            State::Start if sight.map_from_robot.is_none() => self.state = State::Search,
            State::Start => self.follow(),
            State::Search if sight.map_from_robot.is_some() => self.state = State::Enter,
            State::Search if self.guide(sight).beside(&sight.rows).iter().all(Option::is_some) => self.follow(),
            State::Enter if self.lane_x_m(sight).is_none_or(|x_m| x_m >= self.params.enter_distance_m) => self.follow(),
            State::Follow { few } => self.watch_for_the_end(few, sight),
            State::Exit { from, distance_m } if self.has_left(from, distance_m, sight) => self.change(sight),
            State::Change(mut manoeuvre) => {
                let done = manoeuvre.is_done(self.pose(sight));
                self.state = if done { State::Search } else { State::Change(manoeuvre) };
            }
            _ => {}
        }
    }

    fn follow(&mut self) {
        self.control.restart();
        self.state = State::Follow { few: None };
    }

    /// The end of a row: by the map with localization, else by too few plant points.
    fn watch_for_the_end(&mut self, few: Option<(u32, Pose)>, sight: &NurserySight<'_>) {
        let from = self.pose(sight);
        if let Some(x_m) = self.lane_x_m(sight) {
            if x_m >= self.map.row_length_m() {
                self.state = State::Exit { from, distance_m: self.params.exit_distance_m };
            }
            return;
        }
        let is_few = sight.points_ahead < self.params.end_points;
        let few = is_few.then(|| few.map_or((1, from), |(scans, from)| (scans + 1, from)));
        self.state = match few {
            // The last plants are where points begin to count.
            Some((scans, from)) if scans >= self.params.end_scans => {
                State::Exit { from, distance_m: self.end_m + self.params.exit_distance_m }
            }
            _ => State::Follow { few },
        };
    }

    /// By the map with localization, else straight on.
    fn exit(&mut self, from: Pose, sight: &NurserySight<'_>, dt_s: f64) -> Twist {
        if sight.map_from_robot.is_some() {
            let line = self.guide(sight).by_map();
            return self.along(line, dt_s);
        }
        let turned_rad = from.heading_rad - sight.odometry_from_robot.heading_rad;
        Twist { linear_m_s: self.params.exit_speed_m_s, angular_rad_s: self.limited(STRAIGHT_ON_PER_S * turned_rad) }
    }

    fn has_left(&self, from: Pose, distance_m: f64, sight: &NurserySight<'_>) -> bool {
        match self.lane_x_m(sight) {
            Some(x_m) => x_m >= self.map.row_length_m() + self.params.exit_distance_m,
            None => from.local(sight.odometry_from_robot.x_m, sight.odometry_from_robot.y_m).0 >= distance_m,
        }
    }

    /// The end after the last lane, else over to the next one.
    fn change(&mut self, sight: &NurserySight<'_>) {
        if self.lane + 1 >= self.map.lanes() {
            self.state = State::End;
            return;
        }
        // Even lanes are driven along x: there the next lane is to the left if lanes follow each other to the left.
        let next_is_left = self.lane.is_multiple_of(2) == self.map.lanes_to_the_left;
        let heading_rad = match sight.map_from_robot {
            Some(pose) => nearest_turn(self.lane_heading_rad(), pose.heading_rad),
            None => sight.odometry_from_robot.heading_rad,
        };
        self.lane += 1;
        self.state = State::Change(Manoeuvre::new(heading_rad, next_is_left, self.map.row_distance_m));
    }

    /// The pose with its heading a whole number of turns away, nearest to the last one.
    fn unwound(&mut self, map_from_robot: Option<Pose>) -> Option<Pose> {
        let pose = map_from_robot?;
        self.heading_rad = nearest_turn(pose.heading_rad, self.heading_rad);
        Some(Pose { heading_rad: self.heading_rad, ..pose })
    }

    /// The pose that blind driving goes by.
    fn pose(&self, sight: &NurserySight<'_>) -> Pose {
        sight.map_from_robot.unwrap_or(sight.odometry_from_robot)
    }

    fn guide(&self, sight: &NurserySight<'_>) -> Guide<'_> {
        Guide { params: &self.params, map: &self.map, lane: self.lane, map_from_robot: sight.map_from_robot }
    }

    fn along(&mut self, line: Option<MidLine>, dt_s: f64) -> Twist {
        line.map_or_else(Twist::default, |line| self.control.steer(line, dt_s))
    }

    fn lane_heading_rad(&self) -> f64 {
        if self.lane.is_multiple_of(2) { 0.0 } else { std::f64::consts::PI }
    }

    /// How far beyond the first plants of its lane the robot is, in the direction of travel \[m\]; with localization.
    fn lane_x_m(&self, sight: &NurserySight<'_>) -> Option<f64> {
        let x_m = sight.map_from_robot?.x_m;
        Some(if self.lane.is_multiple_of(2) { x_m } else { self.map.row_length_m() - x_m })
    }

    fn limited(&self, yaw_rate_rad_s: f64) -> f64 {
        yaw_rate_rad_s.clamp(-self.params.max_yaw_rate_rad_s, self.params.max_yaw_rate_rad_s)
    }
}

/// `angle_rad` plus as many whole turns as bring it nearest to `near_rad`.
fn nearest_turn(angle_rad: f64, near_rad: f64) -> f64 {
    let turn = 2.0 * std::f64::consts::PI;
    angle_rad + turn * ((near_rad - angle_rad) / turn).round()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::mid_line::pid::{MidLinePid, MidLinePidParams};
    use crate::perception::rows::RowLine;

    const MAP: PlantingMap = PlantingMap {
        row_distance_m: 1.3,
        planting_distance_m: 0.4,
        rows: 2,
        plants_per_row: 20,
        lanes_to_the_left: true,
    };

    fn mission() -> NurseryMission {
        let control = Box::new(MidLinePid::new(&MidLinePidParams::default()));
        NurseryMission::new(NurseryParams::default(), MAP, (0.575, 30_f64.to_radians()), control)
    }

    #[test]
    fn only_points_that_still_give_a_line_count_for_the_end_of_a_row() {
        let mission = mission();
        let at = |x: f64, y: f64| Point3 { x, y, z: 0.2 };
        // The view meets the rows 0.575 m + 0.65 m / tan 30 degrees ahead; a metre more counts.
        assert!((mission.end_m() - 2.700_833).abs() < 1e-6);
        assert_eq!(mission.points_ahead(&[at(2.69, 0.65), at(2.71, 0.65), at(2.71, -1.31), at(9.0, -1.29)]), 2);
    }

    #[test]
    fn a_robot_that_sees_no_line_at_the_start_creeps_ahead_and_by_a_map_follows_that() {
        let step = |map_from_robot| {
            let odometry_from_robot = Pose::default();
            let sight =
                NurserySight { rows: DetectedRows::default(), points_ahead: 100, odometry_from_robot, map_from_robot };
            mission().step(&sight, 0.1)
        };
        assert_eq!(step(None), NurseryStep::Drive(Twist { linear_m_s: 0.3, angular_rad_s: 0.0 }));
        let lane_y_m = MAP.lane_y_m(0);
        let NurseryStep::Drive(twist) = step(Some(Pose { x_m: -1.0, y_m: lane_y_m, heading_rad: 0.0 })) else {
            panic!()
        };
        assert!((twist.linear_m_s - 0.8).abs() < 1e-9 && twist.angular_rad_s.abs() < 1e-9, "{twist:?}");
    }

    #[test]
    fn the_robot_leaves_a_row_by_the_place_of_the_first_scan_with_too_few_points() {
        let (mut mission, mut x_m) = (mission(), 0.0);
        let mut seen = |x_m: f64, points_ahead: u32| {
            let rows = [0.65, -0.65].map(|y| RowLine::along([0.0, y], [1.0, 0.0]));
            let rows = DetectedRows { lines: rows, ..DetectedRows::default() };
            let odometry_from_robot = Pose { x_m, y_m: 0.0, heading_rad: 0.0 };
            mission.step(&NurserySight { rows, points_ahead, odometry_from_robot, map_from_robot: None }, 0.1)
        };
        seen(0.0, 100);
        // Two scans with few points are no end.
        for points in [3, 3, 100, 3, 3, 3] {
            x_m += 0.08;
            assert!(matches!(seen(x_m, points), NurseryStep::Drive(_)));
        }
        let first_m = x_m - 2.0 * 0.08;
        let leaves_m = first_m + 2.700_833 + 1.0;
        assert!(matches!(seen(leaves_m - 0.01, 0), NurseryStep::Drive(_)));
        assert_eq!(seen(leaves_m + 0.01, 0), NurseryStep::Finished);
    }
}
