//! The loop of a robot that follows a lane: Velasquez et al. (2022), figure 1.
//!
//! An operator puts the robot back where it fails; a run ends at the end of the lane.

use furrow_navigation::control::{ControlSpec, LanePd, Twist};
use furrow_navigation::mission::{LaneFollower, LaneParams};
use furrow_navigation::perception::Points;
use furrow_navigation::random::Stream;

use super::{Outcome, Part, Probe, RunResult, STEP_S, STEPS_PER_CYCLE, STEPS_PER_S, STEPS_PER_SAMPLE, Seed, timed};
use crate::field::{Field, FieldSpec, Lane};
use crate::lidar::{OnePlanarLidarParams, SensorsSpec, TiltedLidar};
use crate::motion_sensors::MotionSensors;
use crate::observer::operator::{Heard, Verdict};
use crate::observer::{ObserverSpec, Operator};
use crate::perception::LanePerception;
use crate::robot::{RobotSpec, SkidSteer};
use crate::{Pose, Scenario};

/// Runs `scenario`, and where gaps may be to blame once more with the gaps filled.
pub(super) fn simulate(scenario: &Scenario, params: &LaneParams, seed: Seed, probe: &mut impl Probe) -> RunResult {
    let field = scenario.field.build(seed.0);
    let (outcome, mut operator) = follow(scenario, params, &field, seed, probe);
    if outcome != Outcome::Stopped && operator.suspects_gaps() {
        let filled = filled(&scenario.field).build(seed.0);
        let (without, other) = follow(scenario, params, &filled, seed, &mut StopOnly(probe));
        if without == Outcome::Stopped {
            return operator.result(without);
        }
        operator.blame_gaps(&other);
    }
    operator.result(outcome)
}

/// The same lane with its gaps filled.
fn filled(field: &FieldSpec) -> FieldSpec {
    let mut field = field.clone();
    if let FieldSpec::Velasquez2022(params) = &mut field {
        params.gap_factor = 0.0;
    }
    field
}

/// Asks to stop for a run of which nothing else is to be seen.
struct StopOnly<'a, P: Probe>(&'a mut P);

impl<P: Probe> Probe for StopOnly<'_, P> {
    fn stop(&mut self) -> bool {
        self.0.stop()
    }
}

/// The loop: how it ended, and what the operator saw.
fn follow<'a>(
    scenario: &'a Scenario,
    params: &LaneParams,
    field: &'a Field,
    seed: Seed,
    probe: &mut impl Probe,
) -> (Outcome, Operator<'a>) {
    let (SensorsSpec::OnePlanarLidar(sensors), RobotSpec::SkidSteer(dimensions)) = (&scenario.sensors, &scenario.robot)
    else {
        unreachable!("a scenario is checked")
    };
    let ObserverSpec::Operator(observer) = &scenario.observer else { unreachable!("a scenario is checked") };
    let lane = field.lane.as_ref().expect("a scenario is checked: the field is a lane");
    let mut robot = SkidSteer::new(dimensions.clone());
    let mut operator = Operator::new(observer, &scenario.limits, (field, lane), dimensions, sensors.lidar_x_m);
    let mut pilot = Pilot::new(scenario, params, sensors, seed);
    let steps_per_scan = u64::from(STEPS_PER_S / sensors.rate_hz.max(1)).max(1);
    let mut truth = field.start;
    let mut command = Twist::default();
    let mut step = 0_u64;
    loop {
        let time_s = step as f64 * STEP_S;
        if step.is_multiple_of(STEPS_PER_SAMPLE) {
            probe.pose(time_s, truth);
            match timed(probe, Part::Observe, || operator.observe(time_s, truth)) {
                Verdict::DriveOn => {}
                Verdict::PutBack(pose) => {
                    truth = pose;
                    command = Twist::default();
                    robot.stop();
                    pilot.restart();
                }
                Verdict::Ended(outcome) => return (outcome, operator),
            }
        }
        if step.is_multiple_of(STEPS_PER_CYCLE) && probe.stop() {
            return (Outcome::Stopped, operator);
        }
        if step.is_multiple_of(steps_per_scan) {
            command = pilot.step((field, lane), truth, time_s, &mut operator, probe);
        }
        let ground = lane.ground(operator.along_m());
        let (moved, motion) = timed(probe, Part::Drive, || robot.drive(truth, command, ground, STEP_S));
        truth = moved;
        pilot.motion.measure(motion, STEP_S, &mut pilot.motion_noise);
        step += 1;
    }
}

/// Everything on board.
struct Pilot {
    lidar_x_m: f64,
    lidar: TiltedLidar,
    lidar_noise: Stream,
    motion: MotionSensors,
    motion_noise: Stream,
    perception: LanePerception,
    perception_random: Stream,
    follower: LaneFollower,
    estimator_random: Stream,
    points: Points,
}

impl Pilot {
    fn new(scenario: &Scenario, params: &LaneParams, sensors: &OnePlanarLidarParams, seed: Seed) -> Self {
        let ControlSpec::LanePd(control) = &scenario.control else { unreachable!("a scenario is checked") };
        let estimator = scenario.localization.lane_estimator(params.lane_width_m).expect("a scenario is checked");
        Self {
            lidar_x_m: sensors.lidar_x_m,
            lidar: TiltedLidar::new(sensors),
            lidar_noise: Stream::new(seed.0, "lidar-front"),
            motion: MotionSensors::new(sensors),
            motion_noise: Stream::new(seed.0, "motion-sensors"),
            perception: LanePerception::new(&scenario.perception, params.lane_width_m).expect("a scenario is checked"),
            perception_random: Stream::new(seed.0, "lane-finder"),
            follower: LaneFollower::new(params.clone(), estimator, LanePd::new(control)),
            estimator_random: Stream::new(seed.0, "lane-estimator"),
            points: Points::default(),
        }
    }

    /// One scan: perception, filter, control.
    fn step(
        &mut self,
        lane: (&Field, &Lane),
        truth: Pose,
        time_s: f64,
        operator: &mut Operator<'_>,
        probe: &mut impl Probe,
    ) -> Twist {
        let world_from_lidar = truth.sensor(self.lidar_x_m, false);
        let ground = lane.1.ground(operator.along_m());
        let (along_m, noise) = (operator.along_m(), &mut self.lidar_noise);
        let (scan, from_stem) =
            timed(probe, Part::Scan, || self.lidar.scan(lane, world_from_lidar, along_m, ground, noise));
        self.points.read_scan(&scan);
        let place = operator.place(truth);
        let (points, follower) = (&self.points, &mut self.follower);
        let (twist, dt_s) = self.motion.take();
        let prior = timed(probe, Part::LanePrediction, || follower.predict(twist, dt_s));
        let (perception, random) = (&mut self.perception, &mut self.perception_random);
        let view = timed(probe, Part::LaneFinding, || perception.find(points, prior, random, place));
        let random = &mut self.estimator_random;
        let estimate = timed(probe, Part::LaneCorrection, || follower.correct(points, view, random));
        timed(probe, Part::Observe, || operator.hear(&Heard { time_s, place, view, estimate, scan, from_stem }));
        timed(probe, Part::Control, || follower.steer(dt_s))
    }

    fn restart(&mut self) {
        self.motion.forget();
        self.perception.restart(self.follower.restart());
    }
}
