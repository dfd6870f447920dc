//! The loop of a robot with a 3D LiDAR that drives through all lanes of a nursery: Vintu (2018), figure 3.3.

use furrow_navigation::control::Twist;
use furrow_navigation::mission::{NurseryMission, NurseryParams, NurserySight, NurseryStep};
use furrow_navigation::random::Stream;

use super::{
    InSpace, Outcome, Part, Probe, RunResult, STEP_S, STEPS_PER_CYCLE, STEPS_PER_S, STEPS_PER_SAMPLE, Seed, timed,
};
use crate::field::{Field, Nursery, vintu2018};
use crate::lidar::fx10::RATE_HZ;
use crate::lidar::{Fx10, Fx10Params, SensorsSpec};
use crate::localization::InMap;
use crate::observer::{NurseryObserver, ObserverSpec};
use crate::odometry::Odometry;
use crate::perception::RowPerception;
use crate::robot::{Motion, RobotSpec, SkidSteer, Tracked};
use crate::{Pose, Scenario};

/// Steps from scan to scan.
const STEPS_PER_SCAN: u64 = (STEPS_PER_S / RATE_HZ) as u64;
/// From scan to scan \[s\].
const SCAN_S: f64 = 1.0 / RATE_HZ as f64;

/// Runs `scenario` with `seed` to its end.
pub(super) fn simulate(scenario: &Scenario, params: &NurseryParams, seed: Seed, probe: &mut impl Probe) -> RunResult {
    let field = scenario.field.build(seed.0);
    let nursery = field.nursery.as_ref().expect("a scenario is checked: the field is a nursery");
    let (SensorsSpec::Fx10(sensors), ObserverSpec::Nursery(watched)) = (&scenario.sensors, &scenario.observer) else {
        unreachable!("a scenario is checked")
    };
    // Else the same wheel would slip at the same turn in all of a plan's fields.
    let seed = Seed(vintu2018::seed_in(nursery.number, seed.0));
    let mut robot = Robot::new(&scenario.robot);
    let mut observer = NurseryObserver::new(watched, &scenario.limits, (&field, nursery), robot.body());
    let mut pilot = Pilot::new(scenario, params, sensors, (&field, nursery), seed);
    let (mut truth, mut command) = (field.start, Twist::default());
    let mut step = 0_u64;
    loop {
        let time_s = step as f64 * STEP_S;
        if step.is_multiple_of(STEPS_PER_SAMPLE) {
            probe.pose(time_s, truth);
            if let Some(outcome) = timed(probe, Part::Observe, || observer.observe(time_s, truth)) {
                return observer.result(time_s, outcome);
            }
        }
        if step.is_multiple_of(STEPS_PER_CYCLE) && probe.stop() {
            return observer.result(time_s, Outcome::Stopped);
        }
        if step.is_multiple_of(STEPS_PER_SCAN) {
            let wanted = pilot.step(nursery, truth, &mut observer, probe);
            if let NurseryStep::Drive(twist) = wanted {
                command = twist;
            }
            if let Some(outcome) = observer.judge(wanted) {
                return observer.result(time_s, outcome);
            }
        }
        let (moved, motion) = timed(probe, Part::Drive, || robot.drive(truth, command, nursery));
        truth = moved;
        pilot.odometry.advance(motion, &mut pilot.odometry_noise);
        step += 1;
    }
}

/// A robot on the ground of a nursery.
enum Robot {
    Tracked(Tracked),
    SkidSteer(SkidSteer),
}

impl Robot {
    fn new(spec: &RobotSpec) -> Self {
        match spec {
            RobotSpec::Tracked(params) => Self::Tracked(Tracked::new(params.clone())),
            RobotSpec::SkidSteer(params) => Self::SkidSteer(SkidSteer::new(params.clone())),
            RobotSpec::TwoWheeled(_) => unreachable!("a scenario is checked"),
        }
    }

    /// Length and width \[m\].
    fn body(&self) -> [f64; 2] {
        match self {
            Self::Tracked(robot) => [robot.params().body_length_m, robot.params().body_width_m],
            Self::SkidSteer(robot) => [robot.params().body_length_m, robot.params().body_width_m],
        }
    }

    fn drive(&mut self, truth: Pose, command: Twist, nursery: &Nursery) -> (Pose, Motion) {
        match self {
            Self::Tracked(robot) => robot.drive(truth, command, nursery.terrain.ground(truth).roll_rad, STEP_S),
            Self::SkidSteer(robot) => robot.drive(truth, command, Default::default(), STEP_S),
        }
    }
}

/// Everything on board.
struct Pilot {
    lidar: Fx10,
    lidar_noise: Stream,
    odometry: Odometry,
    odometry_noise: Stream,
    perception: RowPerception,
    in_map: InMap,
    mission: NurseryMission,
    /// Where the last scan was taken.
    scanned_at: Pose,
}

impl Pilot {
    fn new(
        scenario: &Scenario,
        params: &NurseryParams,
        sensors: &Fx10Params,
        (field, nursery): (&Field, &Nursery),
        seed: Seed,
    ) -> Self {
        let control = scenario.control.mid_line().expect("a scenario is checked");
        let view = (sensors.lidar_x_m, 0.5 * sensors.field_of_view_rad);
        let mission = NurseryMission::new(params.clone(), nursery.map, view, control);
        Self {
            lidar: Fx10::new(sensors),
            lidar_noise: Stream::new(seed.0, "lidar"),
            odometry: Odometry::new(sensors.odometry_noise()),
            odometry_noise: Stream::new(seed.0, "odometry"),
            perception: RowPerception::new(&scenario.perception, sensors, &nursery.map, mission.end_m(), seed),
            in_map: InMap::new(&scenario.localization, nursery.map, believed_start(field.start, sensors, seed)),
            mission,
            scanned_at: field.start,
        }
    }

