//! One point per cell of a grid, so that a near stem counts no more than a far one.

use crate::perception::Points;

/// Thinned points, and which cells are taken.
#[derive(Debug, Clone)]
pub(crate) struct Thinned {
    /// The first point in each cell.
    pub(crate) points: Points,
    cell_m: f64,
    reach_m: f64,
    per_row: usize,
    taken: Vec<bool>,
    /// The cells that are taken.
    marked: Vec<usize>,
}

impl Thinned {
    /// Square cells of `cell_m`, up to `reach_m` ahead, behind and to each side.
    pub(crate) fn new(cell_m: f64, reach_m: f64) -> Self {
        let per_row = 2 * ((reach_m / cell_m) as usize + 1);
        let taken = vec![false; per_row * per_row];
        Self { points: Points::default(), cell_m, reach_m, per_row, taken, marked: Vec::new() }
    }

    /// Replaces the points by those of `points`.
    pub(crate) fn fill(&mut self, points: &Points) {
        self.points.clear();
        self.marked.drain(..).for_each(|cell| self.taken[cell] = false);
        for (x, y) in points.iter().filter(|(x, y)| x.abs() < self.reach_m && y.abs() < self.reach_m) {
            let cell = self.mirrored_cell(x) * self.per_row + self.mirrored_cell(y);
            if !self.taken[cell] {
                self.taken[cell] = true;
                self.marked.push(cell);
                self.points.push(x, y);
            }
        }
    }

    /// Cells on both sides of zero are mirror images.
    fn mirrored_cell(&self, value_m: f64) -> usize {
        2 * ((value_m.abs() / self.cell_m) as usize) + usize::from(value_m > 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_point_per_cell_is_kept_whatever_the_side() {
        let mut thinned = Thinned::new(0.03, 4.0);
        let mut points = Points::default();
        for x in [0.301, 0.302, 0.329, 0.331, -0.301, f64::NAN, 1e9] {
            points.push(x, 0.0);
        }
        for _ in 0..2 {
            thinned.fill(&points);
            assert_eq!(thinned.points.x_m, [0.301, 0.331, -0.301]);
        }
    }
}
