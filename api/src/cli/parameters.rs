//! `furrow parameters`: what `--set` and `--vary` can change.

use furrow_sim::scenario::PARTS;

use super::error::CliError;
use super::output;
use crate::http::catalogue::{ParameterInfo, PartChoice, choices};
use crate::table::{Column, Entry, Format, Grid, render};

/// List what a scenario can be made of, with every parameter's default, range, unit, meaning and source
#[derive(Debug, clap::Args)]
pub(super) struct ParametersArgs {
    /// A part (`perception`), or one of its choices (`perception.rgop`); all if not given
    of: Option<String>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// # Errors
/// There is no such part or choice.
pub(super) fn run(args: &ParametersArgs) -> Result<(), CliError> {
    let mut found = choices(|_| true);
    if let Some(of) = &args.of {
        found.items.retain(|choice| is(choice, of));
        if found.items.is_empty() {
            return Err(unknown(of));
        }
    }
    if args.json {
        return output::json(&found);
    }
    if args.of.is_none() {
        return output::line(&overview(&found.items));
    }
    found.items.iter().try_for_each(|choice| output::line(&shown(choice)))
}

fn is(choice: &PartChoice, of: &str) -> bool {
    choice.part == of || of.split_once('.').is_some_and(|(part, kind)| choice.part == part && choice.kind == kind)
}

fn unknown(of: &str) -> CliError {
    let part = of.split('.').next().unwrap_or_default();
    let kinds = choices(|one| one == part).items.into_iter().map(|choice| format!("{part}.{}", choice.kind));
    let kinds: Vec<_> = kinds.collect();
    let allowed = if kinds.is_empty() { PARTS.join(", ") } else { kinds.join(", ") };
    CliError::BadInput(format!("{of}: there is no such part or choice, allowed is {allowed}"))
}

fn overview(choices: &[PartChoice]) -> String {
    let row = |choice: &PartChoice| {
        let name = format!("{}.{}", choice.part, choice.kind);
        vec![Entry::Text(name), Entry::Count(choice.parameters.len() as u64), Entry::Text(choice.about.clone())]
    };
    let columns = vec![Column::left("choice"), Column::right("parameters"), Column::left("about")];
    render(&Grid { columns, rows: choices.iter().map(row).collect(), ..Grid::default() }, Format::Text)
}

fn shown(choice: &PartChoice) -> String {
    let head = format!("{}.{}: {}", choice.part, choice.kind, choice.about);
    let columns = ["path", "default", "allowed", "unit", "meaning and source"].map(Column::left).to_vec();
    let rows: Vec<_> = choice.parameters.iter().map(row).collect();
    match rows.is_empty() {
        true => head,
        false => format!("{head}\n{}", render(&Grid { columns, rows, ..Grid::default() }, Format::Text)),
    }
}

fn row(parameter: &ParameterInfo) -> Vec<Entry> {
    let default = match &parameter.default {
        serde_json::Value::String(word) => word.clone(),
        other => other.to_string(),
    };
    let allowed = match parameter.range {
        Some([min, max]) => format!("{min} to {max}"),
        None => parameter.words.join(", "),
    };
    let about = format!("{} {}", parameter.about, parameter.source);
    [parameter.path.clone(), default, allowed, parameter.unit.clone(), about].map(Entry::Text).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_choice_is_shown_with_all_that_is_known_of_its_parameters() {
        let rgop = choices(|part| part == "perception").items.into_iter().find(|choice| choice.kind == "rgop").unwrap();
        let text = shown(&rgop);
        let line = text.lines().find(|line| line.contains("perception.attach_distance_m")).unwrap();
        for word in ["0.2", "0.001 to 10", " m ", "A point belongs to its nearest line", "Program: 0.2."] {
            assert!(line.contains(word), "{word}: {line}");
        }
    }

    #[test]
    fn what_there_is_not_is_refused_with_what_there_is() {
        let refused = |of: &str| {
            let args = ParametersArgs { of: Some(of.to_owned()), json: false };
            let error = run(&args).unwrap_err();
            assert_eq!(error.exit_code(), 2);
            error.to_string()
        };
        assert!(refused("perception.eyes").contains("perception.rgop"));
        assert!(refused("weather").contains("field, robot, sensors"));
    }
}
