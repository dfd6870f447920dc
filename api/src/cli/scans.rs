//! `furrow scans`: perception on labelled scans of real lanes.

use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};

use flate2::read::MultiGzDecoder;
use furrow_navigation::labelled::{self, Errors, Evaluation, Feed, LabelledScan, Subject};
use furrow_navigation::mission::LaneParams;
use furrow_navigation::parameters::Parameters;
use serde::Serialize;
use serde_json::Map;

use super::error::CliError;
use super::output;
use super::selection::{literal, pairs};
use crate::table::{Column, Entry, Format, Grid, render};

/// What a gzip file begins with.
const GZIP: [u8; 2] = [0x1f, 0x8b];

/// Judge perception on scans of real lanes in which a person has labelled both rows
#[derive(Debug, clap::Args)]
pub(super) struct ScansArgs {
    /// Labelled scans, a line a scan, plain or gzip: docs/labelled-scans.md describes them
    file: PathBuf,
    /// What is judged: pl, joint-fit or particle-filter
    #[arg(long, value_name = "NAME")]
    perception: String,
    /// Set a parameter by its dotted path, as in a scenario: mission.lane_width_m, perception.bin_m,
    /// localization.particles; may be repeated
    #[arg(long, value_name = "PATH=VALUE")]
    set: Vec<String>,
    /// Tell the label's heading with normal noise of so many degrees before each scan; otherwise nothing is told
    #[arg(long, value_name = "DEG", value_parser = degrees)]
    prior_noise: Option<f64>,
    /// Keep what it made of the scans before, which came so many seconds apart; otherwise each scan stands alone
    #[arg(long, value_name = "SECONDS", value_parser = seconds, conflicts_with = "prior_noise")]
    sequence: Option<f64>,
    /// Of the random numbers
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// What is printed with `--json`.
#[derive(Debug, Serialize)]
struct Report {
    file: String,
    perception: String,
    lane_width_m: f64,
    prior_noise_deg: Option<f64>,
    period_s: Option<f64>,
    seed: u64,
    /// All scans, labelled or not.
    scans: usize,
    labelled: Errors,
}

/// # Errors
/// Bad input: names the file and the line, or the parameter.
pub(super) fn run(args: &ScansArgs) -> Result<(), CliError> {
    let (subject, lane_width_m) = subject(args)?;
    let scans = read(&args.file)?;
    let evaluation = Evaluation { subject, feed: feed(args), lane_width_m, seed: args.seed };
    let file = args.file.display().to_string();
    let labelled =
        evaluation.errors(&scans).ok_or_else(|| CliError::BadInput(format!("{file}: no scan is labelled")))?;
    let report = Report {
        file,
        perception: args.perception.clone(),
        lane_width_m,
        prior_noise_deg: args.prior_noise,
        period_s: args.sequence,
        seed: args.seed,
        scans: scans.len(),
        labelled,
    };
    if args.json { output::json(&report) } else { output::line(&text(&report)) }
}

fn degrees(text: &str) -> Result<f64, String> {
    let degrees = text.parse::<f64>().ok().filter(|degrees| (0.0..=180.0).contains(degrees));
    degrees.ok_or_else(|| "a number from 0 to 180 is expected".to_owned())
}

fn seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse::<f64>().ok().filter(|seconds| (0.0..=3600.0).contains(seconds));
    seconds.ok_or_else(|| "a number from 0 to 3600 is expected".to_owned())
}

fn feed(args: &ScansArgs) -> Feed {
    match (args.prior_noise, args.sequence) {
        (Some(degrees), _) => Feed::HeadingPrior { noise_rad: degrees.to_radians() },
        (None, Some(period_s)) => Feed::Sequence { period_s },
        (None, None) => Feed::Alone,
    }
}

/// The subject with its parameters, and the lane's nominal width \[m\].
fn subject(args: &ScansArgs) -> Result<(Subject, f64), CliError> {
    let kind = args.perception.as_str();
    let part = Subject::part(kind);
    let (mut own, mut mission) = (Map::new(), Map::new());
    for (path, value) in pairs("--set", &args.set, literal)? {
        match path.split_once('.') {
            Some((name, key)) if name == part => own.insert(key.to_owned(), value),
            Some(("mission", key @ "lane_width_m")) => mission.insert(key.to_owned(), value),
            _ => {
                let allowed = format!("allowed is mission.lane_width_m and {part}.<parameter of {kind}>");
                return Err(CliError::BadInput(format!("--set {path}: nothing reads it here, {allowed}")));
            }
        };
    }
    let bad_input = |part: &'static str| {
        move |error: furrow_navigation::parameters::ParameterError| CliError::BadInput(error.under(part).to_string())
    };
    let lane_width_m = LaneParams::read(mission).map_err(bad_input("mission"))?.lane_width_m;
    let subject = Subject::read(kind, own, lane_width_m).map_err(|error| match error.path.as_str() {
        "" => CliError::BadInput(format!("--perception: {}", error.reason)),
        _ => bad_input(part)(error),
    })?;
    Ok((subject, lane_width_m))
}

fn read(file: &Path) -> Result<Vec<LabelledScan>, CliError> {
    let name = file.display();
    let bytes = fs::read(file).map_err(CliError::bad_input(name))?;
    let mut text = String::new();
    let readable = if bytes.starts_with(&GZIP) {
        MultiGzDecoder::new(bytes.as_slice()).read_to_string(&mut text)
    } else {
        bytes.as_slice().read_to_string(&mut text)
    };
    readable.map_err(CliError::bad_input(file.display()))?;
    labelled::read(&text)
        .map_err(|error| CliError::BadInput(format!("{}:{}: {}", file.display(), error.line, error.reason)))
}

