-- Who may use HTTP from beyond this machine, and the mark by which the service tells that it can write.

create table token (
    -- Not given twice, so that a line in a log stays with its token.
    id integer primary key autoincrement,
    name text not null check (length(name) between 1 and 64),
    hash blob not null unique check (length(hash) = 32),
    -- Some of read, submit and admin, separated by commas.
    scopes text not null check (scopes <> ''),
    created_ms integer not null,
    expires_ms integer,
    used_ms integer,
    revoked_ms integer,
    constraint expires_later check (expires_ms is null or expires_ms > created_ms)
) strict;

-- A name is free again once its token is revoked.
create unique index token_name on token (name) where revoked_ms is null;

create table heartbeat (
    one integer primary key check (one = 1),
    beat_ms integer not null
) strict;
insert into heartbeat (one, beat_ms) values (1, 0);
