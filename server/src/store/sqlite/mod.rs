//! The store in one SQLite file.
//!
//! One connection writes, a pool of read-only ones reads: SQLite has one writer anyway, and a queue in front of it is
//! fair where its lock is not. Every writing transaction begins with `BEGIN IMMEDIATE`, since a read that turns into a
//! write would fail with `SQLITE_BUSY_SNAPSHOT` whatever the busy timeout says.

mod claim;
mod close;
mod demand;
mod events;
mod farm;
mod idempotency;
mod jobs;
mod measurements;
mod meshes;
mod offers;
mod queue;
mod read;
mod removal;
mod scenes;
mod workers;

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use async_trait::async_trait;
use jiff::Timestamp;
use lightshaft_api::event::Event;
use lightshaft_api::job::{Artifact, Attempt, Job, JobState, Phase, Task};
use lightshaft_api::lease::{Complete, Fail};
use lightshaft_api::mesh::{FindStructures, Mesh, NewStructure, Structure};
use lightshaft_api::scene::Scene;
use lightshaft_api::settings::Integrator;
use lightshaft_api::worker::{NewWorker, Worker};
use serde::Serialize;
use serde::de::DeserializeOwned;
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePool, SqlitePoolOptions, SqliteSynchronous};
use sqlx::{Sqlite, Transaction};

use super::{
    Change, Claim, Claimed, Close, Completed, Creation, Demanding, Expired, Idempotency, JobQuery, JobRecord,
    JobRemoval, LeaseState, ListedJob, Measurement, PageRequest, QueuedRecord, Removal, Result, SceneRecord, Store,
    StoreError, TaskProgress, Totals,
};
use crate::queue::Millis;

const READERS: u32 = 4;
const BUSY_TIMEOUT: Duration = Duration::from_secs(5);

#[derive(Debug)]
pub struct SqliteStore {
    writer: SqlitePool,
    readers: SqlitePool,
}

type Tx = Transaction<'static, Sqlite>;

impl SqliteStore {
    /// Opens or makes the database, checks its integrity, and brings its schema up to date.
    pub async fn open(path: &Path) -> Result<Self> {
        let options = SqliteConnectOptions::new()
            .filename(path)
            .create_if_missing(true)
            .journal_mode(SqliteJournalMode::Wal)
            .synchronous(SqliteSynchronous::Normal)
            .foreign_keys(true)
            .busy_timeout(BUSY_TIMEOUT);
        let writer = SqlitePoolOptions::new()
            .max_connections(1)
            .min_connections(1)
            .idle_timeout(None)
            .max_lifetime(None)
            .connect_with(options.clone())
            .await
            .map_err(context("opening the database"))?;
        check(&writer).await?;
        sqlx::migrate!("../migrations/sqlite").run(&writer).await.map_err(context("migrating the database"))?;
        let readers = SqlitePoolOptions::new()
            .max_connections(READERS)
            .connect_with(options.create_if_missing(false).read_only(true))
            .await
            .map_err(context("opening the database for reading"))?;
        Ok(Self { writer, readers })
    }

    async fn begin(&self) -> Result<Tx> {
        self.writer.begin_with("BEGIN IMMEDIATE").await.map_err(context("beginning a transaction"))
    }

    /// Writes what is pending and closes every connection.
    pub async fn close(&self) {
        self.readers.close().await;
        self.writer.close().await;
    }
}

async fn check(pool: &SqlitePool) -> Result<()> {
    let foreign_keys: i64 = sqlx::query_scalar("PRAGMA foreign_keys")
        .fetch_one(pool)
        .await
        .map_err(context("reading the database's settings"))?;
    if foreign_keys != 1 {
        return Err(StoreError::Corrupt("this SQLite library does not enforce foreign keys".to_owned()));
    }
    let verdict: String = sqlx::query_scalar("PRAGMA quick_check(1)")
        .fetch_one(pool)
        .await
        .map_err(context("checking the database's integrity"))?;
    if verdict != "ok" {
        return Err(StoreError::Corrupt(verdict));
    }
    Ok(())
}

/// Names what was being done when the database failed.
fn context<E: std::error::Error + Send + Sync + 'static>(context: &'static str) -> impl FnOnce(E) -> StoreError {
    move |source| StoreError::Database { context, source: Box::new(source) }
}

