//! The scenes that a suite calls by a name: uploaded or generated before its run.

use std::collections::BTreeMap;
use std::path::Path;

use lightshaft_api::client::{Client, Upload};
use lightshaft_api::farm::{NewSuite, SceneSource};

use super::{CliError, Result, scene};

/// Ids of the scenes by their names. What `given` maps is taken from there: an id, or a file.
pub(super) async fn bring(
    client: &Client,
    suite: &NewSuite,
    folder: &Path,
    given: &BTreeMap<String, String>,
) -> Result<BTreeMap<String, String>> {
    let mut ids = BTreeMap::new();
    let names = suite.scene_names();
    if let Some(unused) = given.keys().find(|name| !names.contains(name.as_str())) {
        return Err(CliError::usage(format!("--scene {unused}: no case of the suite has a scene of this name")));
    }
    for name in names {
        let id = match (given.get(name), suite.scenes.get(name)) {
            (Some(given), _) if Path::new(given).is_file() => upload(client, Path::new(given), name).await?,
            (Some(given), _) => given.clone(),
            (None, Some(source)) => from_source(client, source, folder, name).await?,
            // An id or a hash: the service knows it, or says that it does not.
            (None, None) => continue,
        };
        ids.insert(name.to_owned(), id);
    }
    Ok(ids)
}

async fn from_source(client: &Client, source: &SceneSource, folder: &Path, name: &str) -> Result<String> {
    if let Some(file) = &source.file {
        return upload(client, &folder.join(file), name).await;
    }
    let words = source.generate.as_deref().unwrap_or_default();
    let glb = scene::generated(words).map_err(|error| error.below(&format!("scene {name}")))?;
    let length = glb.len() as u64;
    let (scene, _) = client.upload_scene(Upload::Glb(glb.into(), Some(length)), Some(name)).await?;
    Ok(scene.id)
}

async fn upload(client: &Client, file: &Path, name: &str) -> Result<String> {
    Ok(scene::upload(client, file, Some(name)).await?.0.id)
}
