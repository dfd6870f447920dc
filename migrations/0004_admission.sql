-- Enrolment on a local network, and workers that are turned away.

-- Join secrets by their public key; the secret half is not kept.
create table join_secret (
    id integer primary key,
    public_key blob not null unique check (length(public_key) = 32),
    created_ms integer not null,
    until_ms integer not null,
    -- So many workers may still enrol with it.
    uses_left integer not null check (uses_left >= 0),
    -- Workers that enrol with it are let in for so long; for good if null.
    worker_ms integer check (worker_ms > 0)
) strict;

-- Workers that came in with a join secret, by the key that only they have.
create table enrolment (
    worker_id integer primary key references worker (id),
    join_secret_id integer not null references join_secret (id),
    public_key blob not null unique check (length(public_key) = 32),
    enrolled_ms integer not null,
    certificate_until_ms integer not null
) strict;

-- When a user turned the worker away for good.
alter table worker add column revoked_ms integer;
-- Until when the worker is let in; for good if null.
alter table worker add column until_ms integer;
-- Results of this worker that were recorded.
alter table worker add column results integer not null default 0 check (results >= 0);
update worker set results = (select count(*) from claim join result on result.claim_id = claim.id where claim.worker_id = worker.id);
