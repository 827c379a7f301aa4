//! Which scenes a benchmark without a service measures: files, or what the generator makes in their place.

use std::path::{Path, PathBuf};

use lightshaft_api::settings::BenchmarkPreset;
use lightshaft_engine::scene::{KINDS, Limits, Params, Source, generate};
use lightshaft_worker::benchmark::{PresetScene, SceneInput, Scenes, load};
use lightshaft_worker::executor::TaskError;

use crate::cli::error::{CliError, Result};

/// Endings of scene files, in the order in which they are looked for.
const ENDINGS: [&str; 3] = ["glb", "gltf", "zip"];

#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Scenes")]
pub(crate) struct SceneArgs {
    /// Folder in which a preset finds its scenes; what is not there is generated, and marked as a stand-in.
    #[arg(long, value_name = "DIR")]
    scenes: Option<PathBuf>,
    /// Measure this file instead of the preset's scenes; may be given several times.
    #[arg(long, value_name = "FILE")]
    scene: Vec<PathBuf>,
    /// Measure a generated scene, such as pile (see `scene generate`); may be given several times.
    #[arg(long, value_name = "KIND")]
    generate: Vec<String>,
    /// Of a preset's scenes only this one; may be given several times.
    #[arg(long, value_name = "NAME")]
    only: Vec<String>,
}

/// Scenes of this machine.
#[derive(Debug)]
pub(crate) struct LocalScenes(Vec<(SceneInput, Origin)>);

#[derive(Clone, Debug)]
enum Origin {
    File(PathBuf),
    Generated(String, Params),
}

impl SceneArgs {
    pub(crate) fn find(&self, preset: Option<BenchmarkPreset>) -> Result<LocalScenes> {
        let table = preset.map(load).transpose().map_err(CliError::system)?;
        let mut found = Vec::new();
        for path in &self.scene {
            if !path.is_file() {
                return Err(CliError::usage(format!("--scene {}: is no file", path.display())));
            }
            let name = file_name(path);
            let input = SceneInput::named(&name, name.clone(), table.as_ref());
            found.push((input, Origin::File(path.clone())));
        }
        for kind in &self.generate {
            if !KINDS.iter().any(|known| known.name == kind) {
                let known: Vec<&str> = KINDS.iter().map(|kind| kind.name).collect();
                return Err(CliError::usage(format!("--generate {kind}: must be one of {}", known.join(", "))));
            }
            let input =
                SceneInput { name: kind.clone(), measured: format!("generated {kind}"), ..SceneInput::default() };
            found.push((input, Origin::Generated(kind.clone(), Params::default())));
        }
        let Some(table) = table else {
            if !self.only.is_empty() || self.scenes.is_some() {
                return Err(CliError::usage("--scenes and --only are for presets: name files by --scene"));
            }
            if found.is_empty() {
                return Err(CliError::usage("which scene? Give --scene FILE or --generate KIND"));
            }
            return Ok(LocalScenes(found));
        };
        if let Some(unknown) = self.only.iter().find(|name| !table.scenes.iter().any(|scene| scene.name == **name)) {
            let known: Vec<&str> = table.scenes.iter().map(|scene| scene.name.as_str()).collect();
            return Err(CliError::usage(format!("--only {unknown}: must be one of {}", known.join(", "))));
        }
        if found.is_empty() {
            let wanted = |scene: &&PresetScene| self.only.is_empty() || self.only.contains(&scene.name);
            found.extend(table.scenes.iter().filter(wanted).map(|scene| self.of_preset(scene)));
        }
        Ok(LocalScenes(found))
    }

