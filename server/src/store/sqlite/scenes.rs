//! Scenes. A deleted scene's row stays, because finished jobs name it; its hash is free again.

use lightshaft_api::scene::Scene;
use sqlx::FromRow;

use super::jobs::{cancel_tasks, refresh_job};
use super::{SqliteStore, commit, context, from_json, signed, timestamp, to_json};
use crate::queue::Millis;
use crate::store::{PageRequest, Removal, Result, SceneRecord};

/// The scenes that are there and for which a condition holds.
macro_rules! scenes {
    ($which:literal) => {
        concat!(
            "SELECT s.id, s.hash, s.name, s.bytes, s.summary, s.created_at,
                    EXISTS (SELECT 1 FROM job j WHERE j.id = s.thumbnail_job AND j.state = 'succeeded') AS has_thumbnail
             FROM scene s WHERE s.deleted_at IS NULL AND ",
            $which
        )
    };
}

#[derive(FromRow)]
struct SceneRow {
    id: String,
    hash: String,
    name: String,
    bytes: i64,
    summary: String,
    created_at: i64,
    has_thumbnail: bool,
}

impl SceneRow {
    fn into_scene(self) -> Result<Scene> {
        Ok(Scene {
            thumbnail: self.has_thumbnail.then(|| format!("/v1/scenes/{}/thumbnail.png", self.id)),
            id: self.id,
            hash: self.hash,
            name: self.name,
            created_at: timestamp(self.created_at)?,
            bytes: self.bytes.unsigned_abs(),
            summary: from_json(&self.summary)?,
        })
    }
}

impl SqliteStore {
    pub(super) async fn do_insert_scene(&self, scene: &SceneRecord, now: Millis) -> Result<(String, bool)> {
        let mut tx = self.begin().await?;
        let known: Option<String> = sqlx::query_scalar("SELECT id FROM scene WHERE hash = $1 AND deleted_at IS NULL")
            .bind(&scene.hash)
            .fetch_optional(&mut *tx)
            .await
            .map_err(context("looking up a scene"))?;
        if let Some(id) = known {
            return Ok((id, false));
        }
        sqlx::query("INSERT INTO scene (id, hash, name, bytes, summary, created_at) VALUES ($1, $2, $3, $4, $5, $6)")
            .bind(&scene.id)
            .bind(&scene.hash)
            .bind(&scene.name)
            .bind(signed(scene.bytes))
            .bind(to_json(&scene.summary)?)
            .bind(now)
            .execute(&mut *tx)
            .await
            .map_err(context("adding a scene"))?;
        for (position, file) in scene.files.iter().enumerate() {
            sqlx::query("INSERT INTO scene_file (scene_id, position, path, blob, bytes) VALUES ($1, $2, $3, $4, $5)")
                .bind(&scene.id)
                .bind(signed(position as u64))
                .bind(&file.path)
                .bind(&file.blob)
                .bind(signed(file.bytes))
                .execute(&mut *tx)
                .await
                .map_err(context("adding a scene's file"))?;
        }
        for mesh in &scene.summary.meshes {
            sqlx::query("INSERT INTO mesh (hash, triangles, spheres) VALUES ($1, $2, $3) ON CONFLICT DO NOTHING")
                .bind(&mesh.hash)
                .bind(signed(mesh.triangles))
                .bind(signed(mesh.spheres))
                .execute(&mut *tx)
                .await
                .map_err(context("adding a mesh"))?;
            sqlx::query("INSERT INTO scene_mesh (scene_id, mesh_hash) VALUES ($1, $2) ON CONFLICT DO NOTHING")
                .bind(&scene.id)
                .bind(&mesh.hash)
                .execute(&mut *tx)
                .await
                .map_err(context("adding a scene's mesh"))?;
        }
        commit(tx).await?;
        Ok((scene.id.clone(), true))
    }

