//! The ground of a nursery: a slope, smooth undulation, roughness, and a hole for each missing plant. All numbers are ours.

mod relief;

use furrow_navigation::random::Stream;

use crate::Pose;
pub(super) use relief::{Hole, Relief};

/// Distance between the nodes of the raster \[m\].
const STEP_M: f64 = 0.1;
const NODES_PER_M: f64 = 1.0 / STEP_M;
/// Nodes along a block, whose highest point lets rays skip it.
const BLOCK: usize = 4;
const BLOCK_M: f64 = BLOCK as f64 * STEP_M;
/// Rays that skip come this much nearer at least \[m\].
const LEAST_SKIP_M: f64 = 1e-6;
/// The raster reaches so far beyond the plants \[m\].
const MARGIN_M: f64 = 6.0;
/// Largest slope along x and along y.
const SLOPE: f64 = 0.03;
/// Depth of a hole as a share of its radius.
const HOLE_DEPTH: f64 = 0.6;
/// Length and width of what a robot stands on \[m\], and samples along each.
const STANDS_ON_M: [f64; 2] = [1.0, 0.8];
const SAMPLES: i32 = 5;

/// The ground: the bare plane through the origin outside of its raster.
#[derive(Debug, Clone, PartialEq)]
pub struct Terrain {
    slope: [f64; 2],
    /// The first node \[m\].
    from_m: [f64; 2],
    columns: usize,
    rows: usize,
    /// Height above the plane, x fastest \[m\].
    relief_m: Vec<f32>,
    /// The same without roughness, which tracks and wheels press flat \[m\].
    pressed_m: Vec<f32>,
    /// The highest relief in each block and its neighbours, 0 included: none within a block's length of any point
    /// in it is higher.
    tops_m: Vec<f32>,
    block_columns: usize,
    /// The lowest and the highest relief, 0 included \[m\].
    band_m: [f64; 2],
}

/// How a robot stands on the ground.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Standing {
    /// Height of the mean plane below its centre \[m\].
    pub z_m: f64,
    /// Left side up \[rad\].
    pub roll_rad: f64,
    /// Nose down \[rad\].
    pub pitch_rad: f64,
}

impl Terrain {
    /// Ground around the rectangle from, to (x, y) \[m\].
    pub(super) fn draw([from, to]: [[f64; 2]; 2], relief: &Relief<'_>, random: &mut Stream) -> Self {
        let from_m = from.map(|at| at - MARGIN_M);
        let nodes = |axis: usize| ((to[axis] + MARGIN_M - from_m[axis]) * NODES_PER_M).ceil() as usize + 1;
        let (columns, rows) = (nodes(0), nodes(1));
        let slope = [(); 2].map(|()| relief.factor * random.between(-SLOPE, SLOPE));
        let [relief_m, pressed_m] = relief.draw(from_m, [columns, rows], random);
        let block_columns = columns.div_ceil(BLOCK);
        let tops_m = Vec::new();
        let mut terrain =
            Self { slope, from_m, columns, rows, relief_m, pressed_m, tops_m, block_columns, band_m: [0.0; 2] };
        for hole in relief.holes {
            terrain.dig(hole);
        }
        terrain.find_tops();
        let bounds = terrain.relief_m.iter().fold([0.0_f32; 2], |[low, high], z| [low.min(*z), high.max(*z)]);
        terrain.band_m = bounds.map(f64::from);
        terrain
    }

    /// Rise per metre along x and along y of the plane.
    #[must_use]
    pub const fn slope(&self) -> [f64; 2] {
        self.slope
    }

    /// Height of the ground \[m\].
    #[must_use]
    pub fn height_m(&self, x_m: f64, y_m: f64) -> f64 {
        self.plane_m(x_m, y_m) + self.above_m(&self.relief_m, x_m, y_m)
    }

    fn plane_m(&self, x_m: f64, y_m: f64) -> f64 {
        self.slope[0] * x_m + self.slope[1] * y_m
    }

