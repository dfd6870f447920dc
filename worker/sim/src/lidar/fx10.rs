//! The FX10, a 3D LiDAR of 60 by 50 degrees at the robot's front: Vintu (2018), section 3.1 and figure 3.2.
//!
//! Rays begin at the closest range: leaves that the body has just bent aside hide nothing.

mod pattern;

use furrow_navigation::perception::cloud::{CloudMount, CloudScan, Point3};
use furrow_navigation::random::Stream;

use super::canopy::{Grid, Rays, Room, View};
use super::frame::Frame;
use crate::Pose;
use crate::field::Nursery;
use crate::field::vintu2018::Standing;
use crate::odometry::OdometryNoise;
use pattern::Bundle;

furrow_navigation::words! {
    /// How the rays of a scan lie.
    pub enum Pattern {
        /// At equal angles from row to row and from column to column, all at once.
        Uniform = "uniform",
        /// Along a Lissajous figure that takes the whole scan, while the robot moves on.
        Lissajous = "lissajous",
    }
}

furrow_navigation::parameters! {
    /// One 3D LiDAR (FX10) that scans ten times a second, and wheel odometry: Vintu (2018), sections 3.1 and 3.2;
    /// odometry after Eliazar and Parr, coefficients for a skid-steered robot on soil.
    pub struct Fx10Params {
        /// Position of the LiDAR ahead of the robot's centre. Ours: at the front of the body.
        pub lidar_x_m: f64 = 0.575, "m", [-5.0, 5.0];
        /// Height of the LiDAR above the ground. Ours.
        pub height_m: f64 = 0.55, "m", [0.05, 5.0];
        /// Of its optical axis below the horizontal. Ours: 5 degrees.
        pub pitch_down_rad: f64 = 5.0_f64.to_radians(), "rad", [-0.5, 0.5];
        /// Rays from left to right. Paper: 65.
        pub columns: u32 = 65, "1", [2, 200];
        /// Rays from above to below. Paper: 40.
        pub rows: u32 = 40, "1", [2, 200];
        /// Horizontal field of view, its first and last rays included. Paper: 60 degrees.
        pub field_of_view_rad: f64 = 60.0_f64.to_radians(), "rad", [0.1, 2.0];
        /// Vertical field of view. Paper: 50 degrees.
        pub vertical_field_of_view_rad: f64 = 50.0_f64.to_radians(), "rad", [0.1, 1.6];
        /// Closest return. Paper: 0.3.
        pub range_min_m: f64 = 0.3, "m", [0.0, 10.0];
        /// Farthest return. Paper: 15.
        pub range_max_m: f64 = 15.0, "m", [0.1, 100.0];
        /// How the rays of a scan lie. Ours; the paper shows a Lissajous figure, and casts as many rays as the grid has.
        pub pattern: Pattern = Pattern::Uniform, "";
        /// Standard deviation of a range at no distance: it grows exponentially. Ours; the growth is the paper's.
        pub range_noise_m: f64 = 0.01, "m", [0.0, 1.0];
        /// Distance over which the noise grows e-fold. Ours.
        pub range_noise_scale_m: f64 = 10.0, "m", [1.0, 1000.0];
        /// Odometry: standard deviation of the distance per distance. Ours.
        pub odometry_distance_sd: f64 = 0.05, "m/m", [0.0, 1.0];
        /// Odometry: standard deviation of the drift across per distance. Ours.
        pub odometry_drift_sd: f64 = 0.02, "m/m", [0.0, 1.0];
        /// Odometry: standard deviation of the drift across per turn. Ours.
        pub odometry_drift_turn_sd: f64 = 0.06, "m/rad", [0.0, 1.0];
        /// Odometry: standard deviation of the heading per distance. Ours.
        pub odometry_heading_sd: f64 = 0.02, "rad/m", [0.0, 1.0];
        /// Odometry: standard deviation of the heading per turn. Ours.
        pub odometry_heading_turn_sd: f64 = 0.10, "rad/rad", [0.0, 1.0];
        /// How well the robot knows where it starts: standard deviation along x and along y. Ours.
        pub start_position_sd_m: f64 = 0.05, "m", [0.0, 2.0];
        /// Likewise of the heading. Ours: 1 degree.
        pub start_heading_sd_rad: f64 = 1.0_f64.to_radians(), "rad", [0.0, 1.0];
    }
}

