//! Admission: join secrets, workers that come in with one, and workers that are turned away.

use furrow_schema::id::{Credential, JobId, PublicKey, WorkerId};
use furrow_schema::protocol::{Call, Enrol, LEASE_MS, Refresh, Refusal};
use sqlx::SqliteConnection;

use crate::error::StoreError;
use crate::store::tally::Tally;
use crate::store::transition::{Changes, Charges};
use crate::store::worker::{Known, hash_of};
use crate::store::{Store, hash, to_json, unsigned};
use crate::view::{AttemptEnd, WorkerChange};

/// A worker's certificate lasts so long; it asks for another one before.
const CERTIFICATE_MS: i64 = 30 * 24 * 60 * 60 * 1_000;
/// Expired workers are looked at for this long after: by then no lease of theirs is left.
const LOOK_BACK_MS: i64 = 2 * LEASE_MS;

/// A new join secret: key, now, until, uses, how long its workers are let in.
const ADD_SECRET: &str = "insert into join_secret (public_key, created_ms, until_ms, uses_left, worker_ms)
    values (?1, ?2, ?3, ?4, ?5)";

/// Whether there ever was a join secret.
const ANY_SECRET: &str = "select exists (select 1 from join_secret)";

/// The join secret with a key.
const SECRET: &str = "select id, until_ms, uses_left, worker_ms from join_secret where public_key = ?1";

/// A worker enrols with a join secret.
const USE_SECRET: &str = "update join_secret set uses_left = uses_left - 1 where id = ?1";

/// The worker of a name, and the key with which it enrolled.
const NAMESAKE: &str = "select worker.id, credential_hash, public_key, certificate_until_ms
    from worker left join enrolment on worker_id = worker.id where uid = ?1";

/// Whether anybody enrolled with a key.
const KEY_USED: &str = "select exists (select 1 from enrolment where public_key = ?1)";

/// A worker that comes in: name, hash of its credential, name for people, engine, threads, now, until.
const ADD_WORKER: &str = "insert into worker
        (uid, credential_hash, name, engine_id, threads, first_seen_ms, last_seen_ms, until_ms)
    values (?1, ?2, ?3, ?4, ?5, ?6, ?6, ?7)
    on conflict (uid) do update set credential_hash = excluded.credential_hash, until_ms = excluded.until_ms
    returning id";

/// It did: worker, join secret, key, now, end of its certificate.
const ADD_ENROLMENT: &str = "insert into enrolment
        (worker_id, join_secret_id, public_key, enrolled_ms, certificate_until_ms) values (?1, ?2, ?3, ?4, ?5)";

/// The key of an enrolled worker, and until when it is let in.
const KEY: &str =
    "select public_key, until_ms from enrolment join worker on worker.id = worker_id where worker_id = ?1";

/// A worker gets a new certificate.
const REFRESH: &str = "update enrolment set certificate_until_ms = ?2 where worker_id = ?1";

/// Turns a worker away for good.
const REVOKE: &str = "update worker set revoked_ms = coalesce(revoked_ms, ?2) where uid = ?1 returning id";

/// Until when a worker is let in.
const SET_END: &str = "update worker set until_ms = ?2 where uid = ?1 returning id";

/// Workers whose time ended between ?1 and ?2.
const ENDED: &str = "select id from worker where until_ms > ?1 and until_ms <= ?2";

/// The jobs that workers hold.
const HELD: &str = "select job.id, job.attempt, job.claim_id, job.panics, job.deaths
    from job join claim on claim.id = job.claim_id
    where job.state = 'leased' and claim.worker_id in (select value from json_each(?1))";

#[cfg(test)]
pub(super) const STATEMENTS: &[&str] = &[
    ADD_SECRET,
    ANY_SECRET,
    SECRET,
    USE_SECRET,
    NAMESAKE,
    KEY_USED,
    ADD_WORKER,
    ADD_ENROLMENT,
    KEY,
    REFRESH,
    REVOKE,
    SET_END,
    ENDED,
    HELD,
];

/// A new join secret's terms.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SecretTerms {
    /// It can be used for so long \[ms\].
    pub valid_ms: i64,
    /// So many workers may enrol with it.
    pub uses: u32,
    /// They are let in for so long \[ms\]; for good if none.
    pub workers_ms: Option<i64>,
}

/// What is asked about admission.
#[derive(Debug)]
pub(crate) enum Request {
    /// There is a new join secret.
    AddSecret(PublicKey, SecretTerms),
    /// A worker with a good signature wants to come in; the credential that it will have.
    Enrol(Box<Call<Enrol>>, Credential),
    /// A worker wants a new certificate.
    Refresh(Call<Refresh>),
    /// A user lets a worker in for a time, or turns it away.
    Change(WorkerId, WorkerChange),
}

