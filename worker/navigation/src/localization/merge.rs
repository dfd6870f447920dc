//! Merging the lines that both finders gave within one control cycle.

use crate::perception::Line;
use crate::perception::line::same_line;

/// Where a LiDAR sits on the robot: on the x axis, looking forward or back.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobotFromLidar {
    /// Position along the robot's x axis \[m\].
    pub x_m: f64,
    /// Whether it looks back (yaw pi).
    pub looks_back: bool,
}

impl RobotFromLidar {
    /// A point of the LiDAR's frame in the robot's frame \[m\].
    #[must_use]
    pub fn point(&self, x_m: f64, y_m: f64) -> (f64, f64) {
        if self.looks_back { (self.x_m - x_m, -y_m) } else { (self.x_m + x_m, y_m) }
    }

    /// A line of the LiDAR's frame in the robot's frame. The slope is the same, whichever way it looks.
    #[must_use]
    pub fn line(&self, line: Line) -> Line {
        let intercept_m = if self.looks_back { -line.intercept_m } else { line.intercept_m };
        Line::new(line.slope, intercept_m - line.slope * self.x_m)
    }
}

/// Running means of the lines seen since the last [`clear`](Self::clear), in the robot's frame.
#[derive(Debug, Clone, Default)]
pub struct MergedLines {
    lines: Vec<(Line, f64)>,
}

impl MergedLines {
    /// Forgets all lines.
    pub fn clear(&mut self) {
        self.lines.clear();
    }

    /// Takes a line into the mean of every line that is the same, or as a new one if none is.
    pub fn add(&mut self, line: Line) {
        let mut known = false;
        for (mean, n) in &mut self.lines {
            if same_line(*mean, line) {
                *n += 1.0;
                mean.slope += (line.slope - mean.slope) / *n;
                mean.intercept_m += (line.intercept_m - mean.intercept_m) / *n;
                known = true;
            }
        }
        if !known {
            self.lines.push((line, 1.0));
        }
    }

    /// The means, in the order in which they came up.
    pub fn iter(&self) -> impl Iterator<Item = Line> + Clone + '_ {
        self.lines.iter().map(|(line, _)| *line)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn same_lines_become_their_mean_and_others_stay_apart() {
        let mut merged = MergedLines::default();
        for intercept in [0.5, 0.6, -0.5, 0.55] {
            merged.add(Line::new(0.0, intercept));
        }
        let intercepts: Vec<f64> = merged.iter().map(|line| line.intercept_m).collect();
        assert_eq!(intercepts.len(), 2);
        assert!((intercepts[0] - 0.55).abs() < 1e-12 && intercepts[1] == -0.5);
    }

    #[test]
    fn a_line_and_its_points_change_frames_alike() {
        let line = Line::new(0.3, 0.7);
        for lidar in [RobotFromLidar { x_m: 0.5, looks_back: false }, RobotFromLidar { x_m: -0.5, looks_back: true }] {
            let moved = lidar.line(line);
            for x in [0.0, 2.0] {
                let (robot_x, robot_y) = lidar.point(x, line.slope * x + line.intercept_m);
                assert!(moved.distance_m(robot_x, robot_y) < 1e-12);
            }
        }
    }
}