/// Scans a second. Paper.
pub const RATE_HZ: u32 = 10;
impl Fx10Params {
    /// The errors of the odometry.
    #[must_use]
    pub const fn odometry_noise(&self) -> OdometryNoise {
        OdometryNoise {
            distance_sd: self.odometry_distance_sd,
            drift_sd: self.odometry_drift_sd,
            drift_turn_sd: self.odometry_drift_turn_sd,
            heading_sd: self.odometry_heading_sd,
            heading_turn_sd: self.odometry_heading_turn_sd,
        }
    }

    /// Where the LiDAR is on the robot.
    #[must_use]
    pub const fn mount(&self) -> CloudMount {
        CloudMount { x_m: self.lidar_x_m, height_m: self.height_m, pitch_down_rad: self.pitch_down_rad }
    }
}

/// The LiDAR and its last scan.
#[derive(Debug, Clone)]
pub struct Fx10 {
    params: Fx10Params,
    rays: Bundle,
    grid: Grid,
    /// Of a scan on the way: where each ray begins.
    origins: Vec<[f64; 3]>,
    /// Unit vectors of the rays in the world's frame: x, y, z.
    directions: [Vec<f64>; 3],
    /// From where each ray may meet the ground, and from where on it is below \[m\].
    reach_m: Vec<[f64; 2]>,
    /// Where each ray first meets something; infinity where it meets nothing \[m\].
    first_m: Vec<f64>,
    room: Room,
    deviates: Vec<f64>,
    points: Vec<Point3>,
    cells: Vec<u32>,
}

impl Fx10 {
    /// A LiDAR with these parameters.
    #[must_use]
    pub fn new(params: &Fx10Params) -> Self {
        let rays = Bundle::new(params);
        let n = rays.cells.len();
        let view_rad = [params.field_of_view_rad, params.vertical_field_of_view_rad];
        Self {
            params: params.clone(),
            grid: Grid::new([params.columns, params.rows], view_rad, rays.spread_cells, rays.cells.iter().copied()),
            origins: vec![[0.0; 3]; if params.pattern == Pattern::Lissajous { n } else { 0 }],
            directions: [vec![0.0; n], vec![0.0; n], vec![0.0; n]],
            reach_m: vec![[0.0; 2]; n],
            first_m: vec![0.0; n],
            room: Room::default(),
            deviates: vec![0.0; n],
            points: Vec::with_capacity(n),
            cells: Vec::with_capacity(n),
            rays,
        }
    }

