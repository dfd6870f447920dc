//! A grid for programs as Apache Parquet: words as text, counts as integers, other numbers as doubles; nothing as null.

use parquet::errors::ParquetError;

use crate::columnar::{File, Heading, Kind, Values};
use crate::table::grid::{Entry, Grid};

/// The grid as one row group.
///
/// # Errors
/// Two columns have one heading.
pub(crate) fn parquet(grid: &Grid) -> Result<Vec<u8>, ParquetError> {
    let kinds: Vec<Kind> = (0..grid.columns.len()).map(|column| kind(grid, column)).collect();
    let headings = grid.columns.iter().zip(&kinds);
    let heading = |name: &str, kind: Kind| Heading { name: name.to_owned(), kind, optional: true };
    let mut file = File::begin(headings.map(|(column, kind)| heading(&column.heading, *kind)).collect())?;
    file.group(kinds.iter().enumerate().map(|(column, kind)| values(grid, column, *kind)).collect())?;
    let mut bytes = file.written();
    bytes.extend(file.end()?);
    Ok(bytes)
}

/// What a column holds: text if any of it is, else counts if there is no other number.
fn kind(grid: &Grid, column: usize) -> Kind {
    let entries = || grid.rows.iter().filter_map(|row| row.get(column));
    if entries().any(|entry| matches!(entry, Entry::Text(_) | Entry::Lines(_))) {
        Kind::Text
    } else if entries().any(|entry| matches!(entry, Entry::Count(_))) {
        Kind::Whole
    } else {
        Kind::Number
    }
}

fn values(grid: &Grid, column: usize, kind: Kind) -> Values {
    let entries = grid.rows.iter().map(|row| row.get(column).unwrap_or(&Entry::Empty));
    match kind {
        Kind::Text => Values::Text(entries.map(text).collect()),
        Kind::Whole => Values::Whole(entries.map(whole).collect()),
        Kind::Number => Values::Number(entries.map(number).collect()),
    }
}

fn text(entry: &Entry) -> Option<String> {
    (*entry != Entry::Empty).then(|| super::plain(entry, "; "))
}

fn whole(entry: &Entry) -> Option<i64> {
    if let Entry::Count(count) = entry { i64::try_from(*count).ok() } else { None }
}

fn number(entry: &Entry) -> Option<f64> {
    if let Entry::Number(number) = entry { Some(*number) } else { None }
}

#[cfg(test)]
mod tests {
    use axum::body::Bytes;
    use parquet::file::reader::{FileReader, SerializedFileReader};
    use parquet::record::RowAccessor;

    use super::*;
    use crate::table::grid::Column;

    #[test]
    fn words_counts_and_numbers_are_read_back_and_nothing_is_null() {
        let columns = vec![Column::left("field"), Column::right("n"), Column::right("mean"), Column::right("std")];
        let row = |label: &str, mean| vec![Entry::text(label), Entry::Count(3), Entry::number(mean), Entry::Empty];
        let grid = Grid { columns, rows: vec![row("crop-1", Some(0.1)), row("crop-2", None)], ..Grid::default() };
        let reader = SerializedFileReader::new(Bytes::from(parquet(&grid).unwrap())).unwrap();
        let rows: Vec<_> = reader.get_row_iter(None).unwrap().map(Result::unwrap).collect();
        assert_eq!((rows[1].get_string(0).unwrap().as_str(), rows[1].get_long(1).unwrap()), ("crop-2", 3));
        assert_eq!(rows[0].get_double(2).unwrap(), 0.1);
        assert!(rows[1].get_double(2).is_err() && rows[0].get_double(3).is_err());
    }
}
