//! How uneven the ground is: undulation and roughness, drawn node by node.

use std::f64::consts::TAU;

use furrow_navigation::random::Stream;

use super::STEP_M;

/// The relief fades into the bare plane over so much of the raster \[m\].
const FADE_M: f64 = 1.0;
/// Waves of the undulation, their lengths and their standard deviation together \[m\]: the thesis' simulation had no large differences
/// in soil height (section 4.4.2).
const WAVES: u32 = 4;
const WAVE_LENGTH_M: [f64; 2] = [8.0, 20.0];
const UNDULATION_M: f64 = 0.01;
/// What weights 1, 2, 1 across and along leave of the standard deviation of independent values.
const SMOOTHED: f64 = 0.375;

/// A bowl in the soil.
pub(in super::super) struct Hole {
    pub x_m: f64,
    pub y_m: f64,
    pub radius_m: f64,
}

/// What the ground is made of.
pub(in super::super) struct Relief<'a> {
    /// Standard deviation of the roughness \[m\].
    pub roughness_m: f64,
    /// Of slope, undulation and roughness.
    pub factor: f64,
    pub holes: &'a [Hole],
}

impl Relief<'_> {
    /// Heights above the plane of `nodes` columns and rows from `from_m`, without holes \[m\]: with the roughness, and without it.
    pub(super) fn draw(&self, from_m: [f64; 2], nodes: [usize; 2], random: &mut Stream) -> [Vec<f32>; 2] {
        let [columns, rows] = nodes;
        let undulation = Undulation::draw(from_m, nodes, self.factor, random);
        let rough = roughness(nodes, self.factor * self.roughness_m, random);
        [rough, vec![0.0; columns * rows]].map(|mut relief_m| {
            for (j, line) in relief_m.chunks_exact_mut(columns).enumerate() {
                undulation.add(j, line);
                for (i, node) in line.iter_mut().enumerate() {
                    *node *= fade(i, columns).min(fade(j, rows));
                }
            }
            relief_m
        })
    }
}

/// From 0 at the raster's edge to 1 inside.
fn fade(i: usize, n: usize) -> f32 {
    let from_edge = i.min(n - 1 - i) as f32 * (STEP_M / FADE_M) as f32;
    from_edge.min(1.0)
}

/// Smoothed independent values of standard deviation `sd_m`.
fn roughness([columns, rows]: [usize; 2], sd_m: f64, random: &mut Stream) -> Vec<f32> {
    let mut deviates = vec![0.0; columns];
    let mut nodes = vec![0.0_f32; columns * rows];
    for line in nodes.chunks_exact_mut(columns) {
        random.normals(&mut deviates);
        for (i, node) in line.iter_mut().enumerate().take(columns - 1).skip(1) {
            let smooth = 0.25 * (deviates[i - 1] + 2.0 * deviates[i] + deviates[i + 1]);
            *node = (smooth * sd_m / SMOOTHED) as f32;
        }
    }
    let mut smooth = vec![0.0_f32; columns * rows];
    for j in 1..rows - 1 {
        let [before, at, after] = [j - 1, j, j + 1].map(|j| &nodes[j * columns..(j + 1) * columns]);
        for (((smooth, a), b), c) in smooth[j * columns..].iter_mut().zip(before).zip(at).zip(after) {
            *smooth = 0.25 * (a + 2.0 * b + c);
        }
    }
    smooth
}

/// A few standing waves, as factors by column and by row.
struct Undulation {
    waves: Vec<[Vec<f64>; 2]>,
}

impl Undulation {
    fn draw(from_m: [f64; 2], nodes: [usize; 2], factor: f64, random: &mut Stream) -> Self {
        // Each factor has a mean square of 1 / 2.
        let amplitude = factor * UNDULATION_M * 2.0 / f64::from(WAVES).sqrt();
        let mut wave = |axis: usize| {
            let number = TAU / random.between(WAVE_LENGTH_M[0], WAVE_LENGTH_M[1]);
            let phase = random.between(0.0, TAU);
            let scale = if axis == 0 { amplitude } else { 1.0 };
            let at = |i: usize| scale * libm::sin(number * (from_m[axis] + i as f64 * STEP_M) + phase);
            (0..nodes[axis]).map(at).collect()
        };
        Self { waves: (0..WAVES).map(|_| [wave(0), wave(1)]).collect() }
    }

    fn add(&self, j: usize, line: &mut [f32]) {
        for [by_column, by_row] in &self.waves {
            for (node, wave) in line.iter_mut().zip(by_column) {
                *node += (wave * by_row[j]) as f32;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roughness_has_its_standard_deviation() {
        let nodes = roughness([500, 500], 0.02, &mut Stream::new(1, "field-terrain"));
        let inner = nodes.chunks_exact(500).skip(1).take(498).flat_map(|line| &line[1..499]);
        let sum: f64 = inner.map(|z| f64::from(*z) * f64::from(*z)).sum();
        assert!((f64::sqrt(sum / (498.0 * 498.0)) - 0.02).abs() < 0.0004);
    }
}