    /// What the LiDAR of a robot at `world_from_robot` sees; a tenth of a second ago the robot was at `previous`.
    ///
    /// A Lissajous scan is cast on the way from there to here, each of its points in the LiDAR's frame of its own time.
    pub fn scan(
        &mut self,
        nursery: &Nursery,
        world_from_robot: Pose,
        previous: Pose,
        noise: &mut Stream,
    ) -> CloudScan<'_> {
        let here = (world_from_robot, nursery.terrain.ground(world_from_robot));
        match self.params.pattern {
            Pattern::Uniform => self.cast_at_once(nursery, here),
            Pattern::Lissajous => self.cast_on_the_way(nursery, (previous, nursery.terrain.ground(previous)), here),
        }
        self.read(noise);
        let Fx10Params { columns, rows, .. } = self.params;
        CloudScan { points: &self.points, cells: &self.cells, columns, rows }
    }

    fn cast_at_once(&mut self, nursery: &Nursery, (pose, standing): (Pose, Standing)) {
        let frame = Frame::of_lidar(self.params.mount(), pose, standing);
        let [x, y, z] = &mut self.directions;
        for (((local, x), y), z) in self.rays.directions.iter().zip(x).zip(y).zip(z) {
            [*x, *y, *z] = frame.turn(*local);
        }
        let view = View::new(frame, [0.0; 2], self.params.range_max_m);
        let origin = frame.origin;
        let found = (&mut self.reach_m[..], &mut self.first_m[..]);
        let rays = rays(&self.params, &self.grid, &self.directions);
        cast(nursery, &view, rays, |_| origin, found, &mut self.room);
    }

    fn cast_on_the_way(&mut self, nursery: &Nursery, from: (Pose, Standing), to: (Pose, Standing)) {
        let mount = self.params.mount();
        for (ray, (local, time)) in self.rays.directions.iter().zip(&self.rays.times).enumerate() {
            let (pose, standing) = between(from, to, *time);
            let frame = Frame::of_lidar(mount, pose, standing);
            self.origins[ray] = frame.origin;
            let direction = frame.turn(*local);
            (0..3).for_each(|k| self.directions[k][ray] = direction[k]);
        }
        let (pose, standing) = between(from, to, 0.5);
        let frame = Frame::of_lidar(mount, pose, standing);
        let view = View::new(frame, self.way(from, to), self.params.range_max_m);
        let origins = &self.origins;
        let found = (&mut self.reach_m[..], &mut self.first_m[..]);
        let rays = rays(&self.params, &self.grid, &self.directions);
        cast(nursery, &view, rays, |ray| origins[ray], found, &mut self.room);
    }

    /// Upper bounds of how far the LiDAR moves \[m\] and turns \[rad\] in a scan.
    fn way(&self, (a, a_stands): (Pose, Standing), (b, b_stands): (Pose, Standing)) -> [f64; 2] {
        let turned = (a.heading_rad - b.heading_rad).abs()
            + (a_stands.roll_rad - b_stands.roll_rad).abs()
            + (a_stands.pitch_rad - b_stands.pitch_rad).abs();
        let moved = (a.x_m - b.x_m).abs() + (a.y_m - b.y_m).abs() + (a_stands.z_m - b_stands.z_m).abs();
        [moved + turned * (self.params.lidar_x_m.abs() + self.params.height_m), turned]
    }

    /// Makes points of the returns, each with its own noise, in firing order.
    fn read(&mut self, noise: &mut Stream) {
        let Fx10Params { range_noise_m, range_noise_scale_m, range_min_m, range_max_m, .. } = self.params;
        let n = self.first_m.iter().filter(|first| **first <= range_max_m).count();
        noise.normals(&mut self.deviates[..n]);
        let mut deviates = self.deviates.iter();
        self.points.clear();
        self.cells.clear();
        for ray in self.rays.fired.iter().map(|ray| *ray as usize) {
            let range = self.first_m[ray];
            if range > range_max_m {
                continue;
            }
            let sd_m = range_noise_m * libm::exp(range / range_noise_scale_m);
            let deviate = deviates.next().expect("there is one for each return");
            let range = (range + sd_m * deviate).max(range_min_m).min(range_max_m);
            let [x, y, z] = self.rays.directions[ray];
            self.points.push(Point3 { x: range * x, y: range * y, z: range * z });
            self.cells.push(self.rays.cells[ray]);
        }
    }
}

fn rays<'a>(params: &Fx10Params, grid: &'a Grid, [x, y, z]: &'a [Vec<f64>; 3]) -> Rays<'a> {
    Rays { grid, directions: [x, y, z], from_m: params.range_min_m }
}

/// Finds where each ray first meets something.
fn cast(
    nursery: &Nursery,
    view: &View,
    rays: Rays<'_>,
    origin: impl Fn(usize) -> [f64; 3],
    (reach_m, first_m): (&mut [[f64; 2]], &mut [f64]),
    room: &mut Room,
) {
    let terrain = &nursery.terrain;
    for (ray, (reach, first)) in reach_m.iter_mut().zip(first_m.iter_mut()).enumerate() {
        *reach = terrain.reach(origin(ray), rays.direction(ray), [rays.from_m, view.range_max_m()]);
        *first = reach[1];
    }
    nursery.canopy.shorten(view, rays, &origin, first_m, room);
    for (ray, ([from, below], first)) in reach_m.iter().zip(first_m).enumerate() {
        let ground = terrain.cast(origin(ray), rays.direction(ray), [*from, *first]);
        *first = ground.min(if *first < *below { *first } else { f64::INFINITY });
    }
}

/// On the way from one to the other.
fn between((a, a_stands): (Pose, Standing), (b, b_stands): (Pose, Standing), share: f64) -> (Pose, Standing) {
    let between = |a: f64, b: f64| a + share * (b - a);
    let pose = Pose {
        x_m: between(a.x_m, b.x_m),
        y_m: between(a.y_m, b.y_m),
        heading_rad: between(a.heading_rad, b.heading_rad),
    };
    let standing = Standing {
        z_m: between(a_stands.z_m, b_stands.z_m),
        roll_rad: between(a_stands.roll_rad, b_stands.roll_rad),
        pitch_rad: between(a_stands.pitch_rad, b_stands.pitch_rad),
    };
    (pose, standing)
}

#[cfg(test)]
mod tests;
