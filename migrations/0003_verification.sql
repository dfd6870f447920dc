-- Some results are computed again on other workers, and a worker that computes wrongly gets no more jobs.

alter table worker add column barred_ms integer;
alter table worker add column barred_reason text check ((barred_reason is null) = (barred_ms is null));

-- A job that has a result and is run again, to compare digests. Neither the job's state nor its result depends on it.
create table verification (
    job_id integer primary key references result (job_id),
    state text not null default 'waits',
    -- When it was asked for, or when the latest opinion came.
    since_ms integer not null,
    -- Handings-out that brought no opinion.
    fruitless integer not null default 0 check (fruitless >= 0),
    -- The present handing-out; its number is one of the job's attempts.
    attempt integer,
    claim_id integer references claim (id),
    lease_until_ms integer,
    running integer not null default 0 check (running in (0, 1)),
    constraint state_known
        check (state in ('waits', 'leased', 'agreed', 'upheld', 'overruled', 'undecided', 'given-up')),
    constraint lease_iff_leased check ((state = 'leased') = (lease_until_ms is not null)),
    constraint holder_iff_leased check ((state = 'leased') = (claim_id is not null)),
    constraint attempt_iff_leased check ((state = 'leased') = (attempt is not null)),
    constraint running_only_when_leased check (running = 0 or state = 'leased')
) strict;

-- What a claim takes from first, in its order.
create index verification_waits on verification (since_ms, job_id) where state = 'waits';

-- What expiry looks at.
create index verification_leased on verification (lease_until_ms) where state = 'leased';

-- Results that users should know to be in doubt.
create index verification_doubtful on verification (job_id) where state in ('overruled', 'undecided');

-- A digest that a worker had for a job beside the one on record, equal or not.
create table opinion (
    job_id integer not null references result (job_id),
    attempt integer not null check (attempt > 0),
    worker_id integer not null references worker (id),
    digest blob not null check (length(digest) = 32),
    given_ms integer not null,
    primary key (job_id, attempt)
) strict, without rowid;
