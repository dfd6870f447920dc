//! Where the rays of a scan lie, and in which order they are fired.

use std::f64::consts::{FRAC_PI_2, TAU};

use super::{Fx10Params, Pattern};

/// Periods of the Lissajous figure in a scan, across and up and down. Ours.
const ACROSS: f64 = 33.0;
const UP_AND_DOWN: f64 = 20.0;

/// The rays in the LiDAR's frame, in the order of their cells.
#[derive(Debug, Clone)]
pub(super) struct Bundle {
    pub(super) cells: Vec<u32>,
    pub(super) directions: Vec<[f64; 3]>,
    /// When each is fired, as a share of the scan.
    pub(super) times: Vec<f64>,
    /// Rays lie within so many cells of the middle of theirs.
    pub(super) spread_cells: f32,
    /// The rays in firing order.
    pub(super) fired: Vec<u32>,
}

impl Bundle {
    /// The rays of the pattern.
    pub(super) fn new(params: &Fx10Params) -> Self {
        match params.pattern {
            Pattern::Uniform => Self::sorted(&uniform(params), 0.0),
            Pattern::Lissajous => Self::sorted(&lissajous(params), 0.5),
        }
    }

    /// Rays in firing order, at equal times: their cells and directions.
    fn sorted(fired: &[(u32, [f64; 3])], spread_cells: f32) -> Self {
        let n = fired.len();
        let mut by_cell: Vec<usize> = (0..n).collect();
        by_cell.sort_by_key(|i| fired[*i].0);
        let mut place = vec![0; n];
        by_cell.iter().enumerate().for_each(|(ray, i)| place[*i] = ray as u32);
        Self {
            cells: by_cell.iter().map(|i| fired[*i].0).collect(),
            directions: by_cell.iter().map(|i| fired[*i].1).collect(),
            times: by_cell.iter().map(|i| (i + 1) as f64 / n as f64).collect(),
            spread_cells,
            fired: place,
        }
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
