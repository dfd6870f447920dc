//! The FX10, a 3D LiDAR of 60 by 50 degrees at the robot's front: Vintu (2018), section 3.1 and figure 3.2.
//!
//! Rays begin at the closest range: leaves that the body has just bent aside hide nothing.

use std::f64::consts::{FRAC_PI_2, TAU};

use furrow_navigation::perception::cloud::{CloudMount, CloudScan, Point3};
use furrow_navigation::random::Stream;

use super::canopy::{Ray, Tried};
use crate::Pose;
use crate::field::Nursery;
use crate::field::vintu2018::Standing;
use crate::odometry::OdometryNoise;

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
/// Periods of the Lissajous figure in a scan, across and up and down. Ours.
const ACROSS: f64 = 33.0;
const UP_AND_DOWN: f64 = 20.0;

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
    /// Of each ray in the LiDAR's frame, in firing order: its cell and its unit vector.
    rays: Vec<(u32, [f64; 3])>,
    tried: Tried,
    /// Rays with a return, and their ranges \[m\].
    returns: Vec<(u32, f64)>,
    deviates: Vec<f64>,
    points: Vec<Point3>,
    cells: Vec<u32>,
}

impl Fx10 {
    /// A LiDAR with these parameters.
    #[must_use]
    pub fn new(params: &Fx10Params) -> Self {
        let rays = match params.pattern {
            Pattern::Uniform => uniform(params),
            Pattern::Lissajous => lissajous(params),
        };
        let n = rays.len();
        Self {
            params: params.clone(),
            rays,
            tried: Tried::default(),
            returns: Vec::with_capacity(n),
            deviates: vec![0.0; n],
            points: Vec::with_capacity(n),
            cells: Vec::with_capacity(n),
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
        self.returns.clear();
        self.tried.begin(&nursery.canopy);
        match self.params.pattern {
            Pattern::Uniform => {
                let at = Frame::of_lidar(&self.params, world_from_robot, nursery.terrain.ground(world_from_robot));
                (0..self.rays.len()).for_each(|ray| self.cast(nursery, &at, ray));
            }
            Pattern::Lissajous => self.cast_on_the_way(nursery, previous, world_from_robot),
        }
        self.read(noise);
        let Fx10Params { columns, rows, .. } = self.params;
        CloudScan { points: &self.points, cells: &self.cells, columns, rows }
    }

    fn cast_on_the_way(&mut self, nursery: &Nursery, from: Pose, to: Pose) {
        let [begins, ends] = [from, to].map(|pose| nursery.terrain.ground(pose));
        for ray in 0..self.rays.len() {
            let share = (ray + 1) as f64 / self.rays.len() as f64;
            let between = |a: f64, b: f64| a + share * (b - a);
            let pose = Pose {
                x_m: between(from.x_m, to.x_m),
                y_m: between(from.y_m, to.y_m),
                heading_rad: between(from.heading_rad, to.heading_rad),
            };
            let standing = Standing {
                z_m: between(begins.z_m, ends.z_m),
                roll_rad: between(begins.roll_rad, ends.roll_rad),
                pitch_rad: between(begins.pitch_rad, ends.pitch_rad),
            };
            self.cast(nursery, &Frame::of_lidar(&self.params, pose, standing), ray);
        }
    }

    /// Casts one ray; keeps it if it meets something.
    fn cast(&mut self, nursery: &Nursery, world_from_lidar: &Frame, ray: usize) {
        let direction = world_from_lidar.turn(self.rays[ray].1);
        let origin = world_from_lidar.origin;
        let [from, to] = [self.params.range_min_m, self.params.range_max_m];
        let [high, low] = nursery.terrain.reach(origin, direction, [from, to]);
        // Beyond the lower end the ray is below the ground; only a ray that falls has one.
        let end = if direction_falls(nursery, direction) { low } else { to };
        let plant = nursery.canopy.cast(&Ray { origin, direction }, [from, end], &mut self.tried);
        let ground = nursery.terrain.cast(origin, direction, [high, low.min(plant)]);
        let range = plant.min(ground);
        if range <= to {
            self.returns.push((ray as u32, range));
        }
    }

    /// Makes points of the returns, each with its own noise, in firing order.
    fn read(&mut self, noise: &mut Stream) {
        let Fx10Params { range_noise_m, range_noise_scale_m, range_min_m, range_max_m, .. } = self.params;
        let deviates = &mut self.deviates[..self.returns.len()];
        noise.normals(deviates);
        self.points.clear();
        self.cells.clear();
        for ((ray, range), deviate) in self.returns.iter().zip(deviates) {
            let sd_m = range_noise_m * libm::exp(range / range_noise_scale_m);
            let range = (range + sd_m * *deviate).max(range_min_m).min(range_max_m);
            let (cell, [x, y, z]) = self.rays[*ray as usize];
            self.points.push(Point3 { x: range * x, y: range * y, z: range * z });
            self.cells.push(cell);
        }
    }
}

fn direction_falls(nursery: &Nursery, [dx, dy, dz]: [f64; 3]) -> bool {
    let [a, b] = nursery.terrain.slope();
    dz < a * dx + b * dy
}

/// `world_from_lidar`: the LiDAR's place, and its axes.
struct Frame {
    origin: [f64; 3],
    axes: [[f64; 3]; 3],
}

impl Frame {
    fn of_lidar(params: &Fx10Params, pose: Pose, standing: Standing) -> Self {
        let (sy, cy) = libm::sincos(pose.heading_rad);
        let (sp, cp) = libm::sincos(standing.pitch_rad);
        let (sr, cr) = libm::sincos(standing.roll_rad);
        let ahead = [cy * cp, sy * cp, -sp];
        let left = [cy * sp * sr - sy * cr, sy * sp * sr + cy * cr, cp * sr];
        let up = [cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr];
        let (sin, cos) = libm::sincos(params.pitch_down_rad);
        let foot = [pose.x_m, pose.y_m, standing.z_m];
        let each = |of: &dyn Fn(usize) -> f64| [of(0), of(1), of(2)];
        Self {
            origin: each(&|k| foot[k] + params.lidar_x_m * ahead[k] + params.height_m * up[k]),
            axes: [each(&|k| cos * ahead[k] - sin * up[k]), left, each(&|k| sin * ahead[k] + cos * up[k])],
        }
    }

