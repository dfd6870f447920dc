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
}

impl Metric {
    const fn new(name: &'static str, title: &'static str, unit: &'static str, decimals: u8) -> Self {
        let (name, title, unit) = (Cow::Borrowed(name), Cow::Borrowed(title), Cow::Borrowed(unit));
        Self { name, title, unit, ratio: false, timing: false, decimals }
    }

    const fn ratio(name: &'static str, title: &'static str) -> Self {
        let (name, title, unit) = (Cow::Borrowed(name), Cow::Borrowed(title), Cow::Borrowed("1"));
        Self { name, title, unit, ratio: true, timing: false, decimals: 2 }
    }

    const fn timing(name: &'static str, title: &'static str) -> Self {
        let (name, title, unit) = (Cow::Borrowed(name), Cow::Borrowed(title), Cow::Borrowed("ms"));
        Self { name, title, unit, ratio: false, timing: true, decimals: 3 }
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
pub(super) const SUCCESS: &str = "success";

/// All metrics that have a place in tables, in this order.
static METRICS: [Metric; 20] = [
    Metric::ratio(SUCCESS, "success ratio"),
    Metric::new("mean_squared_error_mm2", "mean squared error", "mm^2", 1),
    Metric::new("points_processed", "points processed", "points", 2),
    Metric::new("rows_completed", "rows completed", "rows", 2),
    Metric::new("simulated_s", "simulated time", "s", 1),
    Metric::new("crop_damage", "crop plants damaged", "plants", 2),
    Metric::new("wheel_damage", "crop plants under a wheel", "plants", 2),
    Metric::new("closest_plant_m", "closest plant", "m", 3),
    Metric::new("covered_rows_percent", "rows covered", "%", 1),
    Metric::new("damaged_plants_percent", "plants damaged", "%", 1),
    Metric::new("trajectory_error_mean_m", "trajectory error, mean", "m", 3),
    Metric::new("trajectory_error_std_m", "trajectory error, deviation", "m", 3),
    Metric::new("trajectory_error_p99_m", "trajectory error, 99th percentile", "m", 3),
    Metric::new("trajectory_error_max_m", "trajectory error, largest", "m", 3),
    Metric::new("interventions", "interventions", "1", 2),
    Metric::new("distance_m", "distance", "m", 1),
    Metric::new("cross_track_rms_m", "cross-track error, rms", "m", 3),
    Metric::timing("line_finding_time_ms", "line finding time"),
    Metric::timing("line_finding_time_per_100_points_ms", "line finding time per 100 points"),
    Metric::timing("computation_time_ms", "computation time"),
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

/// Names of all metrics that have a place in tables.
pub(super) fn listed() -> impl Iterator<Item = &'static str> {
    METRICS.iter().map(|metric| metric.name.as_ref())
}

/// Where tables show the metric: those of the list first, the others behind them by name.
pub(super) fn order(name: &str) -> (usize, &str) {
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
