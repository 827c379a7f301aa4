-- Ready tasks by what they demand, without those of paused jobs: a claim looks at the first few of each kind that its
-- worker can do, and at nothing else.

-- `paused` is the job's, for the index below; `demand`: any worker, one with a CPU, one with a GPU. (No comment may stand
-- within ADD COLUMN: SQLite keeps its text as the column's type.)
ALTER TABLE task ADD COLUMN paused INTEGER NOT NULL DEFAULT 0;
ALTER TABLE task ADD COLUMN demand INTEGER
    GENERATED ALWAYS AS (CASE WHEN needs_gpu THEN 2 WHEN needs_cpu THEN 1 ELSE 0 END) VIRTUAL;
UPDATE task SET paused = 1 WHERE job_id IN (SELECT id FROM job WHERE paused);
DROP INDEX task_ready;
CREATE INDEX task_offer ON task (demand, priority DESC, run_at, id) WHERE state = 'ready' AND paused = 0;
CREATE INDEX worker_block_worker ON worker_block (worker_id, blocked_until);

-- Lists of one scene's jobs in order of age.
DROP INDEX job_scene;
CREATE INDEX job_scene ON job (scene_id, id);

-- Deleting a job looks for what refers to its rows.
CREATE INDEX artifact_task ON artifact (task_id);
CREATE INDEX idempotency_job ON idempotency (job_id);
CREATE INDEX job_finished ON job (finished_at) WHERE finished_at IS NOT NULL;
CREATE INDEX scene_bare ON scene (id) WHERE thumbnail_job IS NULL AND deleted_at IS NULL;

-- What merged pictures were made of is of no more use.
DELETE FROM artifact WHERE name = 'part' AND job_id IN (SELECT id FROM job WHERE state = 'succeeded');
UPDATE attempt SET metrics = NULL WHERE job_id IN (SELECT id FROM job WHERE state = 'succeeded');
