//! One run: the closed loop, in fixed steps, a pure function of scenario and seed.

use std::collections::BTreeMap;

use furrow_navigation::control::{ControlSpec, Fuzzy, WheelSpeeds};
use furrow_navigation::localization::merge::RobotFromLidar;
use furrow_navigation::localization::{LocalizationSpec, RowFilter};
use furrow_navigation::mission::{Brief, RowByRow, Step};
use furrow_navigation::random::Stream;

use crate::field::Field;
use crate::lidar::{PlanarLidar, SensorsSpec, TwoPlanarLidarsParams};
use crate::mission::{HeadingHold, Layout, MissionSpec};
use crate::observer::Observer;
use crate::odometry::Odometry;
use crate::perception::Perception;
use crate::robot::{RobotSpec, TwoWheeled};
use crate::{Pose, Scenario};

/// One step of the loop [s]: the period of the LiDARs, 40 Hz.
pub const STEP_S: f64 = 0.025;
/// Steps per control cycle: 250 ms, the program behind the tables of Guyonneau et al. (2022).
pub const STEPS_PER_CYCLE: u64 = 10;
/// Steps per sample of the observer: 20 Hz.
pub const STEPS_PER_SAMPLE: u64 = 2;

/// The seed of a run's random streams.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Seed(pub u64);

/// A part of the loop, for timing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Part {
    /// Ray casting of both LiDARs.
    Scan,
    /// The line finder on a scan of the front LiDAR.
    LineFindingFront,
    /// The line finder on a scan of the back LiDAR.
    LineFindingBack,
    /// Merging, filter, state machine and controller.
    Control,
    /// The robot's motion.
    Drive,
    /// The observer.
    Observe,
}

impl Part {
    /// All parts, in the order of the loop.
    pub const ALL: [Self; 6] =
        [Self::Scan, Self::LineFindingFront, Self::LineFindingBack, Self::Control, Self::Drive, Self::Observe];

    /// Its kebab-case name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Scan => "scan",
            Self::LineFindingFront => "line-finding-front",
            Self::LineFindingBack => "line-finding-back",
            Self::Control => "control",
            Self::Drive => "drive",
            Self::Observe => "observe",
        }
    }
}

/// Watches a run: times parts, records, may ask to stop. It never feeds back.
pub trait Probe {
    /// A part begins.
    fn begin(&mut self, _part: Part) {}
    /// A part ends.
    fn end(&mut self, _part: Part) {}
    /// The true pose, every 0.05 s of simulated time.
    fn pose(&mut self, _time_s: f64, _world_from_robot: Pose) {}
    /// Asked every 0.25 s of simulated time; true ends the run with [`Outcome::Stopped`].
    fn stop(&mut self) -> bool {
        false
    }
}

impl Probe for () {}

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Outcome {
    /// The end of the last inter-row was reached and no crop plant run over.
    Success,
    /// The end was reached, but crop plants were run over.
    Crushed,
    /// The robot did not know where it was any more.
    Lost,
    /// It was in another inter-row than it should have been.
    WrongRow,
    /// It said that it was done and was not.
    EndedEarly,
    /// It stayed where it was for too long.
    Stuck,
    /// The simulated time ran out.
    Time,
    /// The probe asked for it; there is no result.
    Stopped,
}

impl Outcome {
    /// All outcomes, the good one first.
    pub const ALL: [Self; 8] = [
        Self::Success,
        Self::Crushed,
        Self::Lost,
        Self::WrongRow,
        Self::EndedEarly,
        Self::Stuck,
        Self::Time,
        Self::Stopped,
    ];

    /// Its kebab-case name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::Crushed => "crushed",
            Self::Lost => "lost",
            Self::WrongRow => "wrong-row",
            Self::EndedEarly => "ended-early",
            Self::Stuck => "stuck",
            Self::Time => "time",
            Self::Stopped => "stopped",
        }
    }
}

/// What came out of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct RunResult {
    /// Hash over trajectory, outcome and metrics.
    pub digest: [u8; 32],
    /// How it ended.
    pub outcome: Outcome,
    /// Value by metric; undefined metrics are absent. All finite.
    pub metrics: BTreeMap<&'static str, f64>,
    /// Crop plants that were run over, by index in the field.
    pub damaged: Vec<usize>,
}

/// Runs `scenario` with `seed` to its end.
pub fn simulate(scenario: &Scenario, seed: Seed, probe: &mut impl Probe) -> RunResult {
    let field = scenario.field.build(seed.0);
    let RobotSpec::TwoWheeled(dimensions) = &scenario.robot;
    let mut robot = TwoWheeled::new(dimensions.clone());
    let mut pilot = Pilot::new(scenario, &field, seed);
    let mut observer = Observer::new(&scenario.observer, &scenario.limits, &field, dimensions);
    let mut truth = field.start;
    let mut command = WheelSpeeds::STOP;
    let mut step = 0_u64;
    loop {
        let time_s = step as f64 * STEP_S;
        if step.is_multiple_of(STEPS_PER_SAMPLE) {
            probe.pose(time_s, truth);
            let ended = timed(probe, Part::Observe, || observer.observe(time_s, truth));
            if let Some(outcome) = ended {
                return observer.result(time_s, outcome);
            }
        }
        pilot.sense(&field, truth, &mut observer, probe);
        step += 1;
        if step.is_multiple_of(STEPS_PER_CYCLE) {
            let wanted = timed(probe, Part::Control, || pilot.decide(robot.wheels()));
            if let Step::Drive(wheels) = wanted {
                command = wheels;
            }
            let ended = if probe.stop() { Some(Outcome::Stopped) } else { observer.judge(wanted) };
            if let Some(outcome) = ended {
                return observer.result(time_s, outcome);
            }
        }
        let (moved, motion) = timed(probe, Part::Drive, || robot.drive(truth, command, STEP_S));
        truth = moved;
        pilot.advance(motion);
    }
}

