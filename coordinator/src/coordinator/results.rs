//! What users ask about the results of a sweep.

use std::collections::{BTreeMap, HashMap};

use furrow_schema::id::{ScenarioId, SweepId};

use super::Coordinator;
use crate::error::StoreError;
use crate::store::{cell, columns, run_rows, runs, scenario, unfinished, values};
use crate::view::{CellColumns, CellSummary, CellValues, RunCursor, RunRow, RunValue, UnfinishedRun};

impl Coordinator {
    /// The cells of a sweep by position, with counts and exact moments; empty if there is no such sweep.
    ///
    /// # Errors
    /// [`StoreError::Database`] and [`StoreError::Damaged`].
    pub async fn cells(&self, sweep: SweepId) -> Result<Vec<CellSummary>, StoreError> {
        cell::list(&self.shared.store, sweep).await
    }

    /// The values behind the cells of a sweep, by position; of all metrics, or of those named.
    ///
    /// # Errors
    /// [`StoreError::Database`] and [`StoreError::Damaged`].
    pub async fn values(&self, sweep: SweepId, metrics: Option<&[&str]>) -> Result<Vec<CellValues>, StoreError> {
        values::by_cell(&self.shared.store, sweep, metrics).await
    }

    /// The metrics of the results in the cells of a sweep as columns, by position; of all metrics, or of those named. Much
    /// faster than [`Self::values`] for many runs, of which it does not tell which is which; without times.
    ///
    /// # Errors
    /// [`StoreError::Database`] and [`StoreError::Damaged`].
    pub async fn columns(&self, sweep: SweepId, metrics: Option<&[&str]>) -> Result<Vec<CellColumns>, StoreError> {
        columns::by_cell(&self.shared.store, sweep, metrics).await
    }

    /// The runs with a result in those cells of a sweep that have all of `labels` (label by factor), by seed, each
    /// with its value of `metric`.
    ///
    /// # Errors
    /// [`StoreError::Database`] and [`StoreError::Damaged`].
    pub async fn runs(
        &self,
        sweep: SweepId,
        labels: &BTreeMap<String, String>,
        metric: &str,
    ) -> Result<Vec<RunValue>, StoreError> {
        runs::with_labels(&self.shared.store, sweep, labels, metric).await
    }

    /// The runs of a sweep behind `after`, by cell, then job; at most `limit`. Each page is of its own moment.
    ///
    /// # Errors
    /// [`StoreError::Database`] and [`StoreError::Damaged`].
    pub async fn run_rows(&self, sweep: SweepId, after: RunCursor, limit: u32) -> Result<Vec<RunRow>, StoreError> {
        run_rows::page(&self.shared.store, sweep, after, limit).await
    }

    /// The runs of a sweep that have no result, by cell.
    ///
    /// # Errors
    /// [`StoreError::Database`] and [`StoreError::Damaged`].
    pub async fn unfinished(&self, sweep: SweepId) -> Result<Vec<UnfinishedRun>, StoreError> {
        unfinished::list(&self.shared.store, sweep).await
    }

    /// The texts of scenarios, canonical JSON, by number; of those that are there.
    ///
    /// # Errors
    /// [`StoreError::Database`].
    pub async fn scenario_texts(&self, ids: &[ScenarioId]) -> Result<HashMap<ScenarioId, String>, StoreError> {
        let mut conn = self.shared.store.readers().acquire().await?;
        let texts = scenario::texts(&mut conn, ids).await?;
        Ok(texts.into_iter().map(|text| (text.id, text.json)).collect())
    }
}
