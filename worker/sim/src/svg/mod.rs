//! Drawings of a run, fit to be printed: axes in metres, start, path with direction, damage, and what was run.
//!
//! Sizes of marks and letters are given in units of which a drawing is 16 wide, whatever the field's size.

mod lane;
mod nursery;

use std::fmt::Write as _;

use crate::field::{Field, PlantKind};
use crate::run::LocatedNode;
use crate::{Pose, RunResult, Scenario, Seed};

/// Space around all that is drawn \[m\].
const SPACE_M: f64 = 0.7;
/// Width of a drawing \[units\].
const WIDTH: f64 = 16.0;
/// Room for the labels left of the axes, above and right of them, and below for labels, caption and key \[units\].
const LEFT: f64 = 1.1;
const EDGE: f64 = 0.3;
const BELOW: f64 = 2.3;
/// Stems are drawn at least this large \[units\]; the true radius is two centimetres.
const SMALLEST_STEM: f64 = 0.045;
/// Along the path from one arrow of travel to the next \[units\].
const ARROW_EVERY: f64 = 2.2;
/// The path is drawn in pieces of at least this length \[units\].
const PIECE: f64 = 0.04;
/// Of the drawing's nominal size.
const PIXELS_PER_UNIT: f64 = 60.0;
/// More ticks than this do not fit an axis.
const MOST_TICKS: f64 = 16.0;

const CROP: &str = "#2e7d32";
const WEED: &str = "#b8860b";
const DAMAGED: &str = "#d32f2f";
const PATH: &str = "#1f4e9c";
const START: &str = "#111";

/// Field, weeds, damaged plants, start and path of a run, seen from above, as an SVG document.
///
/// `path` holds the true poses in order, one every 0.05 s. x runs to the right, y upward, a metre is a metre both ways.
/// A lane is drawn in strips, with the cross-track error and the distances between interventions below.
#[must_use]
pub fn trajectory(scenario: &Scenario, seed: Seed, path: &[Pose], result: &RunResult) -> String {
    let field = scenario.field.build(seed.0);
    if let Some(lane) = &field.lane {
        return lane::run((&field, lane), path, result, &lane::caption(scenario, &field, seed, result));
    }
    if field.nursery.is_some() {
        return nursery::run(&field, path, &result.damaged, &nursery_caption(scenario, &field, seed, result));
    }
    let mut sheet = Sheet::new(&field, path);
    sheet.draw_axes();
    sheet.draw_plants(&field, &result.damaged);
    sheet.draw_path(path);
    sheet.draw_start(&field.start);
    sheet.draw_caption(&caption(scenario, &field, seed, result));
    sheet.draw_key(field.plants.iter().any(|plant| plant.kind == PlantKind::Weed), !result.damaged.is_empty());
    sheet.svg + "</svg>\n"
}

/// The graph of a run's poses over the map of its nursery; none of a run elsewhere, or without a graph.
#[must_use]
pub fn pose_graph(scenario: &Scenario, seed: Seed, nodes: &[LocatedNode], result: &RunResult) -> Option<String> {
    let field = scenario.field.build(seed.0);
    let nursery = field.nursery.as_ref().filter(|_| !nodes.is_empty())?;
    let caption = format!("{}; {} nodes", nursery_caption(scenario, &field, seed, result), nodes.len());
    Some(nursery::graph((&field, nursery), nodes, &caption))
}

/// What was run, and how much of the rows it covered.
fn nursery_caption(scenario: &Scenario, field: &Field, seed: Seed, result: &RunResult) -> String {
    let scenario = scenario.to_value();
    let kind = |part: &str| scenario[part]["kind"].as_str().unwrap_or_default().to_owned();
    let percent = |name: &str| result.metrics.get(name).copied().unwrap_or(0.0);
    format!(
        "{}, localization {}, {}, {}, seed {}: {}, {:.1} % covered, {:.1} % damaged, {:.0} s",
        kind("perception"),
        kind("localization"),
        kind("control"),
        field.name,
        seed.0,
        result.outcome.name(),
        percent("covered_rows_percent"),
        percent("damaged_plants_percent"),
        percent("simulated_s")
    )
}

