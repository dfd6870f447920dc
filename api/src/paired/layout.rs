//! A comparison in rows and columns: exact and wide for programs, rounded for people.

use super::compare::{Comparison, GroupComparison, MetricComparison};
use crate::table::{Column, Entry, Format, Grid, Metric, render, short};

impl Comparison {
    /// The comparison as text in `format`.
    #[must_use]
    pub fn write(&self, format: Format) -> String {
        match format {
            Format::Json => serde_json::to_string(self).expect("numbers and texts are JSON"),
            Format::Csv => render(&self.for_programs(), format),
            Format::Md | Format::Latex | Format::Text => render(&self.for_people(), format),
        }
    }

    fn rows(&self) -> impl Iterator<Item = (&GroupComparison, &Metric, &MetricComparison)> {
        let of = |group| self.metrics.iter().filter_map(move |metric| of_group(group, metric));
        self.groups.iter().flat_map(of)
    }

    fn labels(&self, group: &GroupComparison, all: &str) -> Vec<Entry> {
        let label = |factor: &String| Entry::text(group.factors.get(factor).map_or(all, String::as_str));
        self.group_by.iter().map(label).collect()
    }

    fn for_programs(&self) -> Grid {
        let mut grid = Grid::default();
        grid.columns.extend(self.group_by.iter().map(|factor| Column::left(factor.as_str())));
        grid.columns.push(Column::left("metric"));
        grid.columns.extend(PROGRAM_COLUMNS.map(Column::right));
        for (group, metric, said) in self.rows() {
            let mut row = self.labels(group, "");
            row.push(Entry::text(metric.name.as_ref()));
            row.extend(program_entries(group, said));
            grid.rows.push(row);
        }
        grid
    }

    fn for_people(&self) -> Grid {
        let mut grid = Grid { title: self.title(), ..Grid::default() };
        grid.columns.extend(self.group_by.iter().map(|factor| Column::left(factor.as_str())));
        grid.columns.push(Column::left("metric"));
        let numbers = ["pairs", "incomplete", "a", "b", "a - b", "95 %", "p", "p (Holm)", "effect", "more seeds"];
        grid.columns.extend(numbers.map(Column::right));
        for (group, metric, said) in self.rows() {
            let mut row = self.labels(group, "all");
            row.extend(people_entries(group, metric, said));
            grid.rows.push(row);
        }
        grid.notes = self.notes();
        grid
    }

    fn title(&self) -> String {
        let by: Vec<&str> = self.paired_by.iter().map(String::as_str).chain(["seed"]).collect();
        let by = by.join(", ");
        match (&self.factor, &self.a, &self.b) {
            (Some(factor), Some(a), Some(b)) => format!("{factor}: a = {a}, b = {b}, paired by {by}"),
            _ => format!("a = this sweep, b = the other, paired by {by}"),
        }
    }

    fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        let has = |word: &str| self.rows().any(|(_, _, said)| said.interval == word);
        if has("student") {
            notes.push(
                "Student's interval of the mean difference; Wilcoxon's signed-rank test, without differences of 0; d: mean over \
                 deviation of the differences; r: rank-biserial correlation.",
            );
        }
        if has("tango") {
            notes.push("Success: Tango's interval, McNemar's exact test; OR: odds ratio of matched pairs.");
        }
        if has("bootstrap") {
            notes.push("Ratios of sums: bootstrap over pairs, no test.");
        }
        let mut notes: Vec<String> = notes.into_iter().map(str::to_owned).collect();
        notes.push(format!("Holm: corrected for the {} tests of this table.", self.tests));
        notes.push(
            "More seeds: about how many more per cell until the 95 % interval excludes 0, if the difference stays."
                .to_owned(),
        );
        notes.extend(self.missing());
        notes
    }

    /// Says what is in no figure.
    fn missing(&self) -> Option<String> {
        let all = self.groups.first()?.counts;
        if all.incomplete + all.ambiguous == 0 {
            return None;
        }
        let mut text = format!(
            "{} pairs are incomplete and in no figure: {} have only a's result, {} only b's; {} jobs of a and {} of b failed.",
            all.incomplete, all.only_a, all.only_b, all.failed_a, all.failed_b
        );
        if all.ambiguous > 0 {
            text += &format!(" {} runs of pools belong to no other one in particular.", all.ambiguous);
        }
        Some(text)
    }
}

