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

/// Mean normalised estimation error squared: 3 where the covariance is the error's own.
fn nees(ends: &[(nalgebra::Vector3<f64>, Matrix3<f64>)]) -> f64 {
    mean(ends.iter().map(|(error, covariance)| error.dot(&(covariance.try_inverse().unwrap() * error))))
}

/// Root mean squares of the errors along the rows, and of what the estimate thinks they are.
fn along(ends: &[(nalgebra::Vector3<f64>, Matrix3<f64>)]) -> [f64; 2] {
    let squares = [mean(ends.iter().map(|(error, _)| error.x * error.x)), mean(ends.iter().map(|(_, c)| c[(0, 0)]))];
    squares.map(f64::sqrt)
}

/// The mean of 200 values of chi-square with 3 degrees of freedom has a standard deviation of sqrt(6 / 200): three of
/// them to either side.
const CONSISTENT: std::ops::RangeInclusive<f64> = 2.48..=3.52;

#[test]
fn thirty_metres_down_a_lane_the_robot_knows_where_it_is() {
    for planting_distance_m in [0.4, 1.2] {
        for seed in 1..=20 {
            let mut chunks = 0;
            drive(Drive::new(planting_distance_m, true, 0.05, seed), |error| {
                chunks += 1;
                // The start may be further off; three metres suffice to find the rows.
                let [along, across, turned] = [error.x, error.y, error.z.to_degrees()].map(f64::abs);
                assert!(along < 0.15, "{planting_distance_m} {seed} {chunks}: {along}");
                if chunks > 30 {
                    assert!(across < 0.05 && turned < 2.0, "{planting_distance_m} {seed} {chunks}: {across} {turned}");
                }
            });
        }
    }
}

#[test]
fn the_covariance_is_that_of_the_errors() {
    let ends = ends(200, |seed| Drive::new(1.2, true, 0.1, seed));
    assert!(CONSISTENT.contains(&nees(&ends)), "{}", nees(&ends));
    let [along_m, expected_m] = along(&ends);
    assert!(along_m < 0.03 && (along_m / expected_m - 1.0).abs() < 0.2, "{along_m} {expected_m}");
}

#[test]
fn without_plants_the_error_along_the_rows_grows_as_the_odometrys() {
    let ends = ends(200, |seed| Drive::new(1.2, false, 0.1, seed));
    assert!(CONSISTENT.contains(&nees(&ends)), "{}", nees(&ends));
    // 300 chunks of 0.1 m, each off by 5 %, and the start.
    let odometry_m = (300.0 * 0.005 * 0.005 + 0.05 * 0.05_f64).sqrt();
    let [along_m, expected_m] = along(&ends);
    assert!((expected_m / odometry_m - 1.0).abs() < 0.02, "{expected_m} {odometry_m}");
    assert!((along_m / odometry_m - 1.0).abs() < 0.15, "{along_m} {odometry_m}");
}

#[test]
fn plants_are_left_alone_while_they_could_be_their_neighbours() {
    let plants = |start_sd_m: f64| {
        let mut seen = Drive::new(0.4, true, 0.0, 1);
        let params = GraphParams { start_sd_m, ..GraphParams::default() };
        let mut graph = GraphLocalization::new(&params, seen.map, seen.truth);
        graph.predict(seen.odometry);
        (0..3).for_each(|chunk| seen.go_on(chunk));
        assert!(graph.correct(seen.odometry, &seen.rows()));
        let (_, matches) = graph.newest();
        matches.iter().filter(|one| matches!(one, Measurement::Plant { .. })).count()
    };
    // The gate is 0.16 m, half of it 0.08 m.
    assert!(plants(0.07) > 10);
    assert_eq!(plants(0.09), 0);
}

