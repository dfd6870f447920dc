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
    /// The middle between two lines, half a row distance beside one line, by the map without any; none without a map.
    pub(super) fn line(&self, rows: &DetectedRows<'_>) -> Option<MidLine> {
        let mut lines = rows.lines.iter().flatten().filter(|line| self.is_a_row(line));
        match (lines.next(), lines.next()) {
            (Some(a), Some(b)) => mid_line::bisector(*a, *b),
            (Some(line), None) => Some(mid_line::shifted(*line, self.map.row_distance_m)),
            _ => self.by_map(),
        }
    }

    /// The lane's middle in the map; none without localization.
    pub(super) fn by_map(&self) -> Option<MidLine> {
        let robot = self.map_from_robot?;
        let (x, y) = robot.local(robot.x_m, self.map.lane_y_m(self.lane));
        Some(MidLine { point: [x, y], direction: self.travel(robot) })
    }

    /// Whether a line may be a row beside the robot: roughly ahead, and by the map near one of the lane's rows, and along it.
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
