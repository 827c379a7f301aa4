//! Meshes and the structures that workers published for them.

use std::collections::BTreeMap;

use lightshaft_api::mesh::{FindStructures, Mesh, NewStructure, Structure};
use sqlx::FromRow;

use super::{SqliteStore, commit, context, signed, timestamp, to_json};
use crate::queue::Millis;
use crate::store::{PageRequest, Result};

#[derive(FromRow)]
struct StructureRow {
    kind: String,
    parameters: String,
    builder_version: u32,
    bytes: i64,
    build_s: f64,
    blob: String,
    created_at: i64,
}

impl StructureRow {
    fn into_structure(self) -> Result<Structure> {
        Ok(Structure {
            kind: self.kind,
            parameters: self.parameters,
            builder_version: self.builder_version,
            bytes: self.bytes.unsigned_abs(),
            build_s: self.build_s,
            built_at: timestamp(self.created_at)?,
            blob: self.blob,
            workers: Vec::new(),
        })
    }
}

impl SqliteStore {
    pub(super) async fn read_meshes(&self, scene: Option<&str>, page: &PageRequest) -> Result<Vec<Mesh>> {
        let rows: Vec<(String, i64, i64)> = sqlx::query_as(
            "SELECT hash, triangles, spheres FROM mesh
             WHERE ($1 IS NULL OR hash > $1)
               AND ($3 IS NULL OR hash IN (SELECT mesh_hash FROM scene_mesh WHERE scene_id = $3))
             ORDER BY hash LIMIT $2",
        )
        .bind(&page.after)
        .bind(page.limit)
        .bind(scene)
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading meshes"))?;
        let mut meshes = Vec::with_capacity(rows.len());
        for (hash, triangles, spheres) in rows {
            let structures = self.read_structures(&hash).await?;
            meshes.push(Mesh {
                hash,
                triangles: triangles.unsigned_abs(),
                spheres: spheres.unsigned_abs(),
                structures,
            });
        }
        Ok(meshes)
    }

    pub(super) async fn read_mesh(&self, hash: &str) -> Result<Option<Mesh>> {
        let row: Option<(i64, i64)> = sqlx::query_as("SELECT triangles, spheres FROM mesh WHERE hash = $1")
            .bind(hash)
            .fetch_optional(&self.readers)
            .await
            .map_err(context("reading a mesh"))?;
        let Some((triangles, spheres)) = row else { return Ok(None) };
        Ok(Some(Mesh {
            hash: hash.to_owned(),
            triangles: triangles.unsigned_abs(),
            spheres: spheres.unsigned_abs(),
            structures: self.read_structures(hash).await?,
        }))
    }

    async fn read_structures(&self, mesh: &str) -> Result<Vec<Structure>> {
        let rows: Vec<StructureRow> = sqlx::query_as(
            "SELECT kind, parameters, builder_version, bytes, build_s, blob, created_at FROM structure WHERE mesh_hash = $1
             ORDER BY kind, parameters, builder_version",
        )
        .bind(mesh)
        .fetch_all(&self.readers)
        .await
        .map_err(context("reading structures"))?;
        rows.into_iter().map(StructureRow::into_structure).collect()
    }

    pub(super) async fn read_find_structures(&self, wanted: &FindStructures) -> Result<BTreeMap<String, String>> {
        let rows: Vec<(String, String)> = sqlx::query_as(
            "SELECT mesh_hash, blob FROM structure
             WHERE mesh_hash IN (SELECT value FROM json_each($1))
               AND kind = $2 AND parameters = $3 AND builder_version = $4",
        )
        .bind(to_json(&wanted.meshes)?)
        .bind(&wanted.kind)
        .bind(&wanted.parameters)
        .bind(wanted.builder_version)
        .fetch_all(&self.readers)
        .await
        .map_err(context("looking for structures"))?;
        Ok(rows.into_iter().collect())
    }

    pub(super) async fn do_add_structure(
        &self,
        mesh: &str,
        structure: &NewStructure,
        now: Millis,
    ) -> Result<Option<Structure>> {
        let mut tx = self.begin().await?;
        let known: bool = sqlx::query_scalar("SELECT EXISTS (SELECT 1 FROM mesh WHERE hash = $1)")
            .bind(mesh)
            .fetch_one(&mut *tx)
            .await
            .map_err(context("looking up a mesh"))?;
        if !known {
            return Ok(None);
        }
        sqlx::query(
            "INSERT INTO structure (mesh_hash, kind, parameters, builder_version, bytes, build_s, blob, created_at)
             VALUES ($1, $2, $3, $4, $5, $6, $7, $8)
             ON CONFLICT DO UPDATE SET bytes = $5, build_s = $6, blob = $7, created_at = $8 WHERE blob = $9",
        )
        .bind(mesh)
        .bind(&structure.kind)
        .bind(&structure.parameters)
        .bind(structure.builder_version)
        .bind(signed(structure.bytes))
        .bind(structure.build_s)
        .bind(&structure.blob)
        .bind(now)
        .bind(&structure.replaces)
        .execute(&mut *tx)
        .await
        .map_err(context("adding a structure"))?;
        let row: StructureRow = sqlx::query_as(
            "SELECT kind, parameters, builder_version, bytes, build_s, blob, created_at FROM structure
             WHERE mesh_hash = $1 AND kind = $2 AND parameters = $3 AND builder_version = $4",
        )
        .bind(mesh)
        .bind(&structure.kind)
        .bind(&structure.parameters)
        .bind(structure.builder_version)
        .fetch_one(&mut *tx)
        .await
        .map_err(context("reading a structure"))?;
        commit(tx).await?;
        row.into_structure().map(Some)
    }

    pub(super) async fn read_is_blob_used(&self, hash: &str) -> Result<bool> {
        sqlx::query_scalar(
            "SELECT EXISTS (SELECT 1 FROM artifact WHERE blob = $1)
                 OR EXISTS (SELECT 1 FROM structure WHERE blob = $1)
                 OR EXISTS (SELECT 1 FROM scene_file f JOIN scene s ON s.id = f.scene_id
                            WHERE f.blob = $1 AND s.deleted_at IS NULL)
                 OR EXISTS (SELECT 1 FROM job_blob WHERE blob = $1)
                 OR EXISTS (SELECT 1 FROM farm_artifact WHERE blob = $1)
                 OR EXISTS (SELECT 1 FROM farm_accepted_file WHERE blob = $1)
                 OR EXISTS (SELECT 1 FROM farm_suite s, json_each(s.cases) c
                            WHERE json_extract(c.value, '$.settings.environment.map') = $1)",
        )
        .bind(hash)
        .fetch_one(&self.readers)
        .await
        .map_err(context("looking for uses of a blob"))
    }
}
