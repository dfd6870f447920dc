//! Scenarios: each content once.

use std::collections::HashMap;
use std::sync::Arc;

use furrow_schema::id::{ScenarioHash, ScenarioId};
use furrow_schema::protocol::ScenarioText;
use sqlx::SqliteConnection;

use crate::error::StoreError;
use crate::store::{hash, to_json};

/// The next number for a scenario: no number is given twice.
const NEXT: &str = "select max(scenario, coalesce((select max(id) from scenario), 0)) + 1 from last_number";

/// New scenarios, numbered from ?2 on; those known by content stay as they are.
const ADD: &str = "insert into scenario (id, hash, json)
    select ?2 + key, unhex(value ->> 0), value ->> 1 from json_each(?1) where true
    on conflict (hash) do nothing";

/// Numbers of scenarios by content.
const FIND: &str = "select scenario.hash, scenario.id
    from json_each(?1) as wanted join scenario on scenario.hash = unhex(wanted.value)";

/// Texts of scenarios by number.
const TEXTS: &str = "select id, json from scenario where id in (select value from json_each(?1)) order by id";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[NEXT, ADD, FIND, TEXTS];

/// Numbers of `texts`, which are stored as needed.
pub(crate) async fn intern(
    conn: &mut SqliteConnection,
    texts: &[(ScenarioHash, Arc<str>)],
) -> Result<HashMap<ScenarioHash, ScenarioId>, StoreError> {
    let wanted = to_json(&texts.iter().map(|(hash, _)| hash).collect::<Vec<_>>());
    let known = find(conn, &wanted).await?;
    let new: Vec<_> = texts.iter().filter(|(hash, _)| !known.contains_key(hash)).collect();
    if new.is_empty() {
        return Ok(known);
    }
    let next: i64 = sqlx::query_scalar(NEXT).fetch_one(&mut *conn).await?;
    sqlx::query(ADD).bind(to_json(&new)).bind(next).execute(&mut *conn).await?;
    find(conn, &wanted).await
}

async fn find(conn: &mut SqliteConnection, wanted: &str) -> Result<HashMap<ScenarioHash, ScenarioId>, StoreError> {
    let rows: Vec<(Vec<u8>, i64)> = sqlx::query_as(FIND).bind(wanted).fetch_all(conn).await?;
    let pair = |(bytes, id): (Vec<u8>, i64)| Ok((ScenarioHash(hash("a scenario's hash", &bytes)?), ScenarioId(id)));
    rows.into_iter().map(pair).collect()
}

/// Texts of the scenarios in `ids`.
pub(crate) async fn texts(conn: &mut SqliteConnection, ids: &[ScenarioId]) -> Result<Vec<ScenarioText>, StoreError> {
    if ids.is_empty() {
        return Ok(Vec::new());
    }
    let rows: Vec<(i64, String)> = sqlx::query_as(TEXTS).bind(to_json(&ids)).fetch_all(conn).await?;
    Ok(rows.into_iter().map(|(id, json)| ScenarioText { id: ScenarioId(id), json }).collect())
}
