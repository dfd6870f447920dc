//! Scans of simple lanes whose place is known, for tests: stems in rows, leaves that hang into the lane.

use std::f64::consts::PI;
use std::fmt::Write as _;

use super::{LaneEstimate, Points};
use crate::perception::{Beams, Scan};
use crate::random::Stream;

/// What stands around the robot.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scene {
    pub(crate) place: LaneEstimate,
    /// Leaves per metre of row.
    pub(crate) leaves_per_m: f64,
    /// Whether the rows to the left and to the right are there.
    pub(crate) rows: [bool; 2],
}

impl Scene {
    pub(crate) const fn new(place: LaneEstimate, leaves_per_m: f64) -> Self {
        Self { place, leaves_per_m, rows: [true, true] }
    }

    /// One turn of the LiDAR: 1081 beams over 270 degrees, noise of 0.01 m.
    pub(crate) fn scan(&self, random: &mut Stream) -> Points {
        let beams = Beams::new(1081, 1.5 * PI);
        let mut ranges_m = vec![f64::INFINITY; beams.len()];
        for (x_m, y_m, radius_m) in self.things(random) {
            cast(&beams, &mut ranges_m, [x_m, y_m, radius_m]);
        }
        ranges_m.iter_mut().for_each(|range| *range += 0.01 * random.normal());
        let mut points = Points::default();
        points.read_scan(&Scan { beams: &beams, ranges_m: &ranges_m });
        points
    }

    /// Circles in the robot's frame: two rows on each side.
    fn things(&self, random: &mut Stream) -> Vec<(f64, f64, f64)> {
        let width_m = self.place.width_m();
        let mut things = Vec::new();
        let (sin, cos) = libm::sincos(-self.place.heading_rad);
        let turned = |x: f64, y: f64, radius_m: f64| (cos * x - sin * y, sin * x + cos * y, radius_m);
        for (side, sign, near_m) in [(0, 1.0, self.place.left_m), (1, -1.0, self.place.right_m)] {
            for row_m in [near_m, near_m + width_m].into_iter().filter(|_| self.rows[side]) {
                for i in -20..60 {
                    let x = 0.1 * f64::from(i) + 0.02 * random.normal();
                    things.push(turned(x, sign * (row_m + 0.02 * random.normal()), 0.0125));
                    if random.uniform() < 0.1 * self.leaves_per_m {
                        let reach_m = random.between(0.0, 0.3 * width_m);
                        things.push(turned(x + random.between(-0.1, 0.1), sign * (row_m - reach_m), 0.03));
                    }
                }
            }
        }
        // Nothing grows where the robot stands.
        things.retain(|(x, y, _)| libm::hypot(*x, *y) > 0.15);
        things
    }
}

/// Shortens the ranges of the beams that meet a circle.
fn cast(beams: &Beams, ranges_m: &mut [f64], [x, y, radius]: [f64; 3]) {
    for ((range, cos), sin) in ranges_m.iter_mut().zip(&beams.cos).zip(&beams.sin) {
        let (along, across) = (x * cos + y * sin, x * sin - y * cos);
        if along > 0.0 && across.abs() < radius {
            *range = range.min(along - (radius * radius - across * across).sqrt());
        }
    }
}

/// The places that the scans of [`FILE`] were made from.
fn places() -> impl Iterator<Item = (u64, Scene)> {
    (1_u64..=12).map(|frame| {
        let mut random = Stream::new(frame, "place");
        let (width_m, offset_m) = (random.between(0.68, 0.82), random.between(-0.12, 0.12));
        let heading_rad = random.between(-0.2, 0.2);
        let place = LaneEstimate { left_m: 0.5 * width_m - offset_m, right_m: 0.5 * width_m + offset_m, heading_rad };
        (frame, Scene::new(place, 2.0))
    })
}

/// Labelled scans as text: see [`labelled`](crate::labelled).
fn text() -> String {
    let mut text = String::from(
        "# Simulated scans of a LiDAR between two rows, labelled with their true place.\n\
         # frame;x0,y0,x1,y1 of the left row,x2,y2,x3,y3 of the right row;x,y of each return. In mm, x right, y forward.\n",
    );
    for (frame, scene) in places() {
        let LaneEstimate { left_m, right_m, heading_rad } = scene.place;
        let (sin, cos) = libm::sincos(heading_rad);
        let mm = |lane_x: f64, lane_y: f64| {
            let (x, y) = (cos * lane_x + sin * lane_y, cos * lane_y - sin * lane_x);
            format!("{:.0},{:.0}", -1000.0 * y, 1000.0 * x)
        };
        let label = [mm(0.0, left_m), mm(2.0, left_m), mm(0.0, -right_m), mm(2.0, -right_m)].join(",");
        let points = scene.scan(&mut Stream::new(frame, "scan"));
        let near = points.iter().filter(|(x, y)| libm::hypot(*x, *y) < 3.0);
        let points: Vec<_> = near.map(|(x, y)| format!("{:.0},{:.0}", -1000.0 * y, 1000.0 * x)).collect();
        writeln!(text, "{frame};{label};{}", points.join(" ")).expect("a text takes all");
    }
    text
}

pub(crate) const FILE: &str = "benches/scans/lane.csv";

#[test]
fn the_file_of_simulated_scans_is_made_here() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(FILE);
    if std::env::var_os("UPDATE_SCANS").is_some() {
        std::fs::write(&path, text()).unwrap();
    }
    assert!(std::fs::read_to_string(&path).unwrap() == text(), "UPDATE_SCANS=1 cargo test writes it anew");
}
