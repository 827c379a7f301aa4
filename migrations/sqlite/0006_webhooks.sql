-- Who is told of verdicts and decisions, and what became of each message.

CREATE TABLE farm_webhook (
    id         TEXT PRIMARY KEY,
    url        TEXT NOT NULL,
    secret     TEXT NOT NULL, -- signs messages
    events     TEXT NOT NULL, -- JSON: list of names; all when empty
    suite_name TEXT,
    created_at INTEGER NOT NULL
) STRICT;

-- The outbox: written in the transaction that makes a message true, emptied by a chore.
CREATE TABLE farm_delivery (
    id         TEXT PRIMARY KEY,
    webhook_id TEXT NOT NULL REFERENCES farm_webhook (id) ON DELETE CASCADE,
    body       TEXT NOT NULL, -- JSON: WebhookMessage, as it is signed and sent
    state      TEXT NOT NULL CHECK (state IN ('waiting', 'delivered', 'given_up')),
    due_at     INTEGER,
    created_at INTEGER NOT NULL
) STRICT;
CREATE INDEX farm_delivery_due ON farm_delivery (due_at, id) WHERE state = 'waiting';
CREATE INDEX farm_delivery_webhook ON farm_delivery (webhook_id, id);

CREATE TABLE farm_attempt (
    delivery_id TEXT NOT NULL REFERENCES farm_delivery (id) ON DELETE CASCADE,
    number      INTEGER NOT NULL,
    at          INTEGER NOT NULL,
    seconds     REAL NOT NULL,
    status      INTEGER,
    error       TEXT,
    PRIMARY KEY (delivery_id, number)
) STRICT, WITHOUT ROWID;

-- As of jobs: the same key with the same request gives the same run.
CREATE TABLE farm_idempotency (
    key         TEXT PRIMARY KEY,
    fingerprint TEXT NOT NULL,
    run_id      TEXT NOT NULL REFERENCES farm_run (id) ON DELETE CASCADE,
    created_at  INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
CREATE INDEX farm_idempotency_run ON farm_idempotency (run_id);
