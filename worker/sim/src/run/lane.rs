//! The loop of a robot that follows a lane: Velasquez et al. (2022), figure 1.
//!
//! An operator puts the robot back where it fails; a run ends at the end of the lane.

use furrow_navigation::control::{ControlSpec, LanePd, Twist};
use furrow_navigation::mission::{LaneFollower, LaneParams};
use furrow_navigation::perception::Points;
use furrow_navigation::random::Stream;

use super::{
    Detection, Outcome, Part, Probe, RunResult, STEP_S, STEPS_PER_CYCLE, STEPS_PER_S, STEPS_PER_SAMPLE, Seed, timed,
};
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
        let view = timed(probe, Part::LaneFinding, || perception.find(points, prior, dt_s, random, place));
        probe.scanned(world_from_lidar, &scan, Detection::Lane(view));
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::field::velasquez2022::LaneName;
    use crate::observer::Cause;
    use crate::scenario::tests::lane;
    use crate::simulate as run;
    use furrow_navigation::parameters::ParameterType;
    use serde_json::{Value, json};

    fn scenario(patches: &[(&str, &str, Value)]) -> Scenario {
        let mut value = lane();
        value["field"]["seed"] = json!("job");
        for (part, key, patch) in patches {
            if *key == "kind" {
                value[*part] = json!({"kind": patch});
            } else {
                value[*part][*key] = patch.clone();
            }
        }
        Scenario::from_value(value).unwrap()
    }

    /// Perfect perception; it needs no scans.
    fn oracle(lane: &str) -> Vec<(&'static str, &'static str, Value)> {
        vec![
            ("field", "lane", json!(lane)),
            ("perception", "kind", json!("oracle")),
            ("localization", "kind", json!("view")),
            ("sensors", "beams", json!(2)),
        ]
    }

    #[test]
    fn perfect_perception_drives_every_lane_to_its_end_alone() {
        for lane in LaneName::WORDS {
            for seed in 1..=3 {
                let result = run(&scenario(&oracle(lane)), Seed(seed), &mut ());
                assert_eq!(result.outcome, Outcome::Success, "{lane}, seed {seed}: {:?}", result.interventions);
                assert_eq!(result.metrics["interventions"], 1.0);
                assert!(result.metrics["cross_track_rms_m"] < 0.08, "{lane}: {:?}", result.metrics);
            }
        }
    }

    #[test]
    fn the_same_scenario_and_seed_give_the_same_result_and_another_seed_another() {
        let scenario = scenario(&[("limits", "max_time_s", json!(5.0))]);
        let first = run(&scenario, Seed(1), &mut ());
        assert_eq!(first, run(&scenario, Seed(1), &mut ()));
        assert_ne!(first.digest, run(&scenario, Seed(2), &mut ()).digest);
        assert_eq!((first.outcome, first.metrics["simulated_s"]), (Outcome::Time, 5.0));
        assert!((first.metrics["distance_m"] - 3.4).abs() < 0.1);
    }

    #[test]
    fn a_robot_that_cannot_steer_is_put_back_again_and_again_and_still_reaches_the_end() {
        let patches = [&oracle("lane-h")[..], &[("control", "kp", json!(0.0)), ("control", "kd", json!(0.0))]].concat();
        let result = run(&scenario(&patches), Seed(1), &mut ());
        assert_eq!(result.outcome, Outcome::Intervened);
        assert!(result.metrics["interventions_control"] >= 3.0, "{:?}", result.metrics);
        let causes: f64 = ["end_of_lane", "bad_start", "gap", "perception", "control"]
            .iter()
            .map(|cause| result.metrics[format!("interventions_{cause}").as_str()])
            .sum();
        assert_eq!(causes, result.metrics["interventions"]);
        assert!(result.interventions.windows(2).all(|pair| pair[1].along_m > pair[0].along_m + 0.4));
        assert_eq!(result.interventions.last().unwrap().cause, Cause::EndOfLane);
    }

    #[test]
    fn a_robot_that_does_not_move_is_moved_on() {
        let patches = [
            &oracle("lane-h")[..],
            &[
                ("robot", "lag_s", json!(10.0)),
                ("limits", "max_time_s", json!(60.0)),
                ("observer", "no_progress_m", json!(10.0)),
                ("observer", "no_progress_s", json!(2.0)),
            ],
        ]
        .concat();
        let result = run(&scenario(&patches), Seed(1), &mut ());
        assert!(result.interventions.len() > 10, "{}", result.interventions.len());
    }

    #[test]
    fn a_probe_stops_a_run_and_sees_the_parts_of_a_lane() {
        #[derive(Default)]
        struct Watch(u32, Vec<Part>);
        impl Probe for Watch {
            fn begin(&mut self, part: Part) {
                self.1.push(part);
            }
            fn pose(&mut self, _time_s: f64, _pose: Pose) {
                self.0 += 1;
            }
            fn stop(&mut self) -> bool {
                self.0 >= 20
            }
        }
        let mut watch = Watch::default();
        let result = run(&scenario(&[]), Seed(1), &mut watch);
        assert_eq!((result.outcome, watch.0), (Outcome::Stopped, 21));
        let of_others = [&[Part::LineFindingFront, Part::LineFindingBack][..], &Part::OF_NURSERIES].concat();
        assert!(Part::ALL.iter().all(|part| watch.1.contains(part) != of_others.contains(part)));
    }

    #[test]
    fn slower_scans_mean_slower_control() {
        #[derive(Default)]
        struct Scans(u32);
        impl Probe for Scans {
            fn begin(&mut self, part: Part) {
                self.0 += u32::from(part == Part::Control);
            }
        }
        for (rate_hz, expected) in [(40, 400), (10, 100), (5, 50)] {
            let mut scans = Scans::default();
            let patches = [("sensors", "rate_hz", json!(rate_hz)), ("limits", "max_time_s", json!(10.0))];
            run(&scenario(&patches), Seed(1), &mut scans);
            assert_eq!(scans.0, expected);
        }
    }
}
