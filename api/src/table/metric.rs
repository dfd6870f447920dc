//! What is measured: the one list of metrics, in the order in which tables show them.

use std::borrow::Cow;

use serde::Serialize;

use super::query::Statistic;

/// What a metric is called and how it is counted.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, utoipa::ToSchema)]
pub struct Metric {
    /// Its name, with its unit.
    #[schema(value_type = String)]
    pub name: Cow<'static, str>,
    /// A few words for a table's heading.
    #[schema(value_type = String)]
    pub title: Cow<'static, str>,
    /// Its unit, `1` where it has none.
    #[schema(value_type = String)]
    pub unit: Cow<'static, str>,
    /// Whether each value is 0 or 1 and the mean is a ratio.
    pub ratio: bool,
    /// Whether it is wall-clock time: measured in runs that had the machine to themselves, and no result.
    pub timing: bool,
    /// Digits behind the decimal point that a table for people shows.
    pub decimals: u8,
    /// The metrics whose sums it is the ratio of, where it is one: no run has such a value by itself.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub of_sums: Option<OfSums>,
}

/// A ratio of two metrics, each summed over the runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
pub struct OfSums {
    /// The metric whose sum stands above.
    #[schema(value_type = String)]
    pub numerator: &'static str,
    /// The metric whose sum stands below.
    #[schema(value_type = String)]
    pub denominator: &'static str,
}

impl Metric {
    const fn new(name: &'static str, title: &'static str, unit: &'static str, decimals: u8) -> Self {
        let (name, title, unit) = (Cow::Borrowed(name), Cow::Borrowed(title), Cow::Borrowed(unit));
        Self { name, title, unit, ratio: false, timing: false, decimals, of_sums: None }
    }

    const fn ratio(name: &'static str, title: &'static str) -> Self {
        let (name, title, unit) = (Cow::Borrowed(name), Cow::Borrowed(title), Cow::Borrowed("1"));
        Self { name, title, unit, ratio: true, timing: false, decimals: 2, of_sums: None }
    }

    const fn timing(name: &'static str, title: &'static str, decimals: u8) -> Self {
        let (name, title, unit) = (Cow::Borrowed(name), Cow::Borrowed(title), Cow::Borrowed("ms"));
        Self { name, title, unit, ratio: false, timing: true, decimals, of_sums: None }
    }

    const fn of_sums(name: &'static str, title: &'static str, unit: &'static str, decimals: u8, of: OfSums) -> Self {
        let (name, title, unit) = (Cow::Borrowed(name), Cow::Borrowed(title), Cow::Borrowed(unit));
        Self { name, title, unit, ratio: false, timing: false, decimals, of_sums: Some(of) }
    }

    /// A cause's share of the interventions.
    const fn share(name: &'static str, title: &'static str, numerator: &'static str) -> Self {
        Self::of_sums(name, title, "1", 2, OfSums { numerator, denominator: "relevant_interventions" })
    }

    /// The heading of a column that holds `statistic` of this metric: `mean_squared_error_mm2_median`; the mean
    /// of a ratio goes by the ratio's name: `success_ratio`.
    #[must_use]
    pub fn column(&self, statistic: Statistic) -> String {
        match statistic {
            Statistic::Mean if self.ratio => format!("{}_ratio", self.name),
            Statistic::Ci95 if self.ratio => format!("{}_ratio_ci95", self.name),
            _ => format!("{}_{}", self.name, statistic.as_str()),
        }
    }

    /// Title and unit: `squared error [mm^2]`.
    #[must_use]
    pub fn heading(&self) -> String {
        if self.unit == "1" { self.title.to_string() } else { format!("{} [{}]", self.title, self.unit) }
    }
}

/// The metric whose mean is the success ratio.
pub(crate) const SUCCESS: &str = "success";

