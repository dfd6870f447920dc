-- The queue and everything it remembers. README.md beside this file draws the job's state machine.

-- "Furw": tells a database of this program from any other.
pragma application_id = 1182102135;

-- The name this database's coordinator goes by on the network; it outlives restarts.
create table coordinator (
    one integer primary key check (one = 1),
    id text not null check (length(id) = 32)
) strict;
insert into coordinator (one, id) values (1, lower(hex(randomblob(16))));

-- Simulation code, by the hash of its sources.
create table engine (
    id integer primary key,
    hash blob not null unique check (length(hash) = 32)
) strict;

-- Where each priority's queue has got to: the largest turn handed out. New sweeps start from there.
create table virtual_time (
    priority integer primary key,
    turn integer not null check (turn >= 0)
) strict;

create table worker (
    id integer primary key,
    uid text not null unique check (length(uid) = 32),
    credential_hash blob not null check (length(credential_hash) = 32),
    name text not null,
    engine_id integer not null references engine (id),
    threads integer not null check (threads >= 1),
    first_seen_ms integer not null,
    last_seen_ms integer not null
) strict;

-- One request for work that was granted; the same request again finds this row.
create table claim (
    id integer primary key,
    worker_id integer not null references worker (id),
    request text not null check (length(request) = 32),
    claimed_ms integer not null,
    constraint request_once unique (worker_id, request)
) strict;

create table scenario (
    id integer primary key,
    hash blob not null unique check (length(hash) = 32),
    json text not null
) strict;

create table job (
    id integer primary key,
    key blob not null unique check (length(key) = 32),
    engine_id integer not null references engine (id),
    scenario_id integer not null references scenario (id),
    seed integer not null check (seed >= 0),
    state text not null,
    -- The highest among the sweeps that want it.
    priority integer not null,
    -- Its place among jobs of equal priority.
    turn integer not null,
    record integer not null check (record in (0, 1)),
    alone integer not null check (alone in (0, 1)),
    not_before_ms integer not null default 0,
    -- How often it was handed out; the current or last attempt.
    attempt integer not null default 0 check (attempt >= 0),
    panics integer not null default 0 check (panics >= 0),
    deaths integer not null default 0 check (deaths >= 0),
    claim_id integer references claim (id),
    lease_until_ms integer,
    running integer not null default 0 check (running in (0, 1)),
    created_ms integer not null,
    ended_ms integer,
    constraint state_known check (state in ('queued', 'leased', 'done', 'failed', 'cancelled')),
    constraint lease_iff_leased check ((state = 'leased') = (lease_until_ms is not null)),
    constraint holder_iff_leased check ((state = 'leased') = (claim_id is not null)),
    constraint running_only_when_leased check (running = 0 or state = 'leased'),
    constraint leased_only_by_attempt check (state <> 'leased' or attempt > 0),
    constraint ended_iff_ended check ((state in ('done', 'failed', 'cancelled')) = (ended_ms is not null))
) strict;

-- What a claim takes from, in its order.
create index job_queued on job (engine_id, priority desc, turn, not_before_ms) where state = 'queued';

-- What expiry looks at; covers the jobs of one claim too.
create index job_leased on job (lease_until_ms, claim_id) where state = 'leased';

-- Handings-out that ended without a result on record. The current one stands in job, the successful one in result.
create table attempt (
    job_id integer not null references job (id),
    attempt integer not null check (attempt > 0),
    claim_id integer not null references claim (id),
    ended_ms integer not null,
    ended text not null,
    reason text,
    primary key (job_id, attempt),
    constraint ended_known check (ended in ('panicked', 'died', 'expired', 'handed-back', 'superseded'))
) strict, without rowid;

create table result (
    job_id integer primary key references job (id),
    claim_id integer not null references claim (id),
    attempt integer not null check (attempt > 0),
    digest blob not null check (length(digest) = 32),
    outcome text not null,
    recorded_ms integer not null,
    -- Per-run values by metric name.
    metrics text not null,
    -- Wall-clock figures: another record, kept beside the result and never part of it.
    timings text not null
) strict;

create table trajectory (
    job_id integer primary key references result (job_id),
    poses blob not null
) strict;

-- A second result of a job that differs from the one on record.
create table incident (
    id integer primary key,
    job_id integer not null references job (id),
    noted_ms integer not null,
    recorded_worker_id integer not null references worker (id),
    recorded_engine_id integer not null references engine (id),
    recorded_attempt integer not null,
    recorded_digest blob not null check (length(recorded_digest) = 32),
    other_worker_id integer not null references worker (id),
    other_engine_id integer not null references engine (id),
    other_attempt integer not null,
    other_digest blob not null check (length(other_digest) = 32),
    other_outcome text not null,
    other_metrics text not null,
    constraint noted_once unique (job_id, other_worker_id, other_attempt, other_digest),
    constraint digests_differ check (recorded_digest <> other_digest)
) strict;

create table sweep (
    id integer primary key autoincrement,
    name text not null,
    plan text not null,
    request_json text not null,
    engine_id integer not null references engine (id),
    state text not null,
    priority integer not null,
    record integer not null check (record in (0, 1)),
    timing integer not null check (timing in (0, 1)),
    seeds integer not null check (seeds >= 1),
    factors text not null,
    idempotency_key text unique,
    -- Jobs by cell: a job that two cells of the sweep want counts in both.
    total integer not null default 0,
    new integer not null default 0,
    cached integer not null default 0,
    done integer not null default 0,
    failed integer not null default 0,
    cancelled integer not null default 0,
    created_ms integer not null,
    finished_ms integer,
    constraint state_known check (state in ('active', 'paused', 'done', 'cancelled')),
    constraint counts_fit check (done >= 0 and failed >= 0 and cancelled >= 0 and done + failed + cancelled <= total),
    constraint finished_iff_ended check ((state in ('done', 'cancelled')) = (finished_ms is not null))
) strict;

create table cell (
    id integer primary key,
    sweep_id integer not null references sweep (id),
    -- Its place in the sweep, from 0.
    position integer not null,
    -- Label by factor.
    factors text not null,
    total integer not null default 0,
    done integer not null default 0,
    failed integer not null default 0,
    constraint position_once unique (sweep_id, position),
    constraint counts_fit check (done >= 0 and failed >= 0 and done + failed <= total)
) strict;

create table cell_job (
    cell_id integer not null references cell (id),
    job_id integer not null references job (id),
    primary key (cell_id, job_id)
) strict, without rowid;
create index cell_job_by_job on cell_job (job_id);

-- n, minimum, maximum, exact sum and exact sum of squares of a metric over a cell's results, as one value.
create table cell_metric (
    cell_id integer not null references cell (id),
    metric text not null,
    moments blob not null,
    primary key (cell_id, metric)
) strict, without rowid;