async fn commit(tx: Tx) -> Result<()> {
    tx.commit().await.map_err(context("committing"))
}

fn to_json(value: &impl Serialize) -> Result<String> {
    serde_json::to_string(value).map_err(context("writing JSON"))
}

fn from_json<T: DeserializeOwned>(text: &str) -> Result<T> {
    serde_json::from_str(text).map_err(|error| StoreError::Corrupt(error.to_string()))
}

/// A name of one of the API's enums, as stored.
fn from_name<T: DeserializeOwned>(name: &str) -> Result<T> {
    serde_json::from_value(serde_json::Value::from(name)).map_err(|error| StoreError::Corrupt(error.to_string()))
}

fn timestamp(ms: Millis) -> Result<Timestamp> {
    Timestamp::from_millisecond(ms).map_err(|error| StoreError::Corrupt(error.to_string()))
}

/// SQLite's integers are signed; sizes and counts beyond 2^63 do not occur.
fn signed(value: u64) -> i64 {
    i64::try_from(value).unwrap_or(i64::MAX)
}

#[async_trait]
impl Store for SqliteStore {
    async fn check_writable(&self, now: Millis) -> Result<()> {
        sqlx::query("INSERT INTO heartbeat (id, at) VALUES (1, $1) ON CONFLICT (id) DO UPDATE SET at = $1")
            .bind(now)
            .execute(&self.writer)
            .await
            .map_err(context("writing the readiness row"))?;
        Ok(())
    }

    async fn totals(&self) -> Result<Totals> {
        self.read_totals().await
    }

    async fn insert_scene(&self, scene: &SceneRecord, now: Millis) -> Result<(String, bool)> {
        self.do_insert_scene(scene, now).await
    }

    async fn scene(&self, id: &str) -> Result<Option<Scene>> {
        self.read_scene(id).await
    }

    async fn scene_by_hash(&self, hash: &str) -> Result<Option<Scene>> {
        self.read_scene_by_hash(hash).await
    }

    async fn scenes(&self, page: &PageRequest) -> Result<Vec<Scene>> {
        self.read_scenes(page).await
    }

    async fn scene_blobs(&self, id: &str) -> Result<Vec<String>> {
        self.read_scene_blobs(id).await
    }

    async fn scenes_without_thumbnail(&self, limit: u32) -> Result<Vec<Scene>> {
        self.read_scenes_without_thumbnail(limit).await
    }

    async fn thumbnail_job(&self, scene: &str) -> Result<Option<String>> {
        self.read_thumbnail_job(scene).await
    }

    async fn delete_scene(&self, id: &str, now: Millis) -> Result<Removal> {
        self.do_delete_scene(id, now).await
    }

    async fn meshes(&self, scene: Option<&str>, page: &PageRequest) -> Result<Vec<Mesh>> {
        self.read_meshes(scene, page).await
    }

    async fn mesh(&self, hash: &str) -> Result<Option<Mesh>> {
        self.read_mesh(hash).await
    }

    async fn find_structures(&self, wanted: &FindStructures) -> Result<BTreeMap<String, String>> {
        self.read_find_structures(wanted).await
    }

    async fn add_structure(&self, mesh: &str, structure: &NewStructure, now: Millis) -> Result<Option<Structure>> {
        self.do_add_structure(mesh, structure, now).await
    }

    async fn is_blob_used(&self, hash: &str) -> Result<bool> {
        self.read_is_blob_used(hash).await
    }

    async fn create_job(&self, job: &JobRecord, idempotency: Option<&Idempotency>, now: Millis) -> Result<Creation> {
        self.do_create_job(job, idempotency, now).await
    }

    async fn repeated_job(&self, idempotency: &Idempotency) -> Result<Option<Creation>> {
        self.read_repeated_job(idempotency).await
    }

    async fn job(&self, id: &str) -> Result<Option<Job>> {
        self.read_job(id).await
    }

    async fn job_state(&self, id: &str) -> Result<Option<JobState>> {
        self.read_job_state(id).await
    }

    async fn jobs(&self, query: &JobQuery, page: &PageRequest) -> Result<Vec<ListedJob>> {
        self.read_jobs(query, page).await
    }

    async fn measurements(&self, integrator: Integrator, limit: u32) -> Result<Vec<Measurement>> {
        self.read_measurements(integrator, limit).await
    }

