//! Tokens of users beyond this machine: a hash of each.

use sqlx::SqliteConnection;

use crate::error::StoreError;
use crate::store::{Store, hash};
use crate::token::{NewToken, Scope, TokenInfo};

/// When a token was last used is kept to this \[ms\].
const USED_GRAIN_MS: i64 = 60_000;

/// A new token, unless one that is not revoked has its name.
const ADD: &str = "insert into token (name, hash, scopes, created_ms, expires_ms) values (?1, ?2, ?3, ?4, ?5)
    on conflict (name) where revoked_ms is null do nothing";

/// One token by its hash.
const FIND: &str =
    "select id, name, scopes, created_ms, expires_ms, used_ms, revoked_ms, hash from token where hash = ?1";

/// All tokens.
const LIST: &str = "select id, name, scopes, created_ms, expires_ms, used_ms, revoked_ms, hash from token order by id";

/// Revokes one by its number or name.
const REVOKE: &str = "update token set revoked_ms = ?2
    where revoked_ms is null and (name = ?1 or cast(id as text) = ?1)
    returning id, name, scopes, created_ms, expires_ms, used_ms, revoked_ms, hash";

/// Notes that one was used.
const USED: &str = "update token set used_ms = ?2 where id = ?1 and (used_ms is null or used_ms < ?2 - ?3)";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[ADD, FIND, LIST, REVOKE, USED];

type Row = (i64, String, String, i64, Option<i64>, Option<i64>, Option<i64>, Vec<u8>);

/// Keeps a token by its hash.
pub(crate) async fn add(
    conn: &mut SqliteConnection,
    new: &NewToken,
    hash: &blake3::Hash,
    now_ms: i64,
) -> Result<(), StoreError> {
    let insert = sqlx::query(ADD).bind(&new.name).bind(hash.as_bytes().to_vec()).bind(words(&new.scopes));
    let added = insert.bind(now_ms).bind(new.expires_ms).execute(conn).await?;
    match added.rows_affected() {
        1 => Ok(()),
        _ => Err(StoreError::Invalid(format!("there is a token `{}` already: revoke it first", new.name))),
    }
}

/// The token with that hash.
///
/// The index finds the row by a hash of which nobody can choose a part; the comparison that decides takes the same time
/// wherever two hashes differ.
pub(crate) async fn find(store: &Store, sent: &blake3::Hash) -> Result<Option<TokenInfo>, StoreError> {
    let row: Option<Row> = sqlx::query_as(FIND).bind(sent.as_bytes().to_vec()).fetch_optional(store.readers()).await?;
    let Some(row) = row else { return Ok(None) };
    let kept = blake3::Hash::from_bytes(hash("a token's hash", &row.7)?);
    if kept == *sent { read(row).map(Some) } else { Ok(None) }
}

/// All tokens by number.
pub(crate) async fn list(conn: &mut SqliteConnection) -> Result<Vec<TokenInfo>, StoreError> {
    let rows: Vec<Row> = sqlx::query_as(LIST).fetch_all(conn).await?;
    rows.into_iter().map(read).collect()
}

/// Revokes a token, which it returns.
pub(crate) async fn revoke(
    conn: &mut SqliteConnection,
    name_or_id: &str,
    now_ms: i64,
) -> Result<Option<TokenInfo>, StoreError> {
    let row: Option<Row> = sqlx::query_as(REVOKE).bind(name_or_id).bind(now_ms).fetch_optional(conn).await?;
    row.map(read).transpose()
}

/// Notes that a token was used, at most once a minute.
pub(crate) async fn used(store: &Store, token: &TokenInfo, now_ms: i64) -> Result<(), StoreError> {
    if token.used_ms.is_none_or(|used| used < now_ms - USED_GRAIN_MS) {
        sqlx::query(USED).bind(token.id).bind(now_ms).bind(USED_GRAIN_MS).execute(store.writer()).await?;
    }
    Ok(())
}

fn words(scopes: &[Scope]) -> String {
    let kept: Vec<_> = Scope::ALL.into_iter().filter(|scope| scopes.contains(scope)).map(Scope::word).collect();
    kept.join(",")
}

fn read((id, name, scopes, created_ms, expires_ms, used_ms, revoked_ms, _): Row) -> Result<TokenInfo, StoreError> {
    let damaged = |error: String| StoreError::Damaged(format!("the scopes of token {id}: {error}"));
    let scopes = scopes.split(',').map(str::parse).collect::<Result<_, _>>().map_err(damaged)?;
    Ok(TokenInfo { id, name, scopes, created_ms, expires_ms, used_ms, revoked_ms })
}
