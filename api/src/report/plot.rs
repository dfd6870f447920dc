//! Means with their intervals, a line per cell.

use std::fmt::Write;

use super::html::escaped;

/// One line of a plot.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Line {
    pub(super) label: String,
    pub(super) mean: Option<f64>,
    pub(super) ci95: Option<[f64; 2]>,
    /// What stands right of it.
    pub(super) shown: String,
}

const LEFT: f64 = 230.0;
const RIGHT: f64 = 150.0;
const WIDTH: f64 = 860.0;
const STEP: f64 = 22.0;
const ABOVE: f64 = 12.0;
const BELOW: f64 = 52.0;

/// The lines as an SVG document; none without a mean. The axis begins at 0 unless a value lies below it.
pub(super) fn intervals(lines: &[Line], axis: &str) -> Option<String> {
    let values = lines.iter().flat_map(|line| line.mean.into_iter().chain(line.ci95.into_iter().flatten()));
    let values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
    let top = values.iter().copied().fold(0.0, f64::max);
    let bottom = values.iter().copied().fold(0.0, f64::min);
    if values.is_empty() {
        return None;
    }
    let ticks = ticks(bottom, if top > bottom { top } else { bottom + 1.0 });
    let (low, high) = (ticks[0], ticks[ticks.len() - 1]);
    let x = |value: f64| LEFT + (value - low) / (high - low) * (WIDTH - LEFT - RIGHT);
    let foot = ABOVE + STEP * lines.len() as f64;
    let height = foot + BELOW;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" width=\"{WIDTH}\" height=\"{height}\" \
         font-family=\"system-ui, sans-serif\" font-size=\"12\" role=\"img\" aria-label=\"{}\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n",
        escaped(axis)
    );
    for tick in &ticks {
        let at = x(*tick);
        let _ = writeln!(
            svg,
            "<line x1=\"{at:.1}\" y1=\"{ABOVE}\" x2=\"{at:.1}\" y2=\"{foot}\" stroke=\"#ddd\"/>\
             <text x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\" fill=\"#444\">{tick}</text>",
            foot + 18.0
        );
    }
    for (i, line) in lines.iter().enumerate() {
        svg.push_str(&drawn(line, ABOVE + STEP * (i as f64 + 0.5), &x));
    }
    let middle = f64::midpoint(LEFT, WIDTH - RIGHT);
    let _ = writeln!(
        svg,
        "<text x=\"{middle}\" y=\"{}\" text-anchor=\"middle\" fill=\"#111\">{}</text>",
        foot + 40.0,
        escaped(axis)
    );
    Some(svg + "</svg>\n")
}

fn drawn(line: &Line, y: f64, x: &impl Fn(f64) -> f64) -> String {
    let text = y + 4.0;
    let mut svg = format!(
        "<text x=\"{}\" y=\"{text}\" text-anchor=\"end\" fill=\"#111\">{}</text>\
         <text x=\"{}\" y=\"{text}\" fill=\"#444\">{}</text>\n",
        LEFT - 10.0,
        escaped(&line.label),
        WIDTH - RIGHT + 10.0,
        escaped(&line.shown)
    );
    if let Some([low, high]) = line.ci95.filter(|ends| ends.iter().all(|end| end.is_finite())) {
        let (a, b) = (x(low), x(high));
        let _ = writeln!(
            svg,
            "<path d=\"M{a:.1} {y}H{b:.1}M{a:.1} {0}v10M{b:.1} {0}v10\" stroke=\"#1f4e9c\" stroke-width=\"1.5\" fill=\"none\"/>",
            y - 5.0
        );
    }
    if let Some(mean) = line.mean.filter(|mean| mean.is_finite()) {
        let _ = writeln!(svg, "<circle cx=\"{:.1}\" cy=\"{y}\" r=\"4\" fill=\"#1f4e9c\"/>", x(mean));
    }
    svg
}

/// Four to nine round numbers that hold `low` to `high`.
fn ticks(low: f64, high: f64) -> Vec<f64> {
    let power = 10_f64.powf(((high - low) / 5.0).log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|step| step * power);
    let step = steps.into_iter().find(|step| (high - low) / step <= 7.0 + 1e-9).unwrap_or(10.0 * power);
    let (first, last) = ((low / step + 1e-9).floor() as i64, (high / step - 1e-9).ceil() as i64);
    // Divided rather than multiplied: 3 / 10 is the number that is written 0.3.
    let tick = |i: i64| if step < 1.0 { i as f64 / (1.0 / step).round() } else { i as f64 * step };
    (first..=last).map(tick).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_hold_all_values() {
        assert_eq!(ticks(0.0, 1.0), [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]);
        assert_eq!(ticks(0.0, 637.0), [0.0, 100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0]);
        assert_eq!(ticks(-3.0, 11.0), [-4.0, -2.0, 0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0]);
        assert_eq!(ticks(0.0, 0.07), [0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.07]);
    }

    #[test]
    fn a_mean_stands_within_its_interval() {
        let line = |mean, ci95| Line { label: "a<b".into(), mean, ci95, shown: String::new() };
        let svg = intervals(&[line(Some(5.0), Some([0.0, 10.0])), line(None, None)], "error [m]").unwrap();
        assert!(svg.contains("M230.0 23H710.0") && svg.contains("cx=\"470.0\""), "{svg}");
        assert!(svg.contains("a&lt;b") && svg.matches("<circle").count() == 1);
        assert_eq!(intervals(&[line(None, None)], "x"), None);
    }
}