    pub(super) async fn read_scene(&self, id: &str) -> Result<Option<Scene>> {
        let row: Option<SceneRow> = sqlx::query_as(scenes!("s.id = $1"))
            .bind(id)
            .fetch_optional(&self.readers)
            .await
            .map_err(context("reading a scene"))?;
        row.map(SceneRow::into_scene).transpose()
    }

    pub(super) async fn read_scene_by_hash(&self, hash: &str) -> Result<Option<Scene>> {
        let row: Option<SceneRow> = sqlx::query_as(scenes!("s.hash = $1"))
            .bind(hash)
            .fetch_optional(&self.readers)
            .await
            .map_err(context("reading a scene"))?;
        row.map(SceneRow::into_scene).transpose()
    }

    pub(super) async fn read_scenes(&self, page: &PageRequest) -> Result<Vec<Scene>> {
        let rows: Vec<SceneRow> = sqlx::query_as(scenes!("($1 IS NULL OR s.id < $1) ORDER BY s.id DESC LIMIT $2"))
            .bind(&page.after)
            .bind(page.limit)
            .fetch_all(&self.readers)
            .await
            .map_err(context("reading scenes"))?;
        rows.into_iter().map(SceneRow::into_scene).collect()
    }

    pub(super) async fn read_scene_blobs(&self, id: &str) -> Result<Vec<String>> {
        sqlx::query_scalar("SELECT DISTINCT blob FROM scene_file WHERE scene_id = $1")
            .bind(id)
            .fetch_all(&self.readers)
            .await
            .map_err(context("reading a scene's files"))
    }

    pub(super) async fn read_scenes_without_thumbnail(&self, limit: u32) -> Result<Vec<Scene>> {
        let rows: Vec<SceneRow> = sqlx::query_as(scenes!(
            "s.thumbnail_job IS NULL AND json_extract(s.summary, '$.instances') > 0 ORDER BY s.id LIMIT $1"
        ))
        .bind(limit)
        .fetch_all(&self.readers)
        .await
        .map_err(context("looking for scenes without a thumbnail"))?;
        rows.into_iter().map(SceneRow::into_scene).collect()
    }

    pub(super) async fn read_thumbnail_job(&self, scene: &str) -> Result<Option<String>> {
        sqlx::query_scalar("SELECT thumbnail_job FROM scene WHERE id = $1 AND deleted_at IS NULL")
            .bind(scene)
            .fetch_optional(&self.readers)
            .await
            .map(Option::flatten)
            .map_err(context("reading a scene's thumbnail"))
    }

    pub(super) async fn do_delete_scene(&self, id: &str, now: Millis) -> Result<Removal> {
        let mut tx = self.begin().await?;
        let unfinished: Vec<(String, bool)> = sqlx::query_as(
            "SELECT id, automatic FROM job WHERE scene_id = $1 AND state IN ('queued', 'running')
                 UNION SELECT j.id, FALSE FROM job j, json_each(j.settings, '$.scenes') further
                 WHERE j.kind = 'benchmark' AND j.state IN ('queued', 'running') AND further.value = $1",
        )
        .bind(id)
        .fetch_all(&mut *tx)
        .await
        .map_err(context("looking for a scene's jobs"))?;
        if unfinished.iter().any(|(_, automatic)| !automatic) {
            return Ok(Removal::InUse);
        }
        let deleted = sqlx::query("UPDATE scene SET deleted_at = $2 WHERE id = $1 AND deleted_at IS NULL")
            .bind(id)
            .bind(now)
            .execute(&mut *tx)
            .await
            .map_err(context("deleting a scene"))?;
        if deleted.rows_affected() == 0 {
            return Ok(Removal::Unknown);
        }
        for (job, _) in unfinished {
            cancel_tasks(&mut tx, &job).await?;
            refresh_job(&mut tx, &job, now).await?;
        }
        commit(tx).await?;
        Ok(Removal::Done)
    }
}
