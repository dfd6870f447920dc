//! Cells with their counts and moments: what tables without medians are made of.

use std::collections::BTreeMap;

use furrow_schema::id::{CellId, SweepId};

use crate::error::StoreError;
use crate::store::tally::moments;
use crate::store::{Store, from_json, unsigned};
use crate::view::CellSummary;

/// The cells of a sweep by position, a row for each metric and one with none where there is no result.
const LIST: &str = "select cell.id, position, factors, total, done, failed, metric, moments
    from cell left join cell_metric on cell_metric.cell_id = cell.id
    where sweep_id = ?1 order by position, metric";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[LIST];

type Row = (i64, i64, String, i64, i64, i64, Option<String>, Option<Vec<u8>>);

/// The cells of a sweep by position.
pub(crate) async fn list(store: &Store, sweep: SweepId) -> Result<Vec<CellSummary>, StoreError> {
    let rows: Vec<Row> = sqlx::query_as(LIST).bind(sweep.0).fetch_all(store.readers()).await?;
    let mut cells: Vec<CellSummary> = Vec::new();
    for (id, position, factors, total, done, failed, metric, bytes) in rows {
        if cells.last().is_none_or(|cell| cell.id.0 != id) {
            cells.push(CellSummary {
                id: CellId(id),
                position: unsigned("a cell's position", position)?,
                factors: from_json("a cell's factors", &factors)?,
                total: unsigned("a cell's count", total)?,
                done: unsigned("a cell's count", done)?,
                failed: unsigned("a cell's count", failed)?,
                metrics: BTreeMap::new(),
            });
        }
        if let (Some(metric), Some(bytes), Some(cell)) = (metric, bytes, cells.last_mut()) {
            let moments = moments(&metric, &bytes)?;
            cell.metrics.insert(metric, moments);
        }
    }
    Ok(cells)
}
