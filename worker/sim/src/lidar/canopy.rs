//! The plants of a nursery for a bundle of rays: plant by plant, the nearest first, each against those rays that
//! can meet it.
//!
//! Single precision only leaves out what a ray cannot meet: no range depends on it.

mod body;
mod leaves;
mod window;

pub use window::{Grid, View};

use crate::field::vintu2018::Shape;
use body::{Foliage, Stem};
use leaves::Leaves;

/// Plants ready for rays.
#[derive(Debug, Clone, PartialEq)]
pub struct Canopy {
    foliage: Vec<Foliage>,
    stems: Vec<Stem>,
    leaves: Leaves,
}

/// The rays of one scan, in the order of their cells.
#[derive(Debug, Clone, Copy)]
pub struct Rays<'a> {
    /// Which rays lie where.
    pub grid: &'a Grid,
    /// Unit vectors in the world's frame: x, y, z.
    pub directions: [&'a [f64]; 3],
    /// No plant is met before \[m\].
    pub from_m: f64,
}

impl Rays<'_> {
    /// The direction of one of them.
    #[inline]
    #[must_use]
    pub fn direction(&self, ray: usize) -> [f64; 3] {
        let [x, y, z] = self.directions;
        [x[ray], y[ray], z[ray]]
    }
}

/// Room for the work of a scan, kept by the caller so that nothing is allocated once warm.
#[derive(Debug, Clone, Default)]
pub struct Room {
    /// Distance and index of what is in sight.
    near: Vec<(f32, u32)>,
    /// Rays that pass a plant's crown.
    passing: Vec<u32>,
}

impl Canopy {
    /// The plants `shapes`; where leaves are is a function of `seed`.
    #[must_use]
    pub fn new(shapes: &[Shape], seed: u64) -> Self {
        let foliage = |(number, shape): (usize, &Shape)| Foliage::new(shape, leaves::seed(seed, number as u32));
        Self {
            foliage: shapes.iter().enumerate().map(foliage).collect(),
            stems: shapes.iter().flat_map(|shape| shape.poles).flatten().map(Stem::new).collect(),
            leaves: Leaves::new(),
        }
    }

    /// Shortens `first_m` of each ray to where it first meets a plant, if that is nearer. Ray i begins at `origin(i)`,
    /// all of them within what `view` says.
    pub fn shorten(
        &self,
        view: &View,
        rays: Rays<'_>,
        origin: impl Fn(usize) -> [f64; 3],
        first_m: &mut [f64],
        room: &mut Room,
    ) {
        for stem in &self.stems {
            let Some(window) = stem.window(view, rays.grid) else { continue };
            for ray in window.rows.flat_map(|row| rays.grid.rays(row, &window.columns)) {
                let met = stem.meet(origin(ray), rays.direction(ray), [rays.from_m, first_m[ray]]);
                first_m[ray] = first_m[ray].min(met);
            }
        }
        self.find_near(view, room);
        for (_, index) in &room.near {
            let foliage = &self.foliage[*index as usize];
            let Some(window) = foliage.window(view, rays.grid) else { continue };
            for row in window.rows {
                let in_row = rays.grid.rays(row, &window.columns);
                room.passing.resize(in_row.len().max(room.passing.len()), 0);
                let mut n = 0;
                for ray in in_row {
                    room.passing[n] = ray as u32;
                    n += usize::from(foliage.chord(origin(ray), rays.direction(ray)).is_some());
                }
                for ray in room.passing[..n].iter().map(|ray| *ray as usize) {
                    let within = [rays.from_m, first_m[ray]];
                    let met = foliage.meet(origin(ray), rays.direction(ray), within, &self.leaves);
                    first_m[ray] = first_m[ray].min(met);
                }
            }
        }
    }

    /// What may be in sight, the nearest first: leaves behind others are then seldom looked at.
    fn find_near(&self, view: &View, room: &mut Room) {
        room.near.clear();
        for (index, foliage) in self.foliage.iter().enumerate() {
            if let Some(distance) = foliage.distance(view) {
                room.near.push((distance, index as u32));
            }
        }
        room.near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    }
}

#[cfg(test)]
mod tests;
