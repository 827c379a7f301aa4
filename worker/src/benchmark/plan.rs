//! What a benchmark measures: from its settings, or from a preset.

use lightshaft_api::benchmark::{Column, PaperFigures};
use lightshaft_api::settings::{
    Acceleration, BenchmarkSettings, CameraChoice, DeviceChoice, Effect, validate_acceleration,
};
use lightshaft_engine::scene::{Limits, Source};
use serde_json::Value;

use super::presets::{self, Group, Preset};
use crate::executor::TaskError;
use crate::settings::Wanted;

/// Pixels on each side when neither settings nor a preset say.
const DEFAULT_SIDE: u32 = 512;

/// The scenes of a benchmark.
pub trait Scenes: Sync {
    fn list(&self) -> Vec<SceneInput>;

    /// Opens one of them, by its place in the list.
    fn open(&self, index: usize, limits: &Limits) -> Result<Source, TaskError>;
}

/// What is known of a scene before it is opened.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneInput {
    /// As the paper or the user calls it.
    pub name: String,
    /// What is measured: a file, a generated kind, a scene's id.
    pub measured: String,
    /// Whether it stands in for a scene of the paper.
    pub stand_in: bool,
    /// Those to take when the settings name none.
    pub views: Vec<CameraChoice>,
}

impl SceneInput {
    /// A scene by its file's name: the paper's, or one of one's own.
    pub fn named(file: &str, measured: String, table: Option<&Preset>) -> Self {
        let stem = file.rsplit_once('.').map_or(file, |(stem, _)| stem);
        match table.and_then(|table| table.scene_of(stem)) {
            Some((scene, file)) => {
                Self { name: scene.name.clone(), measured, stand_in: file.stand_in, views: file.views.clone() }
            }
            None => Self { name: stem.to_owned(), measured, ..Self::default() },
        }
    }
}

#[derive(Debug)]
pub(super) struct Plan {
    pub title: String,
    pub source: Option<String>,
    pub width: u32,
    pub height: u32,
    pub columns: Vec<Column>,
    /// For each scene, what is compared.
    pub scenes: Vec<(SceneInput, Vec<PlannedComparison>)>,
}

#[derive(Debug)]
pub(super) struct PlannedComparison {
    pub title: String,
    pub effect: Option<Effect>,
    pub reference: Option<String>,
    pub configurations: Vec<PlannedConfiguration>,
}

#[derive(Debug)]
pub(super) struct PlannedConfiguration {
    pub name: String,
    /// As it was written.
    pub written: Value,
    /// Or why this build cannot have it.
    pub acceleration: Result<Acceleration, String>,
    pub paper: Option<PaperFigures>,
}

/// What a table shows when no preset says.
const COLUMNS: [Column; 10] = [
    Column::InitS,
    Column::StructureMb,
    Column::LineSpaceMb,
    Column::Fps,
    Column::MraysPerS,
    Column::Ratio,
    Column::Rmse,
    Column::Flip,
    Column::BoxTests,
    Column::LookUps,
];

impl Plan {
    /// Of settings that have been validated.
    pub(super) fn of(settings: &BenchmarkSettings, scenes: Vec<SceneInput>) -> Result<Self, TaskError> {
        let Some(preset) = settings.preset else { return Ok(Self::own(settings, scenes)) };
        let table = presets::load(preset).map_err(TaskError::worker)?;
        let plan = |scene: SceneInput| {
            let groups = table.groups_of(&scene.name);
            let comparisons = groups.into_iter().map(|group| of_group(group, &scene.name, settings.device)).collect();
            (scene, comparisons)
        };
        Ok(Self {
            title: format!("{}: {}", preset.as_str(), table.title),
            source: Some(table.source.clone()),
            width: settings.width.unwrap_or(table.width),
            height: settings.height.unwrap_or(table.height),
            columns: table.columns.clone(),
            scenes: scenes.into_iter().map(plan).collect(),
        })
    }

    fn own(settings: &BenchmarkSettings, scenes: Vec<SceneInput>) -> Self {
        let first = settings.configurations.first().map(|configuration| configuration.name.clone());
        let reference = settings.reference.clone().or(first);
        let configurations = || {
            let planned = settings.configurations.iter().map(|configuration| PlannedConfiguration {
                name: configuration.name.clone(),
                written: serde_json::to_value(&configuration.acceleration).unwrap_or_default(),
                acceleration: Ok(configuration.acceleration.clone()),
                paper: None,
            });
            planned.collect()
        };
        let comparisons = || {
            let planned = settings.effects.iter().map(|effect| PlannedComparison {
                title: effect.describe(),
                effect: Some(effect.clone()),
                reference: reference.clone(),
                configurations: configurations(),
            });
            planned.collect()
        };
        Self {
            title: "Benchmark".into(),
            source: None,
            width: settings.width.unwrap_or(DEFAULT_SIDE),
            height: settings.height.unwrap_or(DEFAULT_SIDE),
            columns: COLUMNS.to_vec(),
            scenes: scenes.into_iter().map(|scene| (scene, comparisons())).collect(),
        }
    }

