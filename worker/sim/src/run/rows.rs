//! The loop of a robot that drives from inter-row to inter-row: Guyonneau et al. (2022).

use furrow_navigation::control::{ControlSpec, Fuzzy, WheelSpeeds};
use furrow_navigation::localization::merge::RobotFromLidar;
use furrow_navigation::localization::{LocalizationSpec as OnBoard, RowFilter};
use furrow_navigation::mission::{Brief, RowByRow, Step};
use furrow_navigation::random::Stream;

use super::{Detection, Outcome, Part, Probe, RunResult, STEP_S, STEPS_PER_CYCLE, STEPS_PER_SAMPLE, Seed, timed};
use crate::field::Field;
use crate::lidar::{PlanarLidar, SensorsSpec, TwoPlanarLidarsParams};
use crate::localization::LocalizationSpec;
use crate::mission::{HeadingHold, Layout, MissionSpec};
use crate::observer::Observer;
use crate::odometry::Odometry;
use crate::perception::Perception;
use crate::robot::{Motion, RobotSpec, TwoWheeled};
use crate::{Pose, Scenario};

/// Runs `scenario` with `seed` to its end.
pub(super) fn simulate(scenario: &Scenario, seed: Seed, probe: &mut impl Probe) -> RunResult {
    let field = scenario.field.build(seed.0);
    let RobotSpec::TwoWheeled(dimensions) = &scenario.robot else { unreachable!("a scenario is checked") };
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
        let SensorsSpec::TwoPlanarLidars(sensors) = &scenario.sensors else { unreachable!("a scenario is checked") };
        let ControlSpec::Fuzzy(control) = &scenario.control else { unreachable!("a scenario is checked") };
        let fuzzy = Fuzzy::new(control.clone());
        match &scenario.mission {
            MissionSpec::RowByRow(params) => {
                let LocalizationSpec::OnBoard(OnBoard::RowFilter(filter)) = &scenario.localization else {
                    unreachable!("a scenario is checked")
                };
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
                let odometry = Odometry::new(sensors.odometry_noise());
                let mission = HeadingHold::new(params.clone(), layout, fuzzy);
                Self::ByHeading { mission, odometry, random: Stream::new(seed.0, "odometry") }
            }
            MissionSpec::Lane(_) | MissionSpec::Nursery(_) => unreachable!("it has a loop of its own"),
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
            probe.scanned(world_from_lidar, &scan, Detection::Lines(found));
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

    fn advance(&mut self, motion: Motion) {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::tests::base;
    use serde_json::{Value, json};

    fn scenario(patches: &[(&str, Value)]) -> Scenario {
        let mut value = base();
        for (part, patch) in patches {
            value[*part] = patch.clone();
        }
        Scenario::from_value(value).unwrap()
    }

    fn short(max_time_s: f64) -> (&'static str, Value) {
        ("limits", json!({"kind": "simulated-time", "max_time_s": max_time_s}))
    }

    #[test]
    fn the_same_scenario_and_seed_give_the_same_result_and_another_seed_another() {
        let scenario = scenario(&[short(5.0)]);
        let first = simulate(&scenario, Seed(1), &mut ());
        assert_eq!(first, simulate(&scenario, Seed(1), &mut ()));
        assert_ne!(first.digest, simulate(&scenario, Seed(2), &mut ()).digest);
        assert_eq!((first.outcome, first.metrics["simulated_s"]), (Outcome::Time, 5.0));
    }

    #[test]
    fn a_field_without_plants_is_an_outcome() {
        let field = json!({
            "kind": "custom", "name": "bare", "row_spacing_m": 1.0, "plants": [], "inter_rows": 1,
            "rows": [{"points_m": [[0.0, -0.5], [5.0, -0.5]]}, {"points_m": [[0.0, 0.5], [5.0, 0.5]]}],
            "start": {"x_m": 0.0, "y_m": 0.0, "heading_rad": 0.0}
        });
        let result = simulate(&scenario(&[("field", field)]), Seed(1), &mut ());
        assert_eq!(result.outcome, Outcome::Stuck);
        assert_eq!(result.metrics["points_processed"], 0.0);
        assert!(!result.metrics.contains_key("closest_plant_m"));
    }

    #[test]
    fn the_oracle_succeeds_in_every_crop() {
        for crop in 1..=4 {
            let field = json!({"kind": "guyonneau2022", "crop": crop, "seed": "job"});
            let result =
                simulate(&scenario(&[("field", field), ("perception", json!({"kind": "oracle"}))]), Seed(3), &mut ());
            assert_eq!(result.outcome, Outcome::Success, "crop {crop}: {result:?}");
        }
    }

    #[test]
    fn an_oracle_follows_curved_rows() {
        let arc = |radius: f64| -> Vec<[f64; 2]> {
            (0..=20)
                .map(|i| 0.03 * f64::from(i))
                .map(|a| [radius * libm::sin(a), 20.0 - radius * libm::cos(a)])
                .collect()
        };
        let rows: Vec<_> = [20.5, 19.5].iter().map(|radius| json!({"points_m": arc(*radius)})).collect();
        let stem = |radius: f64, row: u32| {
            move |i: u32| {
                let (sin, cos) = libm::sincos(0.01 * f64::from(i));
                json!({"x_m": radius * sin, "y_m": 20.0 - radius * cos, "radius_m": 0.02, "height_m": 1.0, "kind": "crop", "row": row})
            }
        };
        let plants: Vec<_> = (0..=60).flat_map(|i| [stem(20.5, 0)(i), stem(19.5, 1)(i)]).collect();
        let field = json!({
            "kind": "custom", "name": "curve", "row_spacing_m": 1.0, "rows": rows, "plants": plants, "inter_rows": 1,
            "start": {"x_m": 0.0, "y_m": 0.0, "heading_rad": 0.0}
        });
        let result =
            simulate(&scenario(&[("field", field), ("perception", json!({"kind": "oracle"}))]), Seed(1), &mut ());
        assert_eq!(result.outcome, Outcome::Success, "{result:?}");
        assert!(result.metrics["mean_squared_error_mm2"] < 50.0_f64.powi(2));
    }

    #[test]
    fn a_probe_stops_a_run_and_sees_twenty_poses_a_second() {
        #[derive(Default)]
        struct Watch {
            poses: u32,
            parts: Vec<Part>,
        }
        impl Probe for Watch {
            fn begin(&mut self, part: Part) {
                self.parts.push(part);
            }
            fn pose(&mut self, _time_s: f64, _pose: Pose) {
                self.poses += 1;
            }
            fn stop(&mut self) -> bool {
                self.poses >= 20
            }
        }
        let mut watch = Watch::default();
        let result = simulate(&scenario(&[]), Seed(1), &mut watch);
        assert_eq!((result.outcome, watch.poses), (Outcome::Stopped, 20));
        let of_lanes = [Part::LaneFinding, Part::LanePrediction, Part::LaneCorrection];
        let of_others = [&of_lanes[..], &Part::OF_NURSERIES].concat();
        assert!(Part::ALL.iter().all(|part| watch.parts.contains(part) != of_others.contains(part)));
    }
}
