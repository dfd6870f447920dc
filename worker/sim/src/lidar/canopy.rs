//! The plants of a nursery for rays in space: a grid seen from above, cell by cell along each ray.
//!
//! Single precision only leaves out what a ray cannot meet: no range depends on it.

mod leaves;

use crate::field::vintu2018::{Crown, Pole, Shape};
use leaves::Leaves;

/// Side of a cell \[m\].
const CELL_M: f64 = 0.5;
/// Above the rounding error of a height in single precision \[m\].
const GUARD_M: f32 = 1e-3;

/// A ray in the world's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ray {
    /// Where it begins \[m\].
    pub origin: [f64; 3],
    /// Unit vector.
    pub direction: [f64; 3],
}

/// Plants ready for rays.
#[derive(Debug, Clone, PartialEq)]
pub struct Canopy {
    /// Lower corner of the first cell \[m\].
    from_m: [f64; 2],
    columns: usize,
    rows: usize,
    cells: Vec<Cell>,
    /// Bodies by cell.
    members: Vec<u32>,
    bodies: Vec<Body>,
    leaves: Leaves,
    slope: [f64; 2],
    /// No plant rises higher above the sloping plane \[m\].
    top_m: f64,
}

/// Which members a cell has, and how high they rise \[m\].
#[derive(Debug, Clone, Copy, PartialEq)]
struct Cell {
    first: u32,
    end: u32,
    top_z_m: f32,
}

/// A plant.
#[derive(Debug, Clone, PartialEq)]
struct Body {
    x_m: f64,
    y_m: f64,
    /// Square of the radius around all of it \[m^2\].
    reach2: f64,
    crown: Crown,
    per_radius: f64,
    per_half_height: f64,
    poles: [Option<Pole>; 2],
    /// What its leaves are drawn from.
    seed: u32,
}

/// Which bodies the ray at hand has been tried against: kept by the caller, so that nothing is allocated per scan.
#[derive(Debug, Clone, Default)]
pub struct Tried {
    ray: u32,
    by: Vec<u32>,
}

impl Tried {
    /// Begins a scan of fewer than 2^32 rays in `canopy`.
    pub fn begin(&mut self, canopy: &Canopy) {
        self.ray = 0;
        self.by.clear();
        self.by.resize(canopy.bodies.len(), 0);
    }

    /// Whether the body is new to the ray.
    fn first_time(&mut self, body: u32) -> bool {
        std::mem::replace(&mut self.by[body as usize], self.ray) != self.ray
    }
}

