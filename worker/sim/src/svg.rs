//! Drawings of a run.

use std::fmt::Write as _;

use crate::field::{Field, PlantKind};
use crate::{Pose, RunResult, Scenario, Seed};

/// Space around the drawing \[m\].
const MARGIN_M: f64 = 1.0;
/// Room for title and key below the field \[m\].
const CAPTION_M: f64 = 1.1;
/// Stems are drawn at least this large \[m\]; the true radius is two centimetres.
const SMALLEST_STEM_M: f64 = 0.045;
/// Pixels per metre of the drawing's nominal size.
const PIXELS_PER_M: f64 = 60.0;

const GROUND: &str = "#faf8f3";
const CROP: &str = "#2e7d32";
const WEED: &str = "#b8860b";
const DAMAGED: &str = "#d32f2f";
const PATH: &str = "#1f4e9c";

/// Field, weeds, damaged plants and the path of a run, seen from above, as an SVG document.
///
/// `path` holds the true poses in order. x runs to the right, y upward, a metre is a metre both ways.
#[must_use]
pub fn trajectory(scenario: &Scenario, seed: Seed, path: &[Pose], result: &RunResult) -> String {
    let field = scenario.field.build(seed.0);
    let bounds = Bounds::of(&field, path);
    let mut svg = open(&bounds);
    draw_plants(&mut svg, &field, &result.damaged, &bounds);
    draw_path(&mut svg, path, &bounds);
    draw_caption(&mut svg, &field, seed, result, &bounds);
    svg.push_str("</svg>\n");
    svg
}

/// The drawn part of the world \[m\].
struct Bounds {
    x: [f64; 2],
    y: [f64; 2],
}

impl Bounds {
    fn of(field: &Field, path: &[Pose]) -> Self {
        let plants = field.plants.iter().map(|plant| (plant.x_m, plant.y_m));
        let rows = field.rows.iter().flat_map(|row| row.points().iter().map(|point| (point[0], point[1])));
        let poses = path.iter().map(|pose| (pose.x_m, pose.y_m));
        let mut bounds = Self { x: [f64::INFINITY, f64::NEG_INFINITY], y: [f64::INFINITY, f64::NEG_INFINITY] };
        for (x, y) in plants.chain(rows).chain(poses) {
            bounds.x = [bounds.x[0].min(x - MARGIN_M), bounds.x[1].max(x + MARGIN_M)];
            bounds.y = [bounds.y[0].min(y - MARGIN_M), bounds.y[1].max(y + MARGIN_M)];
        }
        bounds
    }

    fn width(&self) -> f64 {
        self.x[1] - self.x[0]
    }

    fn height(&self) -> f64 {
        self.y[1] - self.y[0]
    }

    /// Drawing coordinates: y runs downward in SVG.
    fn place(&self, x: f64, y: f64) -> (f64, f64) {
        (x - self.x[0], self.y[1] - y)
    }
}

fn open(bounds: &Bounds) -> String {
    let (width, height) = (bounds.width(), bounds.height() + CAPTION_M);
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{:.0}\" height=\"{:.0}\" viewBox=\"0 0 {width:.3} {height:.3}\" \
         font-family=\"sans-serif\">\n<rect width=\"100%\" height=\"100%\" fill=\"{GROUND}\"/>\n",
        width * PIXELS_PER_M,
        height * PIXELS_PER_M
    )
}

fn draw_plants(svg: &mut String, field: &Field, damaged: &[usize], bounds: &Bounds) {
    for (i, plant) in field.plants.iter().enumerate() {
        let (x, y) = bounds.place(plant.x_m, plant.y_m);
        let radius = plant.radius_m.max(SMALLEST_STEM_M);
        let colour = match plant.kind {
            _ if damaged.contains(&i) => DAMAGED,
            PlantKind::Crop => CROP,
            PlantKind::Weed => WEED,
        };
        push(svg, format_args!("<circle cx=\"{x:.3}\" cy=\"{y:.3}\" r=\"{radius:.3}\" fill=\"{colour}\"/>\n"));
        if damaged.contains(&i) {
            let ring = "fill=\"none\" stroke=\"#d32f2f\" stroke-width=\"0.03\"";
            push(svg, format_args!("<circle cx=\"{x:.3}\" cy=\"{y:.3}\" r=\"{:.3}\" {ring}/>\n", 3.0 * radius));
        }
    }
}

