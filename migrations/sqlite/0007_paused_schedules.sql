-- A schedule that is paused begins nothing.

ALTER TABLE farm_schedule ADD COLUMN paused INTEGER NOT NULL DEFAULT 0 CHECK (paused IN (0, 1));
