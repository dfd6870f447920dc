//! What a publication says in words, checked against our runs.
//!
//! A claim is data: a figure made of one or more groups of runs, and the side of a limit on which it must lie. It
//! `holds` if the whole 95 % interval of the figure lies there, does `not hold` if the whole of it lies on the other
//! side, and is `undecided` in between, where there is no interval, and where a group has fewer than three runs. The interval is the bootstrap's over runs; the
//! groups are drawn independently of each other, also where seeds met the same lanes in both, which makes the
//! interval rather too wide than too narrow.
//!
//! Where a group of a quotient counts no event at all, its interval is that of the count (Poisson), and the quotient's is
//! made of the outer ends of both.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use serde::Deserialize;

use super::error::PublicationError;
use super::reference::{COMPILED_IN, Kind, tables};
use super::verdict::Verdict;
use super::{Comparison, ComparisonCell, Ours};
use crate::table::{CellData, Contrast, Pairs, Series, SweepData, interval, metric, short};

/// The table of the claims in a URL.
pub const TABLE: &str = "claims";

/// A group of fewer runs decides nothing: their spread says too little of that of others.
const FEWEST: u64 = 3;

static FILES: LazyLock<Vec<(&'static str, File)>> = LazyLock::new(|| {
    [
        ("velasquez2022", include_str!("../../reference/velasquez2022-claims.json")),
        ("vintu2018", include_str!("../../reference/vintu2018-claims.json")),
    ]
    .map(|(source, text)| (source, serde_json::from_str(text).expect(COMPILED_IN)))
    .into()
});

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    source: String,
    claims: Vec<Claim>,
}

/// A claim.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Claim {
    name: String,
    /// What is said, in our words.
    says: String,
    /// Where in the publication.
    section: String,
    figure: Figure,
    /// The first one is compared with the others.
    groups: Vec<Group>,
    /// Labels in further factors that all the runs must have where the sweep has such a factor.
    #[serde(default)]
    only: BTreeMap<String, String>,
    must_be: Side,
    limit: f64,
    /// The figure from the published values, where they give one.
    published: Option<f64>,
}

#[derive(Deserialize, Clone, Copy, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
enum Figure {
    /// The first over the second.
    Quotient,
    /// The first less the largest of the others.
    Lead,
}

#[derive(Deserialize, Clone, Copy, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
enum Side {
    Above,
    Below,
    AtMost,
    /// Nearer to 0 than the limit, either way.
    Within,
}

/// Runs, and what is measured of them.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Group {
    metric: String,
    /// The runs have one of these labels, by factor.
    labels: BTreeMap<String, Vec<String>>,
}

/// Whether the claims of a publication are known.
pub(super) fn exist(source: &str) -> bool {
    FILES.iter().any(|(known, _)| *known == source)
}

/// Checks each claim of a publication in the first of these sweeps that has runs for it.
///
/// # Errors
/// Names the publication that has no claims here.
pub fn check(source: &str, sweeps: &[impl std::borrow::Borrow<SweepData>]) -> Result<Comparison, PublicationError> {
    let Some((source, file)) = FILES.iter().find(|(known, _)| *known == source) else {
        let known = tables(source)?;
        return Err(PublicationError::UnknownTable { source_name: "the publication", table: TABLE.into(), known });
    };
    let checked = |claim: &Claim| {
        let mut found = sweeps.iter().filter_map(|data| claim.check(data.borrow()));
        found.next().unwrap_or_else(|| claim.not_run())
    };
    Ok(Comparison {
        source: (*source).to_owned(),
        table: TABLE.to_owned(),
        citation: file.source.clone(),
        metric: "claim".to_owned(),
        unit: "1".to_owned(),
        note: None,
        program_source: None,
        row_factors: &[],
        column_factor: "claim",
        columns: file.claims.iter().map(|claim| claim.name.clone()).collect(),
        counts_successes: false,
        cells: file.claims.iter().map(checked).collect(),
    })
}