    async fn queue(&self, limit: u32, now: Millis) -> Result<Vec<QueuedRecord>> {
        self.read_queue(limit, now).await
    }

    async fn task_progress(&self, job: &str) -> Result<TaskProgress> {
        self.read_task_progress(job).await
    }

    async fn tasks(&self, job: &str) -> Result<Vec<Task>> {
        self.read_tasks(job).await
    }

    async fn attempts(&self, job: &str) -> Result<Vec<Attempt>> {
        self.read_attempts(job).await
    }

    async fn artifacts(&self, job: &str) -> Result<Vec<Artifact>> {
        self.read_artifacts(job).await
    }

    async fn cancel_job(&self, id: &str, now: Millis) -> Result<Change> {
        self.do_cancel_job(id, now).await
    }

    async fn retry_job(&self, id: &str, now: Millis) -> Result<Change> {
        self.do_retry_job(id, now).await
    }

    async fn demanding_jobs(&self) -> Result<Vec<Demanding>> {
        self.read_demanding_jobs().await
    }

    async fn give_up_job(&self, id: &str, error: &str, now: Millis) -> Result<bool> {
        self.do_give_up_job(id, error, now).await
    }

    async fn delete_job(&self, id: &str, now: Millis) -> Result<JobRemoval> {
        self.do_delete_job(id, now).await
    }

    async fn jobs_finished_before(&self, before: Millis, limit: u32) -> Result<Vec<String>> {
        self.read_jobs_finished_before(before, limit).await
    }

    async fn patch_job(&self, id: &str, priority: Option<i32>, paused: Option<bool>, now: Millis) -> Result<Change> {
        self.do_patch_job(id, priority, paused, now).await
    }

    async fn register_worker(&self, id: &str, worker: &NewWorker, now: Millis) -> Result<Vec<Expired>> {
        self.do_register_worker(id, worker, now).await
    }

    async fn worker(&self, id: &str) -> Result<Option<Worker>> {
        self.read_worker(id).await
    }

    async fn workers(&self) -> Result<Vec<Worker>> {
        self.read_workers().await
    }

    async fn touch_worker(&self, id: &str, now: Millis) -> Result<()> {
        self.do_touch_worker(id, now).await
    }

    async fn set_draining(&self, id: &str, draining: bool) -> Result<bool> {
        self.do_set_draining(id, draining).await
    }

    async fn remove_worker(&self, id: &str, now: Millis) -> Result<Removal> {
        self.do_remove_worker(id, now).await
    }

    async fn has_task_for(&self, worker: &str, now: Millis) -> Result<Option<bool>> {
        self.read_has_task_for(worker, now).await
    }

    async fn claim(&self, claim: &Claim) -> Result<Claimed> {
        self.do_claim(claim).await
    }

    async fn lease(&self, token: &str) -> Result<Option<LeaseState>> {
        self.read_lease(token).await
    }

    async fn renew(&self, token: &str, phase: Phase, progress: f64, expires_at: Millis) -> Result<bool> {
        self.do_renew(token, phase, progress, expires_at).await
    }

    async fn note_progress(&self, token: &str, progress: f64) -> Result<()> {
        self.do_note_progress(token, progress).await
    }

    async fn complete(&self, token: &str, report: &Complete, now: Millis) -> Result<Completed> {
        self.do_complete(token, report, now).await
    }

    async fn fail(&self, token: &str, report: &Fail, jitter: f64, now: Millis) -> Result<Close> {
        self.do_fail(token, report, jitter, now).await
    }

    async fn release(&self, token: &str, cancelled: bool, now: Millis) -> Result<Close> {
        self.do_release(token, cancelled, now).await
    }

    async fn expire_leases(&self, now: Millis) -> Result<Vec<Expired>> {
        self.do_expire_leases(now).await
    }

    async fn events_after(&self, id: i64, job: Option<&str>, limit: u32) -> Result<Vec<Event>> {
        self.read_events_after(id, job, limit).await
    }

    async fn last_event(&self) -> Result<i64> {
        self.read_last_event().await
    }

    async fn forget_before(&self, keys: Millis, events: Millis) -> Result<u64> {
        self.do_forget_before(keys, events).await
    }

    async fn checkpoint(&self) -> Result<()> {
        sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)")
            .execute(&self.writer)
            .await
            .map_err(context("writing back the write-ahead log"))?;
        Ok(())
    }
}