/// The algorithm, the field, the seed and what became of the run.
fn caption(scenario: &Scenario, field: &Field, seed: Seed, result: &RunResult) -> String {
    let scenario = scenario.to_value();
    let kind = |part: &str| scenario[part]["kind"].as_str().unwrap_or_default().to_owned();
    let algorithm = if kind("perception") == "none" { kind("mission") } else { kind("perception") };
    let metric = |name: &str| result.metrics.get(name).copied().unwrap_or(0.0);
    let crushed = match result.damaged.len() {
        0 => String::new(),
        1 => ", 1 crop plant run over".to_owned(),
        several => format!(", {several} crop plants run over"),
    };
    format!(
        "{algorithm}, {}, seed {}: {}, {} of {} rows{crushed}, {:.0} s",
        field.name,
        seed.0,
        result.outcome.name(),
        metric("rows_completed"),
        field.inter_rows,
        metric("simulated_s")
    )
}

/// The drawing so far, and where the world lies on it.
struct Sheet {
    svg: String,
    /// The drawn part of the world \[m\].
    x_m: [f64; 2],
    y_m: [f64; 2],
    /// Metres to a unit.
    unit_m: f64,
}

impl Sheet {
    fn new(field: &Field, path: &[Pose]) -> Self {
        let plants = field.plants.iter().map(|plant| [plant.x_m, plant.y_m]);
        let rows = field.rows.iter().flat_map(|row| row.points().iter().copied());
        let poses = path.iter().chain([&field.start]).map(|pose| [pose.x_m, pose.y_m]);
        let (mut x_m, mut y_m) = ([f64::INFINITY, f64::NEG_INFINITY], [f64::INFINITY, f64::NEG_INFINITY]);
        for [x, y] in plants.chain(rows).chain(poses) {
            x_m = [x_m[0].min(x - SPACE_M), x_m[1].max(x + SPACE_M)];
            y_m = [y_m[0].min(y - SPACE_M), y_m[1].max(y + SPACE_M)];
        }
        let unit_m = (x_m[1] - x_m[0]) / (WIDTH - LEFT - EDGE);
        let height = (y_m[1] - y_m[0]) / unit_m + EDGE + BELOW;
        let svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{:.0}\" height=\"{:.0}\" viewBox=\"0 0 {WIDTH} {height:.3}\" \
             font-family=\"sans-serif\" font-size=\"0.26\">\n<rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n",
            WIDTH * PIXELS_PER_UNIT,
            height * PIXELS_PER_UNIT
        );
        Self { svg, x_m, y_m, unit_m }
    }

    fn push(&mut self, piece: std::fmt::Arguments<'_>) {
        self.svg.write_fmt(piece).expect("a text takes all");
        self.svg.push('\n');
    }

    /// A point of the world on the sheet \[units\]: y runs downward in SVG.
    fn place(&self, x_m: f64, y_m: f64) -> (f64, f64) {
        (LEFT + (x_m - self.x_m[0]) / self.unit_m, EDGE + (self.y_m[1] - y_m) / self.unit_m)
    }

    /// Where the frame around the world ends below \[units\].
    fn bottom(&self) -> f64 {
        self.place(0.0, self.y_m[0]).1
    }

    fn text(&mut self, place: (f64, f64), anchor: &str, text: &str) {
        write_text(&mut self.svg, place, anchor, text);
    }

    /// A frame with ticks, labelled in metres.
    fn draw_axes(&mut self) {
        let (bottom, width) = (self.bottom(), WIDTH - LEFT - EDGE);
        let frame = "fill=\"none\" stroke=\"#222\" stroke-width=\"0.025\"";
        let height = bottom - EDGE;
        self.push(format_args!("<rect x=\"{LEFT}\" y=\"{EDGE}\" width=\"{width}\" height=\"{height:.3}\" {frame}/>"));
        let step_m = step(self.x_m).max(step(self.y_m));
        let mut marks = String::new();
        for x_m in ticks(self.x_m, step_m) {
            let (x, _) = self.place(x_m, 0.0);
            write!(marks, "M {x:.3} {bottom:.3} v 0.1 ").expect("a text takes all");
            self.text((x, bottom + 0.36), "middle", &x_m.to_string());
        }
        for y_m in ticks(self.y_m, step_m) {
            let (_, y) = self.place(0.0, y_m);
            write!(marks, "M {LEFT} {y:.3} h -0.1 ").expect("a text takes all");
            self.text((LEFT - 0.16, y + 0.09), "end", &y_m.to_string());
        }
        self.push(format_args!("<path d=\"{}\" {frame}/>", marks.trim_end()));
        self.text((LEFT + width / 2.0, bottom + 0.72), "middle", "x [m]");
        let middle = f64::midpoint(EDGE, bottom);
        self.push(format_args!("<g transform=\"translate(0.3 {middle:.3}) rotate(-90)\">"));
        self.text((0.0, 0.0), "middle", "y [m]");
        self.svg.push_str("</g>\n");
    }

    fn draw_plants(&mut self, field: &Field, damaged: &[usize]) {
        for (i, plant) in field.plants.iter().enumerate() {
            let place = self.place(plant.x_m, plant.y_m);
            let radius = (plant.radius_m / self.unit_m).max(SMALLEST_STEM);
            match plant.kind {
                _ if damaged.contains(&i) => self.draw_damaged(place, radius),
                PlantKind::Crop => self.dot(place, radius, CROP),
                PlantKind::Weed => self.dot(place, radius, WEED),
            }
        }
    }

    fn dot(&mut self, (x, y): (f64, f64), radius: f64, colour: &str) {
        self.push(format_args!("<circle cx=\"{x:.3}\" cy=\"{y:.3}\" r=\"{radius:.3}\" fill=\"{colour}\"/>"));
    }

    fn draw_damaged(&mut self, (x, y): (f64, f64), radius: f64) {
        self.dot((x, y), radius, DAMAGED);
        let ring = format!("fill=\"none\" stroke=\"{DAMAGED}\" stroke-width=\"0.03\"");
        self.push(format_args!("<circle cx=\"{x:.3}\" cy=\"{y:.3}\" r=\"{:.3}\" {ring}/>", 3.0 * radius));
    }

    /// The path with arrows in the direction of travel, which is backward in every other row, and a square at its end.
    fn draw_path(&mut self, path: &[Pose]) {
        let mut points: Vec<(f64, f64)> = Vec::new();
        let mut arrows: Vec<((f64, f64), f64)> = Vec::new();
        let mut left = ARROW_EVERY / 2.0;
        for pose in path {
            let (x, y) = self.place(pose.x_m, pose.y_m);
            let Some((x_before, y_before)) = points.last().copied() else {
                points.push((x, y));
                continue;
            };
            let length = libm::hypot(x - x_before, y - y_before);
            if length >= PIECE {
                points.push((x, y));
                left -= length;
            }
            if left <= 0.0 {
                arrows.push(((x, y), libm::atan2(y - y_before, x - x_before)));
                left = ARROW_EVERY;
            }
        }
        let line: Vec<String> = points.iter().map(|(x, y)| format!("{x:.3},{y:.3}")).collect();
        let style = format!("fill=\"none\" stroke=\"{PATH}\" stroke-width=\"0.03\" stroke-linejoin=\"round\"");
        self.push(format_args!("<polyline points=\"{}\" {style}/>", line.join(" ")));
        arrows.into_iter().for_each(|(place, angle)| self.draw_arrow(place, angle));
        if let Some(end) = path.last() {
            self.draw_end(self.place(end.x_m, end.y_m));
        }
    }

    /// `angle` as on the sheet, clockwise from the right \[rad\].
    fn draw_arrow(&mut self, (x, y): (f64, f64), angle: f64) {
        let turn = angle.to_degrees();
        self.push(format_args!(
            "<path d=\"M 0.12 0 L -0.1 0.1 L -0.1 -0.1 Z\" fill=\"{PATH}\" transform=\"translate({x:.3} {y:.3}) rotate({turn:.1})\"/>"
        ));
    }

    fn draw_end(&mut self, (x, y): (f64, f64)) {
        let (x, y) = (x - 0.1, y - 0.1);
        self.push(format_args!("<rect x=\"{x:.3}\" y=\"{y:.3}\" width=\"0.2\" height=\"0.2\" fill=\"{PATH}\"/>"));
    }

    /// A circle where the robot starts, and a line in the direction in which it looks.
    fn draw_start(&mut self, start: &Pose) {
        self.draw_start_at(self.place(start.x_m, start.y_m), -start.heading_rad);
    }

    fn draw_start_at(&mut self, (x, y): (f64, f64), angle: f64) {
        let turn = angle.to_degrees();
        self.push(format_args!(
            "<g transform=\"translate({x:.3} {y:.3}) rotate({turn:.1})\" stroke=\"{START}\" stroke-width=\"0.05\">\
             <circle r=\"0.13\" fill=\"#fff\"/><path d=\"M 0 0 H 0.5 M 0.36 -0.11 L 0.5 0 L 0.36 0.11\" fill=\"none\"/></g>"
        ));
    }

    fn draw_caption(&mut self, caption: &str) {
        self.text((LEFT, self.bottom() + 1.35), "start", caption);
    }

    /// What the marks mean, as far as they are there.
    fn draw_key(&mut self, weeds: bool, damage: bool) {
        let marks: [(&str, bool, f64, Mark); 6] = [
            ("start and heading", true, 0.6, |sheet, place| sheet.draw_start_at(place, 0.0)),
            ("travel", true, 0.2, |sheet, place| sheet.draw_arrow(place, 0.0)),
            ("end", true, 0.2, Self::draw_end),
            ("crop plant", true, 0.15, |sheet, place| sheet.dot(place, 0.08, CROP)),
            ("weed", weeds, 0.15, |sheet, place| sheet.dot(place, 0.08, WEED)),
            ("crop plant run over", damage, 0.25, |sheet, place| sheet.draw_damaged(place, SMALLEST_STEM)),
        ];
        self.draw_marks(&marks);
    }

    /// A mark with its word, whether it is shown, and its width \[units\], one after the other.
    fn draw_marks(&mut self, marks: &[(&str, bool, f64, Mark)]) {
        let y = self.bottom() + 1.85;
        let mut x = LEFT + 0.15;
        for (word, _, width, draw) in marks.iter().copied().filter(|(_, shown, ..)| *shown) {
            draw(self, (x, y));
            self.text((x + width, y + 0.09), "start", word);
            x += width + 0.6 + 0.14 * word.len() as f64;
        }
    }
}