    /// How a robot stands there: on the mean plane of what is below it, without the roughness.
    #[must_use]
    pub fn ground(&self, world_from_robot: Pose) -> Standing {
        let half = f64::from(SAMPLES / 2);
        let [dx, dy] = STANDS_ON_M.map(|length| 0.5 * length / half);
        let (mut sum, mut along, mut across) = (0.0, 0.0, 0.0);
        for i in -SAMPLES / 2..=SAMPLES / 2 {
            for j in -SAMPLES / 2..=SAMPLES / 2 {
                let [x, y] = world_from_robot.world(f64::from(i) * dx, f64::from(j) * dy);
                let height = self.plane_m(x, y) + self.above_m(&self.pressed_m, x, y);
                sum += height;
                along += f64::from(i) * height;
                across += f64::from(j) * height;
            }
        }
        let n = f64::from(SAMPLES);
        // Sum of i^2 over all samples.
        let squares = n * 2.0 * half * (half + 1.0) * (2.0 * half + 1.0) / 6.0;
        Standing {
            z_m: sum / (n * n),
            roll_rad: libm::atan(across / (squares * dy)),
            pitch_rad: -libm::atan(along / (squares * dx)),
        }
    }

    /// From where along a ray within `from` and `to` it may meet the ground, and from where on all of it is below the
    /// ground; `to` if it does not get there \[m\].
    #[must_use]
    pub fn reach(&self, origin: [f64; 3], direction: [f64; 3], [from, to]: [f64; 2]) -> [f64; 2] {
        let [above, rise] = self.above_plane(origin, direction);
        let [low, high] = self.band_m;
        if rise < 0.0 {
            let per = 1.0 / rise;
            [from.max((high - above) * per), to.min((low - above) * per)]
        } else {
            [if above + rise * from <= high { from } else { f64::INFINITY }, to]
        }
    }

    /// Where a ray first meets the ground within `from` and `to`, to a few millimetres \[m\]; infinity where it does not.
    #[must_use]
    pub fn cast(&self, origin: [f64; 3], direction: [f64; 3], [from, to]: [f64; 2]) -> f64 {
        let [above, rise] = self.above_plane(origin, direction);
        let per = 1.0 / rise;
        let (u, v) = self.at_nodes(origin[0], origin[1]);
        let (du, dv) = (direction[0] * NODES_PER_M, direction[1] * NODES_PER_M);
        let (mut t, mut before) = (from, None);
        while t < to + STEP_M {
            let at = Place::new(u + t * du, v + t * dv);
            let height = above + rise * t;
            let top = self.top_m(at);
            if height > top {
                if rise >= 0.0 && height > self.band_m[1] {
                    return f64::INFINITY;
                }
                let at_top = if rise < 0.0 { (top - above) * per } else { f64::INFINITY };
                t = (t + BLOCK_M).min(at_top).max(t + LEAST_SKIP_M);
                before = None;
                continue;
            }
            let gap = height - self.raster_at(&self.relief_m, at);
            if gap <= 0.0 {
                // The relief is close to straight in between.
                let met = before.map_or(t, |before: f64| t - STEP_M * gap / (gap - before));
                return if met <= to { met } else { f64::INFINITY };
            }
            before = Some(gap);
            t += STEP_M;
        }
        f64::INFINITY
    }

    /// Height of a ray above the plane at its origin, and how much that grows per metre.
    fn above_plane(&self, origin: [f64; 3], direction: [f64; 3]) -> [f64; 2] {
        [origin, direction].map(|[x, y, z]| z - self.slope[0] * x - self.slope[1] * y)
    }

    /// Height above the plane, by one of the rasters \[m\].
    fn above_m(&self, raster: &[f32], x_m: f64, y_m: f64) -> f64 {
        let (u, v) = self.at_nodes(x_m, y_m);
        self.raster_at(raster, Place::new(u, v))
    }

    /// A place in steps from the first node.
    #[inline]
    fn at_nodes(&self, x_m: f64, y_m: f64) -> (f64, f64) {
        ((x_m - self.from_m[0]) * NODES_PER_M, (y_m - self.from_m[1]) * NODES_PER_M)
    }

    /// Whether the place has four nodes around it.
    #[inline]
    const fn is_inside(&self, at: Place) -> bool {
        (at.i as usize) < self.columns - 1 && (at.j as usize) < self.rows - 1
    }

    #[inline]
    fn raster_at(&self, raster: &[f32], at: Place) -> f64 {
        if !self.is_inside(at) {
            return 0.0;
        }
        let first = at.j as usize * self.columns + at.i as usize;
        let second = first + self.columns;
        let (near, far) = (&raster[first..first + 2], &raster[second..second + 2]);
        let (u, v) = ((at.u - f64::from(at.i)) as f32, (at.v - f64::from(at.j)) as f32);
        let (near, far) = (near[0] + u * (near[1] - near[0]), far[0] + u * (far[1] - far[0]));
        f64::from(near + v * (far - near))
    }