impl Canopy {
    /// The plants `shapes` on ground that rises by `slope` along x and y; where leaves are is a function of `seed`.
    #[must_use]
    pub fn new(shapes: &[Shape], slope: [f64; 2], seed: u64) -> Self {
        let bodies: Vec<Body> = shapes.iter().enumerate().map(|(i, shape)| Body::new(shape, seed, i as u32)).collect();
        let (mut from_m, mut to_m, mut top_m) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2], 0.0_f64);
        for (body, shape) in bodies.iter().zip(shapes) {
            let reach = body.reach2.sqrt();
            for (axis, at) in [body.x_m, body.y_m].into_iter().enumerate() {
                from_m[axis] = from_m[axis].min(at - reach);
                to_m[axis] = to_m[axis].max(at + reach);
            }
            let plane = slope[0] * body.x_m + slope[1] * body.y_m;
            top_m = top_m.max(shape.top_z_m() - plane + reach * (slope[0].abs() + slope[1].abs()) + f64::from(GUARD_M));
        }
        let cells = |axis: usize| ((to_m[axis] - from_m[axis]) / CELL_M).max(0.0) as usize + 1;
        let (columns, rows) = (cells(0), cells(1));
        let mut canopy = Self {
            from_m,
            columns,
            rows,
            cells: Vec::with_capacity(columns * rows),
            members: Vec::new(),
            bodies,
            leaves: Leaves::new(),
            slope,
            top_m,
        };
        canopy.fill(shapes);
        canopy
    }

    /// Lists the members of each cell: those whose circle around all of it touches the cell.
    fn fill(&mut self, shapes: &[Shape]) {
        let mut by_cell = vec![Vec::new(); self.columns * self.rows];
        for (member, body) in self.bodies.iter().enumerate() {
            let reach = body.reach2.sqrt();
            let cell = |at: f64, axis: usize| ((at - self.from_m[axis]) / CELL_M).max(0.0) as usize;
            let [i0, j0] = [cell(body.x_m - reach, 0), cell(body.y_m - reach, 1)];
            let [i1, j1] = [cell(body.x_m + reach, 0), cell(body.y_m + reach, 1)];
            for j in j0..=j1.min(self.rows - 1) {
                for i in i0..=i1.min(self.columns - 1) {
                    if self.touches(body, i, j) {
                        by_cell[j * self.columns + i].push(member as u32);
                    }
                }
            }
        }
        for members in by_cell {
            let first = self.members.len() as u32;
            let tops = members.iter().map(|member| shapes[*member as usize].top_z_m() as f32);
            let top_z_m = tops.fold(f32::NEG_INFINITY, f32::max) + GUARD_M;
            self.members.extend(members);
            self.cells.push(Cell { first, end: self.members.len() as u32, top_z_m });
        }
    }

    fn touches(&self, body: &Body, i: usize, j: usize) -> bool {
        let outside = |at: f64, i: usize, axis: usize| {
            let low = self.from_m[axis] + i as f64 * CELL_M;
            at - at.clamp(low, low + CELL_M)
        };
        let (dx, dy) = (outside(body.x_m, i, 0), outside(body.y_m, j, 1));
        // A ray may cross into a cell a rounding error early.
        dx * dx + dy * dy <= body.reach2 + f64::from(GUARD_M)
    }

    /// Where `ray` first meets a plant within `from` and `to` along it \[m\]; infinity where it meets none.
    #[must_use]
    pub fn cast(&self, ray: &Ray, [from, to]: [f64; 2], tried: &mut Tried) -> f64 {
        tried.ray += 1;
        if self.bodies.is_empty() {
            return f64::INFINITY;
        }
        let [mut enter, end] = self.clip(ray, [from, to]);
        if enter >= end {
            return f64::INFINITY;
        }
        let ([ox, oy, oz], [dx, dy, dz]) = (ray.origin, ray.direction);
        let mut x = Axis::new(ox, dx, self.from_m[0], self.columns, enter);
        let mut y = Axis::new(oy, dy, self.from_m[1], self.rows, enter);
        let mut first = f64::INFINITY;
        loop {
            let leave = x.next.min(y.next).min(end);
            let cell = &self.cells[(y.cell * self.columns as i32 + x.cell) as usize];
            let lowest_z = oz + dz * if dz > 0.0 { enter } else { leave };
            if lowest_z as f32 <= cell.top_z_m {
                for member in &self.members[cell.first as usize..cell.end as usize] {
                    if tried.first_time(*member) {
                        let until = first.min(to);
                        first = first.min(self.bodies[*member as usize].meet(ray, [from, until], &self.leaves));
                    }
                }
            }
            if leave >= end.min(first) {
                return first;
            }
            enter = leave;
            let inside = if x.next <= y.next { x.advance(self.columns) } else { y.advance(self.rows) };
            if !inside {
                return first;
            }
        }
    }

    /// The part of the ray that lies above the grid's cells and below the highest plant.
    fn clip(&self, ray: &Ray, [mut from, mut to]: [f64; 2]) -> [f64; 2] {
        let ([ox, oy, oz], [dx, dy, dz]) = (ray.origin, ray.direction);
        let above = oz - self.slope[0] * ox - self.slope[1] * oy - self.top_m;
        let rise = dz - self.slope[0] * dx - self.slope[1] * dy;
        if rise > 0.0 {
            to = to.min(-above / rise);
        } else if rise < 0.0 {
            from = from.max(-above / rise);
        } else if above > 0.0 {
            return [from, from];
        }
        for (o, d, low, cells) in [(ox, dx, self.from_m[0], self.columns), (oy, dy, self.from_m[1], self.rows)] {
            let high = low + cells as f64 * CELL_M;
            if d == 0.0 {
                if !(low..=high).contains(&o) {
                    return [from, from];
                }
                continue;
            }
            let (a, b) = ((low - o) / d, (high - o) / d);
            from = from.max(a.min(b));
            to = to.min(a.max(b));
        }
        [from, to]
    }
}

