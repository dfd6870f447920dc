//! A run along a lane: the lane from above in strips, the cross-track error along it, and the distances driven between
//! interventions, as in figures 9 to 12 of Velasquez et al. (2022).
//!
//! The lane is drawn straight: along its middle to the right, across it upward.

use std::fmt::Write as _;

use super::{CROP, EDGE, LEFT, PATH, PIXELS_PER_UNIT, WEED, WIDTH, step, ticks, write_text};
use crate::field::lane::FoliageKind;
use crate::field::{Field, Lane, Polyline};
use crate::observer::Cause;
use crate::{Pose, RunResult, Scenario, Seed};

/// Length of a strip, and what is drawn of the lane to either side of its middle \[m\].
const STRIP_M: f64 = 25.0;
const SIDE_M: f64 = 0.75;
/// Height of the chart, and its range to either side \[units\], \[m\].
const CHART: f64 = 3.0;
const CHART_M: f64 = 0.4;
/// From one bar to the next \[units\].
const BAR: f64 = 0.2;
/// Between the parts of the sheet \[units\].
const SPACE: f64 = 1.0;
/// A robot that is farther from where it was a sample ago was put there \[m\].
const JUMP_M: f64 = 0.2;
const LEAF: &str = "#8bc34a";
const STALK: &str = "#a1887f";

/// The whole sheet.
pub(super) fn run((field, lane): (&Field, &Lane), path: &[Pose], result: &RunResult, caption: &str) -> String {
    let track = Track::new(field, lane, path, result);
    let strips = (lane.length_m / STRIP_M).ceil().max(1.0);
    let strip_height = 2.0 * SIDE_M * (WIDTH - LEFT - EDGE) / STRIP_M + 0.35;
    let chart_top = EDGE + strips * strip_height + SPACE;
    let bars_top = chart_top + CHART + SPACE;
    let bars_height = BAR * track.stretches.len() as f64 + 0.1;
    let height = bars_top + bars_height + SPACE + 1.0;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{:.0}\" height=\"{:.0}\" viewBox=\"0 0 {WIDTH} {height:.3}\" \
         font-family=\"sans-serif\" font-size=\"0.26\">\n<rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n",
        WIDTH * PIXELS_PER_UNIT,
        height * PIXELS_PER_UNIT
    );
    for strip in 0..strips as u32 {
        let from_m = f64::from(strip) * STRIP_M;
        let top = EDGE + f64::from(strip) * strip_height;
        let frame = Frame::new(top, strip_height - 0.35, [from_m, from_m + STRIP_M], [-SIDE_M, SIDE_M]);
        draw_strip(&mut svg, &frame, (field, lane), &track);
    }
    draw_chart(&mut svg, &Frame::new(chart_top, CHART, [0.0, lane.length_m], [-CHART_M, CHART_M]), &track);
    let longest_m = track.stretches.iter().map(|(length_m, _)| *length_m).fold(1.0, f64::max);
    draw_bars(&mut svg, &Frame::new(bars_top, bars_height, [0.0, longest_m], [0.0, 1.0]), &track);
    write_text(&mut svg, (LEFT, height - 0.7), "start", caption);
    draw_key(&mut svg, height - 0.25);
    svg + "</svg>\n"
}

/// System, lane, seed and what became of the run.
pub(super) fn caption(scenario: &Scenario, field: &Field, seed: Seed, result: &RunResult) -> String {
    let scenario = scenario.to_value();
    let kind = |part: &str| scenario[part]["kind"].as_str().unwrap_or_default().to_owned();
    let metric = |name: &str| result.metrics.get(name).copied().unwrap_or(0.0);
    let guide = scenario["control"]["guide"].as_str().unwrap_or_default();
    format!(
        "{}, {}, {guide} at {} Hz, {}, seed {}: {}, {:.0} m, {} interventions, cross-track error {:.3} m rms",
        kind("perception"),
        kind("localization"),
        scenario["sensors"]["rate_hz"],
        field.name,
        seed.0,
        result.outcome.name(),
        metric("distance_m"),
        result.interventions.len(),
        metric("cross_track_rms_m")
    )
}

/// A run along a straightened lane.
struct Track {
    /// Pieces without an intervention, each of (along, across) \[m\].
    pieces: Vec<Vec<(f64, f64)>>,
    /// Where interventions were, and why.
    interventions: Vec<(f64, f64, Cause)>,
    /// Distances driven without an intervention, and what ended them \[m\].
    stretches: Vec<(f64, Cause)>,
}