    fn of_preset(&self, scene: &PresetScene) -> (SceneInput, Origin) {
        for file in &scene.files {
            let paths =
                ENDINGS.iter().filter_map(|ending| Some(self.scenes.as_ref()?.join(format!("{}.{ending}", file.stem))));
            if let Some(path) = paths.into_iter().find(|path| path.is_file()) {
                let input = SceneInput {
                    name: scene.name.clone(),
                    measured: file_name(&path),
                    stand_in: file.stand_in,
                    views: file.views.clone(),
                };
                return (input, Origin::File(path));
            }
        }
        let made = &scene.generate;
        let amounts = [("count", made.count), ("triangles", made.triangles)];
        let amounts = amounts.iter().filter_map(|(name, amount)| Some(format!(", {name} {}", (*amount)?)));
        let input = SceneInput {
            name: scene.name.clone(),
            measured: format!("generated {}{}", made.kind, amounts.collect::<String>()),
            stand_in: !scene.generated_is_it,
            views: Vec::new(),
        };
        let params = Params { seed: 0, triangles: made.triangles, count: made.count };
        (input, Origin::Generated(made.kind.clone(), params))
    }
}

fn file_name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

impl Scenes for LocalScenes {
    fn list(&self) -> Vec<SceneInput> {
        self.0.iter().map(|(input, _)| input.clone()).collect()
    }

    fn open(&self, index: usize, limits: &Limits) -> std::result::Result<Source, TaskError> {
        let Some((_, origin)) = self.0.get(index) else {
            return Err(TaskError::bad_input(format!("there is no scene {index}")));
        };
        match origin {
            Origin::File(path) => Ok(Source::open(path, limits)?),
            Origin::Generated(kind, params) => {
                let glb = generate(kind, params).map_err(|error| TaskError::bad_input(error.to_string()))?;
                Ok(Source::from_bytes("scene.glb", glb, limits)?)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn args() -> SceneArgs {
        SceneArgs { scenes: None, scene: Vec::new(), generate: Vec::new(), only: Vec::new() }
    }

    #[test]
    fn what_is_not_at_hand_is_generated_and_marked_and_can_be_opened() {
        let only = SceneArgs { only: vec!["SPHEREFLAKE".into(), "BUNNY".into()], ..args() };
        let scenes = only.find(Some(BenchmarkPreset::Keul41)).unwrap();
        let listed = scenes.list();
        assert_eq!([listed[0].stand_in, listed[1].stand_in], [true, false], "a sphere flake is a sphere flake");
        assert_eq!(listed[0].measured, "generated pile, count 1, triangles 69451");
        assert!(scenes.open(0, &Limits::default()).is_ok());
        assert!(only.find(Some(BenchmarkPreset::Keul83)).unwrap_err().code() == 2);
    }

    #[test]
    fn files_of_a_folder_are_taken_and_stand_ins_are_marked() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["stanford-bunny.glb", "kitchen.glb"] {
            std::fs::write(folder.path().join(name), b"x").unwrap();
        }
        let of_folder = SceneArgs { scenes: Some(folder.path().to_owned()), ..args() };
        let listed = of_folder.find(Some(BenchmarkPreset::Keul41)).unwrap().list();
        let found = |i: usize| (listed[i].name.as_str(), listed[i].measured.as_str(), listed[i].stand_in);
        assert_eq!(found(0), ("BUNNY", "stanford-bunny.glb", false));
        assert_eq!(found(4), ("CONFERENCE", "kitchen.glb", true));
        let named = SceneArgs { scene: vec![folder.path().join("kitchen.glb")], ..args() };
        let listed = named.find(Some(BenchmarkPreset::Keul83)).unwrap().list();
        assert_eq!((listed.len(), listed[0].name.as_str(), listed[0].stand_in), (1, "BREAKFAST", true));
    }

    #[test]
    fn own_settings_need_a_scene() {
        assert_eq!(args().find(None).unwrap_err().code(), 2);
        assert!(SceneArgs { generate: vec!["pile".into()], ..args() }.find(None).is_ok());
        assert_eq!(SceneArgs { generate: vec!["heap".into()], ..args() }.find(None).unwrap_err().code(), 2);
    }
}
