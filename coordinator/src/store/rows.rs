//! Statements that write many rows and have a parameter for every value.
//!
//! A row of many or of long values is written several times as fast as through a JSON text, which SQLite renders and
//! parses again for every row.

use sqlx::query::Query;
use sqlx::sqlite::SqliteArguments;
use sqlx::{Sqlite, SqliteConnection};

use crate::error::StoreError;

/// How many rows the statements of a [`ByRows`] take.
const SIZES: [usize; 4] = [64, 16, 4, 1];

/// One statement in several sizes.
pub(crate) type ByRows = [&'static str; SIZES.len()];

/// A statement that is waiting for its parameters.
pub(crate) type Binding<'q> = Query<'q, Sqlite, SqliteArguments>;

/// A statement around a list of rows: what stands before them, one row of parameters, what stands after them.
macro_rules! by_rows {
    ($before:literal, $row:literal, $after:literal) => {{
        use $crate::store::rows::four as four_times;
        [
            concat!($before, four_times!(four_times!(four_times!($row))), $after),
            concat!($before, four_times!(four_times!($row)), $after),
            concat!($before, four_times!($row), $after),
            concat!($before, $row, $after),
        ]
    }};
}

macro_rules! four {
    ($($rows:tt)*) => { concat!($($rows)*, ", ", $($rows)*, ", ", $($rows)*, ", ", $($rows)*) };
}

pub(crate) use {by_rows, four};

/// Writes all of `rows`, whose values `bind` adds in the order of the parameters.
pub(crate) async fn write<'q, R>(
    conn: &mut SqliteConnection,
    statement: &ByRows,
    rows: &'q [R],
    bind: impl Fn(Binding<'q>, &'q R) -> Binding<'q>,
) -> Result<(), StoreError> {
    let mut rest = rows;
    for (size, sql) in SIZES.into_iter().zip(statement) {
        while let Some((some, others)) = rest.split_at_checked(size) {
            some.iter().fold(sqlx::query(*sql), &bind).execute(&mut *conn).await?;
            rest = others;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::Store;

    const ADD: ByRows = by_rows!("insert into temp.pair (a, b) values ", "(?, ?)", " on conflict (a) do nothing");

    #[test]
    fn a_statement_has_as_many_rows_as_its_size_says() {
        let rows = |sql: &str| sql.matches("(?, ?)").count();
        assert_eq!(ADD.map(rows), SIZES);
    }

    #[tokio::test]
    async fn every_row_is_written_once_whatever_their_number() {
        let store = Store::in_memory().await.unwrap();
        let mut conn = store.writer().acquire().await.unwrap();
        sqlx::query("create temp table pair (a integer primary key, b text)").execute(&mut *conn).await.unwrap();
        for n in [0, 1, 3, 4, 64, 65, 149] {
            let rows: Vec<_> = (0..n).map(|a| (a, format!("row {a}"))).collect();
            write(&mut conn, &ADD, &rows, |add, (a, b)| add.bind(a).bind(b)).await.unwrap();
            let written: Vec<(i64, String)> =
                sqlx::query_as("delete from temp.pair returning a, b").fetch_all(&mut *conn).await.unwrap();
            assert_eq!(written, rows);
        }
    }
}
