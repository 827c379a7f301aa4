//! What every store must do, each behaviour a sentence. A new store passes by adding one line to [`suite`]'s calls.

mod farm;
mod jobs;
mod leases;
mod lists;
mod model;
mod scenes;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, AtomicU32, Ordering};

use lightshaft_api::job::{Job, JobState, Metrics, TaskState, TaskWork};
use lightshaft_api::lease::{Complete, Fail, NewArtifact, RetryClass, SceneFile};
use lightshaft_api::scene::{MeshSummary, SceneSummary};
use lightshaft_api::settings::{JobSettings, RenderSettings};
use lightshaft_api::worker::{Device, DeviceKind, NewWorker};
use uuid::Uuid;

use super::sqlite::SqliteStore;
use super::{Claim, Claimed, ClaimedTask, Close, JobRecord, SceneRecord, Store};
use crate::queue::{Millis, plan};

pub(super) const TTL: Millis = 60_000;

/// A store with a clock and the things that every test needs.
#[derive(Clone)]
pub(super) struct Farm {
    pub(super) store: Arc<dyn Store>,
    now: Arc<AtomicI64>,
    scenes: Arc<AtomicU32>,
    _dir: Arc<tempfile::TempDir>,
}

/// A lease as its worker holds it.
#[derive(Clone, Debug)]
pub(super) struct Held {
    pub(super) token: String,
    pub(super) task: ClaimedTask,
}

impl Farm {
    pub(super) async fn sqlite() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let store = Arc::new(SqliteStore::open(&dir.path().join("test.db")).await.unwrap());
        let now = Arc::new(AtomicI64::new(1_800_000_000_000));
        Self { store, now, scenes: Arc::default(), _dir: Arc::new(dir) }
    }

    pub(super) fn now(&self) -> Millis {
        self.now.load(Ordering::SeqCst)
    }

    pub(super) fn wait(&self, ms: Millis) {
        self.now.fetch_add(ms, Ordering::SeqCst);
    }

    /// A scene with one mesh of its own; returns its id and the mesh's hash.
    pub(super) async fn scene(&self) -> (String, String) {
        let number = self.scenes.fetch_add(1, Ordering::SeqCst);
        let mesh = format!("{number:064x}");
        let (id, is_new) = self.store.insert_scene(&scene_record(number, &mesh), self.now()).await.unwrap();
        assert!(is_new);
        (id, mesh)
    }

    pub(super) async fn job(&self, scene: &str) -> String {
        self.job_with(scene, |_| {}).await
    }

    pub(super) async fn job_with(&self, scene: &str, change: impl FnOnce(&mut JobRecord)) -> String {
        let mut record = job_record(scene);
        change(&mut record);
        record.tasks = plan(&record.settings);
        self.store.create_job(&record, None, self.now()).await.unwrap();
        record.id
    }

    pub(super) async fn worker(&self) -> String {
        self.worker_with(&["cpu"]).await
    }

    pub(super) async fn worker_with(&self, devices: &[&str]) -> String {
        let id = Uuid::now_v7().to_string();
        self.store.register_worker(&id, &new_worker(devices), self.now()).await.unwrap();
        id
    }

    pub(super) async fn claim(&self, worker: &str) -> Option<Held> {
        self.claim_warm(worker, &[]).await
    }

    pub(super) async fn claim_warm(&self, worker: &str, warm: &[&str]) -> Option<Held> {
        let claim = Claim {
            worker: worker.to_owned(),
            token: Uuid::new_v4().to_string(),
            attempt: Uuid::now_v7().to_string(),
            now: self.now(),
            expires_at: self.now() + TTL,
            warm: warm.iter().map(|&hash| hash.to_owned()).collect(),
        };
        match self.store.claim(&claim).await.unwrap() {
            Claimed::Task(task) => Some(Held { token: claim.token, task: *task }),
            Claimed::Nothing => None,
            Claimed::UnknownWorker => panic!("unknown worker"),
        }
    }

    pub(super) async fn complete(&self, held: &Held) -> Close {
        let name = if matches!(held.task.work, TaskWork::Frame | TaskWork::Merge) { "image.png" } else { "part" };
        let artifact = NewArtifact {
            name: name.to_owned(),
            media_type: "image/png".to_owned(),
            bytes: 1,
            blob: format!("blob of {}", held.token),
        };
        let metrics = Metrics { render_s: 1.0, ..Metrics::default() };
        let report = Complete { artifacts: vec![artifact], metrics };
        self.store.complete(&held.token, &report, self.now()).await.unwrap().close
    }

    pub(super) async fn fail(&self, held: &Held, class: RetryClass) -> Close {
        let report = Fail { class, error: format!("{class:?}"), fatal: false };
        self.store.fail(&held.token, &report, 0.0, self.now()).await.unwrap()
    }

    pub(super) async fn fail_for_good(&self, held: &Held) -> Close {
        let report = Fail { class: RetryClass::Task, error: "bad scene".to_owned(), fatal: true };
        self.store.fail(&held.token, &report, 0.0, self.now()).await.unwrap()
    }

    pub(super) async fn read(&self, job: &str) -> Job {
        self.store.job(job).await.unwrap().unwrap()
    }

    pub(super) async fn state(&self, job: &str) -> JobState {
        self.read(job).await.summary.state
    }

    pub(super) async fn task_states(&self, job: &str) -> Vec<TaskState> {
        self.store.tasks(job).await.unwrap().into_iter().map(|task| task.state).collect()
    }
}

