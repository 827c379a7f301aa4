-- The regression farm: suites, runs and their cases, what was accepted, and who decided so.

-- A task may demand one worker: what is compared in time must run on one.
ALTER TABLE task ADD COLUMN needs_worker TEXT;

-- A version of a suite. Baselines and histories belong to the name.
CREATE TABLE farm_suite (
    id          TEXT PRIMARY KEY,
    hash        TEXT NOT NULL UNIQUE,
    name        TEXT NOT NULL,
    description TEXT NOT NULL,
    scenes      TEXT NOT NULL, -- JSON: SceneSource by name
    cases       TEXT NOT NULL, -- JSON: list of SuiteTestCase
    created_at  INTEGER NOT NULL
) STRICT;
CREATE INDEX farm_suite_name ON farm_suite (name, id);

CREATE TABLE farm_run (
    id          TEXT PRIMARY KEY,
    kind        TEXT NOT NULL CHECK (kind IN ('check', 'calibration')),
    suite_id    TEXT NOT NULL REFERENCES farm_suite (id),
    suite_name  TEXT NOT NULL,
    label       TEXT NOT NULL,
    labels      TEXT NOT NULL, -- JSON
    baseline    TEXT NOT NULL,
    scenes      TEXT NOT NULL, -- JSON: scene ids by name
    overrides   TEXT NOT NULL, -- JSON: SettingsPatch
    priority    INTEGER NOT NULL,
    times       INTEGER NOT NULL, -- of a calibration: how often each case is run
    state       TEXT NOT NULL CHECK (state IN ('running', 'finished', 'cancelled')),
    created_at  INTEGER NOT NULL,
    finished_at INTEGER
) STRICT;
CREATE INDEX farm_run_suite ON farm_run (suite_name, id);
CREATE INDEX farm_run_state ON farm_run (state, id);

CREATE TABLE farm_case (
    run_id         TEXT NOT NULL REFERENCES farm_run (id) ON DELETE CASCADE,
    name           TEXT NOT NULL,
    position       INTEGER NOT NULL,
    state          TEXT NOT NULL CHECK (state IN ('rendering', 'confirming', 'finished', 'cancelled')),
    generation     INTEGER NOT NULL DEFAULT 0, -- begun anew when its worker was lost
    scene_id       TEXT NOT NULL REFERENCES scene (id),
    settings       TEXT NOT NULL,              -- JSON: RenderSettings
    repeat         INTEGER NOT NULL,
    tolerance      TEXT NOT NULL,              -- JSON: ImageTolerance
    time_tolerance TEXT NOT NULL,              -- JSON: TimeTolerance
    device_class   TEXT,                       -- what the suite says, or what the first job found
    worker_id      TEXT,
    versions       TEXT,                       -- JSON: of what rendered it
    image          TEXT,                       -- JSON: ImageResult
    image_verdict  TEXT,
    time           TEXT,                       -- JSON: TimeResult
    time_verdict   TEXT,
    ok             INTEGER,                    -- passes or was approved, and was not rejected
    decision_id    TEXT,                       -- the last
    PRIMARY KEY (run_id, name)
) STRICT, WITHOUT ROWID;
CREATE INDEX farm_case_open ON farm_case (run_id, position) WHERE state IN ('rendering', 'confirming');
CREATE INDEX farm_case_history ON farm_case (name, device_class, run_id) WHERE state = 'finished';

-- Jobs of cases; the jobs themselves may be deleted since.
CREATE TABLE farm_job (
    job_id     TEXT PRIMARY KEY,
    run_id     TEXT NOT NULL,
    case_name  TEXT NOT NULL,
    generation INTEGER NOT NULL,
    phase      TEXT NOT NULL CHECK (phase IN ('warm_up', 'sample', 'a', 'b')),
    position   INTEGER NOT NULL,
    time_s     REAL,
    FOREIGN KEY (run_id, case_name) REFERENCES farm_case (run_id, name) ON DELETE CASCADE
) STRICT, WITHOUT ROWID;
CREATE UNIQUE INDEX farm_job_case ON farm_job (run_id, case_name, generation, phase, position);

