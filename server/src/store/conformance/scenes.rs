//! Scenes, meshes and their structures, blobs, workers.

use std::collections::BTreeMap;

use lightshaft_api::job::JobState;
use lightshaft_api::mesh::{FindStructures, NewStructure};
use lightshaft_api::settings::{Environment, EnvironmentMap};

use super::{Farm, job_record, picture, scene_record};
use crate::store::{Automatic, Change, Creation, PageRequest, Removal};

fn first_page(limit: u32) -> PageRequest {
    PageRequest { limit, after: None }
}

pub(super) async fn scenes_get_one_thumbnail_each(farm: &Farm) {
    let (first, second) = (farm.scene().await.0, farm.scene().await.0);
    let bare = async || {
        let scenes = farm.store.scenes_without_thumbnail(10).await.unwrap();
        scenes.into_iter().map(|scene| scene.id).collect::<Vec<_>>()
    };
    assert_eq!(bare().await, [first.clone(), second.clone()]);
    farm.job(&first).await;
    let view = |job: &mut crate::store::JobRecord| job.automatic = Some(Automatic::Camera);
    farm.job_with(&first, view).await;
    assert_eq!(bare().await, [first.clone(), second.clone()], "what a camera sees is none");
    let job = farm.job_with(&first, |job| job.automatic = Some(Automatic::Thumbnail)).await;
    farm.job_with(&first, view).await;
    assert_eq!(bare().await, std::slice::from_ref(&second));
    assert_eq!(farm.store.thumbnail_job(&first).await.unwrap(), Some(job));
    farm.store.delete_scene(&second, farm.now()).await.unwrap();
    assert!(bare().await.is_empty());
}

pub(super) async fn the_same_scene_is_kept_once(farm: &Farm) {
    let first = farm.store.insert_scene(&scene_record(7, "m"), farm.now()).await.unwrap();
    let second = farm.store.insert_scene(&scene_record(7, "m"), farm.now()).await.unwrap();
    assert_eq!((first.1, second.1, &first.0), (true, false, &second.0));
    assert_eq!(farm.store.scenes(&first_page(10)).await.unwrap().len(), 1);
    assert_eq!(farm.store.scene_by_hash("scene 7").await.unwrap().unwrap().id, first.0);
    assert_eq!(farm.store.delete_scene(&first.0, farm.now()).await.unwrap(), Removal::Done);
    assert_eq!(farm.store.delete_scene(&first.0, farm.now()).await.unwrap(), Removal::Unknown);
    let third = farm.store.insert_scene(&scene_record(7, "m"), farm.now()).await.unwrap();
    assert!(third.1 && third.0 != first.0, "after its deletion it is a new one");
}

pub(super) async fn a_scene_in_use_is_not_deleted(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job(&scene).await;
    assert_eq!(farm.store.delete_scene(&scene, farm.now()).await.unwrap(), Removal::InUse);
    farm.store.cancel_job(&job, farm.now()).await.unwrap();
    assert_eq!(farm.store.delete_scene(&scene, farm.now()).await.unwrap(), Removal::Done);
    assert!(farm.store.scene(&scene).await.unwrap().is_none());
    assert_eq!(farm.read(&job).await.summary.scene_name, "Scene 0", "finished jobs stay");
    assert_eq!(farm.store.retry_job(&job, farm.now()).await.unwrap(), Change::SceneGone);
    let creation = farm.store.create_job(&job_record(&scene), None, farm.now()).await.unwrap();
    assert_eq!(creation, Creation::UnknownScene);
}

pub(super) async fn deleting_a_scene_cancels_its_automatic_jobs(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job_with(&scene, |job| job.automatic = Some(Automatic::Thumbnail)).await;
    assert_eq!(farm.store.delete_scene(&scene, farm.now()).await.unwrap(), Removal::Done);
    assert_eq!(farm.state(&job).await, JobState::Cancelled);
}