pub(super) fn scene_record(number: u32, mesh: &str) -> SceneRecord {
    let mesh = MeshSummary {
        hash: mesh.to_owned(),
        name: "mesh".to_owned(),
        triangles: 12,
        spheres: 0,
        instances: 1,
        bounds: None,
    };
    SceneRecord {
        id: Uuid::now_v7().to_string(),
        hash: format!("scene {number}"),
        name: format!("Scene {number}"),
        bytes: 100,
        summary: SceneSummary {
            meshes: vec![mesh],
            instances: 1,
            triangles_total: 12,
            triangles_instanced: 12,
            spheres_total: 0,
            materials: Vec::new(),
            textures: 0,
            texture_pixels: 0,
            cameras: Vec::new(),
            lights: Vec::new(),
            emitters: 0,
            bounds: None,
            estimated_bytes: 0,
            warnings: Vec::new(),
        },
        files: vec![SceneFile { path: "scene.glb".to_owned(), blob: format!("file of {number}"), bytes: 100 }],
    }
}

pub(super) fn job_record(scene: &str) -> JobRecord {
    JobRecord {
        id: Uuid::now_v7().to_string(),
        scene: scene.to_owned(),
        priority: 0,
        max_attempts: 3,
        labels: BTreeMap::new(),
        settings: JobSettings::default(),
        tasks: vec![TaskWork::Frame],
        trace_id: "0".repeat(32),
        automatic: None,
        worker: None,
    }
}

pub(super) fn new_worker(devices: &[&str]) -> NewWorker {
    let kind = |name: &str| if name == "cpu" { DeviceKind::Cpu } else { DeviceKind::Gpu };
    NewWorker::new("worker", "1", devices.iter().map(|name| Device::named(kind(name), name)).collect())
}

/// Runs each behaviour as a test of its own against a store that `$open` makes.
macro_rules! suite {
    ($store:ident, $open:expr; $($module:ident: $($behaviour:ident),+;)+) => {
        mod $store {
            $(mod $module {
                $(#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
                async fn $behaviour() {
                    super::super::$module::$behaviour(&$open.await).await;
                })+
            })+
        }
    };
}