/// All metrics that have a place in tables, in this order.
static METRICS: [Metric; 66] = [
    Metric::ratio(SUCCESS, "success ratio"),
    Metric::new("mean_squared_error_mm2", "mean squared error", "mm^2", 1),
    Metric::new("points_processed", "points processed", "points", 2),
    Metric::new("rows_completed", "rows completed", "rows", 2),
    Metric::new("interventions", "interventions", "1", 2),
    Metric::of_sums(
        "distance_per_intervention_m",
        "distance per intervention",
        "m",
        1,
        OfSums { numerator: "distance_m", denominator: "relevant_interventions" },
    ),
    Metric::new("cross_track_rms_m", "cross-track error, rms", "m", 3),
    Metric::of_sums(
        "distance_per_intervention_without_bad_starts_m",
        "distance per intervention, no bad starts",
        "m",
        1,
        OfSums { numerator: "distance_m", denominator: "relevant_interventions_without_bad_starts" },
    ),
    Metric::new("cross_track_mean_m", "cross-track error, mean", "m", 3),
    Metric::new("cross_track_p99_m", "cross-track error, 99th percentile", "m", 3),
    Metric::new("oscillation_hz", "oscillation", "Hz", 2),
    Metric::new("relevant_interventions", "interventions but lane ends", "1", 2),
    Metric::new("relevant_interventions_without_bad_starts", "interventions but lane ends and bad starts", "1", 2),
    Metric::new("interventions_end_of_lane", "lane ends", "1", 2),
    Metric::new("interventions_bad_start", "interventions, bad start", "1", 2),
    Metric::new("interventions_gap", "interventions, gap", "1", 2),
    Metric::new("interventions_perception", "interventions, perception", "1", 2),
    Metric::new("interventions_perception_heading", "interventions, perception: heading", "1", 2),
    Metric::new("interventions_perception_convergence", "interventions, perception: convergence of rows", "1", 2),
    Metric::new("interventions_perception_valid_side", "interventions, perception: valid side", "1", 2),
    Metric::new("interventions_perception_distance", "interventions, perception: distance", "1", 2),
    Metric::new("interventions_control", "interventions, control", "1", 2),
    Metric::share("bad_start_share", "share of bad starts", "interventions_bad_start"),
    Metric::share("control_share", "share of control", "interventions_control"),
    Metric::share("gap_share", "share of gaps", "interventions_gap"),
    Metric::share("perception_share", "share of perception", "interventions_perception"),
    Metric::new("left_distance_error_rms_m", "error of the distance to the left row, rms", "m", 3),
    Metric::new("right_distance_error_rms_m", "error of the distance to the right row, rms", "m", 3),
    Metric::new("heading_error_rms_rad", "error of the heading, rms", "rad", 3),
    Metric::new("view_valid_left_percent", "left side found", "%", 1),
    Metric::new("view_valid_right_percent", "right side found", "%", 1),
    Metric::new("view_valid_heading_percent", "heading found", "%", 1),
    Metric::new("valid_left_percent", "left side valid to a person", "%", 1),
    Metric::new("valid_right_percent", "right side valid to a person", "%", 1),
    Metric::new("mean_lane_width_m", "lane width", "m", 3),
    Metric::new("std_lane_width_m", "lane width, deviation", "m", 3),
    Metric::new("within_0.05m_percent", "lane width within 0.05 m", "%", 1),
    Metric::new("within_0.1m_percent", "lane width within 0.1 m", "%", 1),
    Metric::new("distance_m", "distance", "m", 1),
    Metric::new("simulated_s", "simulated time", "s", 1),
    Metric::new("crop_damage", "crop plants damaged", "plants", 2),
    Metric::new("wheel_damage", "crop plants under a wheel", "plants", 2),
    Metric::new("closest_plant_m", "closest plant", "m", 3),
    Metric::new("covered_rows_percent", "rows covered", "%", 1),
    Metric::new("damaged_plants_percent", "plants damaged", "%", 1),
    Metric::new("unavoidable_damage_percent", "plants damaged by the very middle of the lane", "%", 1),
    Metric::new("trajectory_error_mean_m", "trajectory error, mean", "m", 3),
    Metric::new("trajectory_error_std_m", "trajectory error, deviation", "m", 3),
    Metric::new("trajectory_error_p99_m", "trajectory error, 99th percentile", "m", 3),
    Metric::new("trajectory_error_max_m", "trajectory error, largest", "m", 3),
    Metric::new("localization_error_rms_m", "error of the place in the map, rms", "m", 3),
    Metric::new("passed_plants", "plants passed", "plants", 1),
    Metric::new("damaged_plants", "plants damaged", "plants", 1),
    Metric::new("passable_lanes_percent", "lanes passable", "%", 1),
    Metric::ratio("passable_field", "share of fields wholly passable"),
    Metric::timing("line_finding_time_ms", "line finding time", 3),
    Metric::timing("line_finding_time_per_100_points_ms", "line finding time per 100 points", 3),
    Metric::timing("lane_finding_time_ms", "lane finding time", 4),
    Metric::timing("lane_estimation_time_ms", "lane estimation time", 5),
    Metric::timing("control_time_ms", "control time", 5),
    Metric::timing("filtering_time_ms", "outlier removal time", 3),
    Metric::timing("ground_detection_time_ms", "ground detection time", 3),
    Metric::timing("row_detection_time_ms", "row detection time", 3),
    Metric::timing("localization_time_ms", "localization time", 3),
    Metric::timing("computation_time_ms", "computation time", 3),
    Metric::timing("ray_casting_time_ms", "ray casting time", 3),
];

