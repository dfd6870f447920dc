//! What a user asks of a sweep's results.

use std::str::FromStr;

use super::error::TableError;
use super::metric::{Metric, OfSums, SUCCESS, metric, ratios_of_sums};

/// A question for a table. The default asks for everything.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Query {
    /// Factors that make up the cells, in this order; runs that differ in other factors are put together. None
    /// takes all factors of the plan, an empty list puts all runs together.
    pub group_by: Option<Vec<String>>,
    /// Metrics, in this order. None takes all that are there.
    pub metrics: Option<Vec<String>>,
    /// A factor whose levels become columns in CSV, Markdown, LaTeX and text.
    pub columns: Option<String>,
    /// Statistics, in this order. None takes all, and in tables for people the mean with its interval.
    pub statistics: Option<Vec<Statistic>>,
}

impl Query {
    /// A question from the words of a URL or a command line, each a list separated by commas.
    ///
    /// # Errors
    /// An unknown statistic. Factors and metrics are checked against the sweep by [`tabulate`](super::tabulate()).
    pub fn from_words(
        group_by: Option<&str>,
        metric: Option<&str>,
        columns: Option<&str>,
        statistic: Option<&str>,
    ) -> Result<Self, TableError> {
        Ok(Self {
            group_by: group_by.map(list),
            metrics: metric.map(list).filter(|metrics| !metrics.is_empty()),
            columns: columns.map(str::trim).filter(|word| !word.is_empty()).map(str::to_owned),
            statistics: statistic
                .map(list)
                .filter(|words| !words.is_empty())
                .map(|words| words.iter().map(|word| word.parse()).collect())
                .transpose()?,
        })
    }

    /// The metrics of which values are needed, if not all: those asked for, what ratios of sums are made of, and success,
    /// without which no table stands.
    #[must_use]
    pub fn wanted(&self) -> Option<Vec<String>> {
        let names = self.metrics.as_ref()?;
        let sums = names.iter().filter_map(|name| metric(name).of_sums).flat_map(|of| [of.numerator, of.denominator]);
        let sums = sums.chain([SUCCESS]).map(str::to_owned);
        Some(names.iter().cloned().chain(sums).collect())
    }

    /// Whether single values are needed: for medians, percentiles, times and ratios of sums. Everything else comes from the cells' moments.
    /// `present` are the metrics of which there are moments; times have none.
    #[must_use]
    pub fn needs_values(&self, timing: bool, present: impl Fn(&str) -> bool) -> bool {
        let asked = self.statistics.as_deref().unwrap_or(&Statistic::USUAL);
        let median = asked.iter().any(|statistic| statistic.needs_values());
        let can_be = |of: OfSums| present(of.numerator) && present(of.denominator);
        let by_value = |metric: &Metric| metric.timing || metric.of_sums.is_some();
        median
            || match &self.metrics {
                Some(names) => names.iter().any(|name| by_value(&metric(name))),
                None => timing || ratios_of_sums().any(|(_, of)| can_be(of)),
            }
    }
}

/// A list separated by commas; what stands in it twice counts once. An empty text is an empty list, and an empty word
/// between commas is one, of which nothing goes by the name.
pub(crate) fn list(words: &str) -> Vec<String> {
    let mut listed: Vec<String> = Vec::new();
    if words.trim().is_empty() {
        return listed;
    }
    for word in words.split(',').map(str::trim) {
        if !listed.iter().any(|other| other == word) {
            listed.push(word.to_owned());
        }
    }
    listed
}

/// A statistic of a metric.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Statistic {
    /// Arithmetic mean.
    Mean,
    /// Sample standard deviation.
    Std,
    /// Median.
    Median,
    /// Smallest value.
    Min,
    /// Largest value.
    Max,
    /// 95 % interval of the mean.
    Ci95,
    /// Number of values.
    N,
    /// Sum of the values.
    Sum,
    /// 5th percentile.
    P5,
    /// 25th percentile.
    P25,
    /// 75th percentile.
    P75,
    /// 95th percentile.
    P95,
}

impl Statistic {
    /// Those that a table has unless it was asked for others, in its order.
    pub const USUAL: [Self; 7] = [Self::Mean, Self::Std, Self::Median, Self::Min, Self::Max, Self::Ci95, Self::N];

    /// All of them.
    pub const ALL: [Self; 12] = [
        Self::Mean,
        Self::Std,
        Self::Median,
        Self::Min,
        Self::Max,
        Self::Ci95,
        Self::N,
        Self::Sum,
        Self::P5,
        Self::P25,
        Self::P75,
        Self::P95,
    ];