impl Claim {
    /// The claim beside these runs; none where a group has none.
    fn check(&self, data: &SweepData) -> Option<ComparisonCell> {
        let only = |cell: &&CellData| self.only.iter().all(|(factor, label)| cell.allows(factor, label));
        let cells: Vec<&CellData> = data.cells.iter().filter(only).collect();
        let groups: Vec<Pairs> = self.groups.iter().map(|group| group.of(&cells)).collect();
        if groups.iter().any(|group| group.n() == 0) {
            return None;
        }
        let groups: Vec<&Pairs> = groups.iter().collect();
        let ends = self.ends(&groups);
        // NaN is null in JSON, as infinity is: there is nothing below the line.
        let mean = self.contrast().of(&groups).or_else(|| ends.map(|ends| ends[1])).unwrap_or(f64::NAN);
        let n = groups.iter().map(|group| group.n()).sum();
        let few = groups.iter().any(|group| group.n() < FEWEST);
        let verdict = ends.filter(|_| !few).map_or(Verdict::Undecided, |ends| self.verdict(ends));
        Some(ComparisonCell {
            ours: Some(Ours { mean, median: None, ci95: ends, n }),
            note: Some(format!("{}; {}", self.words(), self.reason(&groups, ends, verdict))),
            ..self.cell(verdict)
        })
    }

    fn not_run(&self) -> ComparisonCell {
        ComparisonCell { note: Some(self.words()), ..self.cell(Verdict::NotRun) }
    }

    fn words(&self) -> String {
        format!("{} (section {})", self.says, self.section)
    }

    const fn contrast(&self) -> Contrast {
        match self.figure {
            Figure::Quotient => Contrast::Quotient,
            Figure::Lead => Contrast::Lead,
        }
    }

    fn cell(&self, verdict: Verdict) -> ComparisonCell {
        ComparisonCell {
            factors: BTreeMap::from([("claim".to_owned(), self.name.clone())]),
            published: self.published,
            published_runs: None,
            program: None,
            program_median: None,
            program_runs: None,
            ours: None,
            sums: None,
            verdict: Some(verdict),
            note: None,
            reason: None,
            success: None,
            kind: Kind::Measure,
            measured: "claim".to_owned(),
            runs: BTreeMap::new(),
        }
    }

    fn ends(&self, groups: &[&Pairs]) -> Option<[f64; 2]> {
        if self.figure == Figure::Quotient && groups.iter().any(|group| group.ratio().is_none()) {
            let ([low, high], [other_low, other_high]) = (groups[0].ends()?, groups[1].ends()?);
            let ends = [low / other_high, high / other_low];
            return (!ends.iter().any(|end| end.is_nan())).then_some(ends);
        }
        interval(self.contrast(), groups)
    }

    fn verdict(&self, [low, high]: [f64; 2]) -> Verdict {
        let limit = self.limit;
        let (holds, does_not) = match self.must_be {
            Side::Above => (low > limit, high <= limit),
            Side::Below => (high < limit, low >= limit),
            Side::AtMost => (high <= limit, low > limit),
            Side::Within => (low > -limit && high < limit, low >= limit || high <= -limit),
        };
        match (holds, does_not) {
            (true, _) => Verdict::Holds,
            (_, true) => Verdict::DoesNotHold,
            _ => Verdict::Undecided,
        }
    }

    /// What the figure is made of, and what decides.
    fn reason(&self, groups: &[&Pairs], ends: Option<[f64; 2]>, verdict: Verdict) -> String {
        let value = |(pairs, group): (&&Pairs, &Group)| {
            let decimals = metric(&group.metric).decimals;
            let ratio = pairs.ratio().map_or_else(|| "no event".to_owned(), |ratio| short(ratio, decimals));
            format!("{ratio} ({}, n {})", group.words(), pairs.n())
        };
        let values: Vec<String> = groups.iter().zip(&self.groups).map(value).collect();
        let joint = match self.figure {
            Figure::Quotient => " over ",
            Figure::Lead => " against ",
        };
        let side = match self.must_be {
            Side::Above => "above",
            Side::Below => "below",
            Side::AtMost => "at most",
            Side::Within => "nearer to 0 than",
        };
        let decided = match (verdict, ends) {
            (_, None) => "too few runs for an interval",
            _ if groups.iter().any(|group| group.n() < FEWEST) => "too few runs to decide",
            (Verdict::Undecided, _) => "the interval lies on both sides",
            _ => "the interval lies on one side",
        };
        format!("{}; must be {side} {}: {decided}", values.join(joint), self.limit)
    }
}

impl Group {
    /// The pairs of its runs whose ratio is the metric.
    fn of(&self, cells: &[&CellData]) -> Pairs {
        let here = |cell: &&&CellData| {
            self.labels
                .iter()
                .all(|(factor, labels)| cell.factors.get(factor).is_some_and(|label| labels.contains(label)))
        };
        let mut all = Pairs::default();
        for cell in cells.iter().filter(here) {
            let values = || cell.metrics.get(&self.metric).and_then(|series: &Series| series.values.as_deref());
            match cell.ratios.get(self.metric.as_str()) {
                Some(pairs) => all.merge(pairs),
                None => all.merge(&Pairs::of_values(values().unwrap_or_default())),
            }
        }
        all
    }

