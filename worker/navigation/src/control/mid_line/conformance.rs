//! What every controller along a mid line does.

use super::{MidLine, MidLineControl};
use crate::Pose;
use crate::control::{ControlSpec, Twist};
use crate::parameters::Kinds;
use proptest::prelude::*;
use serde_json::Map;

const DT_S: f64 = 0.1;

/// One of each, with its defaults.
fn controllers() -> Vec<(&'static str, Box<dyn MidLineControl>)> {
    let of = |kind| ControlSpec::read_kind(kind, Map::new()).unwrap().mid_line().map(|control| (kind, control));
    ControlSpec::kinds().into_iter().filter_map(of).collect()
}

fn line(y_m: f64, angle_rad: f64) -> MidLine {
    let (sin, cos) = libm::sincos(angle_rad);
    MidLine { point: [0.0, y_m], direction: [cos, sin] }
}

/// The x axis as the robot sees it.
fn axis(robot: Pose) -> MidLine {
    let (x, y) = robot.local(0.0, 0.0);
    let (sin, cos) = libm::sincos(-robot.heading_rad);
    MidLine { point: [x, y], direction: [cos, sin] }
}

/// The way of a robot that starts `y_m` beside the line, turned by `heading_rad`, and answers with a lag of 0.15 s.
fn way(control: &mut dyn MidLineControl, y_m: f64, heading_rad: f64, seconds: f64) -> Vec<Pose> {
    let mut robot = Pose { x_m: 0.0, y_m, heading_rad };
    let mut twist = Twist::default();
    let steps = 10;
    let kept = libm::exp(-DT_S / f64::from(steps) / 0.15);
    let mut way = vec![robot];
    for _ in 0..(seconds / DT_S) as u32 {
        let command = control.steer(axis(robot), DT_S);
        for _ in 0..steps {
            twist.linear_m_s = command.linear_m_s + kept * (twist.linear_m_s - command.linear_m_s);
            twist.angular_rad_s = command.angular_rad_s + kept * (twist.angular_rad_s - command.angular_rad_s);
            let dt_s = DT_S / f64::from(steps);
            robot = robot.moved(twist.linear_m_s * dt_s, twist.angular_rad_s * dt_s);
        }
        way.push(robot);
    }
    way
}

#[test]
fn there_are_two_of_them() {
    let kinds: Vec<_> = controllers().into_iter().map(|(kind, _)| kind).collect();
    assert_eq!(kinds, ["pid", "io-linearization"]);
}

#[test]
fn a_robot_left_of_the_line_or_turned_to_its_left_turns_right() {
    for (kind, mut control) in controllers() {
        assert!(control.steer(line(-0.2, 0.0), DT_S).angular_rad_s < 0.0, "{kind}");
        control.restart();
        assert!(control.steer(line(0.0, -0.2), DT_S).angular_rad_s < 0.0, "{kind}");
    }
}

#[test]
fn both_settle_on_the_line_from_a_foot_beside_it_and_fifteen_degrees_off() {
    // The PID's integral carries it 4 cm over; the point ahead of the other never crosses the line.
    let overshoot_m = |kind| if kind == "pid" { 0.04 } else { 1e-9 };
    let askew = 15_f64.to_radians();
    for (y_m, heading_rad) in [(0.3, askew), (0.3, -askew), (-0.3, askew), (0.3, 0.0)] {
        for (kind, mut control) in controllers() {
            let way = way(&mut *control, y_m, heading_rad, 60.0);
            let beyond_m = way.iter().map(|pose| -pose.y_m * y_m.signum()).fold(0.0, f64::max);
            assert!(beyond_m < overshoot_m(kind), "{kind} from {y_m} {heading_rad}: {beyond_m}");
            let (soon, last) = (way[60], way[way.len() - 1]);
            assert!(soon.y_m.abs() < 0.05 && soon.heading_rad.abs() < 0.05, "{kind}: {soon:?}");
            assert!(last.y_m.abs() < 2e-3 && last.heading_rad.abs() < 1e-3, "{kind}: {last:?}");
        }
    }
}

#[test]
fn what_is_not_finite_stops_the_robot_and_is_forgotten() {
    for (kind, mut control) in controllers() {
        let lines = [line(0.1, 0.1), line(0.05, 0.1)];
        let expected = lines.map(|line| control.steer(line, DT_S));
        control.restart();
        assert_eq!(control.steer(lines[0], DT_S), expected[0], "{kind}");
        for odd in [f64::NAN, f64::INFINITY, 1e300] {
            for bad in [
                MidLine { point: [0.0, odd], direction: [1.0, 0.0] },
                MidLine { point: [0.0, 0.1], direction: [odd, 0.0] },
                MidLine { point: [0.0, 0.1], direction: [1.0, odd] },
            ] {
                assert_eq!(control.steer(bad, DT_S), Twist::default(), "{kind}: {bad:?}");
            }
        }
        assert_eq!(control.steer(lines[1], DT_S), expected[1], "{kind}");
    }
}

fn odd() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => -3.0..3.0_f64,
        1 => prop_oneof![Just(0.0), Just(f64::NAN), Just(f64::INFINITY), Just(1e300), Just(-1e-300)],
    ]
}

proptest! {
    #[test]
    fn mirrored_lines_get_mirrored_commands(
        lines in proptest::collection::vec((-2.0..2.0, -1.5..1.5), 1..6),
    ) {
        for ((kind, mut control), (_, mut mirrored)) in controllers().into_iter().zip(controllers()) {
            for (y_m, angle_rad) in &lines {
                let twist = control.steer(line(*y_m, *angle_rad), DT_S);
                let other = mirrored.steer(line(-y_m, -angle_rad), DT_S);
                prop_assert_eq!(twist.linear_m_s, other.linear_m_s, "{}", kind);
                prop_assert_eq!(twist.angular_rad_s, -other.angular_rad_s, "{}", kind);
            }
        }
    }

    #[test]
    fn any_line_gets_a_command_within_the_limits(
        lines in proptest::collection::vec(([odd(), odd()], [odd(), odd()], odd()), 1..8),
    ) {
        for (kind, mut control) in controllers() {
            for (point, direction, dt_s) in &lines {
                let twist = control.steer(MidLine { point: *point, direction: *direction }, *dt_s);
                prop_assert!((0.0..=0.8).contains(&twist.linear_m_s), "{}: {:?}", kind, twist);
                prop_assert!(twist.angular_rad_s.abs() <= 0.8, "{}: {:?}", kind, twist);
            }
        }
    }
}