suite! {
    sqlite, crate::store::conformance::Farm::sqlite();
    leases:
        a_task_is_leased_to_one_worker_only,
        many_workers_at_once_never_get_the_same_task,
        tasks_go_out_by_priority_then_age,
        a_changed_priority_takes_effect_on_waiting_tasks,
        paused_jobs_are_passed_over,
        gpu_jobs_go_to_workers_with_a_gpu,
        cpu_jobs_go_to_workers_with_a_cpu,
        an_adapter_is_matched_by_part_of_its_name,
        a_warm_worker_gets_the_scene_it_holds,
        a_draining_worker_gets_nothing,
        an_unknown_worker_is_told_so,
        a_lease_is_renewed_until_it_is_taken_away,
        poison_is_twice_in_a_row,
        a_look_tells_what_a_claim_would_find,
        progress_only_falls_when_a_task_starts_anew,
        complete_counts_once,
        complete_of_an_unknown_lease_is_ignored,
        complete_after_expiry_changes_nothing,
        complete_after_failure_changes_nothing,
        complete_beats_a_cancellation_that_was_not_seen,
        a_failed_task_avoids_the_worker_for_a_while,
        two_worker_failures_block_the_worker_from_the_job,
        the_last_worker_that_could_do_it_gets_every_attempt,
        blocked_workers_are_free_again_once_all_are_blocked,
        a_transient_failure_waits,
        attempts_are_used_up,
        a_fatal_failure_cancels_the_siblings,
        expired_tasks_are_rescued_in_batches,
        a_task_that_kills_its_workers_dies,
        a_worker_that_registers_anew_has_lost_its_lease,
        a_cancelled_task_is_released_as_cancelled,
        a_release_without_cancellation_gives_the_task_back;
    jobs:
        a_job_needs_a_scene,
        an_idempotency_key_makes_one_job,
        an_idempotency_key_is_forgotten,
        a_merge_waits_for_every_part,
        a_merged_picture_leaves_no_parts,
        only_finished_jobs_are_deleted_and_then_with_everything,
        old_jobs_are_found_but_thumbnails_stay,
        a_retry_repeats_only_what_did_not_succeed,
        a_job_that_nobody_can_do_is_given_up_unless_taken,
        running_and_succeeded_jobs_are_not_retried,
        cancelling_is_idempotent_and_refused_at_the_end;
    lists:
        jobs_are_listed_newest_first_and_filtered,
        pages_join_without_gap_or_repeat,
        the_queue_stands_in_the_order_of_turns,
        the_queue_tells_what_holds_a_job_up,
        measurements_are_those_of_jobs_that_rendered_alike,
        events_tell_a_jobs_story_in_order,
        totals_count_everything;
    scenes:
        scenes_get_one_thumbnail_each,
        the_same_scene_is_kept_once,
        a_scene_in_use_is_not_deleted,
        deleting_a_scene_cancels_its_automatic_jobs,
        the_first_structure_of_a_key_is_kept,
        an_unreadable_structure_is_replaced_once,
        used_blobs_are_known,
        a_busy_worker_is_not_removed,
        the_store_can_be_written;
    farm:
        a_task_that_demands_a_worker_goes_to_no_other,
        the_same_suite_is_kept_once,
        a_case_goes_on_only_from_where_it_was_read,
        a_step_whose_scene_is_gone_makes_nothing,
        a_run_ends_with_its_last_case,
        a_cancelled_run_leaves_no_job_waiting,
        what_is_accepted_is_kept_until_a_reset_and_decisions_for_good,
        new_times_take_the_place_of_old_ones_where_the_level_changed,
        old_runs_are_found_and_deleted_with_their_pictures,
        a_noise_floor_is_that_of_the_last_calibration;
    model:
        random_histories_keep_every_promise;
}

/// The settings of a job that renders.
fn picture(job: &mut JobRecord) -> &mut RenderSettings {
    match &mut job.settings {
        JobSettings::Render(settings) => settings,
        JobSettings::Benchmark(_) | JobSettings::Build(_) | JobSettings::Compare(_) => panic!("the job is no render"),
    }
}