/// The metric of this name. One that has no place in the list is described by its name alone.
#[must_use]
pub fn metric(name: &str) -> Metric {
    let known = METRICS.iter().find(|metric| metric.name == name);
    known.cloned().unwrap_or_else(|| Metric {
        name: Cow::Owned(name.to_owned()),
        title: Cow::Owned(name.replace('_', " ")),
        ..Metric::new("", "", "1", 3)
    })
}

/// The ratios of sums, with their names.
pub(super) fn ratios_of_sums() -> impl Iterator<Item = (&'static str, OfSums)> {
    METRICS.iter().filter_map(|metric| Some((metric.name.as_ref(), metric.of_sums?)))
}

/// Names of all metrics that have a place in tables.
pub(crate) fn listed() -> impl Iterator<Item = &'static str> {
    METRICS.iter().map(|metric| metric.name.as_ref())
}

/// Where tables show the metric: those of the list first, the others behind them by name.
pub(crate) fn order(name: &str) -> (usize, &str) {
    (METRICS.iter().position(|metric| metric.name == name).unwrap_or(METRICS.len()), name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_metric_stands_once() {
        for (i, metric) in METRICS.iter().enumerate() {
            assert_eq!(order(&metric.name).0, i);
        }
    }

    #[test]
    fn a_ratio_of_sums_is_of_metrics_in_the_list() {
        assert!(ratios_of_sums().count() > 0);
        for (name, OfSums { numerator, denominator }) in ratios_of_sums() {
            assert!([numerator, denominator].iter().all(|part| order(part).0 < METRICS.len()), "{name}");
        }
    }

    #[test]
    fn the_mean_of_success_is_the_success_ratio() {
        assert_eq!(metric("success").column(Statistic::Mean), "success_ratio");
        assert_eq!(metric("simulated_s").column(Statistic::Median), "simulated_s_median");
    }

    #[test]
    fn a_metric_that_is_new_here_stands_behind_the_known_ones() {
        let new = metric("soil_torque_nm");
        assert_eq!((new.name.as_ref(), new.heading().as_str()), ("soil_torque_nm", "soil torque nm"));
        assert!(order("soil_torque_nm") > order("computation_time_ms"));
    }
}