    fn words(&self) -> String {
        let labels: Vec<String> = self.labels.values().map(|labels| labels.join("|")).collect();
        format!("{}, {}", metric(&self.metric).heading(), labels.join(" "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::Format;

    const DISTANCE: &str = "distance_per_intervention_m";

    fn cell(labels: &[(&str, &str)], pairs: &[[f64; 2]], counts: &[(&str, &[f64])]) -> CellData {
        CellData {
            factors: labels.iter().map(|(factor, label)| ((*factor).to_owned(), (*label).to_owned())).collect(),
            total: pairs.len() as u64,
            done: pairs.len() as u64,
            metrics: counts.iter().map(|(name, v)| ((*name).to_owned(), Series::of(v.iter().copied()))).collect(),
            ratios: BTreeMap::from([(DISTANCE, Pairs::of(pairs.iter().copied()))]),
            ..CellData::default()
        }
    }

    fn figure_18(pl: &[[f64; 2]], ekf: &[[f64; 2]]) -> SweepData {
        let at = |algorithm, pairs: &[[f64; 2]]| cell(&[("algorithm", algorithm), ("field", "iaf")], pairs, &[]);
        SweepData {
            factors: vec!["algorithm".into(), "field".into()],
            cells: vec![at("pl-lgg", pl), at("pl-ekf-lgg", ekf)],
        }
    }

    fn claim(data: &SweepData, name: &str) -> ComparisonCell {
        let checked = check("velasquez2022", &[data]).unwrap();
        checked.cells.into_iter().find(|cell| cell.label("claim") == name).unwrap()
    }

    #[test]
    fn a_claim_holds_where_the_whole_interval_of_the_quotient_is_above_one() {
        let pl = [[220.0, 4.0], [220.0, 5.0], [125.0, 3.0], [125.0, 4.0]];
        let cell = claim(&figure_18(&pl, &[[220.0, 1.0], [220.0, 0.0], [125.0, 1.0], [125.0, 1.0]]), "ekf-iaf");
        let ours = cell.ours.unwrap();
        assert_eq!((cell.verdict, ours.n), (Some(Verdict::Holds), 8));
        assert!((ours.mean - (690.0 / 3.0) / (690.0 / 16.0)).abs() < 1e-12 && ours.ci95.unwrap()[0] > 1.0, "{ours:?}");
        assert!((cell.published.unwrap() - 400.0 / 51.6).abs() < 0.01);
    }

    #[test]
    fn a_claim_does_not_hold_or_is_undecided_by_the_interval() {
        let (often, seldom) = ([[200.0, 4.0], [200.0, 5.0], [200.0, 4.0]], [[200.0, 1.0], [200.0, 1.0], [200.0, 2.0]]);
        assert_eq!(claim(&figure_18(&seldom, &often), "ekf-iaf").verdict, Some(Verdict::DoesNotHold));
        assert_eq!(
            claim(&figure_18(&often, &[[200.0, 4.0], [200.0, 5.0]]), "ekf-iaf").verdict,
            Some(Verdict::Undecided)
        );
        let one = claim(&figure_18(&often[..1], &seldom), "ekf-iaf");
        assert_eq!((one.verdict, one.ours.unwrap().ci95), (Some(Verdict::Undecided), None));
        assert!(one.note.unwrap().ends_with("too few runs for an interval"));
    }

    #[test]
    fn no_intervention_at_all_is_better_by_what_the_distance_allows() {
        let often = [[200.0, 4.0], [200.0, 5.0], [200.0, 4.0]];
        let none = claim(&figure_18(&often, &[[200.0, 0.0]; 3]), "ekf-iaf");
        let [low, high] = none.ours.unwrap().ci95.unwrap();
        // 600 m over 3.69 against 600 m over 12 at least.
        assert!((3.0..3.6).contains(&low) && high == f64::INFINITY, "[{low}, {high}]");
        assert_eq!(none.verdict, Some(Verdict::Holds));
        let short = claim(&figure_18(&often, &[[40.0, 0.0]; 2]), "ekf-iaf");
        assert_eq!(short.verdict, Some(Verdict::Undecided));
        let neither = claim(&figure_18(&[[200.0, 0.0]; 2], &[[200.0, 0.0]; 2]), "ekf-iaf");
        assert_eq!(neither.verdict, Some(Verdict::Undecided));
    }

    #[test]
    fn a_claim_without_runs_for_each_group_is_not_run_and_looks_in_the_next_sweep() {
        let whole = figure_18(&[[220.0, 4.0]; 3], &[[220.0, 1.0]; 3]);
        let half = SweepData { cells: whole.cells[..1].to_vec(), ..whole.clone() };
        assert_eq!(claim(&half, "ekf-iaf").verdict, Some(Verdict::NotRun));
        assert_eq!(claim(&whole, "ekf-production").verdict, Some(Verdict::NotRun));
        let checked = check("velasquez2022", &[&half, &whole]).unwrap();
        assert_eq!(checked.cells[0].verdict, Some(Verdict::Holds));
    }

    #[test]
    fn the_first_cause_is_ahead_of_the_largest_of_the_others() {
        let of = |field, gap: &[f64], perception: &[f64]| {
            let rest: (&[f64], &[f64]) = (&[0.0, 1.0, 0.0], &[1.0, 0.0, 0.0]);
            let counts = [
                ("interventions_gap", gap),
                ("interventions_perception", perception),
                ("interventions_control", rest.0),
                ("interventions_bad_start", rest.1),
            ];
            cell(&[("algorithm", "pl-ekf-lgg"), ("field", field)], &[], &counts)
        };
        let cells =
            vec![of("es-1", &[9.0, 8.0, 10.0], &[3.0, 2.0, 3.0]), of("es-2", &[1.0, 2.0, 1.0], &[5.0, 4.0, 4.0])];
        let data = SweepData { factors: vec!["algorithm".into(), "field".into()], cells };
        assert_eq!(claim(&data, "gap-first-in-es-1").verdict, Some(Verdict::Holds));
        assert_eq!(claim(&data, "gap-not-first-in-es-2").verdict, Some(Verdict::Holds));
    }

    #[test]
    fn runs_of_another_experiment_with_the_same_detectors_decide_nothing() {
        let covered = |localization: Option<&str>, algorithm, values: &[f64]| {
            let mut labels = vec![("algorithm", algorithm), ("field", "nursery-001")];
            labels.extend(localization.map(|level| ("localization", level)));
            cell(&labels, &[], &[("covered_rows_percent", values)])
        };
        let runs = |localization| SweepData {
            factors: vec!["algorithm".into(), "field".into()],
            cells: vec![
                covered(localization, "parallel-lines-ransac", &[50.0, 51.0, 49.0]),
                covered(localization, "pcl-lines", &[40.0, 41.0, 39.0]),
            ],
        };
        let verdict = |data: &SweepData| {
            let checked = check("vintu2018", &[data]).unwrap();
            checked.cells.into_iter().find(|cell| cell.label("claim") == "pcl-lines-worst-1").unwrap().verdict
        };
        assert_eq!(verdict(&runs(None)), Some(Verdict::Holds));
        assert_eq!(verdict(&runs(Some("off"))), Some(Verdict::Holds));
        assert_eq!(verdict(&runs(Some("on"))), Some(Verdict::NotRun), "figure 4.8 is without localization");
    }

    #[test]
    fn each_claim_can_be_checked_and_says_where_it_stands() {
        for (source, file) in FILES.iter() {
            assert!(super::super::sources().contains(source));
            for (i, claim) in file.claims.iter().enumerate() {
                let groups = claim.groups.len();
                assert!(if claim.figure == Figure::Quotient { groups == 2 } else { groups >= 2 }, "{}", claim.name);
                assert!(!claim.says.is_empty() && !claim.section.is_empty(), "{}", claim.name);
                assert!(!file.claims[..i].iter().any(|other| other.name == claim.name), "{}", claim.name);
                for group in &claim.groups {
                    let unlisted = group.metric.replace('_', " ");
                    assert!(
                        metric(&group.metric).title != unlisted || group.metric == "interventions",
                        "{}",
                        claim.name
                    );
                }
            }
        }
    }

    #[test]
    fn claims_come_in_every_format() {
        let data = figure_18(&[[220.0, 4.0], [220.0, 5.0]], &[[220.0, 1.0], [220.0, 0.0]]);
        let checked = check("velasquez2022", &[data]).unwrap();
        for format in [Format::Csv, Format::Md, Format::Latex, Format::Text, Format::Json] {
            let text = checked.write(format);
            let not_run = matches!(format, Format::Csv | Format::Json);
            assert!(text.contains("ekf-iaf") && text.contains(if not_run { "not-run" } else { "Not run: " }), "{text}");
        }
        assert!(check("guyonneau2022", &[SweepData::default()]).is_err());
    }
}
