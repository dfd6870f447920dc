-- Pausing, cancelling, retrying and removing sweeps, and taking in large ones in steps.

-- Whether every live sweep that wants the job is paused: then no claim takes it. It counts while queued or leased.
alter table job add column held integer not null default 0 check (held in (0, 1));

-- What a claim takes from, in its order.
drop index job_queued;
create index job_queued on job (engine_id, priority desc, turn, not_before_ms) where state = 'queued' and held = 0;

-- Which scenarios no job needs any more.
create index job_by_scenario on job (scenario_id);

-- An attempt may also end because its job was cancelled.
create table attempt_with_cancelled (
    job_id integer not null references job (id),
    attempt integer not null check (attempt > 0),
    claim_id integer not null references claim (id),
    ended_ms integer not null,
    ended text not null,
    reason text,
    primary key (job_id, attempt),
    constraint ended_known
        check (ended in ('panicked', 'died', 'expired', 'handed-back', 'superseded', 'cancelled'))
) strict, without rowid;
insert into attempt_with_cancelled select job_id, attempt, claim_id, ended_ms, ended, reason from attempt;
drop table attempt;
alter table attempt_with_cancelled rename to attempt;

-- Sweeps on their way in or out, a step at a time: nobody sees them.
create table unlisted (
    sweep_id integer primary key references sweep (id)
) strict;

-- Sweeps that a user changed, whose jobs are brought in line with them a step at a time.
create table settling (
    sweep_id integer primary key references sweep (id),
    -- Whether failed jobs are queued again.
    retry integer not null check (retry in (0, 1)),
    -- The last cell and job that are in line.
    cell_id integer not null,
    job_id integer not null,
    -- Jobs that were given a place in the queue so far.
    placed integer not null check (placed >= 0)
) strict;

-- The largest numbers that were given to jobs and scenarios since removed. No number is given twice: workers keep them.
create table last_number (
    one integer primary key check (one = 1),
    job integer not null,
    scenario integer not null
) strict;
insert into last_number (one, job, scenario) values (1, 0, 0);
