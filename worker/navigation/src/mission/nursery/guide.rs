//! Which line to follow in a lane: Vintu (2018), section 3.5.

use super::NurseryParams;
use crate::Pose;
use crate::control::{MidLine, mid_line};
use crate::localization::PlantingMap;
use crate::perception::rows::{DetectedRows, RowLine};

/// What is known of the lane.
pub(super) struct Guide<'a> {
    pub(super) params: &'a NurseryParams,
    pub(super) map: &'a PlantingMap,
    pub(super) lane: u32,
    pub(super) map_from_robot: Option<Pose>,
}

impl Guide<'_> {
    /// The middle between two rows, half a row distance beside one row, by the map without any; none without a map.
    pub(super) fn line(&self, rows: &DetectedRows<'_>) -> Option<MidLine> {
        match self.beside(rows) {
            [Some(left), Some(right)] => mid_line::bisector(left, right),
            [Some(row), None] | [None, Some(row)] => Some(mid_line::shifted(row, self.map.row_distance_m)),
            [None, None] => self.by_map(),
        }
    }

    /// The row to the left of the robot and the row to its right: of several lines on a side the first.
    pub(super) fn beside(&self, rows: &DetectedRows<'_>) -> [Option<RowLine>; 2] {
        let mut beside = [None, None];
        for line in rows.lines.iter().flatten().filter(|line| self.is_a_row(line)) {
            beside[usize::from(line.left_of([0.0, 0.0]) > 0.0)].get_or_insert(*line);
        }
        beside
    }

    /// The lane's middle in the map; none without localization.
    pub(super) fn by_map(&self) -> Option<MidLine> {
        let robot = self.map_from_robot?;
        let (x, y) = robot.local(robot.x_m, self.map.lane_y_m(self.lane));
        Some(MidLine { point: [x, y], direction: self.travel(robot) })
    }

    /// Whether a line may be a row beside the robot: ahead, and by the map near one of the lane's rows, and along it.
    fn is_a_row(&self, line: &RowLine) -> bool {
        if !line.runs_ahead() {
            return false;
        }
        let Some(robot) = self.map_from_robot else { return true };
        let direction = self.travel(robot);
        let sine = direction[0] * line.direction[1] - direction[1] * line.direction[0];
        let is_near = |row: u32| {
            let (x, y) = robot.local(robot.x_m, self.map.row_y_m(row));
            line.left_of([x, y]).abs() <= self.params.line_gate_m
        };
        sine.abs() <= libm::sin(self.params.line_gate_rad) && (is_near(self.lane) || is_near(self.lane + 1))
    }

    /// Unit vector of travel along the lane, in the robot's frame.
    fn travel(&self, robot: Pose) -> [f64; 2] {
        let (sin, cos) = libm::sincos(robot.heading_rad);
        if self.lane.is_multiple_of(2) { [cos, -sin] } else { [-cos, sin] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MAP: PlantingMap = PlantingMap {
        row_distance_m: 1.3,
        planting_distance_m: 0.4,
        rows: 3,
        plants_per_row: 20,
        lanes_to_the_left: true,
    };

    fn middle(lines: [(f64, f64); 2]) -> Option<MidLine> {
        let lines = lines.map(|(y, angle)| RowLine::along([0.0, y], [libm::cos(angle), libm::sin(angle)]));
        let guide = Guide { params: &NurseryParams::default(), map: &MAP, lane: 0, map_from_robot: None };
        guide.line(&DetectedRows { lines, ..DetectedRows::default() })
    }

    #[test]
    fn of_two_lines_on_a_side_the_first_is_the_row() {
        assert!((middle([(0.65, 0.0), (0.4, 0.1)]).unwrap().point[1]).abs() < 1e-12);
        assert!((middle([(-0.4, 0.0), (-0.65, 0.0)]).unwrap().point[1] - 0.25).abs() < 1e-12);
        assert!((middle([(-0.4, 0.0), (0.6, 0.0)]).unwrap().point[1] - 0.1).abs() < 1e-12);
    }

    #[test]
    fn a_line_across_is_no_row() {
        assert!((middle([(0.6, 0.5), (-0.6, 0.0)]).unwrap().point[1] - 0.05).abs() < 1e-12);
        assert_eq!(middle([(0.6, 0.5), (-0.6, -0.5)]), None);
    }
}
