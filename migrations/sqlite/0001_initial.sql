-- The service's state. Times are milliseconds since 1970 UTC; ids are UUIDv7 texts, so that their order is that of
-- creation; hashes are BLAKE3, 64 lower-case hex digits. Pictures, logs and live progress are kept elsewhere.

CREATE TABLE scene (
    id         TEXT PRIMARY KEY,
    hash       TEXT NOT NULL,
    name       TEXT NOT NULL,
    bytes      INTEGER NOT NULL,
    summary    TEXT NOT NULL, -- JSON: SceneSummary
    created_at INTEGER NOT NULL,
    deleted_at INTEGER,       -- finished jobs still name the scene
    thumbnail_job TEXT
) STRICT;
CREATE UNIQUE INDEX scene_hash ON scene (hash) WHERE deleted_at IS NULL;

-- Blobs that make up a scene, in the order of the upload.
CREATE TABLE scene_file (
    scene_id TEXT NOT NULL REFERENCES scene (id) ON DELETE CASCADE,
    position INTEGER NOT NULL,
    path     TEXT NOT NULL,
    blob     TEXT NOT NULL,
    bytes    INTEGER NOT NULL,
    PRIMARY KEY (scene_id, position)
) STRICT, WITHOUT ROWID;
CREATE INDEX scene_file_blob ON scene_file (blob);

CREATE TABLE mesh (
    hash      TEXT PRIMARY KEY,
    triangles INTEGER NOT NULL,
    spheres   INTEGER NOT NULL
) STRICT;

CREATE TABLE scene_mesh (
    scene_id  TEXT NOT NULL REFERENCES scene (id) ON DELETE CASCADE,
    mesh_hash TEXT NOT NULL REFERENCES mesh (hash),
    PRIMARY KEY (scene_id, mesh_hash)
) STRICT, WITHOUT ROWID;

-- Built structures, shared by all workers.
CREATE TABLE structure (
    mesh_hash       TEXT NOT NULL REFERENCES mesh (hash),
    kind            TEXT NOT NULL,
    parameters      TEXT NOT NULL,
    builder_version INTEGER NOT NULL,
    bytes           INTEGER NOT NULL,
    build_s         REAL NOT NULL,
    blob            TEXT NOT NULL,
    created_at      INTEGER NOT NULL,
    PRIMARY KEY (mesh_hash, kind, parameters, builder_version)
) STRICT, WITHOUT ROWID;
CREATE INDEX structure_blob ON structure (blob);

CREATE TABLE worker (
    id            TEXT PRIMARY KEY,
    name          TEXT NOT NULL,
    version       TEXT NOT NULL,
    devices       TEXT NOT NULL,    -- JSON
    tags          TEXT NOT NULL,    -- JSON
    has_gpu       INTEGER NOT NULL,
    gpu_names     TEXT NOT NULL,    -- lower case, one a line
    draining      INTEGER NOT NULL DEFAULT 0,
    tasks_done    INTEGER NOT NULL DEFAULT 0,
    registered_at INTEGER NOT NULL,
    last_seen_at  INTEGER NOT NULL, -- flushed now and then
    removed_at    INTEGER           -- attempts still name the worker
) STRICT;

CREATE TABLE job (
    id               TEXT PRIMARY KEY,
    kind             TEXT NOT NULL,
    scene_id         TEXT NOT NULL REFERENCES scene (id),
    -- Derived from the tasks' states, in the transaction that changes them.
    state            TEXT NOT NULL CHECK (state IN ('queued', 'running', 'succeeded', 'failed', 'cancelled')),
    paused           INTEGER NOT NULL DEFAULT 0,
    cancel_requested INTEGER NOT NULL DEFAULT 0,
    automatic        INTEGER NOT NULL DEFAULT 0, -- made by the service itself
    priority         INTEGER NOT NULL,
    max_attempts     INTEGER NOT NULL,
    settings         TEXT NOT NULL, -- JSON: RenderSettings
    environment_blob TEXT,
    error            TEXT,
    metrics          TEXT,          -- JSON: Metrics over all tasks, once succeeded
    trace_id         TEXT NOT NULL,
    created_at       INTEGER NOT NULL,
    started_at       INTEGER,
    finished_at      INTEGER
) STRICT;
CREATE INDEX job_state ON job (state, id);
CREATE INDEX job_scene ON job (scene_id, state);
CREATE INDEX job_environment ON job (environment_blob) WHERE environment_blob IS NOT NULL;

CREATE TABLE job_label (
    job_id TEXT NOT NULL REFERENCES job (id) ON DELETE CASCADE,
    key    TEXT NOT NULL,
    value  TEXT NOT NULL,
    PRIMARY KEY (job_id, key)
) STRICT, WITHOUT ROWID;
CREATE INDEX job_label_value ON job_label (key, value, job_id);

