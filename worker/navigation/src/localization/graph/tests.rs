use super::odometry::tests::reported;
use super::*;
use crate::perception::rows::RowLine;
use crate::random::Stream;
use proptest::prelude::*;

const LENGTH_M: f64 = 30.0;
/// The odometry reports a chunk at a time.
const CHUNK_M: f64 = 0.1;
/// Points of a line that are seen, one every quarter of a metre from here.
const NEAREST_M: f64 = 0.5;

fn map(planting_distance_m: f64) -> PlantingMap {
    PlantingMap {
        row_distance_m: 1.3,
        planting_distance_m,
        rows: 5,
        plants_per_row: (LENGTH_M / planting_distance_m) as u32 + 10,
        lanes_to_the_left: true,
    }
}

/// A drive down the first lane, with what a scan shows at each chunk.
struct Drive {
    map: PlantingMap,
    plant_sd_m: f64,
    shows_plants: bool,
    random: Stream,
    truth: Pose,
    odometry: Pose,
    supports: [Vec<[f64; 2]>; 2],
    plants: Vec<[f64; 2]>,
}

impl Drive {
    fn new(planting_distance_m: f64, shows_plants: bool, plant_sd_m: f64, seed: u64) -> Self {
        let random = Stream::new(seed, "drive");
        let odometry = Pose { x_m: 3.0, y_m: -2.0, heading_rad: 1.0 };
        let truth = Pose::default();
        let (supports, plants) = ([vec![], vec![]], vec![]);
        Self { map: map(planting_distance_m), plant_sd_m, shows_plants, random, truth, odometry, supports, plants }
    }

    /// A start pose as unsure as the parameters say.
    fn start(&mut self, params: &GraphParams) -> GraphLocalization {
        let mut off = |sd: f64| sd * self.random.normal();
        let start =
            Pose { x_m: off(params.start_sd_m), y_m: off(params.start_sd_m), heading_rad: off(params.start_sd_rad) };
        let mut graph = GraphLocalization::new(params, self.map, start);
        graph.predict(self.odometry);
        graph
    }

    /// One chunk on, in gentle bends around the middle of the lane.
    fn go_on(&mut self, chunk: u32) {
        let turn_rad = 0.005 * libm::cos(0.1 * f64::from(chunk));
        self.truth = self.truth.moved(CHUNK_M, turn_rad);
        self.odometry = self.odometry.compose(reported(CHUNK_M, turn_rad, &mut self.random));
        self.look();
    }

    fn look(&mut self) {
        for (support, row) in self.supports.iter_mut().zip([0, 1]) {
            support.clear();
            // A line is off as a whole: by as much as one point may be, at its middle and at its ends.
            let (offset, tilt) = (0.1 * self.random.normal(), 0.1 * self.random.normal());
            let along = (0..20).map(|i| f64::from(i) - 9.5);
            let spread = (along.clone().map(|i| i * i).sum::<f64>() / 20.0).sqrt();
            let y_m = self.map.row_y_m(row);
            support.extend(along.map(|i| {
                let x_m = self.truth.x_m + NEAREST_M + 0.25 * (i + 9.5);
                let (ahead, left) = self.truth.local(x_m, y_m);
                [ahead, left + offset + tilt * i / spread]
            }));
        }
        self.plants.clear();
        let plants = if self.shows_plants { self.map.plants_per_row } else { 0 };
        for (row, plant) in (0..2).flat_map(|row| (0..plants).map(move |plant| (row, plant))) {
            let x_m = f64::from(plant) * self.map.planting_distance_m;
            let (ahead, left) = self.truth.local(x_m, self.map.row_y_m(row));
            if (NEAREST_M..4.0).contains(&ahead) {
                let mut noise = || self.plant_sd_m * self.random.normal();
                self.plants.push([ahead + noise(), left + noise()]);
            }
        }
    }

    fn rows(&self) -> DetectedRows<'_> {
        let line = |support: &[[f64; 2]]| {
            let (from, to) = (support[0], support[support.len() - 1]);
            let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
            let length = (dx * dx + dy * dy).sqrt();
            Some(RowLine { point: from, direction: [dx / length, dy / length] })
        };
        let supports = [&self.supports[0][..], &self.supports[1][..]];
        DetectedRows { lines: supports.map(line), supports, plants: &self.plants }
    }

    /// x, y and heading of the estimate less the truth's.
    fn error(&self, graph: &GraphLocalization) -> nalgebra::Vector3<f64> {
        let (estimate, truth) = (graph.estimate(), self.truth);
        let turned = wrap(estimate.heading_rad - truth.heading_rad);
        nalgebra::Vector3::new(estimate.x_m - truth.x_m, estimate.y_m - truth.y_m, turned)
    }
}

/// Drives to the end; hands each chunk's error on.
fn drive(mut drive: Drive, mut watch: impl FnMut(&nalgebra::Vector3<f64>)) -> (Drive, GraphLocalization) {
    let mut graph = drive.start(&GraphParams::default());
    for chunk in 0..(LENGTH_M / CHUNK_M) as u32 {
        drive.go_on(chunk);
        graph.correct(drive.odometry, &drive.rows());
        watch(&drive.error(&graph));
    }
    (drive, graph)
}

/// At the end of each of `runs` drives: the error and its covariance as estimated.
fn ends(runs: u64, drive_of: impl Fn(u64) -> Drive) -> Vec<(nalgebra::Vector3<f64>, Matrix3<f64>)> {
    let end = |seed| {
        let (end, graph) = drive(drive_of(seed), |_| ());
        (end.error(&graph), Matrix3::from(graph.covariance()))
    };
    (1..=runs).map(end).collect()
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let n = values.len() as f64;
    values.sum::<f64>() / n
}

#[test]
fn probe() {
    for (p, sd) in [(1.2, 0.1), (0.4, 0.05), (0.4, 0.1)] {
        let mut worst = [0.0_f64; 3];
        for seed in 1..=50 {
            drive(Drive::new(p, true, sd, seed), |e| (0..3).for_each(|i| worst[i] = worst[i].max(e[i].abs())));
        }
        println!("{p} {sd} worst {worst:?}");
        let ends = ends(200, |seed| Drive::new(p, true, sd, seed));
        let nees = mean(ends.iter().map(|(e, c)| e.dot(&(c.try_inverse().unwrap() * e))));
        let sd: Vec<f64> = (0..3).map(|i| mean(ends.iter().map(|(e, _)| e[i] * e[i])).sqrt()).collect();
        let est: Vec<f64> = (0..3).map(|i| mean(ends.iter().map(|(_, c)| c[(i, i)])).sqrt()).collect();
        println!("nees {nees} {sd:?} {est:?}");
    }
    let ends = ends(200, |seed| Drive::new(1.2, false, 0.1, seed));
    let nees = mean(ends.iter().map(|(e, c)| e.dot(&(c.try_inverse().unwrap() * e))));
    let sd: Vec<f64> = (0..3).map(|i| mean(ends.iter().map(|(e, _)| e[i] * e[i])).sqrt()).collect();
    let est: Vec<f64> = (0..3).map(|i| mean(ends.iter().map(|(_, c)| c[(i, i)])).sqrt()).collect();
    println!("no plants nees {nees} {sd:?} {est:?}");
}