#[test]
fn a_node_is_added_after_a_quarter_metre_or_five_degrees() {
    let mut graph = GraphLocalization::new(&GraphParams::default(), map(0.4), Pose::default());
    let nothing = DetectedRows::default();
    let reading = |x_m: f64, degrees: f64| Pose { x_m, y_m: 0.0, heading_rad: degrees.to_radians() };
    assert!(!graph.correct(reading(0.0, 0.0), &nothing));
    assert!(!graph.correct(reading(0.24, 4.9), &nothing));
    assert!(graph.correct(reading(0.26, 4.9), &nothing));
    // Across the cut of the angle: 10 degrees on, not 350 back.
    assert!(graph.correct(reading(0.26, 175.0), &nothing));
    let before = graph.covariance()[2][2];
    assert!(graph.correct(reading(0.26, -175.0), &nothing));
    let variance = 0.1 * 0.1 * 0.1 * 10_f64.to_radians();
    assert!((graph.covariance()[2][2] - before - variance).abs() < 2e-6);
    assert!(!graph.correct(reading(0.26, -174.0), &nothing));
    let (newest, matches) = graph.newest();
    assert_eq!((graph.nodes().len(), matches.len()), (4, 0));
    let estimate = graph.estimate();
    assert!((newest.heading_rad.to_degrees() + 175.0).abs() < 1e-9 && (estimate.x_m - 0.26).abs() < 1e-9);
    assert!((estimate.heading_rad.to_degrees() + 174.0).abs() < 1e-9);
}

#[test]
fn once_warm_nothing_is_allocated() {
    let mut seen = Drive::new(0.4, true, 0.05, 1);
    let mut graph = seen.start(&GraphParams::default());
    for chunk in 0..200 {
        seen.go_on(chunk);
        let counted = allocation_counter::measure(|| {
            graph.correct(seen.odometry, &seen.rows());
        });
        assert!(chunk < 150 || counted.count_total == 0, "{chunk}: {counted:?}");
    }
    assert_eq!(graph.nodes().len(), 40);
}

#[test]
fn the_same_drive_gives_the_same_bits() {
    let bits = || {
        let (_, graph) = drive(Drive::new(0.4, true, 0.05, 1), |_| ());
        let Pose { x_m, y_m, heading_rad } = graph.estimate();
        [x_m, y_m, heading_rad].map(f64::to_bits)
    };
    assert_eq!(bits(), bits());
}

fn odd() -> impl Strategy<Value = f64> {
    prop_oneof![
        6 => -3.0..3.0_f64,
        1 => prop_oneof![Just(0.0), Just(f64::NAN), Just(f64::INFINITY), Just(1e300), Just(-1e-300), Just(9e5)],
    ]
}

type Scan = ([f64; 3], [Option<[f64; 4]>; 2], [Vec<[f64; 2]>; 2], Vec<[f64; 2]>);

fn scans() -> impl Strategy<Value = Vec<Scan>> {
    let line = || proptest::option::of([odd(), odd(), odd(), odd()]);
    let points = || proptest::collection::vec([odd(), odd()], 0..30);
    proptest::collection::vec(([odd(), odd(), odd()], [line(), line()], [points(), points()], points()), 1..12)
}

proptest! {
    #[test]
    fn odd_odometry_and_rows_leave_a_finite_estimate(scans in scans(), rows in 0..6_u32, window_nodes in 2..5_u32) {
        let params = GraphParams { window_nodes, ..GraphParams::default() };
        let map = PlantingMap { rows, ..map(0.4) };
        let mut graph = GraphLocalization::new(&params, map, Pose::default());
        for ([x_m, y_m, heading_rad], lines, supports, plants) in &scans {
            let lines = lines.map(|line| line.map(|[x, y, dx, dy]| RowLine { point: [x, y], direction: [dx, dy] }));
            let rows = DetectedRows { lines, supports: [&supports[0], &supports[1]], plants };
            graph.correct(Pose { x_m: *x_m, y_m: *y_m, heading_rad: *heading_rad }, &rows);
            let estimate = graph.estimate();
            prop_assert!([estimate.x_m, estimate.y_m, estimate.heading_rad].iter().all(|value| value.is_finite()));
            prop_assert!(graph.covariance().iter().flatten().all(|entry| entry.is_finite()));
        }
    }
}