    /// No relief within a block's length is higher.
    #[inline]
    fn top_m(&self, at: Place) -> f64 {
        if !self.is_inside(at) {
            return self.band_m[1];
        }
        f64::from(self.tops_m[at.j as usize / BLOCK * self.block_columns + at.i as usize / BLOCK])
    }

    fn find_tops(&mut self) {
        let (columns, rows) = (self.block_columns, self.rows.div_ceil(BLOCK));
        let mut own = vec![0.0_f32; columns * rows];
        // A node at the edge of a block belongs to the block before, too.
        let blocks = |i: usize| i.saturating_sub(1) / BLOCK..=i / BLOCK;
        for (j, line) in self.relief_m.chunks_exact(self.columns).enumerate() {
            for (i, z) in line.iter().enumerate() {
                for block in blocks(j).flat_map(|j| blocks(i).map(move |i| j * columns + i)) {
                    own[block] = own[block].max(*z);
                }
            }
        }
        let around = |i: usize, n: usize| i.saturating_sub(1)..(i + 2).min(n);
        let top = |j: usize, i: usize| {
            let lines = around(j, rows).map(|j| &own[j * columns..(j + 1) * columns]);
            lines.flat_map(|line| &line[around(i, columns)]).fold(0.0_f32, |top, z| top.max(*z))
        };
        self.tops_m = (0..rows).flat_map(|j| (0..columns).map(move |i| (j, i))).map(|(j, i)| top(j, i)).collect();
    }

    /// Lowers the nodes within the hole.
    fn dig(&mut self, hole: &Hole) {
        let node = |at: f64, axis: usize| ((at - self.from_m[axis]) * NODES_PER_M).max(0.0) as usize;
        let [i0, j0] = [node(hole.x_m - hole.radius_m, 0), node(hole.y_m - hole.radius_m, 1)];
        let [i1, j1] = [node(hole.x_m + hole.radius_m, 0), node(hole.y_m + hole.radius_m, 1)];
        for j in j0..=(j1 + 1).min(self.rows - 1) {
            for i in i0..=(i1 + 1).min(self.columns - 1) {
                let dx = self.from_m[0] + i as f64 * STEP_M - hole.x_m;
                let dy = self.from_m[1] + j as f64 * STEP_M - hole.y_m;
                let inside = 1.0 - (dx * dx + dy * dy) / (hole.radius_m * hole.radius_m);
                let depth_m = (HOLE_DEPTH * hole.radius_m * inside.max(0.0)) as f32;
                self.relief_m[j * self.columns + i] -= depth_m;
                self.pressed_m[j * self.columns + i] -= depth_m;
            }
        }
    }
}

/// A place on the raster in steps from its first node, and the node before it; a huge one where that is negative.
#[derive(Debug, Clone, Copy)]
struct Place {
    u: f64,
    v: f64,
    i: u32,
    j: u32,
}

