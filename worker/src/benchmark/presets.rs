//! The tables of Keul's dissertation as benchmarks: scenes, configurations, and the figures of the paper.
//!
//! Each preset is a JSON file beside this one. Accelerations are kept as JSON until they are needed: what this build
//! does not know yet is told by the same error that a job would get.

use std::collections::BTreeMap;

use lightshaft_api::benchmark::{Column, PaperFigures};
use lightshaft_api::settings::{BenchmarkPreset, CameraChoice, Effect};
use serde::Deserialize;
use serde_json::Value;

/// A table.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Preset {
    pub title: String,
    /// Which table of the paper, and on what it was measured.
    pub source: String,
    pub width: u32,
    pub height: u32,
    pub columns: Vec<Column>,
    pub scenes: Vec<PresetScene>,
    pub groups: Vec<Group>,
}

/// A scene of the paper, and what can be taken for it.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PresetScene {
    /// As the paper calls it.
    pub name: String,
    /// The first that is there counts.
    #[serde(default)]
    pub files: Vec<KnownFile>,
    /// What is generated where no file is there.
    pub generate: Generate,
    /// Whether that is the paper's scene and no stand-in.
    #[serde(default)]
    pub generated_is_it: bool,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KnownFile {
    /// Name without its ending.
    pub stem: String,
    #[serde(default)]
    pub stand_in: bool,
    #[serde(default)]
    pub views: Vec<CameraChoice>,
}

/// Parameters of the scene generator.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Generate {
    pub kind: String,
    #[serde(default)]
    pub count: Option<u32>,
    #[serde(default)]
    pub triangles: Option<u32>,
}

/// One effect, one reference.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Group {
    #[serde(default)]
    pub title: Option<String>,
    /// Null where structures are only built.
    pub effect: Option<Effect>,
    /// Names of the scenes that it is for; all when null.
    #[serde(default)]
    pub scenes: Option<Vec<String>>,
    #[serde(default)]
    pub reference: Option<String>,
    pub configurations: Vec<PresetConfiguration>,
    /// By scene, by configuration.
    pub paper: BTreeMap<String, BTreeMap<String, PaperFigures>>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PresetConfiguration {
    pub name: String,
    pub acceleration: Value,
}

/// # Errors
/// When the embedded file is not a preset, which a test rules out.
pub fn load(preset: BenchmarkPreset) -> Result<Preset, String> {
    let text = match preset {
        BenchmarkPreset::Keul41 => include_str!("presets/keul-4.1.json"),
        BenchmarkPreset::Keul42 => include_str!("presets/keul-4.2.json"),
        BenchmarkPreset::Keul51 => include_str!("presets/keul-5.1.json"),
        BenchmarkPreset::Keul61 => include_str!("presets/keul-6.1.json"),
        BenchmarkPreset::Keul72 => include_str!("presets/keul-7.2.json"),
        BenchmarkPreset::Keul73 => include_str!("presets/keul-7.3.json"),
        BenchmarkPreset::Keul74 => include_str!("presets/keul-7.4.json"),
        BenchmarkPreset::Keul81 => include_str!("presets/keul-8.1.json"),
        BenchmarkPreset::Keul82 => include_str!("presets/keul-8.2.json"),
        BenchmarkPreset::Keul83 => include_str!("presets/keul-8.3.json"),
    };
    serde_json::from_str(text).map_err(|error| format!("the preset {} is broken: {error}", preset.as_str()))
}

impl Preset {
    /// The scene that a file of this name is, or stands in for.
    pub fn scene_of(&self, stem: &str) -> Option<(&PresetScene, &KnownFile)> {
        self.scenes
            .iter()
            .flat_map(|scene| scene.files.iter().map(move |file| (scene, file)))
            .filter(|(_, file)| file.stem == stem)
            .min_by_key(|(_, file)| file.stand_in)
    }

    /// What is measured of a scene. One that the paper does not have is measured as its first one is.
    pub fn groups_of(&self, scene: &str) -> Vec<&Group> {
        let known = self.scenes.iter().any(|known| known.name == scene);
        let name = if known { scene } else { self.scenes.first().map_or(scene, |first| &first.name) };
        let is_for = |group: &&Group| group.scenes.as_ref().is_none_or(|names| names.iter().any(|n| n == name));
        self.groups.iter().filter(is_for).collect()
    }
}