fn of_group<'a>(
    group: &'a GroupComparison,
    metric: &'a Metric,
) -> Option<(&'a GroupComparison, &'a Metric, &'a MetricComparison)> {
    Some((group, metric, group.metrics.get(metric.name.as_ref())?))
}

const PROGRAM_COLUMNS: [&str; 32] = [
    "pairs",
    "seeds",
    "incomplete",
    "only_a",
    "only_b",
    "failed_a",
    "failed_b",
    "ambiguous",
    "n",
    "undefined",
    "a",
    "b",
    "difference",
    "ci95_low",
    "ci95_high",
    "interval",
    "bootstrap_ci95_low",
    "bootstrap_ci95_high",
    "test",
    "p",
    "p_holm",
    "zeros",
    "both_succeed",
    "only_a_succeeds",
    "only_b_succeeds",
    "neither_succeeds",
    "odds_ratio",
    "odds_ratio_ci95_low",
    "odds_ratio_ci95_high",
    "d_z",
    "rank_biserial",
    "more_seeds",
];

fn program_entries(group: &GroupComparison, said: &MetricComparison) -> Vec<Entry> {
    let counts = group.counts;
    let count = |value: Option<u64>| value.map_or(Entry::Empty, Entry::Count);
    let ends = |ends: Option<[f64; 2]>| [0, 1].map(|end| Entry::number(ends.map(|ends| ends[end])));
    let odds = [0, 1].map(|end| Entry::number(said.odds_ratio_ci95.and_then(|ends| ends[end])));
    let table = said.two_by_two;
    let mut entries: Vec<Entry> = [
        counts.pairs,
        counts.seeds,
        counts.incomplete,
        counts.only_a,
        counts.only_b,
        counts.failed_a,
        counts.failed_b,
        counts.ambiguous,
        said.n,
        said.undefined,
    ]
    .map(Entry::Count)
    .into();
    entries.extend([said.a, said.b, said.difference].map(Entry::number));
    entries.extend(ends(said.ci95));
    entries.push(Entry::text(said.interval));
    entries.extend(ends(said.bootstrap_ci95));
    entries.push(said.test.map_or(Entry::Empty, Entry::text));
    entries.extend([said.p, said.p_holm].map(Entry::number));
    entries.push(count(said.zeros));
    let [both, only_a] = [table.map(|table| table.both), table.map(|table| table.only_a)].map(count);
    let [only_b, neither] = [table.map(|table| table.only_b), table.map(|table| table.neither)].map(count);
    entries.extend([both, only_a, only_b, neither, Entry::number(said.odds_ratio)]);
    entries.extend(odds);
    entries.extend([said.d_z, said.rank_biserial].map(Entry::number));
    entries.push(count(said.more_seeds));
    entries
}

fn people_entries(group: &GroupComparison, metric: &Metric, said: &MetricComparison) -> Vec<Entry> {
    let decimals = metric.decimals;
    let number = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| short(value, decimals));
    let interval = |[low, high]: [f64; 2]| format!("[{}, {}]", short(low, decimals), short(high, decimals));
    let count = |value: Option<u64>| value.map_or_else(|| "-".to_owned(), |value| value.to_string());
    let words = [
        number(said.a),
        number(said.b),
        number(said.difference),
        said.ci95.map_or_else(|| "-".to_owned(), interval),
        chance(said.p),
        chance(said.p_holm),
        effect(said),
        count(said.more_seeds),
    ];
    let counts = [Entry::Count(said.n), Entry::Count(group.counts.incomplete)];
    [Entry::text(metric.heading())].into_iter().chain(counts).chain(words.map(Entry::Text)).collect()
}

fn chance(p: Option<f64>) -> String {
    match p {
        None => "-".to_owned(),
        Some(p) if p < 1e-4 => "<0.0001".to_owned(),
        Some(p) => short(p, 4),
    }
}

/// The size of the effect in a few words: `OR 4.00`, `d 0.55, r 0.60`.
fn effect(said: &MetricComparison) -> String {
    if let Some(table) = said.two_by_two {
        return match said.odds_ratio {
            Some(odds) => format!("OR {}", short(odds, 2)),
            None if table.only_a > 0 => format!("OR {}:0", table.only_a),
            None => "-".to_owned(),
        };
    }
    let part = |name: &str, value: Option<f64>| value.map(|value| format!("{name} {}", short(value, 2)));
    let parts: Vec<String> = [part("d", said.d_z), part("r", said.rank_biserial)].into_iter().flatten().collect();
    if parts.is_empty() { "-".to_owned() } else { parts.join(", ") }
}