impl Track {
    fn new(field: &Field, lane: &Lane, path: &[Pose], result: &RunResult) -> Self {
        let middle = lane.middle(field);
        let (mut pieces, mut piece, mut before, mut near_m) = (Vec::new(), Vec::new(), None::<Pose>, 0.0);
        for pose in path {
            if before.is_some_and(|before| libm::hypot(pose.x_m - before.x_m, pose.y_m - before.y_m) > JUMP_M) {
                pieces.push(std::mem::take(&mut piece));
            }
            let place = straightened(middle, [pose.x_m, pose.y_m], near_m);
            near_m = place.0;
            piece.push(place);
            before = Some(*pose);
        }
        pieces.push(piece);
        let at = |pose: Pose, along_m: f64| straightened(middle, [pose.x_m, pose.y_m], along_m);
        let interventions = result.interventions.iter().map(|i| {
            let (along_m, across_m) = at(i.pose, i.along_m);
            (along_m, across_m, i.cause)
        });
        let driven = |piece: &Vec<(f64, f64)>| piece.last().map_or(0.0, |last| last.0) - piece[0].0;
        let causes = result.interventions.iter().map(|intervention| intervention.cause);
        let stretches = pieces.iter().filter(|piece| !piece.is_empty()).map(driven).zip(causes).collect();
        Self { interventions: interventions.collect(), stretches, pieces }
    }
}

fn straightened(middle: &Polyline, [x_m, y_m]: [f64; 2], near_m: f64) -> (f64, f64) {
    let place = middle.project_near(x_m, y_m, near_m);
    (place.along_m, place.across_m)
}

/// A rectangle on the sheet and what it shows.
struct Frame {
    top: f64,
    height: f64,
    x: [f64; 2],
    y: [f64; 2],
}

impl Frame {
    const fn new(top: f64, height: f64, x: [f64; 2], y: [f64; 2]) -> Self {
        Self { top, height, x, y }
    }

    fn place(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let across = (x - self.x[0]) / (self.x[1] - self.x[0]);
        let up = (y.clamp(self.y[0], self.y[1]) - self.y[0]) / (self.y[1] - self.y[0]);
        (LEFT + across * (WIDTH - LEFT - EDGE), self.top + (1.0 - up) * self.height)
    }

    fn shows(&self, (x, y): (f64, f64)) -> bool {
        (self.x[0]..=self.x[1]).contains(&x) && (self.y[0]..=self.y[1]).contains(&y)
    }

    /// The rectangle and ticks along it.
    fn draw(&self, svg: &mut String) {
        let (width, style) = (WIDTH - LEFT - EDGE, "fill=\"none\" stroke=\"#222\" stroke-width=\"0.02\"");
        put(
            svg,
            format_args!(
                "<rect x=\"{LEFT}\" y=\"{:.3}\" width=\"{width}\" height=\"{:.3}\" {style}/>",
                self.top, self.height
            ),
        );
        let bottom = self.top + self.height;
        for tick in ticks(self.x, step(self.x)) {
            let (x, _) = self.place((tick, 0.0));
            put(svg, format_args!("<path d=\"M {x:.3} {bottom:.3} v 0.06\" {style}/>"));
            write_text(svg, (x, bottom + 0.28), "middle", &tick.to_string());
        }
    }

    /// Lines through points; strokes of no length are dots.
    fn draw_lines(&self, svg: &mut String, lines: &[Vec<(f64, f64)>], colour: &str, width: f64) {
        let mut path = String::new();
        for line in lines {
            for (i, point) in line.iter().enumerate() {
                let (x, y) = self.place(*point);
                write!(path, "{}{x:.2} {y:.2}", if i == 0 { 'M' } else { 'L' }).expect("a text takes all");
            }
        }
        let style = format!("fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\" stroke-linecap=\"round\"");
        put(svg, format_args!("<path d=\"{path}\" {style}/>"));
    }
}

fn put(svg: &mut String, piece: std::fmt::Arguments<'_>) {
    svg.write_fmt(piece).expect("a text takes all");
    svg.push('\n');
}

fn draw_strip(svg: &mut String, frame: &Frame, (field, lane): (&Field, &Lane), track: &Track) {
    frame.draw(svg);
    let middle = lane.middle(field);
    let [from_m, to_m] = frame.x;
    for kind in [FoliageKind::Weed, FoliageKind::Stalk, FoliageKind::Leaf] {
        let all = lane.foliage_within(from_m, to_m).iter().filter(|foliage| foliage.kind == kind);
        let ends = all.map(|foliage| [foliage.from_m, foliage.to_m].map(|end| straight(middle, end)));
        let lines: Vec<_> = ends.filter(|ends| ends.iter().all(|end| frame.shows(*end))).map(Vec::from).collect();
        frame.draw_lines(svg, &lines, foliage_colour(kind), 0.02);
    }
    let plants = lane.plants_within(&field.plants, from_m, to_m);
    let dots = plants.iter().map(|plant| straight(middle, [plant.x_m, plant.y_m]));
    let dots: Vec<_> = dots.filter(|dot| frame.shows(*dot)).map(|dot| vec![dot, dot]).collect();
    frame.draw_lines(svg, &dots, CROP, 0.04);
    let within = |piece: &Vec<(f64, f64)>| piece.iter().copied().filter(|place| frame.shows(*place)).collect();
    let pieces: Vec<_> = track.pieces.iter().map(within).collect();
    frame.draw_lines(svg, &pieces, PATH, 0.03);
    for (along_m, across_m, cause) in &track.interventions {
        if (from_m..=to_m).contains(along_m) {
            draw_cross(svg, frame.place((*along_m, *across_m)), colour(*cause));
        }
    }
}

