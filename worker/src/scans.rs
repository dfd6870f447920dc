//! Scans of a run and what was found in them, four times a second and thinned: enough to show them to people.

use furrow_navigation::perception::cloud::Point3;
use furrow_navigation::perception::rows::RowLine;
use furrow_sim::{Detection, InSpace, LocatedNode, Part, Pose, Probe, Scan};

use crate::trajectory::Recorder;

/// From one kept scan to the next at least \[s\]: the control cycle of Guyonneau et al. (2022).
const EVERY_S: f64 = 0.25;
/// Times are sums of steps.
const ROUNDING_S: f64 = 1e-6;
/// Returns kept of a scan at most.
const POINTS: usize = 90;
/// Lines kept of a scan at most.
const LINES: usize = 16;
/// A run has at most this many kept: two LiDARs for an hour.
const MAX_SCANS: usize = 28_800;
/// Nodes of a graph of poses kept of a run at most: 25 km.
const MAX_NODES: usize = 100_000;
/// Lines are shown up to here ahead of the LiDAR \[m\].
const AHEAD_M: f64 = 3.0;
const UNITS_PER_M: f64 = 100.0;

/// One scan of one LiDAR, seen from above. Points and lines are in the LiDAR's frame, in centimetres; of a 3D LiDAR the points are those above
/// the ground, and the frame is the robot's.
#[derive(Debug, Clone, PartialEq)]
pub struct ThinnedScan {
    /// When \[s\].
    pub time_s: f64,
    /// Where the LiDAR truly was.
    pub world_from_lidar: Pose,
    /// Returns (x, y), evenly taken from all of them.
    pub points_cm: Vec<[i16; 2]>,
    /// What was found: rows from (x, y) to (x, y).
    pub lines_cm: Vec<[i16; 4]>,
}

/// Records a run's path and thinned scans.
#[derive(Debug, Clone, Default)]
pub(crate) struct ScanRecorder {
    pub(crate) path: Recorder,
    pub(crate) scans: Vec<ThinnedScan>,
    pub(crate) nodes: Vec<LocatedNode>,
    time_s: f64,
    taken_s: Option<f64>,
}

impl ScanRecorder {
    fn is_due(&self) -> bool {
        self.taken_s.is_none_or(|taken_s| self.time_s - taken_s > EVERY_S - ROUNDING_S)
    }
}

impl Probe for ScanRecorder {
    fn pose(&mut self, time_s: f64, world_from_robot: Pose) {
        self.time_s = time_s;
        self.path.pose(time_s, world_from_robot);
    }

    fn scanned(&mut self, world_from_lidar: Pose, scan: &Scan<'_>, found: Detection<'_>) {
        if self.is_due() && self.scans.len() < MAX_SCANS {
            let (points_cm, lines_cm) = (thinned(scan), lines(found));
            self.scans.push(ThinnedScan { time_s: self.time_s, world_from_lidar, points_cm, lines_cm });
        }
    }

    fn scanned_in_space(&mut self, world_from_robot: Pose, sight: &InSpace<'_>) {
        if self.is_due() && self.scans.len() < MAX_SCANS {
            let every = sight.plants.len().div_ceil(POINTS).max(1);
            let seen = |point: &Point3| [centimetres(point.x), centimetres(point.y)];
            let points_cm = sight.plants.iter().step_by(every).map(seen).collect();
            let piece = |line: &RowLine| {
                let [[x0, y0], [x1, y1]] = line.piece(AHEAD_M);
                [x0, y0, x1, y1].map(centimetres)
            };
            let lines_cm = sight.rows.lines.iter().flatten().map(piece).collect();
            self.scans.push(ThinnedScan {
                time_s: self.time_s,
                world_from_lidar: world_from_robot,
                points_cm,
                lines_cm,
            });
        }
    }

    fn located(&mut self, node: &LocatedNode) {
        if self.nodes.len() < MAX_NODES {
            self.nodes.push(node.clone());
        }
    }

    /// The robot drives on when all its LiDARs have looked.
    fn begin(&mut self, part: Part) {
        let looked = self.scans.last().is_some_and(|last| last.time_s >= self.time_s);
        if part == Part::Drive && looked && self.is_due() {
            self.taken_s = Some(self.time_s);
        }
    }
}

fn centimetres(metres: f64) -> i16 {
    (metres * UNITS_PER_M).round() as i16
}

fn thinned(scan: &Scan<'_>) -> Vec<[i16; 2]> {
    let farthest_m = f64::from(i16::MAX) / UNITS_PER_M;
    let is_return = |range: &f64| *range > 0.0 && *range < farthest_m;
    let returns = scan.ranges_m.iter().filter(|range| is_return(range)).count();
    let every = returns.div_ceil(POINTS).max(1);
    let beams = scan.ranges_m.iter().zip(scan.beams.cos.iter().zip(&scan.beams.sin));
    beams
        .filter(|(range, _)| is_return(range))
        .step_by(every)
        .map(|(range, (cos, sin))| [centimetres(range * cos), centimetres(range * sin)])
        .collect()
}

fn lines(found: Detection<'_>) -> Vec<[i16; 4]> {
    match found {
        Detection::Lines(found) => {
            let segment = |slope: f64, intercept_m: f64| [0.0, intercept_m, AHEAD_M, slope * AHEAD_M + intercept_m];
            found.lines.iter().take(LINES).map(|line| segment(line.slope, line.intercept_m).map(centimetres)).collect()
        }
        Detection::Lane(view) => {
            let (sin, cos) = (-view.heading_rad).sin_cos();
            let row = |across_m: f64| {
                let foot = [-across_m * sin, across_m * cos];
                [foot[0], foot[1], foot[0] + AHEAD_M * cos, foot[1] + AHEAD_M * sin].map(centimetres)
            };
            let left = view.left.valid.then(|| row(view.left.distance_m));
            left.into_iter().chain(view.right.valid.then(|| row(-view.right.distance_m))).collect()
        }
    }
}