    /// A direction of the LiDAR's frame in the world's.
    fn turn(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let [ahead, left, up] = &self.axes;
        [0, 1, 2].map(|k| x * ahead[k] + y * left[k] + z * up[k])
    }
}

/// Row by row from above, each from left to right.
fn uniform(params: &Fx10Params) -> Vec<(u32, [f64; 3])> {
    let angle = |i: u32, n: u32, view: f64| view * (0.5 - f64::from(i) / f64::from(n.max(2) - 1));
    let ray = |cell: u32| {
        let (row, column) = (cell / params.columns, cell % params.columns);
        let azimuth = angle(column, params.columns, params.field_of_view_rad);
        (cell, unit(azimuth, angle(row, params.rows, params.vertical_field_of_view_rad)))
    };
    (0..params.columns * params.rows).map(ray).collect()
}

/// At equal times along the figure; each ray counts to the nearest cell of the grid.
fn lissajous(params: &Fx10Params) -> Vec<(u32, [f64; 3])> {
    let n = params.columns * params.rows;
    let nearest = |share: f64, cells: u32| ((0.5 - 0.5 * share) * f64::from(cells - 1) + 0.5) as u32;
    let ray = |i: u32| {
        let time = TAU * f64::from(i) / f64::from(n);
        let (across, up) = (libm::sin(ACROSS * time), libm::sin(UP_AND_DOWN * time + FRAC_PI_2));
        let cell = nearest(up, params.rows) * params.columns + nearest(across, params.columns);
        let [azimuth, elevation] = [across * params.field_of_view_rad, up * params.vertical_field_of_view_rad];
        (cell, unit(0.5 * azimuth, 0.5 * elevation))
    };
    (0..n).map(ray).collect()
}

fn unit(azimuth_rad: f64, elevation_rad: f64) -> [f64; 3] {
    let ((sa, ca), (se, ce)) = (libm::sincos(azimuth_rad), libm::sincos(elevation_rad));
    [ce * ca, ce * sa, se]
}

#[cfg(test)]
mod tests;