/// Where a point is along and across a line that has to be searched for it \[m\].
fn straight(middle: &Polyline, [x_m, y_m]: [f64; 2]) -> (f64, f64) {
    let place = middle.project(x_m, y_m);
    (place.along_m, place.across_m)
}

fn draw_cross(svg: &mut String, (x, y): (f64, f64), colour: &str) {
    let (x, y) = (x - 0.1, y - 0.1);
    put(
        svg,
        format_args!(
            "<path d=\"M {x:.3} {y:.3} l 0.2 0.2 m -0.2 0 l 0.2 -0.2\" stroke=\"{colour}\" stroke-width=\"0.06\"/>"
        ),
    );
}

fn draw_chart(svg: &mut String, frame: &Frame, track: &Track) {
    frame.draw(svg);
    for tick in ticks(frame.y, 0.2) {
        let (x, y) = frame.place((frame.x[0], tick));
        write_text(svg, (x - 0.1, y + 0.09), "end", &format!("{tick:.1}"));
    }
    for (along_m, _, cause) in &track.interventions {
        let (x, _) = frame.place((*along_m, 0.0));
        let style = format!("stroke=\"{}\" stroke-width=\"0.03\"", colour(*cause));
        put(svg, format_args!("<path d=\"M {x:.3} {:.3} v {:.3}\" {style}/>", frame.top, frame.height));
    }
    frame.draw_lines(svg, &track.pieces, PATH, 0.02);
    write_text(
        svg,
        (WIDTH / 2.0, frame.top - 0.12),
        "middle",
        "cross-track error of the robot's centre [m] along the lane [m]",
    );
}

fn draw_bars(svg: &mut String, frame: &Frame, track: &Track) {
    frame.draw(svg);
    for (i, (length_m, cause)) in track.stretches.iter().enumerate() {
        let (end, _) = frame.place((*length_m, 0.0));
        let (y, width) = (frame.top + 0.05 + BAR * i as f64, (end - LEFT).max(0.0));
        let colour = colour(*cause);
        put(
            svg,
            format_args!(
                "<rect x=\"{LEFT}\" y=\"{y:.3}\" width=\"{width:.3}\" height=\"{:.3}\" fill=\"{colour}\"/>",
                0.8 * BAR
            ),
        );
    }
    write_text(svg, (WIDTH / 2.0, frame.top - 0.12), "middle", "distances until an intervention [m]");
}

/// What colours mean.
fn draw_key(svg: &mut String, y: f64) {
    let causes = [
        Cause::EndOfLane,
        Cause::BadStart,
        Cause::Gap,
        Cause::Perception(crate::observer::SubCause::Heading),
        Cause::Control,
    ];
    let marks = causes.map(|cause| (cause.name(), colour(cause)));
    let growth = [("stem", CROP), ("leaf", LEAF), ("fallen stalk", STALK), ("weed", WEED), ("path", PATH)];
    let mut x = LEFT;
    for (word, colour) in marks.into_iter().chain(growth) {
        put(
            svg,
            format_args!("<rect x=\"{x:.3}\" y=\"{:.3}\" width=\"0.2\" height=\"0.2\" fill=\"{colour}\"/>", y - 0.18),
        );
        write_text(svg, (x + 0.28, y), "start", word);
        x += 0.5 + 0.14 * word.len() as f64;
    }
}

const fn foliage_colour(kind: FoliageKind) -> &'static str {
    match kind {
        FoliageKind::Leaf => LEAF,
        FoliageKind::Stalk => STALK,
        FoliageKind::Weed => WEED,
    }
}

const fn colour(cause: Cause) -> &'static str {
    match cause {
        Cause::EndOfLane => "#777777",
        Cause::BadStart => "#7b1fa2",
        Cause::Gap => "#f57c00",
        Cause::Perception(_) => "#d32f2f",
        Cause::Control => "#111111",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::tests::lane;
    use crate::{Probe, simulate};
    use serde_json::json;

    #[derive(Default)]
    struct Path(Vec<Pose>);

    impl Probe for Path {
        fn pose(&mut self, _time_s: f64, world_from_robot: Pose) {
            self.0.push(world_from_robot);
        }
    }

    #[test]
    fn a_lane_is_drawn_in_strips_with_its_chart_and_bars() {
        let mut scenario = lane();
        scenario["field"]["lane"] = json!("lane-h");
        let scenario = Scenario::from_value(scenario).unwrap();
        let mut path = Path::default();
        let result = simulate(&scenario, Seed(1), &mut path);
        let svg = super::super::trajectory(&scenario, Seed(1), &path.0, &result);
        assert!(svg.contains(">pl, ekf, lgg at 40 Hz, lane-h, seed 1: "), "the caption");
        for words in
            ["cross-track error of the robot's centre", "distances until an intervention", "end-of-lane", "weed"]
        {
            assert!(svg.contains(words), "{words}");
        }
        // Strips from 0, 25, 50 and 75 m, the chart and the bars, and a bar per intervention.
        assert_eq!(svg.matches("<rect x=\"1.1\" y=").count(), 6 + result.interventions.len());
    }
}
