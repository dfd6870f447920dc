//! Which rays of a scan can meet a body: by the bearings of its outline, and the cells of rays around these.

use std::f32::consts::PI;
use std::ops::Range;

use crate::lidar::frame::Frame;
use crate::lidar::stems::approximate_atan2;

/// Part of a cell that is above the error of a bearing.
const GUARD_CELLS: f32 = 0.01;
/// All bearings.
pub(super) const ALL: [f32; 2] = [-PI, PI];

/// The rays by cell: columns at equal angles from left to right, rows from above to below.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    columns: usize,
    rows: usize,
    /// Horizontal and vertical field of view \[rad\].
    view_rad: [f32; 2],
    /// Rays lie within so many cells of the middle of theirs.
    spread_cells: f32,
    /// First ray of each cell, and the end of all.
    starts: Vec<u32>,
}

/// Cells.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Window {
    pub(super) columns: Range<usize>,
    pub(super) rows: Range<usize>,
}

/// From where the rays are cast.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    frame: Frame,
    /// No ray begins farther from there \[m\].
    moved_m: f32,
    /// Nor is turned farther \[rad\].
    turned_rad: f32,
    range_max_m: f64,
    /// Square of the sine between the frame's z axis and the vertical, an upper bound.
    pub(super) tilt2: f64,
}

impl Grid {
    /// A grid over the field of view, horizontal and vertical, of rays whose `cells` rise; they lie within
    /// `spread_cells` of the middle of theirs.
    #[must_use]
    pub fn new(
        [columns, rows]: [u32; 2],
        view_rad: [f64; 2],
        spread_cells: f32,
        cells: impl Iterator<Item = u32>,
    ) -> Self {
        let mut starts = vec![0; (columns * rows) as usize + 1];
        cells.for_each(|cell| starts[cell as usize + 1] += 1);
        for cell in 1..starts.len() {
            starts[cell] += starts[cell - 1];
        }
        let view_rad = view_rad.map(|view| view as f32);
        Self { columns: columns as usize, rows: rows as usize, view_rad, spread_cells, starts }
    }

    /// The rays of some columns of a row.
    pub(super) fn rays(&self, row: usize, columns: &Range<usize>) -> Range<usize> {
        let [first, end] = [columns.start, columns.end].map(|column| self.starts[row * self.columns + column]);
        first as usize..end as usize
    }

    /// The cells between bearings from, to \[rad\]; none where there are none.
    pub(super) fn window(&self, azimuth: [f32; 2], elevation: [f32; 2]) -> Option<Window> {
        let columns = self.cells(azimuth, self.view_rad[0], self.columns);
        let rows = self.cells(elevation, self.view_rad[1], self.rows);
        (!columns.is_empty() && !rows.is_empty()).then_some(Window { columns, rows })
    }

    /// The largest angle comes first.
    fn cells(&self, [from, to]: [f32; 2], view: f32, n: usize) -> Range<usize> {
        let cell = |angle: f32| (0.5 - angle / view) * (n - 1) as f32;
        let spare = self.spread_cells + GUARD_CELLS;
        // A cast of what is negative gives 0.
        let first = (cell(to) - spare).ceil() as usize;
        let end = (cell(from) + spare + 1.0) as usize;
        first.min(n)..end.min(n)
    }
}

impl View {
    /// All rays begin within `moved_m` of `frame`, turned by at most `turned_rad`, and end at `range_max_m`.
    #[must_use]
    pub fn new(frame: Frame, [moved_m, turned_rad]: [f64; 2], range_max_m: f64) -> Self {
        let upright = frame.axes[2][2];
        let tilt2 = (1.0 - upright * upright).max(0.0).sqrt() + turned_rad;
        let tilt2 = tilt2 * tilt2;
        Self { frame, moved_m: moved_m as f32, turned_rad: turned_rad as f32, range_max_m, tilt2 }
    }

    /// Where all rays end \[m\].
    #[must_use]
    pub const fn range_max_m(&self) -> f64 {
        self.range_max_m
    }

    /// From here to a body within `radius_m` of `centre`; none if it is all out of range or behind.
    pub(super) fn distance(&self, centre: [f64; 3], radius_m: f64) -> Option<f32> {
        let reach = self.range_max_m + radius_m + f64::from(self.moved_m);
        let [x, y, z] = [0, 1, 2].map(|k| centre[k] - self.frame.origin[k]);
        let distance2 = x * x + y * y + z * z;
        (distance2 <= reach * reach).then(|| (distance2 as f32).sqrt())
    }

    /// Azimuths and elevations from, to \[rad\] of all that is within `width_m` of the line along the frame's z axis
    /// through `centre`, and within `radius_m` of `centre`.
    pub(super) fn bearings(&self, centre: [f64; 3], [width_m, radius_m]: [f64; 2]) -> [[f32; 2]; 2] {
        let [x, y, z] = self.frame.local(centre).map(|at| at as f32);
        let horizontal2 = x * x + y * y;
        let around = |angle: f32, half: Option<f32>| {
            half.map_or(ALL, |half| [angle - half - self.turned_rad, angle + half + self.turned_rad])
        };
        let azimuth = around(approximate_atan2(y, x), self.half_width(horizontal2, width_m));
        let elevation =
            around(approximate_atan2(z, horizontal2.sqrt()), self.half_width(horizontal2 + z * z, radius_m));
        [azimuth, elevation]
    }

    /// Above the half-width asin(r / d) of a circle: its tangent r / sqrt(d^2 - r^2). None from inside.
    fn half_width(&self, distance2: f32, radius_m: f64) -> Option<f32> {
        let radius = radius_m as f32 + self.moved_m;
        let touch2 = distance2 - radius * radius;
        (touch2 > 1e-4 * distance2).then(|| radius / touch2.sqrt())
    }
}