-- Pictures of cases.
CREATE TABLE farm_artifact (
    run_id     TEXT NOT NULL,
    case_name  TEXT NOT NULL,
    name       TEXT NOT NULL,
    media_type TEXT NOT NULL,
    bytes      INTEGER NOT NULL,
    blob       TEXT NOT NULL,
    PRIMARY KEY (run_id, case_name, name),
    FOREIGN KEY (run_id, case_name) REFERENCES farm_case (run_id, name) ON DELETE CASCADE
) STRICT, WITHOUT ROWID;
CREATE INDEX farm_artifact_blob ON farm_artifact (blob);

-- What people said. Never changed, never deleted: so nothing in it refers to what may be.
CREATE TABLE farm_decision (
    id           TEXT PRIMARY KEY,
    kind         TEXT NOT NULL CHECK (kind IN ('approved', 'rejected', 'reset')),
    who          TEXT NOT NULL,
    why          TEXT NOT NULL,
    at           INTEGER NOT NULL,
    baseline     TEXT NOT NULL,
    suite_name   TEXT NOT NULL,
    case_name    TEXT,
    device_class TEXT,
    run_id       TEXT,
    label        TEXT,
    pixels       TEXT
) STRICT;
CREATE INDEX farm_decision_case ON farm_decision (suite_name, case_name, id);
CREATE INDEX farm_decision_run ON farm_decision (run_id, id) WHERE run_id IS NOT NULL;

-- Any accepted picture of a case is right.
CREATE TABLE farm_accepted (
    id           TEXT PRIMARY KEY,
    baseline     TEXT NOT NULL,
    suite_name   TEXT NOT NULL,
    case_name    TEXT NOT NULL,
    device_class TEXT NOT NULL,
    pixels       TEXT NOT NULL,
    source       TEXT NOT NULL,
    run_id       TEXT NOT NULL,
    label        TEXT NOT NULL,
    decision_id  TEXT NOT NULL REFERENCES farm_decision (id),
    accepted_at  INTEGER NOT NULL
) STRICT;
CREATE UNIQUE INDEX farm_accepted_pixels ON farm_accepted (suite_name, case_name, baseline, device_class, pixels);

CREATE TABLE farm_accepted_file (
    accepted_id TEXT NOT NULL REFERENCES farm_accepted (id) ON DELETE CASCADE,
    name        TEXT NOT NULL,
    media_type  TEXT NOT NULL,
    bytes       INTEGER NOT NULL,
    blob        TEXT NOT NULL,
    PRIMARY KEY (accepted_id, name)
) STRICT, WITHOUT ROWID;
CREATE INDEX farm_accepted_file_blob ON farm_accepted_file (blob);

-- Times of accepted runs, and what it takes to render them again.
CREATE TABLE farm_times (
    baseline     TEXT NOT NULL,
    suite_name   TEXT NOT NULL,
    case_name    TEXT NOT NULL,
    device_class TEXT NOT NULL,
    run_id       TEXT NOT NULL,
    metric       TEXT NOT NULL,
    samples      TEXT NOT NULL, -- JSON: seconds
    scene_id     TEXT NOT NULL,
    settings     TEXT NOT NULL, -- JSON: RenderSettings
    versions     TEXT NOT NULL, -- JSON
    label        TEXT NOT NULL,
    decision_id  TEXT NOT NULL REFERENCES farm_decision (id),
    accepted_at  INTEGER NOT NULL,
    PRIMARY KEY (suite_name, case_name, baseline, device_class, run_id)
) STRICT, WITHOUT ROWID;

-- How far the times of unchanged runs lie apart: the last calibration of each case.
CREATE TABLE farm_noise (
    suite_name   TEXT NOT NULL,
    case_name    TEXT NOT NULL,
    device_class TEXT NOT NULL,
    metric       TEXT NOT NULL,
    floor        REAL NOT NULL,
    run_id       TEXT NOT NULL,
    measured_at  INTEGER NOT NULL,
    PRIMARY KEY (suite_name, case_name, device_class, metric)
) STRICT, WITHOUT ROWID;