-- The unit of lease.
CREATE TABLE task (
    id               TEXT PRIMARY KEY,
    job_id           TEXT NOT NULL REFERENCES job (id) ON DELETE CASCADE,
    position         INTEGER NOT NULL,
    work             TEXT NOT NULL, -- JSON: TaskWork
    is_merge         INTEGER NOT NULL,
    state            TEXT NOT NULL
                     CHECK (state IN ('blocked', 'ready', 'leased', 'succeeded', 'failed', 'cancelled', 'dead')),
    priority         INTEGER NOT NULL, -- the job's, for the index below
    run_at           INTEGER NOT NULL,
    leases           INTEGER NOT NULL DEFAULT 0, -- attempts ever begun
    spent            INTEGER NOT NULL DEFAULT 0, -- attempts that count
    progress         REAL NOT NULL DEFAULT 0,
    needs_gpu        INTEGER NOT NULL,
    needs_adapter    TEXT,             -- lower case
    cancel_requested INTEGER NOT NULL DEFAULT 0,
    worker_id        TEXT REFERENCES worker (id),
    lease_token      TEXT,             -- the fence: set exactly while leased
    lease_expires_at INTEGER,
    CHECK ((state = 'leased') = (lease_token IS NOT NULL))
) STRICT;
CREATE UNIQUE INDEX task_position ON task (job_id, position);
CREATE INDEX task_job_state ON task (job_id, state);
CREATE INDEX task_ready ON task (priority DESC, run_at, id) WHERE state = 'ready';
CREATE INDEX task_leased ON task (lease_expires_at) WHERE state = 'leased';
CREATE UNIQUE INDEX task_lease ON task (lease_token) WHERE lease_token IS NOT NULL;

-- One lease of one task. Begun, ended once, never overwritten.
CREATE TABLE attempt (
    id          TEXT PRIMARY KEY,
    task_id     TEXT NOT NULL REFERENCES task (id) ON DELETE CASCADE,
    job_id      TEXT NOT NULL REFERENCES job (id) ON DELETE CASCADE,
    number      INTEGER NOT NULL,
    worker_id   TEXT NOT NULL REFERENCES worker (id),
    token       TEXT NOT NULL UNIQUE,
    outcome     TEXT NOT NULL,
    error       TEXT,
    phase       TEXT, -- the last that a heartbeat told of
    metrics     TEXT, -- JSON: Metrics
    started_at  INTEGER NOT NULL,
    finished_at INTEGER
) STRICT;
CREATE UNIQUE INDEX attempt_number ON attempt (task_id, number);
CREATE INDEX attempt_job ON attempt (job_id);
CREATE INDEX attempt_running ON attempt (worker_id) WHERE outcome = 'running';

-- What successful attempts left.
CREATE TABLE artifact (
    attempt_id TEXT NOT NULL REFERENCES attempt (id) ON DELETE CASCADE,
    task_id    TEXT NOT NULL REFERENCES task (id) ON DELETE CASCADE,
    job_id     TEXT NOT NULL REFERENCES job (id) ON DELETE CASCADE,
    name       TEXT NOT NULL,
    media_type TEXT NOT NULL,
    bytes      INTEGER NOT NULL,
    blob       TEXT NOT NULL,
    PRIMARY KEY (attempt_id, name)
) STRICT, WITHOUT ROWID;
CREATE INDEX artifact_job ON artifact (job_id, name);
CREATE INDEX artifact_blob ON artifact (blob);

-- Workers that failed at a job again and again are kept from it for a while.
CREATE TABLE worker_block (
    job_id        TEXT NOT NULL REFERENCES job (id) ON DELETE CASCADE,
    worker_id     TEXT NOT NULL REFERENCES worker (id),
    failures      INTEGER NOT NULL,
    blocked_until INTEGER NOT NULL,
    PRIMARY KEY (job_id, worker_id)
) STRICT, WITHOUT ROWID;

-- AUTOINCREMENT: ids must never come again, since clients resume after the last one they saw.
CREATE TABLE event (
    id     INTEGER PRIMARY KEY AUTOINCREMENT,
    at     INTEGER NOT NULL,
    job_id TEXT NOT NULL,
    kind   TEXT NOT NULL,
    data   TEXT NOT NULL -- JSON
) STRICT;
CREATE INDEX event_job ON event (job_id, id);
CREATE INDEX event_at ON event (at);

CREATE TABLE idempotency (
    key         TEXT PRIMARY KEY,
    fingerprint TEXT NOT NULL,
    job_id      TEXT NOT NULL REFERENCES job (id) ON DELETE CASCADE,
    created_at  INTEGER NOT NULL
) STRICT, WITHOUT ROWID;

-- Written by the readiness check, to know that writing works.
CREATE TABLE heartbeat (
    id INTEGER PRIMARY KEY CHECK (id = 1),
    at INTEGER NOT NULL
) STRICT;
