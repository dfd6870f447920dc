//! Rows as Apache Parquet: a row group a page.
//!
//! `job`, `seed` and `attempts` are 64-bit integers, metrics doubles, all else text. What a run may not have is optional.

use furrow_coordinator::view::RunRow;

use super::Columns;
use crate::columnar::{Heading, Kind, Values};

pub(super) fn headings(columns: &Columns) -> Vec<Heading> {
    let first_metric = columns.factors.len() + super::BEFORE.len() + super::BEHIND.len();
    let heading = |(place, name): (usize, String)| {
        let kind = match name.as_str() {
            _ if place >= first_metric => Kind::Number,
            "job" | "seed" | "attempts" => Kind::Whole,
            _ => Kind::Text,
        };
        let optional = place >= first_metric || ["outcome", "digest"].contains(&name.as_str());
        Heading { name, kind, optional }
    };
    columns.headings().into_iter().enumerate().map(heading).collect()
}

pub(super) fn columns(columns: &Columns, runs: &[RunRow]) -> Vec<Values> {
    let text = |of: &dyn Fn(&RunRow) -> Option<String>| Values::Text(runs.iter().map(of).collect());
    let whole = |of: &dyn Fn(&RunRow) -> i64| Values::Whole(runs.iter().map(|run| Some(of(run))).collect());
    let mut values = vec![whole(&|run| run.job.0), text(&|run| Some(run.key.to_string()))];
    for factor in &columns.factors {
        values.push(text(&|run| Some(columns.label(run, factor).to_owned())));
    }
    values.extend([
        whole(&|run| i64::try_from(run.seed).unwrap_or(i64::MAX)),
        text(&|run| Some(run.state.as_str().to_owned())),
        whole(&|run| i64::from(run.attempts)),
        text(&|run| run.outcome.clone()),
        text(&|run| run.digest.map(|digest| digest.to_string())),
    ]);
    let metric = |name: &String| Values::Number(runs.iter().map(|run| run.metrics.get(name).copied()).collect());
    values.extend(columns.metrics.iter().map(metric));
    values
}

#[cfg(test)]
mod tests {
    use axum::body::Bytes;
    use parquet::file::reader::{FileReader, SerializedFileReader};
    use parquet::record::RowAccessor;

    use super::super::Form;
    use super::super::tests::{export, runs};

    #[test]
    fn what_was_written_is_read_back_with_a_row_group_a_page() {
        let runs = runs();
        let bytes = export(Form::Parquet, &[&runs, &runs[..1]]);
        let reader = SerializedFileReader::new(Bytes::from(bytes)).unwrap();
        let groups: Vec<i64> = reader.metadata().row_groups().iter().map(|group| group.num_rows()).collect();
        assert_eq!(groups, [2, 1]);
        let rows: Vec<_> = reader.get_row_iter(None).unwrap().map(Result::unwrap).collect();
        assert_eq!((rows[0].get_long(0).unwrap(), rows[0].get_string(3).unwrap().as_str()), (7, "a,b"));
        assert_eq!(rows[0].get_double(10).unwrap(), 0.1 + 0.2);
        assert_eq!(rows[1].get_string(5).unwrap(), "failed");
        assert!(rows[1].get_double(10).is_err() && rows[1].get_string(7).is_err(), "null");
    }

    #[test]
    fn a_sweep_without_rows_is_a_file_with_columns() {
        let reader = SerializedFileReader::new(Bytes::from(export(Form::Parquet, &[]))).unwrap();
        let schema = reader.metadata().file_metadata().schema_descr();
        assert_eq!((schema.num_columns(), reader.metadata().num_row_groups()), (11, 0));
    }
}