impl Place {
    #[inline]
    fn new(u: f64, v: f64) -> Self {
        // Rounded down, as a cast rounds towards zero.
        let before = |at: f64| ((at + 1.0) as i32).wrapping_sub(1) as u32;
        Self { u, v, i: before(u), j: before(v) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn terrain(roughness_m: f64, factor: f64, holes: &[Hole]) -> Terrain {
        let relief = Relief { roughness_m, factor, holes };
        Terrain::draw([[0.0, -1.0], [20.0, 10.0]], &relief, &mut Stream::new(3, "field-terrain"))
    }

    #[test]
    fn outside_of_the_raster_the_plane_goes_on() {
        let terrain = terrain(0.02, 1.0, &[]);
        let [a, b] = terrain.slope();
        assert!((a.abs() + b.abs()) > 0.0);
        for (x, y) in [(-50.0, 3.0), (5.0, 80.0), (1e9, -1e9), (-6.5, 0.0)] {
            assert_eq!(terrain.height_m(x, y), a * x + b * y);
        }
        assert!((terrain.height_m(-5.99, 2.0) - (a * -5.99 + b * 2.0)).abs() < 0.01);
    }

    #[test]
    fn a_hole_is_as_deep_and_as_wide_as_it_should_be() {
        let terrain = terrain(0.0, 0.0, &[Hole { x_m: 5.0, y_m: 2.0, radius_m: 0.25 }]);
        assert!((terrain.height_m(5.0, 2.0) + 0.15).abs() < 0.01);
        assert_eq!((terrain.height_m(5.4, 2.0), terrain.height_m(5.0, 1.6)), (0.0, 0.0));
    }

    #[test]
    fn a_robot_stands_as_the_plane_lies() {
        let mut plane = terrain(0.0, 0.0, &[]);
        plane.slope = [0.1, 0.0];
        let uphill = plane.ground(Pose { x_m: 4.0, y_m: 1.0, heading_rad: 0.0 });
        assert!((uphill.z_m - 0.4).abs() < 1e-12 && (uphill.pitch_rad + libm::atan(0.1)).abs() < 1e-9);
        assert!(uphill.roll_rad.abs() < 1e-9);
        let facing_y = plane.ground(Pose { x_m: 4.0, y_m: 1.0, heading_rad: std::f64::consts::FRAC_PI_2 });
        // The hill rises to its right.
        assert!((facing_y.roll_rad + libm::atan(0.1)).abs() < 1e-9 && facing_y.pitch_rad.abs() < 1e-9);
    }

    #[test]
    fn a_robot_presses_the_roughness_flat_and_dips_into_holes() {
        let hole = [Hole { x_m: 5.0, y_m: 2.0, radius_m: 0.25 }];
        let [rough, smooth] = [0.03, 0.0].map(|roughness_m| terrain(roughness_m, 1.0, &hole));
        for at in [(3.0, 1.0, 0.0), (3.1, 1.0, 0.0), (5.1, 2.2, 0.4)] {
            let (x_m, y_m, heading_rad) = at;
            assert!((rough.height_m(x_m, y_m) - smooth.height_m(x_m, y_m)).abs() > 1e-4);
            let at = Pose { x_m, y_m, heading_rad };
            assert_eq!(rough.ground(at), smooth.ground(at));
        }
        let over_the_hole = Pose { x_m: 5.0, y_m: 2.0, heading_rad: 0.0 };
        let without = terrain(0.03, 1.0, &[]).ground(over_the_hole);
        assert!(rough.ground(over_the_hole).z_m < without.z_m - 0.003);
    }

    #[test]
    fn a_ray_ends_on_the_ground() {
        let terrain = terrain(0.02, 1.0, &[Hole { x_m: 5.0, y_m: 2.0, radius_m: 0.25 }]);
        let (mut met, mut worst) = (0, 0.0_f64);
        for i in 0..2_000 {
            let (sin, cos) = libm::sincos(f64::from(i) * 0.1);
            let down = -0.02 - 0.5 * f64::from(i % 50) / 50.0;
            let length = f64::sqrt(1.0 + down * down);
            let (origin, direction) = ([8.0, 4.0, 1.0], [cos / length, sin / length, down / length]);
            let reach = terrain.reach(origin, direction, [0.3, 15.0]);
            let t = terrain.cast(origin, direction, reach);
            if t.is_finite() {
                let z = terrain.height_m(origin[0] + t * direction[0], origin[1] + t * direction[1]);
                worst = worst.max((origin[2] + t * direction[2] - z).abs());
                met += 1;
                // Between two steps a crest may be missed, no more.
                for k in 0..(t / 0.02) as i32 {
                    let [x, y, z] = [0, 1, 2].map(|axis| origin[axis] + 0.02 * f64::from(k) * direction[axis]);
                    assert!(z > terrain.height_m(x, y) - 0.015, "{k} of {t}");
                }
            } else {
                assert!(1.0 + 15.0 * direction[2] > -0.7, "a steep ray meets the ground");
            }
        }
        assert!(met > 1_500 && worst < 0.012, "{met} {worst}");
    }

    #[test]
    fn a_ray_that_rises_meets_nothing() {
        let terrain = terrain(0.02, 1.0, &[]);
        let (origin, direction) = ([8.0, 4.0, 1.5], [0.8, 0.0, 0.6]);
        assert!(terrain.cast(origin, direction, terrain.reach(origin, direction, [0.3, 15.0])).is_infinite());
    }
}