pub(super) async fn the_first_structure_of_a_key_is_kept(farm: &Farm) {
    let (_, mesh) = farm.scene().await;
    let structure = |blob: &str| NewStructure {
        kind: "bvh".to_owned(),
        parameters: "quality=medium".to_owned(),
        builder_version: 1,
        bytes: 10,
        build_s: 0.5,
        blob: blob.to_owned(),
        replaces: None,
    };
    let first = farm.store.add_structure(&mesh, &structure("a"), farm.now()).await.unwrap().unwrap();
    let second = farm.store.add_structure(&mesh, &structure("b"), farm.now()).await.unwrap().unwrap();
    assert_eq!((first.blob.as_str(), second.blob.as_str()), ("a", "a"));
    assert_eq!(farm.store.mesh(&mesh).await.unwrap().unwrap().structures, [first]);
    assert!(farm.store.add_structure("none", &structure("a"), farm.now()).await.unwrap().is_none());
    assert_eq!(farm.store.meshes(None, &first_page(10)).await.unwrap().len(), 1);

    let (_, other) = farm.scene().await;
    let find = async |parameters: &str, builder_version| {
        let meshes = vec![mesh.clone(), other.clone(), "none".to_owned()];
        let wanted =
            FindStructures { meshes, kind: "bvh".to_owned(), parameters: parameters.to_owned(), builder_version };
        farm.store.find_structures(&wanted).await.unwrap()
    };
    assert_eq!(find("quality=medium", 1).await, BTreeMap::from([(mesh.clone(), "a".to_owned())]));
    assert!(find("quality=high", 1).await.is_empty() && find("quality=medium", 2).await.is_empty());
}

pub(super) async fn an_unreadable_structure_is_replaced_once(farm: &Farm) {
    let (_, mesh) = farm.scene().await;
    let add = async |blob: &str, replaces: Option<&str>| {
        let structure = NewStructure {
            kind: "bvh".to_owned(),
            parameters: "p".to_owned(),
            builder_version: 1,
            bytes: 4,
            build_s: 1.0,
            blob: blob.to_owned(),
            replaces: replaces.map(str::to_owned),
        };
        farm.store.add_structure(&mesh, &structure, farm.now()).await.unwrap().unwrap().blob
    };
    assert_eq!(add("bad", None).await, "bad");
    assert_eq!(add("good", Some("bad")).await, "good");
    assert_eq!(add("late", Some("bad")).await, "good", "what was bad has been replaced already");
    assert!(!farm.store.is_blob_used("bad").await.unwrap());
}

pub(super) async fn used_blobs_are_known(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    let job = farm.job_with(&scene, |job| {
        let map = EnvironmentMap { map: "sky".to_owned(), intensity: 1.0, rotation_deg: 0.0 };
        picture(job).environment = Some(Environment::Map(map));
    });
    job.await;
    let worker = farm.worker().await;
    let held = farm.claim(&worker).await.unwrap();
    farm.complete(&held).await;
    for used in ["file of 0", "sky", &format!("blob of {}", held.token)] {
        assert!(farm.store.is_blob_used(used).await.unwrap(), "{used}");
    }
    assert!(!farm.store.is_blob_used("other").await.unwrap());
    assert_eq!(farm.store.scene_blobs(&scene).await.unwrap(), ["file of 0"]);
    farm.store.delete_scene(&scene, farm.now()).await.unwrap();
    assert!(!farm.store.is_blob_used("file of 0").await.unwrap());
}

pub(super) async fn a_busy_worker_is_not_removed(farm: &Farm) {
    let (scene, _) = farm.scene().await;
    farm.job(&scene).await;
    let worker = farm.worker().await;
    let held = farm.claim(&worker).await.unwrap();
    assert_eq!(farm.store.worker(&worker).await.unwrap().unwrap().current.unwrap().task, held.task.task);
    assert_eq!(farm.store.remove_worker(&worker, farm.now()).await.unwrap(), Removal::InUse);
    farm.complete(&held).await;
    assert_eq!(farm.store.remove_worker(&worker, farm.now()).await.unwrap(), Removal::Done);
    assert_eq!(farm.store.remove_worker(&worker, farm.now()).await.unwrap(), Removal::Unknown);
    assert!(farm.store.workers().await.unwrap().is_empty());
}

pub(super) async fn the_store_can_be_written(farm: &Farm) {
    farm.store.check_writable(farm.now()).await.unwrap();
    farm.store.check_writable(farm.now() + 1).await.unwrap();
    farm.store.checkpoint().await.unwrap();
}
