-- Tasks may demand the CPU as they may demand a GPU, and a task that no worker can do fails without an attempt.

ALTER TABLE task ADD COLUMN needs_cpu INTEGER NOT NULL DEFAULT 0;
ALTER TABLE task ADD COLUMN error TEXT; -- what it failed of, where no attempt says it

-- Workers of before say it with their next registration.
ALTER TABLE worker ADD COLUMN has_cpu INTEGER NOT NULL DEFAULT 1;