    /// Whether it takes the values themselves: the moments do not tell it.
    #[must_use]
    pub const fn needs_values(self) -> bool {
        matches!(self, Self::Median | Self::P5 | Self::P25 | Self::P75 | Self::P95)
    }

    /// Its key in JSON.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Mean => "mean",
            Self::Std => "std",
            Self::Median => "median",
            Self::Min => "min",
            Self::Max => "max",
            Self::Ci95 => "ci95",
            Self::N => "n",
            Self::Sum => "sum",
            Self::P5 => "p5",
            Self::P25 => "p25",
            Self::P75 => "p75",
            Self::P95 => "p95",
        }
    }
}

impl FromStr for Statistic {
    type Err = TableError;

    fn from_str(word: &str) -> Result<Self, TableError> {
        let known = || Self::ALL.map(Self::as_str);
        let found = Self::ALL.into_iter().find(|statistic| statistic.as_str() == word);
        found.ok_or_else(|| TableError::new("statistic", "statistic", word, known()))
    }
}

/// How a table is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Format {
    /// The cells as JSON.
    Json,
    /// Comma-separated values after RFC 4180, in full precision.
    Csv,
    /// A Markdown table.
    Md,
    /// A LaTeX tabular with the rules of booktabs.
    Latex,
    /// Plain text for a terminal.
    Text,
}

impl Format {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Json, Self::Csv, Self::Md, Self::Latex, Self::Text];

    /// The word that asks for it.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Json => "json",
            Self::Csv => "csv",
            Self::Md => "md",
            Self::Latex => "latex",
            Self::Text => "text",
        }
    }

    /// Its media type.
    #[must_use]
    pub const fn media_type(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Csv => "text/csv; charset=utf-8",
            Self::Md => "text/markdown; charset=utf-8",
            Self::Latex => "application/x-latex; charset=utf-8",
            Self::Text => "text/plain; charset=utf-8",
        }
    }
}

impl FromStr for Format {
    type Err = TableError;

    fn from_str(word: &str) -> Result<Self, TableError> {
        let found = Self::ALL.into_iter().find(|format| format.as_str() == word);
        found.ok_or_else(|| TableError::new("format", "format", word, Self::ALL.map(Self::as_str)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_lists_separated_by_commas() {
        let query = Query::from_words(Some("algorithm, field"), Some(""), Some("field"), Some("mean,ci95")).unwrap();
        assert_eq!(query.group_by, Some(vec!["algorithm".into(), "field".into()]));
        assert_eq!(query.metrics, None);
        assert_eq!(query.columns.as_deref(), Some("field"));
        assert_eq!(query.statistics, Some(vec![Statistic::Mean, Statistic::Ci95]));
        let twice = Query::from_words(None, Some("success,success"), None, Some("n,median,n")).unwrap();
        assert_eq!((twice.metrics.unwrap().len(), twice.statistics.unwrap().len()), (1, 2));
        assert_eq!(Query::from_words(Some(""), None, None, None).unwrap().group_by, Some(vec![]));
    }

    #[test]
    fn an_empty_word_is_no_word() {
        let query = Query::from_words(Some("a,,b"), Some(" "), None, None).unwrap();
        assert_eq!((query.group_by, query.metrics), (Some(vec!["a".into(), String::new(), "b".into()]), None));
        assert!(Query::from_words(None, None, None, Some("mean,")).is_err());
    }

    #[test]
    fn an_unknown_word_lists_the_known_ones() {
        let error = Query::from_words(None, None, None, Some("mode")).unwrap_err().to_string();
        assert_eq!(
            error,
            "statistic: unknown statistic `mode`: allowed are mean, std, median, min, max, ci95, n, sum, p5, p25, p75, p95"
        );
        let error = "xlsx".parse::<Format>().unwrap_err().to_string();
        assert_eq!(error, "format: unknown format `xlsx`: allowed are json, csv, md, latex, text");
    }

    #[test]
    fn single_values_are_fetched_only_for_medians_times_and_ratios_of_sums() {
        let of = |metric, statistic| Query::from_words(None, metric, None, statistic).unwrap();
        let needs = |metric, statistic| of(metric, statistic).needs_values(false, |_| false);
        assert!(needs(None, None));
        assert!(needs(Some("success"), None));
        assert!(needs(Some("line_finding_time_ms"), Some("mean")));
        assert!(needs(Some("distance_per_intervention_m"), Some("mean")));
        assert!(needs(Some("success"), Some("p95")));
        assert!(!needs(Some("success,simulated_s"), Some("mean,ci95,sum")));
        assert!(!needs(None, Some("mean")) && of(None, Some("mean")).needs_values(true, |_| false));
        assert!(of(None, Some("mean")).needs_values(false, |name| name != "success"));
    }
}
