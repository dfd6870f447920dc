//! Rows as comma-separated values after RFC 4180; what a run does not have is empty.

use furrow_coordinator::view::RunRow;

use super::{Columns, ExportError};
use crate::table::{exact, harmless};

pub(super) fn heading(columns: &Columns) -> Result<Vec<u8>, ExportError> {
    let mut writer = writer();
    let headings = columns.headings();
    writer.write_record(headings.iter().map(|heading| harmless(heading).into_owned())).map_err(ExportError::of)?;
    writer.into_inner().map_err(ExportError::of)
}

pub(super) fn rows(columns: &Columns, runs: &[RunRow]) -> Result<Vec<u8>, ExportError> {
    let mut writer = writer();
    for run in runs {
        let mut put = |field: &str| writer.write_field(field).map_err(ExportError::of);
        put(&run.job.to_string())?;
        put(&run.key.to_string())?;
        columns.factors.iter().try_for_each(|factor| put(&harmless(columns.label(run, factor))))?;
        put(&run.seed.to_string())?;
        put(run.state.as_str())?;
        put(&run.attempts.to_string())?;
        put(&harmless(run.outcome.as_deref().unwrap_or_default()))?;
        put(&run.digest.map(|digest| digest.to_string()).unwrap_or_default())?;
        let value = |name| run.metrics.get(name).map(|value| exact(*value)).unwrap_or_default();
        columns.metrics.iter().try_for_each(|name| put(&value(name)))?;
        writer.write_record(None::<&[u8]>).map_err(ExportError::of)?;
    }
    writer.into_inner().map_err(ExportError::of)
}

fn writer() -> csv::Writer<Vec<u8>> {
    csv::WriterBuilder::new().terminator(csv::Terminator::CRLF).from_writer(Vec::new())
}

#[cfg(test)]
mod tests {
    use super::super::Form;
    use super::super::tests::{export, runs};

    #[test]
    fn a_run_is_a_line_and_what_it_lacks_is_empty() {
        let runs = runs();
        let bytes = export(Form::Csv, &[&runs[..1], &runs[1..]]);
        let mut reader = csv::Reader::from_reader(bytes.as_slice());
        assert_eq!(reader.headers().unwrap().iter().next_back(), Some("distance_m"));
        let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
        assert_eq!((rows.len(), &rows[0][0], &rows[0][3], &rows[0][10]), (2, "7", "a,b", "0.30000000000000004"));
        assert_eq!((&rows[1][5], &rows[1][7], &rows[1][9]), ("failed", "", ""));
        assert_eq!(&rows[1][2], "'=1+1", "no spreadsheet computes a label");
    }
}