/// What came of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Admitted {
    /// It is done.
    Done,
    /// There is no such worker.
    Unknown,
    /// The worker is in; its key, and when its certificate ends.
    In(PublicKey, i64),
}

/// Whether there ever was a join secret.
pub(crate) async fn any_secret(store: &Store) -> Result<bool, StoreError> {
    Ok(sqlx::query_scalar(ANY_SECRET).fetch_one(store.readers()).await?)
}

/// Does what is asked.
pub(crate) async fn answer(
    conn: &mut SqliteConnection,
    request: &Request,
    engine_id: i64,
    now_ms: i64,
    tally: &mut Tally,
) -> Result<Result<Admitted, Refusal>, StoreError> {
    match request {
        Request::AddSecret(key, terms) => {
            let SecretTerms { valid_ms, uses, workers_ms } = terms;
            let add = sqlx::query(ADD_SECRET).bind(key.0.to_vec()).bind(now_ms).bind(now_ms + valid_ms);
            add.bind(i64::from(*uses)).bind(workers_ms).execute(conn).await?;
            Ok(Ok(Admitted::Done))
        }
        Request::Enrol(call, credential) => enrol(conn, call, credential, engine_id, now_ms).await,
        Request::Refresh(call) => refresh(conn, call, now_ms).await,
        Request::Change(worker, change) => change_worker(conn, worker, *change, engine_id, now_ms, tally).await.map(Ok),
    }
}

/// Takes a worker in. Asked again with the same key, it is in already.
async fn enrol(
    conn: &mut SqliteConnection,
    call: &Call<Enrol>,
    credential: &Credential,
    engine_id: i64,
    now_ms: i64,
) -> Result<Result<Admitted, Refusal>, StoreError> {
    let Enrol { public_key, join, hello, .. } = &call.body;
    let namesake: Option<Namesake> =
        sqlx::query_as(NAMESAKE).bind(call.worker.as_str()).fetch_optional(&mut *conn).await?;
    let secret: Option<Secret> = sqlx::query_as(SECRET).bind(join.0.to_vec()).fetch_optional(&mut *conn).await?;
    let key_used: bool = sqlx::query_scalar(KEY_USED).bind(public_key.0.to_vec()).fetch_one(&mut *conn).await?;
    let Some(secret) = secret else { return refused("the coordinator does not know this join secret") };
    if let Some(namesake) = &namesake {
        if let Some(refusal) = Known::load(conn, &[call.worker.as_str()], now_ms).await?.turned_away(&call.worker) {
            return Ok(Err(refusal));
        }
        match namesake.standing(*public_key, &call.credential)? {
            Standing::Same(until_ms) => return Ok(Ok(Admitted::In(*public_key, until_ms))),
            Standing::Other => return refused("another worker goes by this name"),
            Standing::NotYetEnrolled => {}
        }
    }
    if let Some(why) = secret.is_over(now_ms) {
        return refused(why);
    }
    if key_used {
        return refused("another worker has this key");
    }
    let until_ms = secret.worker_ms.map(|ms| now_ms + ms);
    let add = sqlx::query_scalar(ADD_WORKER).bind(call.worker.as_str()).bind(hash_of(credential).as_bytes().to_vec());
    let add = add.bind(&hello.name).bind(engine_id).bind(i64::from(hello.threads)).bind(now_ms).bind(until_ms);
    let worker: i64 = add.fetch_one(&mut *conn).await?;
    let certificate_until_ms = end_of_certificate(until_ms, now_ms);
    let add = sqlx::query(ADD_ENROLMENT).bind(worker).bind(secret.id).bind(public_key.0.to_vec());
    add.bind(now_ms).bind(certificate_until_ms).execute(&mut *conn).await?;
    sqlx::query(USE_SECRET).bind(secret.id).execute(conn).await?;
    tracing::info!(worker = %call.worker, name = hello.name, "a worker enrolled");
    Ok(Ok(Admitted::In(*public_key, certificate_until_ms)))
}

fn refused(detail: &str) -> Result<Result<Admitted, Refusal>, StoreError> {
    Ok(Err(Refusal::Enrolment { detail: detail.to_owned() }))
}

fn end_of_certificate(worker_until_ms: Option<i64>, now_ms: i64) -> i64 {
    (now_ms + CERTIFICATE_MS).min(worker_until_ms.unwrap_or(i64::MAX))
}

#[derive(sqlx::FromRow)]
struct Secret {
    id: i64,
    until_ms: i64,
    uses_left: i64,
    worker_ms: Option<i64>,
}

impl Secret {
    fn is_over(&self, now_ms: i64) -> Option<&'static str> {
        match self {
            _ if self.until_ms <= now_ms => Some("the join secret has expired"),
            _ if self.uses_left == 0 => Some("the join secret is used up"),
            _ => None,
        }
    }
}