/// A ray's way from cell to cell along one axis.
struct Axis {
    cell: i32,
    step: i32,
    /// Where along the ray the next cell begins.
    next: f64,
    /// From cell to cell along the ray.
    every: f64,
}

impl Axis {
    fn new(origin: f64, direction: f64, low: f64, cells: usize, from: f64) -> Self {
        let at = ((origin + from * direction - low) / CELL_M).clamp(0.0, (cells - 1) as f64);
        let cell = at as i32;
        let step = if direction > 0.0 { 1 } else { -1 };
        if direction == 0.0 {
            return Self { cell, step, next: f64::INFINITY, every: f64::INFINITY };
        }
        let edge = low + f64::from(cell + i32::from(direction > 0.0)) * CELL_M;
        Self { cell, step, next: (edge - origin) / direction, every: CELL_M / direction.abs() }
    }

    /// Goes on to the next cell; false beyond the last.
    fn advance(&mut self, cells: usize) -> bool {
        self.cell += self.step;
        self.next += self.every;
        (0..cells as i32).contains(&self.cell)
    }
}

impl Body {
    fn new(shape: &Shape, seed: u64, number: u32) -> Self {
        let pole_reach = |pole: &Pole| libm::hypot(pole.x_m - shape.x_m, pole.y_m - shape.y_m) + pole.radius_m;
        let reach = shape.poles.iter().flatten().map(pole_reach).fold(shape.crown.radius_m, f64::max);
        Self {
            x_m: shape.x_m,
            y_m: shape.y_m,
            reach2: reach * reach,
            crown: shape.crown,
            per_radius: 1.0 / shape.crown.radius_m,
            per_half_height: 1.0 / shape.crown.half_height_m,
            poles: shape.poles,
            seed: leaves::seed(seed, number),
        }
    }

    /// Where the ray first meets the plant within `from` and `to`; infinity where it does not.
    fn meet(&self, ray: &Ray, [from, to]: [f64; 2], leaves: &Leaves) -> f64 {
        let ([ox, oy, oz], [dx, dy, dz]) = (ray.origin, ray.direction);
        let (x, y) = (ox - self.x_m, oy - self.y_m);
        let across = x * dy - y * dx;
        if across * across > self.reach2 * (dx * dx + dy * dy) {
            return f64::INFINITY;
        }
        let mut first = f64::INFINITY;
        for pole in self.poles.iter().flatten() {
            first = first.min(meet_pole(pole, ray, [from, to.min(first)]));
        }
        let (ex, ey, ez) = (x * self.per_radius, y * self.per_radius, (oz - self.crown.z_m) * self.per_half_height);
        let (fx, fy, fz) = (dx * self.per_radius, dy * self.per_radius, dz * self.per_half_height);
        let (a, b, c) = (fx * fx + fy * fy + fz * fz, ex * fx + ey * fy + ez * fz, ex * ex + ey * ey + ez * ez - 1.0);
        let square = b * b - a * c;
        if square <= 0.0 {
            return first;
        }
        let (root, per) = (square.sqrt(), 1.0 / a);
        let chord = [from.max((-b - root) * per), to.min(first).min((root - b) * per)];
        first.min(leaves.meet(ray, chord, self.crown.per_m, self.seed))
    }
}

/// Where a ray meets a pole from outside; infinity where it does not.
fn meet_pole(pole: &Pole, ray: &Ray, [from, to]: [f64; 2]) -> f64 {
    let ([ox, oy, oz], [dx, dy, dz]) = (ray.origin, ray.direction);
    let (x, y) = (ox - pole.x_m, oy - pole.y_m);
    let (a, b, c) = (dx * dx + dy * dy, x * dx + y * dy, x * x + y * y - pole.radius_m * pole.radius_m);
    let square = b * b - a * c;
    if square <= 0.0 {
        return f64::INFINITY;
    }
    let t = (-b - square.sqrt()) / a;
    let hit = t >= from && t < to && oz + t * dz <= pole.top_z_m;
    if hit { t } else { f64::INFINITY }
}

#[cfg(test)]
mod tests;
