-- Runs of the farm that begin by the clock.

CREATE TABLE farm_schedule (
    id         TEXT PRIMARY KEY,
    name       TEXT NOT NULL UNIQUE,
    cron       TEXT NOT NULL,
    run        TEXT NOT NULL, -- JSON: NewRun
    next_at    INTEGER,       -- null when there is no next time
    begun_at   INTEGER,
    last_run   TEXT,          -- it may have been deleted since
    error      TEXT,          -- what the last try failed of
    created_at INTEGER NOT NULL
) STRICT;
CREATE INDEX farm_schedule_due ON farm_schedule (next_at) WHERE next_at IS NOT NULL;