    /// Whether a configuration that is available can be had on the CPU alone.
    pub(super) fn needs_cpu(&self) -> bool {
        let configurations = self.scenes.iter().flat_map(|(_, all)| all).flat_map(|one| &one.configurations);
        configurations.filter_map(|c| c.acceleration.as_ref().ok()).any(|a| Wanted::of(a).needs_cpu())
    }
}

fn of_group(group: &Group, scene: &str, device: DeviceChoice) -> PlannedComparison {
    let effect = group.effect.as_ref().map_or("construction".to_owned(), Effect::describe);
    let configurations = group.configurations.iter().map(|configuration| PlannedConfiguration {
        name: configuration.name.clone(),
        written: configuration.acceleration.clone(),
        acceleration: available(&configuration.acceleration, device),
        paper: group.paper_figures(scene, &configuration.name),
    });
    PlannedComparison {
        title: group.title.as_ref().map_or(effect.clone(), |title| format!("{effect}, {title}")),
        effect: group.effect.clone(),
        reference: group.reference.clone(),
        configurations: configurations.collect(),
    }
}

/// The acceleration, or the error that a job with it would get.
fn available(written: &Value, device: DeviceChoice) -> Result<Acceleration, String> {
    let acceleration: Acceleration = serde_json::from_value(written.clone()).map_err(|error| error.to_string())?;
    let errors = validate_acceleration(&acceleration, device, "");
    if errors.is_empty() {
        return Ok(acceleration);
    }
    let reasons = errors.iter().map(|e| format!("{}: {}", e.pointer.trim_start_matches("/acceleration/"), e.detail));
    Err(reasons.collect::<Vec<_>>().join("; "))
}

#[cfg(test)]
mod tests {
    use lightshaft_api::settings::BenchmarkPreset;
    use serde_json::json;

    use super::*;

    fn scene(name: &str) -> SceneInput {
        SceneInput { name: name.into(), ..SceneInput::default() }
    }

    #[test]
    fn what_this_build_lacks_is_told_by_the_error_of_the_settings() {
        let on_cpu = |written| available(&written, DeviceChoice::Cpu);
        assert!(on_cpu(json!({ "structure": "ntree", "n": 9 })).is_ok());
        assert!(on_cpu(json!({ "structure": "ntree", "m": 9 })).unwrap_err().contains("unknown field `m`"));
        assert_eq!(on_cpu(json!({ "structure": "ntree", "n": 17 })).unwrap_err(), "n: must be 2 to 16");
        assert!(available(&json!({ "structure": "grid" }), DeviceChoice::Gpu).is_ok());
    }

    #[test]
    fn every_effect_meets_every_configuration_in_every_scene() {
        let settings: BenchmarkSettings = serde_json::from_value(json!({
            "effects": [{ "kind": "primary" }, { "kind": "ao" }],
            "configurations": [{ "name": "a" }, { "name": "b", "acceleration": { "line_space": {} } }],
        }))
        .unwrap();
        let plan = Plan::of(&settings, vec![scene("x"), scene("y")]).unwrap();
        assert_eq!(plan.scenes.len(), 2);
        for (_, comparisons) in &plan.scenes {
            let titles: Vec<&str> = comparisons.iter().map(|c| c.title.as_str()).collect();
            assert_eq!(titles, ["primary rays", "ambient occlusion, 16 rays"]);
            assert!(comparisons.iter().all(|c| c.reference.as_deref() == Some("a") && c.configurations.len() == 2));
        }
        assert!(plan.needs_cpu());
    }

    #[test]
    fn a_preset_gives_its_table_and_the_papers_figures_for_its_own_scenes() {
        let settings = BenchmarkSettings { preset: Some(BenchmarkPreset::Keul41), ..BenchmarkSettings::default() };
        let plan = Plan::of(&settings, vec![scene("DRAGON"), scene("teapot")]).unwrap();
        assert_eq!((plan.width, plan.height), (512, 512));
        let names =
            |i: usize| -> Vec<&str> { plan.scenes[i].1[0].configurations.iter().map(|c| c.name.as_str()).collect() };
        assert_eq!(names(0), ["UG 256", "OT 9", "NT (7,4)", "LS (7,4)"]);
        assert_eq!(names(1), ["UG 128", "OT 7", "NT (9,3)", "LS (9,3)"]);
        let paper = |i: usize| plan.scenes[i].1[0].configurations[3].paper;
        assert_eq!(paper(0).unwrap().fps, Some(3.95));
        assert_eq!(paper(1), None);
    }
}