fn text(report: &Report) -> String {
    let Errors { scans, cross_track_median_m, cross_track_p90_m, heading_median_deg, heading_p90_deg, bad_share } =
        &report.labelled;
    let row = |name: &str, numbers: [String; 2]| {
        [vec![Entry::text(name)], numbers.into_iter().map(Entry::Text).collect()].concat()
    };
    let columns = vec![Column::left("error"), Column::right("median"), Column::right("90 % within")];
    let rows = vec![
        row("cross-track [m]", [format!("{cross_track_median_m:.3}"), format!("{cross_track_p90_m:.3}")]),
        row("heading [deg]", [format!("{heading_median_deg:.1}"), format!("{heading_p90_deg:.1}")]),
    ];
    let grid = Grid { columns, rows, ..Grid::default() };
    format!(
        "{} on {scans} labelled scans of {}, lane width {} m\n{}\noff by more than 0.15 m or 15 deg: {:.1} %",
        report.perception,
        report.file,
        report.lane_width_m,
        render(&grid, Format::Text).trim_end(),
        100.0 * bad_share,
    )
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use flate2::Compression;
    use flate2::write::GzEncoder;

    use super::*;

    const SCANS: &str = "# frame;label;points\n1;-300,0,-300,900,500,0,500,900;-300,500 500,600\n2;;\n";

    fn args(file: &Path, perception: &str, set: &[&str]) -> ScansArgs {
        ScansArgs {
            file: file.to_owned(),
            perception: perception.to_owned(),
            set: set.iter().map(|set| (*set).to_owned()).collect(),
            prior_noise: None,
            sequence: None,
            seed: 1,
            json: false,
        }
    }

    fn written(bytes: &[u8]) -> tempfile::NamedTempFile {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(bytes).unwrap();
        file
    }

    fn refused(error: CliError) -> String {
        assert_eq!(error.exit_code(), 2);
        error.to_string()
    }

    #[test]
    fn plain_and_compressed_files_hold_the_same_scans() {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
        encoder.write_all(SCANS.as_bytes()).unwrap();
        let (plain, compressed) = (written(SCANS.as_bytes()), written(&encoder.finish().unwrap()));
        let scans = read(plain.path()).unwrap();
        assert_eq!(scans.len(), 2);
        assert_eq!(scans, read(compressed.path()).unwrap());
    }

    #[test]
    fn bad_files_are_named_with_the_line() {
        let broken = written(format!("{SCANS}3;;1\n").as_bytes());
        let place = format!("{}:4: points: `1` is no pair", broken.path().display());
        assert!(refused(read(broken.path()).unwrap_err()).starts_with(&place));
        for bytes in [&[0x1f, 0x8b, 1, 2][..], &[0xff, 0xfe]] {
            let file = written(bytes);
            assert!(refused(read(file.path()).unwrap_err()).contains(&file.path().display().to_string()));
        }
        assert!(refused(read(Path::new("no-such-file")).unwrap_err()).starts_with("no-such-file: "));
        let unlabelled = written(b"1;;0,0");
        assert!(refused(run(&args(unlabelled.path(), "pl", &[])).unwrap_err()).ends_with("no scan is labelled"));
    }

    #[test]
    fn parameters_are_set_by_their_path_in_a_scenario() {
        let set = |perception: &str, set: &[&str]| subject(&args(Path::new("x"), perception, set)).map(|made| made.1);
        assert_eq!(set("pl", &["mission.lane_width_m=0.6", "perception.bin_m=0.04"]).unwrap(), 0.6);
        assert_eq!(set("particle-filter", &["localization.particles=50"]).unwrap(), 0.75);
        assert!(refused(set("pl", &["perception.bin_m=9"]).unwrap_err()).starts_with("perception.bin_m: 9 is out of"));
        assert!(refused(set("pl", &["mission.lane_width_m=0"]).unwrap_err()).starts_with("mission.lane_width_m: 0"));
        assert!(
            refused(set("pl", &["localization.particles=5"]).unwrap_err()).contains("perception.<parameter of pl>")
        );
        assert!(refused(set("eyes", &[]).unwrap_err()).starts_with("--perception: `eyes` is unknown, allowed is `pl`"));
    }

    /// Prints the errors on the scans of the file that `FURROW_REAL_SCANS` names, lanes of 0.6 m: for eyes.
    #[test]
    fn real_scans_are_evaluated_if_a_file_is_named() {
        let Some(file) = std::env::var_os("FURROW_REAL_SCANS") else {
            return eprintln!("skipped: FURROW_REAL_SCANS names no file of labelled scans");
        };
        let scans = read(Path::new(&file)).unwrap();
        let prior = Feed::HeadingPrior { noise_rad: 5.0_f64.to_radians() };
        for kind in Subject::kinds() {
            for feed in [Feed::Alone, prior, Feed::Sequence { period_s: 0.1 }] {
                let (subject, lane_width_m) =
                    subject(&args(Path::new(&file), kind, &["mission.lane_width_m=0.6"])).unwrap();
                let errors = Evaluation { subject, feed, lane_width_m, seed: 1 }.errors(&scans).unwrap();
                assert!(errors.scans > 0 && errors.bad_share < 0.5, "{kind} {feed:?}: {errors:?}");
                eprintln!("{kind} {feed:?}: {errors:?}");
            }
        }
    }
}
