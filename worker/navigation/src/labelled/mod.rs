//! Scans of real lanes in which a person has labelled both rows, and how well perception does on them.
//!
//! The text has one line a scan, `frame;label;points`; a line that is empty or begins with `#` does not count.
//! The frame is the LiDAR's, in whole or broken millimetres, x to the right and y forward. A label has two points on
//! one row and two on the other, `x0,y0,x1,y1,x2,y2,x3,y3`, and is empty where nobody labelled. Points are `x,y`
//! pairs, separated by spaces.

mod evaluation;
mod subject;

pub use evaluation::{Errors, Evaluation, Feed};
pub use subject::Subject;

use crate::perception::{LaneEstimate, Points};

/// One scan.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelledScan {
    /// Its number, as written.
    pub frame: u64,
    /// Where the robot is by the label; none where nobody labelled.
    pub label: Option<LaneEstimate>,
    /// The returns in the robot's frame: x forward, y to the left \[m\].
    pub points: Points,
}

/// A line that is not a scan. The caller shows it and does not go on.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {reason}")]
pub struct LabelledScanError {
    /// Counted from 1.
    pub line: usize,
    /// What is wrong with it.
    pub reason: String,
}

/// Coordinates are within a kilometre \[mm\].
const FARTHEST_MM: f64 = 1e6;

/// Reads all scans of a text.
///
/// # Errors
/// The first line that is not as the head of this module says.
pub fn read(text: &str) -> Result<Vec<LabelledScan>, LabelledScanError> {
    let lines = (1..).zip(text.lines()).filter(|(_, text)| !text.trim().is_empty() && !text.starts_with('#'));
    lines.map(|(line, text)| scan(text).map_err(|reason| LabelledScanError { line, reason })).collect()
}

fn scan(text: &str) -> Result<LabelledScan, String> {
    let fields: Vec<&str> = text.trim_end().split(';').collect();
    let [frame, label, points] = fields[..] else {
        return Err(format!("needs three fields, `frame;label;points`, not {}", fields.len()));
    };
    Ok(LabelledScan {
        frame: frame.trim().parse().map_err(|_| format!("frame: `{}` is not a whole number", frame.trim()))?,
        label: if label.trim().is_empty() {
            None
        } else {
            Some(lane(label).map_err(|error| format!("label: {error}"))?)
        },
        points: returns(points).map_err(|error| format!("points: {error}"))?,
    })
}

fn returns(text: &str) -> Result<Points, String> {
    let mut points = Points::default();
    for pair in text.split_whitespace() {
        let Some((right, forward)) = pair.split_once(',') else { return Err(format!("`{pair}` is no pair `x,y`")) };
        let (x_m, y_m) = robot_from_file(number_mm(right)?, number_mm(forward)?);
        points.push(x_m, y_m);
    }
    Ok(points)
}

fn number_mm(text: &str) -> Result<f64, String> {
    let number = text.trim().parse().ok().filter(|number: &f64| number.abs() <= FARTHEST_MM);
    number.ok_or_else(|| format!("`{}` is no number of millimetres within a kilometre", text.trim()))
}

fn robot_from_file(right_mm: f64, forward_mm: f64) -> (f64, f64) {
    (forward_mm / 1000.0, -right_mm / 1000.0)
}

/// The place that the two labelled rows mean: orthogonal distances, and the mean direction of both.
fn lane(text: &str) -> Result<LaneEstimate, String> {
    let numbers: Vec<f64> = text.split(',').map(number_mm).collect::<Result<_, _>>()?;
    let [x0, y0, x1, y1, x2, y2, x3, y3] = numbers[..] else {
        return Err(format!("needs eight numbers, not {}", numbers.len()));
    };
    let first = row(robot_from_file(x0, y0), robot_from_file(x1, y1))?;
    let second = row(robot_from_file(x2, y2), robot_from_file(x3, y3))?;
    let (left_m, right_m) = (first.1.max(second.1), -first.1.min(second.1));
    if left_m + right_m <= 0.0 {
        return Err("both rows are equally far to the left".to_owned());
    }
    Ok(LaneEstimate { left_m, right_m, heading_rad: -0.5 * (first.0 + second.0) })
}

/// Direction of the row through two points, within a right angle of straight ahead \[rad\], and its distance, positive
/// to the left \[m\].
fn row(from: (f64, f64), to: (f64, f64)) -> Result<(f64, f64), String> {
    let (dx, dy) = if to.0 >= from.0 { (to.0 - from.0, to.1 - from.1) } else { (from.0 - to.0, from.1 - to.1) };
    let length = libm::hypot(dx, dy);
    if length <= 0.0 {
        return Err("both points of a row are the same".to_owned());
    }
    Ok((libm::atan2(dy, dx), (from.1 * dx - from.0 * dy) / length))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn refused(line: &str) -> String {
        read(&format!("# a scan\n{line}\n")).unwrap_err().to_string()
    }

    #[test]
    fn a_scan_is_read_into_the_robots_frame() {
        let scans = read("# frame;label;points\n\n7;-300,0,-300,1000,400,1000,400,0;500,2000 -1.5,0\n8;;\n").unwrap();
        assert_eq!(scans.len(), 2);
        assert_eq!(scans[0].frame, 7);
        assert_eq!(scans[0].label, Some(LaneEstimate { left_m: 0.3, right_m: 0.4, heading_rad: 0.0 }));
        assert_eq!(scans[0].points, Points { x_m: vec![2.0, 0.0], y_m: vec![-0.5, 0.0015] });
        assert_eq!((scans[1].label, scans[1].points.len()), (None, 0));
    }

    #[test]
    fn rows_that_run_off_to_the_right_mean_a_robot_turned_left() {
        let scans = read("1;-300,0,-100,1000,400,0,600,1000;").unwrap();
        let lane = scans[0].label.unwrap();
        assert!((lane.heading_rad - 0.2_f64.atan()).abs() < 1e-12);
        assert!((lane.width_m() - 0.7 * lane.heading_rad.cos()).abs() < 1e-12);
        assert!((lane.cross_track_m() - 0.05 * lane.heading_rad.cos()).abs() < 1e-12);
    }

    #[test]
    fn rows_may_be_labelled_in_either_order() {
        let scans = read("1;-300,0,-100,1000,400,0,600,1000;\n2;400,0,600,1000,-100,1000,-300,0;").unwrap();
        assert_eq!(scans[0].label, scans[1].label);
    }

    #[test]
    fn a_bad_line_is_named_with_its_number() {
        assert_eq!(refused("1;2"), "line 2: needs three fields, `frame;label;points`, not 2");
        assert_eq!(refused("x;;"), "line 2: frame: `x` is not a whole number");
        assert_eq!(refused("1;1,2;"), "line 2: label: needs eight numbers, not 2");
        assert_eq!(refused("1;;3"), "line 2: points: `3` is no pair `x,y`");
        assert_eq!(refused("1;;3,nan"), "line 2: points: `nan` is no number of millimetres within a kilometre");
        assert!(refused("1;1,0,1,0,2,0,2,1;").contains("both points of a row are the same"));
        assert!(refused("1;1,0,1,1,1,0,1,1;").contains("both rows are equally far"));
    }

    proptest! {
        #[test]
        fn no_text_makes_it_panic(text in "[0-9;, .e#n\n-]{0,80}") {
            for scan in read(&text).unwrap_or_default() {
                prop_assert!(scan.points.iter().all(|(x, y)| x.is_finite() && y.is_finite()));
            }
        }
    }
}