/// The worker that goes by a name.
#[derive(sqlx::FromRow)]
struct Namesake {
    credential_hash: Vec<u8>,
    public_key: Option<Vec<u8>>,
    certificate_until_ms: Option<i64>,
}

/// What it is to who wants to enrol.
enum Standing {
    /// The same: its certificate's end.
    Same(i64),
    /// The same, but it came in by a hello, without a network.
    NotYetEnrolled,
    /// Somebody else.
    Other,
}

impl Namesake {
    fn standing(&self, key: PublicKey, credential: &Credential) -> Result<Standing, StoreError> {
        let expected = blake3::Hash::from_bytes(hash("a credential's hash", &self.credential_hash)?);
        Ok(match (&self.public_key, self.certificate_until_ms) {
            (Some(own), Some(until_ms)) if *own == key.0 => Standing::Same(until_ms),
            (None, _) if expected == hash_of(credential) => Standing::NotYetEnrolled,
            _ => Standing::Other,
        })
    }
}

async fn refresh(
    conn: &mut SqliteConnection,
    call: &Call<Refresh>,
    now_ms: i64,
) -> Result<Result<Admitted, Refusal>, StoreError> {
    let worker = match Known::load(conn, &[call.worker.as_str()], now_ms).await?.check(call) {
        Ok(worker) => worker,
        Err(refusal) => return Ok(Err(refusal)),
    };
    let enrolled: Option<(Vec<u8>, Option<i64>)> = sqlx::query_as(KEY).bind(worker).fetch_optional(&mut *conn).await?;
    let Some((key, until_ms)) = enrolled else { return Ok(Err(Refusal::NotEnrolled)) };
    let certificate_until_ms = end_of_certificate(until_ms, now_ms);
    sqlx::query(REFRESH).bind(worker).bind(certificate_until_ms).execute(conn).await?;
    Ok(Ok(Admitted::In(PublicKey(hash("a worker's key", &key)?), certificate_until_ms)))
}

async fn change_worker(
    conn: &mut SqliteConnection,
    worker: &WorkerId,
    change: WorkerChange,
    engine_id: i64,
    now_ms: i64,
    tally: &mut Tally,
) -> Result<Admitted, StoreError> {
    let update = match change {
        WorkerChange::Revoke => sqlx::query_scalar(REVOKE).bind(worker.as_str()).bind(now_ms),
        WorkerChange::Until(until_ms) => sqlx::query_scalar(SET_END).bind(worker.as_str()).bind(until_ms),
    };
    let Some(id) = update.fetch_optional(&mut *conn).await? else { return Ok(Admitted::Unknown) };
    let (is_out, reason) = match change {
        WorkerChange::Revoke => (true, "the worker was revoked"),
        WorkerChange::Until(until_ms) => (until_ms.is_some_and(|until_ms| until_ms <= now_ms), TIME_IS_OVER),
    };
    if is_out {
        let jobs = free(conn, &[id], reason, engine_id, now_ms, tally).await?;
        tracing::info!(%worker, jobs, "{reason}");
    }
    Ok(Admitted::Done)
}

const TIME_IS_OVER: &str = "the worker's time is over";

/// Takes back what workers hold whose time is over; says how many jobs.
pub(crate) async fn free_ended(
    conn: &mut SqliteConnection,
    engine_id: i64,
    now_ms: i64,
    tally: &mut Tally,
) -> Result<usize, StoreError> {
    let ended: Vec<i64> =
        sqlx::query_scalar(ENDED).bind(now_ms - LOOK_BACK_MS).bind(now_ms).fetch_all(&mut *conn).await?;
    if ended.is_empty() { Ok(0) } else { free(conn, &ended, TIME_IS_OVER, engine_id, now_ms, tally).await }
}

/// Takes back what workers hold, free of charge; says how many jobs.
async fn free(
    conn: &mut SqliteConnection,
    workers: &[i64],
    reason: &str,
    engine_id: i64,
    now_ms: i64,
    tally: &mut Tally,
) -> Result<usize, StoreError> {
    let rows: Vec<(i64, i64, i64, i64, i64)> =
        sqlx::query_as(HELD).bind(to_json(&workers)).fetch_all(&mut *conn).await?;
    let mut changes = Changes::default();
    for (job, attempt, claim, panics, deaths) in &rows {
        let job = JobId(*job);
        let charges = Charges { panics: unsigned("panics", *panics)?, deaths: unsigned("deaths", *deaths)? };
        let attempt = unsigned("an attempt", *attempt)?;
        changes.archive(job, attempt, *claim, AttemptEnd::HandedBack, Some(reason.to_owned()));
        changes.requeue(job, 0, charges);
    }
    changes.write(conn, engine_id, now_ms, tally).await?;
    Ok(rows.len())
}