    /// One scan: perception, localization, mission.
    fn step(
        &mut self,
        nursery: &Nursery,
        truth: Pose,
        observer: &mut NurseryObserver<'_>,
        probe: &mut impl Probe,
    ) -> NurseryStep {
        let odometry_from_robot = self.odometry.pose();
        let before = std::mem::replace(&mut self.scanned_at, truth);
        let (rows, points_ahead) = match &mut self.perception {
            RowPerception::Oracle(oracle) => oracle.see(truth),
            RowPerception::Detector(detector) => {
                let (lidar, noise) = (&mut self.lidar, &mut self.lidar_noise);
                let cloud = timed(probe, Part::Scan, || lidar.scan(nursery, truth, before, noise));
                timed(probe, Part::Filtering, || detector.front_end.filter(cloud.points));
                timed(probe, Part::GroundDetection, || detector.find_ground());
                let (plants, rows) = timed(probe, Part::RowDetection, || detector.detect(odometry_from_robot));
                probe.scanned_in_space(truth, &InSpace { cloud, plants, rows });
                (rows, self.mission.points_ahead(plants))
            }
        };
        let in_map = &mut self.in_map;
        let map_from_robot = timed(probe, Part::Localization, || in_map.locate(odometry_from_robot, &rows, truth));
        if let Some(pose) = map_from_robot {
            timed(probe, Part::Observe, || observer.hear(pose, truth));
        }
        if let Some(node) = self.in_map.new_node() {
            probe.located(&node);
        }
        let sight = NurserySight { rows, points_ahead, odometry_from_robot, map_from_robot };
        timed(probe, Part::Control, || self.mission.step(&sight, SCAN_S))
    }
}

/// Where the robot believes to start.
fn believed_start(start: Pose, sensors: &Fx10Params, seed: Seed) -> Pose {
    let mut random = Stream::new(seed.0, "start");
    let [x_m, y_m] = [start.x_m, start.y_m].map(|value| value + sensors.start_position_sd_m * random.normal());
    Pose { x_m, y_m, heading_rad: start.heading_rad + sensors.start_heading_sd_rad * random.normal() }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;
    use crate::scenario::tests::nursery;
    use crate::simulate as run;
    use serde_json::{Value, json};

    fn scenario(patches: &[(&str, Value)]) -> Scenario {
        let mut value = nursery();
        for (part, patch) in patches {
            value[*part] = patch.clone();
        }
        Scenario::from_value(value).unwrap()
    }

    fn field(nursery: u32) -> (&'static str, Value) {
        ("field", json!({"kind": "vintu2018", "nursery": nursery}))
    }

    /// Perfect perception and localization.
    fn oracles() -> [(&'static str, Value); 2] {
        [("perception", json!({"kind": "oracle"})), ("localization", json!({"kind": "oracle"}))]
    }

    #[test]
    fn with_perfect_perception_and_localization_every_lane_is_covered_whole() {
        for nursery in (0..100).step_by(7) {
            let [perception, localization] = oracles();
            let result = run(&scenario(&[field(nursery), perception, localization]), Seed(1), &mut ());
            assert_eq!(result.outcome, Outcome::Success, "nursery {nursery}: {:?}", result.metrics);
            assert_eq!(result.metrics["covered_rows_percent"], 100.0);
            assert!(result.metrics["trajectory_error_p99_m"] < 0.1, "{:?}", result.metrics);
        }
    }

    #[test]
    fn the_same_scenario_and_seed_give_the_same_result_and_another_seed_another() {
        let scenario = scenario(&[("limits", json!({"kind": "simulated-time", "max_time_s": 8.0}))]);
        let first = run(&scenario, Seed(1), &mut ());
        assert_eq!(first, run(&scenario, Seed(1), &mut ()));
        assert_ne!(first.digest, run(&scenario, Seed(2), &mut ()).digest);
    }

    /// Odd fields and sensors, with every detector.
    #[test]
    fn whatever_the_field_or_the_sensor_a_run_ends_with_an_outcome() {
        let fields = [
            json!({"kind": "vintu2018", "missing_share": 1.0, "weed_factor": 0.0}),
            json!({"kind": "vintu2018", "rows": 1}),
            json!({"kind": "vintu2018", "rows": 2, "plants_per_row": 1}),
            json!({"kind": "vintu2018", "nursery": 99, "rows": 2, "leaf_factor": 10.0}),
        ];
        let blind = json!({"kind": "fx10", "range_min_m": 0.3, "range_max_m": 0.31});
        let sensors = [json!({"kind": "fx10"}), blind, json!({"kind": "fx10", "pattern": "lissajous"})];
        let limits = ("limits", json!({"kind": "simulated-time", "max_time_s": 3.0}));
        for field in &fields {
            for sensors in &sensors {
                for kind in ["pcl-lines", "parallel-lines-ransac", "centroid-lines", "map-lines", "oracle"] {
                    let patches = [
                        ("field", field.clone()),
                        ("sensors", sensors.clone()),
                        ("perception", json!({"kind": kind})),
                        limits.clone(),
                    ];
                    let result = run(&scenario(&patches), Seed(1), &mut ());
                    assert!(result.metrics.values().all(|value| value.is_finite()), "{kind}: {result:?}");
                }
            }
        }
    }

    #[test]
    fn headings_beyond_half_a_turn_are_believed() {
        let start = Pose { x_m: -1.0, y_m: 0.0, heading_rad: 3.0 * PI };
        let believed = believed_start(
            start,
            &Fx10Params { start_position_sd_m: 0.0, start_heading_sd_rad: 0.0, ..Default::default() },
            Seed(1),
        );
        assert_eq!(believed, start);
    }
}
