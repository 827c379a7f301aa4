-- Blobs that a job needs beside those of its scene: an environment map, the pictures that it compares.

CREATE TABLE job_blob (
    job_id TEXT NOT NULL REFERENCES job (id) ON DELETE CASCADE,
    blob   TEXT NOT NULL,
    PRIMARY KEY (job_id, blob)
) STRICT, WITHOUT ROWID;
CREATE INDEX job_blob_blob ON job_blob (blob);

INSERT INTO job_blob (job_id, blob) SELECT id, environment_blob FROM job WHERE environment_blob IS NOT NULL;
DROP INDEX job_environment;
ALTER TABLE job DROP COLUMN environment_blob;