impl Group {
    /// The paper's figures, with the speed over the reference's.
    pub fn paper_figures(&self, scene: &str, configuration: &str) -> Option<PaperFigures> {
        let rows = self.paper.get(scene)?;
        let mut figures = *rows.get(configuration)?;
        let speed = |figures: &PaperFigures| figures.fps.or(figures.mrays_per_s);
        let reference = self.reference.as_ref().filter(|name| *name != configuration).and_then(|name| rows.get(name));
        figures.ratio = reference.and_then(speed).zip(speed(&figures)).map(|(base, own)| own / base);
        Some(figures)
    }
}

#[cfg(test)]
mod tests {
    use lightshaft_api::settings::{DeviceChoice, validate_acceleration};
    use lightshaft_engine::scene::KINDS;

    use super::*;

    #[test]
    fn every_preset_is_whole() {
        for preset in BenchmarkPreset::ALL {
            let name = preset.as_str();
            let table = load(preset).unwrap();
            assert!(table.source.contains(&name.replace("keul-", "table ")), "{name}: {}", table.source);
            for scene in &table.scenes {
                assert!(KINDS.iter().any(|kind| kind.name == scene.generate.kind), "{name}: {}", scene.name);
                assert!(!table.groups_of(&scene.name).is_empty(), "{name}: {}", scene.name);
            }
            assert_eq!(table.groups_of("a scene of one's own").len(), table.groups_of(&table.scenes[0].name).len());
            for group in &table.groups {
                let has = |name: &String| group.configurations.iter().any(|c| c.name == *name);
                assert_eq!(group.effect.is_some(), group.reference.is_some(), "{name}");
                assert!(group.reference.as_ref().is_none_or(has), "{name}");
                for row in &group.configurations {
                    // A structure for each bounce is nothing that a job can have yet.
                    if row.acceleration.pointer("/policy/per_bounce/0/structure").is_some() {
                        continue;
                    }
                    let acceleration = serde_json::from_value(row.acceleration.clone()).unwrap();
                    let errors = validate_acceleration(&acceleration, DeviceChoice::Cpu, "");
                    assert!(errors.is_empty(), "{name}: {}: {errors:?}", row.name);
                }
                for (scene, rows) in &group.paper {
                    assert!(table.scenes.iter().any(|known| known.name == *scene), "{name}: {scene}");
                    assert!(rows.keys().all(has), "{name}: {:?}", rows.keys());
                }
            }
        }
    }

    #[test]
    fn ratios_are_those_that_the_paper_gives() {
        let ratio = |preset, group: usize, scene: &str, configuration: &str| {
            load(preset).unwrap().groups[group].paper_figures(scene, configuration).unwrap().ratio
        };
        let near = |ratio: Option<f64>, given: f64| (ratio.unwrap() - given).abs() < 0.006;
        // Table 4.2: "+48.3 %" for N = 10, d = 3; table 6.1: "3.7x"; table 8.3: "x2.45".
        assert!(near(ratio(BenchmarkPreset::Keul42, 10, "BUNNY", "LS (10,3)"), 1.483));
        assert!((ratio(BenchmarkPreset::Keul61, 0, "DRAGON", "BVH LS (9)").unwrap() - 3.7).abs() < 0.05);
        assert!(near(ratio(BenchmarkPreset::Keul83, 0, "OBJECTS", "Ad. LS"), 2.45));
        assert_eq!(ratio(BenchmarkPreset::Keul83, 0, "OBJECTS", "BVH"), None, "the reference has none");
    }

    #[test]
    fn a_scene_is_known_by_its_file_and_its_own_name_counts_before_a_stand_in() {
        let table = load(BenchmarkPreset::Keul51).unwrap();
        let (scene, file) = table.scene_of("stanford-dragon").unwrap();
        assert_eq!((scene.name.as_str(), file.stand_in), ("DRAGON", false));
        assert!(table.scene_of("teapot").is_none());
    }
}