fn timed<T>(probe: &mut impl Probe, part: Part, work: impl FnOnce() -> T) -> T {
    probe.begin(part);
    let result = work();
    probe.end(part);
    result
}

/// Everything on board: sensors, perception and mission.
enum Pilot {
    ByRows { mission: RowByRow, eyes: Vec<Eye> },
    ByHeading { mission: HeadingHold, odometry: Odometry, random: Stream },
}

/// A LiDAR with its own perception.
struct Eye {
    /// Where the LiDAR is.
    robot_from_lidar: RobotFromLidar,
    /// Where the robot believes it to be.
    believed: RobotFromLidar,
    lidar: PlanarLidar,
    noise: Stream,
    perception: Perception,
    random: Stream,
}

impl Pilot {
    fn new(scenario: &Scenario, field: &Field, seed: Seed) -> Self {
        let SensorsSpec::TwoPlanarLidars(sensors) = &scenario.sensors;
        let ControlSpec::Fuzzy(control) = &scenario.control;
        let fuzzy = Fuzzy::new(control.clone());
        match &scenario.mission {
            MissionSpec::RowByRow(params) => {
                let LocalizationSpec::RowFilter(filter) = &scenario.localization;
                let brief = Brief { inter_rows: field.inter_rows };
                let mission = RowByRow::new(params.clone(), brief, RowFilter::new(filter.clone()), fuzzy);
                Self::ByRows { mission, eyes: Eye::both(scenario, sensors, seed) }
            }
            MissionSpec::HeadingHold(params) => {
                let first = field.middles[0].project(field.start.x_m, field.start.y_m);
                let layout = Layout {
                    row_length_m: first.length_m - first.along_m,
                    row_spacing_m: field.row_spacing_m,
                    inter_rows: field.inter_rows,
                };
                let odometry = Odometry::new(sensors.clone());
                let mission = HeadingHold::new(params.clone(), layout, fuzzy);
                Self::ByHeading { mission, odometry, random: Stream::new(seed.0, "odometry") }
            }
        }
    }

    /// Scans from the true pose and finds lines.
    fn sense(&mut self, field: &Field, truth: Pose, observer: &mut Observer<'_>, probe: &mut impl Probe) {
        let Self::ByRows { mission, eyes } = self else { return };
        for eye in eyes {
            let RobotFromLidar { x_m, looks_back } = eye.robot_from_lidar;
            let world_from_lidar = truth.sensor(x_m, looks_back);
            let scan = timed(probe, Part::Scan, || eye.lidar.scan(&field.plants, world_from_lidar, &mut eye.noise));
            let part = if looks_back { Part::LineFindingBack } else { Part::LineFindingFront };
            let found = timed(probe, part, || eye.perception.find(&scan, &mut eye.random, (field, world_from_lidar)));
            if !looks_back {
                observer.count_points(found.points.len());
            }
            timed(probe, Part::Control, || mission.filter_mut().sense(eye.believed, found));
        }
    }

    fn decide(&mut self, wheels: WheelSpeeds) -> Step {
        match self {
            Self::ByRows { mission, .. } => mission.step(wheels),
            Self::ByHeading { mission, odometry, .. } => mission.step(odometry.pose()),
        }
    }

    fn advance(&mut self, motion: crate::robot::two_wheeled::Motion) {
        if let Self::ByHeading { odometry, random, .. } = self {
            odometry.advance(motion, random);
        }
    }
}

impl Eye {
    /// The front and the back one; none where the scenario has no perception.
    fn both(scenario: &Scenario, sensors: &TwoPlanarLidarsParams, seed: Seed) -> Vec<Self> {
        let ends = [
            (RobotFromLidar { x_m: sensors.front_x_m, looks_back: false }, "lidar-front", "line-finder-front"),
            (RobotFromLidar { x_m: sensors.back_x_m, looks_back: true }, "lidar-back", "line-finder-back"),
        ];
        let eye = |(robot_from_lidar, lidar, line_finder): (RobotFromLidar, &str, &str)| {
            let error_m =
                if robot_from_lidar.looks_back { -sensors.mounting_error_m } else { sensors.mounting_error_m };
            Some(Self {
                robot_from_lidar,
                believed: RobotFromLidar { x_m: robot_from_lidar.x_m + error_m, ..robot_from_lidar },
                lidar: PlanarLidar::new(sensors),
                noise: Stream::new(seed.0, lidar),
                perception: Perception::new(&scenario.perception)?,
                random: Stream::new(seed.0, line_finder),
            })
        };
        ends.into_iter().filter_map(eye).collect()
    }
}
