//! Expiry: leases that nobody renewed.

use furrow_schema::id::JobId;
use sqlx::SqliteConnection;

use crate::error::StoreError;
use crate::store::tally::Tally;
use crate::store::transition::{Changes, Charges};
use crate::store::unsigned;
use crate::view::AttemptEnd;

/// At most this many leases are expired in one transaction; the rest follow in the next.
const MOST: i64 = 10_000;

/// Jobs whose lease ran out.
const OVERDUE: &str = "select id, attempt, claim_id, running, panics, deaths
    from job where state = 'leased' and lease_until_ms <= ?1 limit ?2";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[OVERDUE];

type Row = (i64, i64, i64, bool, i64, i64);

/// Takes back every job whose lease ran out. One that ran there is charged with the worker's death and given up
/// on after `max_deaths` of them; one that was merely prefetched is not charged. Returns how many there were.
pub(crate) async fn expire(
    conn: &mut SqliteConnection,
    max_deaths: u32,
    engine_id: i64,
    now_ms: i64,
    tally: &mut Tally,
) -> Result<usize, StoreError> {
    let rows: Vec<Row> = sqlx::query_as(OVERDUE).bind(now_ms).bind(MOST).fetch_all(&mut *conn).await?;
    let mut changes = Changes::default();
    for (id, attempt, claim, running, panics, deaths) in &rows {
        let (job, attempt) = (JobId(*id), unsigned("an attempt", *attempt)?);
        let deaths: u32 = unsigned("deaths", *deaths)?;
        let charges = Charges { panics: unsigned("panics", *panics)?, deaths: deaths + u32::from(*running) };
        let end = if *running { AttemptEnd::Died } else { AttemptEnd::Expired };
        changes.archive(job, attempt, *claim, end, None);
        if *running && charges.deaths >= max_deaths.max(1) {
            changes.fail(job, charges);
        } else {
            changes.requeue(job, 0, charges);
        }
    }
    if !rows.is_empty() {
        tracing::info!(jobs = rows.len(), "leases ran out");
        changes.write(conn, engine_id, now_ms, tally).await?;
    }
    Ok(rows.len())
}