fn write_text(svg: &mut String, (x, y): (f64, f64), anchor: &str, text: &str) {
    let text = text.replace('&', "&amp;").replace('<', "&lt;");
    writeln!(svg, "<text x=\"{x:.3}\" y=\"{y:.3}\" text-anchor=\"{anchor}\" fill=\"#222\">{text}</text>")
        .expect("a text takes all");
}

/// Draws something at a place on the sheet.
type Mark = fn(&mut Sheet, (f64, f64));

/// The least of 0.5, 1, 2, 5, 10, 20, .. metres that does not crowd an axis.
fn step(range_m: [f64; 2]) -> f64 {
    let fits = |step: &f64| (range_m[1] - range_m[0]) / step <= MOST_TICKS;
    let decades = [1.0, 10.0, 100.0, 1_000.0, 10_000.0];
    let steps = decades.into_iter().flat_map(|decade| [0.5, 1.0, 2.0].map(|digit| digit * decade));
    steps.into_iter().find(fits).unwrap_or(range_m[1] - range_m[0])
}

/// The multiples of `step_m` within a range \[m\].
fn ticks([low, high]: [f64; 2], step_m: f64) -> impl Iterator<Item = f64> {
    let (first, last) = ((low / step_m).ceil() as i64, (high / step_m).floor() as i64);
    (first..=last).map(move |i| i as f64 * step_m)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use crate::{Part, Probe, simulate};

    #[derive(Default)]
    struct Path(Vec<Pose>);

    impl Probe for Path {
        fn begin(&mut self, _part: Part) {}

        fn pose(&mut self, _time_s: f64, world_from_robot: Pose) {
            self.0.push(world_from_robot);
        }
    }

    /// A robot that keeps its heading in a curved row runs plants over soon.
    fn drawing(name: &str) -> String {
        let plant = |x: f64, y: f64, row: i32| json!({"x_m": x, "y_m": y, "radius_m": 0.02, "height_m": 1.0, "kind": "crop", "row": row});
        let plants: Vec<_> = (0..20)
            .flat_map(|i| {
                let x = 0.3 * f64::from(i);
                [plant(x, 0.2 * x - 0.5, 0), plant(x, 0.2 * x + 0.5, 1)]
            })
            .collect();
        let rows = [-0.5, 0.5].map(|y| json!({"points_m": [[0.0, y], [6.0, y + 1.2]]}));
        let scenario = json!({
            "field": {"kind": "custom", "name": name, "row_spacing_m": 1.0, "rows": rows, "plants": plants,
                "start": {"x_m": 0.0, "y_m": 0.0, "heading_rad": 0.0}, "inter_rows": 1},
            "robot": {"kind": "two-wheeled"}, "sensors": {"kind": "two-planar-lidars"},
            "perception": {"kind": "none"}, "localization": {"kind": "row-filter"}, "control": {"kind": "fuzzy"},
            "mission": {"kind": "heading-hold"}, "observer": {"kind": "inter-rows"},
            "limits": {"kind": "simulated-time"}
        });
        let scenario = Scenario::from_value(scenario).unwrap();
        let mut path = Path::default();
        let result = simulate(&scenario, Seed(3), &mut path);
        trajectory(&scenario, Seed(3), &path.0, &result)
    }

    #[test]
    fn a_drawing_says_what_was_run_and_what_became_of_it() {
        let svg = drawing("slanted");
        assert!(svg.contains(">heading-hold, slanted, seed 3: "), "{svg}");
        assert!(svg.contains(" of 1 rows, ") && svg.contains("crop plants run over, "), "{svg}");
    }

    #[test]
    fn axes_start_travel_and_damage_are_marked_and_explained() {
        let svg = drawing("slanted");
        for words in ["x [m]", "y [m]", "start and heading", "travel", "end", "crop plant", "crop plant run over"] {
            assert!(svg.contains(&format!(">{words}</text>")), "{words}: {svg}");
        }
        assert!(!svg.contains(">weed</text>"));
        for tick in 0..=6 {
            assert!(svg.contains(&format!(">{tick}</text>")), "{tick}: {svg}");
        }
    }

    #[test]
    fn a_name_is_no_markup() {
        assert!(drawing("a<b>&c").contains("a&lt;b>&amp;c"));
    }

    #[test]
    fn ticks_are_round_and_few() {
        assert_eq!(
            (step([-0.7, 7.0]), step([-1.0, 12.7]), step([-2.0, 26.0]), step([0.0, 160.0])),
            (0.5, 1.0, 2.0, 10.0)
        );
        assert_eq!(ticks([-1.2, 2.0], 0.5).collect::<Vec<_>>(), [-1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0]);
        assert_eq!(ticks([-0.9, 0.9], 1.0).map(|tick| tick.to_string()).collect::<Vec<_>>(), ["0"]);
    }
}
