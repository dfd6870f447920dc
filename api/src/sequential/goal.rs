//! What a user asks to be decided.

use std::str::FromStr;

use crate::table::{listed, metric};

/// When there are enough seeds.
#[derive(Debug, Clone, PartialEq)]
pub enum Goal {
    /// `METRIC<=WIDTH`: in every cell the 95 % interval of the metric is at most so wide.
    Width {
        /// The metric.
        metric: String,
        /// The widest interval allowed.
        at_most: Width,
    },
    /// `FACTOR:METRIC`: which of every two levels of the factor has the larger metric is decided.
    Order {
        /// The factor.
        factor: String,
        /// The metric.
        metric: String,
    },
}

/// How wide an interval may be from end to end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Width {
    /// In the metric's unit.
    Absolute(f64),
    /// As a share of the mean.
    OfMean(f64),
}

impl Goal {
    /// The metric that it is about.
    #[must_use]
    pub fn metric(&self) -> &str {
        match self {
            Self::Width { metric, .. } | Self::Order { metric, .. } => metric,
        }
    }
}

impl std::fmt::Display for Goal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Width { metric, at_most: Width::Absolute(width) } => write!(f, "{metric}<={width}"),
            Self::Width { metric, at_most: Width::OfMean(share) } => write!(f, "{metric}<={}%", share * 100.0),
            Self::Order { factor, metric } => write!(f, "{factor}:{metric}"),
        }
    }
}

const FORMS: &str = "expected METRIC<=WIDTH (success<=0.2, or mean_squared_error_mm2<=10% of the mean) or FACTOR:METRIC \
     (algorithm:success)";

impl FromStr for Goal {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Some((metric, width)) = text.split_once("<=") {
            return Ok(Self::Width { metric: known(metric.trim())?, at_most: width.trim().parse()? });
        }
        match text.split_once(':') {
            Some((factor, metric)) if !factor.trim().is_empty() => {
                Ok(Self::Order { factor: factor.trim().to_owned(), metric: known(metric.trim())? })
            }
            _ => Err(FORMS.to_owned()),
        }
    }
}

impl FromStr for Width {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| text.trim().parse::<f64>().ok().filter(|width| width.is_finite() && *width > 0.0);
        let width = match text.strip_suffix('%') {
            Some(percent) => number(percent).map(|percent| Self::OfMean(percent / 100.0)),
            None => number(text).map(Self::Absolute),
        };
        width.ok_or_else(|| format!("`{text}` is no width: a number above 0, or a percentage of the mean"))
    }
}

/// A metric that has a place in tables; `success_ratio` stands for `success`.
fn known(name: &str) -> Result<String, String> {
    let name = if name == "success_ratio" { "success" } else { name };
    if !listed().any(|other| other == name) {
        let some: Vec<&str> = listed().take(8).collect();
        return Err(format!("`{name}` is no metric, allowed is {}, ..", some.join(", ")));
    }
    if metric(name).timing {
        return Err(format!("`{name}` is a time: it is measured with --timing, which runs everything anew"));
    }
    Ok(name.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_forms_are_read_and_written() {
        for text in ["success<=0.2", "mean_squared_error_mm2<=12.5%", "algorithm:success"] {
            assert_eq!(text.parse::<Goal>().unwrap().to_string(), text);
        }
        assert_eq!("success_ratio <= 0.2".parse::<Goal>().unwrap().to_string(), "success<=0.2");
    }

    #[test]
    fn what_is_no_goal_says_what_is() {
        let refused = |text: &str| text.parse::<Goal>().unwrap_err();
        assert!(refused("success").starts_with("expected METRIC<=WIDTH"));
        assert!(refused(":success").starts_with("expected METRIC<=WIDTH"));
        assert!(refused("luck<=1").starts_with("`luck` is no metric, allowed is success"));
        for width in ["0", "-1", "nan", "inf", "wide", "%"] {
            assert!(refused(&format!("success<={width}")).contains("is no width"), "{width}");
        }
        assert!(refused("algorithm:line_finding_time_ms").contains("--timing"));
    }
}