fn draw_path(svg: &mut String, path: &[Pose], bounds: &Bounds) {
    let (Some(first), Some(last)) = (path.first(), path.last()) else { return };
    let style = format!("fill=\"none\" stroke=\"{PATH}\" stroke-width=\"0.03\" stroke-linejoin=\"round\"");
    svg.push_str("<polyline points=\"");
    let mut drawn: Option<&Pose> = None;
    for pose in path {
        let moved = |from: &Pose| (pose.x_m - from.x_m).abs().max((pose.y_m - from.y_m).abs()) >= 0.01;
        if drawn.is_none_or(moved) {
            let (x, y) = bounds.place(pose.x_m, pose.y_m);
            push(svg, format_args!("{x:.3},{y:.3} "));
            drawn = Some(pose);
        }
    }
    push(svg, format_args!("\" {style}/>\n"));
    let (x, y) = bounds.place(first.x_m, first.y_m);
    push(
        svg,
        format_args!(
            "<circle cx=\"{x:.3}\" cy=\"{y:.3}\" r=\"0.12\" fill=\"{GROUND}\" stroke=\"{PATH}\" stroke-width=\"0.04\"/>\n"
        ),
    );
    let (x, y) = bounds.place(last.x_m, last.y_m);
    let turn = -last.heading_rad.to_degrees();
    push(
        svg,
        format_args!(
            "<path d=\"M 0.2 0 L -0.14 0.13 L -0.14 -0.13 Z\" fill=\"{PATH}\" transform=\"translate({x:.3} {y:.3}) rotate({turn:.1})\"/>\n"
        ),
    );
}

fn draw_caption(svg: &mut String, field: &Field, seed: Seed, result: &RunResult, bounds: &Bounds) {
    let y = bounds.height() + 0.25;
    let name = field.name.replace('&', "&amp;").replace('<', "&lt;");
    let time = result.metrics.get("simulated_s").copied().unwrap_or(0.0);
    let rows = result.metrics.get("rows_completed").copied().unwrap_or(0.0);
    let outcome = result.outcome.name();
    let words = format!("{name}, seed {}: {outcome}, {rows} of {} rows, {time:.0} s", seed.0, field.inter_rows);
    push(svg, format_args!("<text x=\"0.4\" y=\"{y:.3}\" font-size=\"0.32\" fill=\"#222\">{words}</text>\n"));
    let key = [(CROP, "crop"), (WEED, "weed"), (DAMAGED, "run over"), (PATH, "path, from circle to arrow")];
    let mut x = 0.5;
    for (colour, word) in key {
        let centre = y + 0.45;
        push(svg, format_args!("<circle cx=\"{x:.3}\" cy=\"{centre:.3}\" r=\"0.08\" fill=\"{colour}\"/>\n"));
        let (text_x, base) = (x + 0.16, centre + 0.09);
        push(
            svg,
            format_args!("<text x=\"{text_x:.3}\" y=\"{base:.3}\" font-size=\"0.26\" fill=\"#222\">{word}</text>\n"),
        );
        x += 0.6 + 0.15 * word.len() as f64;
    }
    let centre = y + 0.45;
    push(svg, format_args!("<path d=\"M {x:.3} {centre:.3} h 1\" stroke=\"#222\" stroke-width=\"0.04\"/>\n"));
    push(
        svg,
        format_args!(
            "<text x=\"{:.3}\" y=\"{:.3}\" font-size=\"0.26\" fill=\"#222\">1 m</text>\n",
            x + 1.1,
            centre + 0.09
        ),
    );
}

fn push(svg: &mut String, piece: std::fmt::Arguments<'_>) {
    svg.write_fmt(piece).expect("a text takes all");
}
