//! Settings of a benchmark job: what is timed, over what, and against what.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::validate::Checker;
use super::{Acceleration, CameraChoice, DeviceChoice, RenderSettings};
use crate::problem::FieldError;

/// Further scenes, views, effects and configurations of one benchmark.
const MAX_SCENES: usize = 16;
const MAX_VIEWS: usize = 16;
const MAX_EFFECTS: usize = 16;
const MAX_CONFIGURATIONS: usize = 32;

/// Every configuration renders every effect from every view of every scene, in turn with the reference.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct BenchmarkSettings {
    /// A table of Keul's work: it gives effects, configurations, references and the picture's size. Null: they are given here.
    pub preset: Option<BenchmarkPreset>,
    /// Ids of further scenes, beside the job's own; at most 16.
    pub scenes: Vec<String>,
    /// At most 16. Empty: the scene's cameras, at most three of them, or three views around it where it has none.
    pub views: Vec<CameraChoice>,
    /// What is rendered, at most 16. With a preset: empty.
    pub effects: Vec<Effect>,
    /// What is compared, 1 to 32. With a preset: empty.
    pub configurations: Vec<Configuration>,
    /// Name of the configuration that the others are compared with; the first when null.
    pub reference: Option<String>,
    /// Rounds in which each configuration is timed once, 3 to 1000.
    pub repetitions: u32,
    /// A configuration renders a frame as often as it takes for one time to be at least so long; 0.001 to 60.
    pub min_sample_s: f64,
    /// Samples per pixel of a timed frame, 1 to 1024.
    pub spp: u32,
    /// Samples per pixel of the pictures that are compared, 1 to 65536.
    pub picture_spp: u32,
    /// Pixels, 16 to 4096; 512, or as in the preset's table, when null.
    pub width: Option<u32>,
    /// Pixels, 16 to 4096; likewise.
    pub height: Option<u32>,
    pub seed: u32,
    /// One device for all configurations; `auto` is a GPU if there is a real one that can walk all of them.
    pub device: DeviceChoice,
    /// Part of the GPU adapter's name, case-insensitive; any adapter when null.
    pub adapter: Option<String>,
}

impl Default for BenchmarkSettings {
    fn default() -> Self {
        Self {
            preset: None,
            scenes: Vec::new(),
            views: Vec::new(),
            effects: Vec::new(),
            configurations: Vec::new(),
            reference: None,
            repetitions: 7,
            min_sample_s: 0.1,
            spp: 1,
            picture_spp: 16,
            width: None,
            height: None,
            seed: 1,
            device: DeviceChoice::Auto,
            adapter: None,
        }
    }
}

/// One of the things that are compared.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Configuration {
    /// 1 to 64 letters, digits, spaces and `.,_+()-`; each different.
    pub name: String,
    #[serde(default)]
    pub acceleration: Acceleration,
}

/// What is rendered. The scene is lit the same for all configurations: see each.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Effect {
    /// Rays of the camera alone.
    Primary {},
    /// Every surface is a mirror, and each hit asks one of the lights, which are points above the scene.
    Whitted {
        /// Longest chain of mirrors, 0 to 64.
        #[serde(default = "ten")]
        reflections: u32,
        /// 1 to 16.
        #[serde(default = "three")]
        lights: u32,
    },
    /// One square light above the scene, for each of whose rays there is one of the camera.
    SoftShadow {
        /// Shadow rays per pixel sample, 1 to 1024.
        #[serde(default = "twenty_five")]
        samples: u32,
    },
    /// Ambient occlusion.
    Ao {
        /// Rays per pixel sample, 1 to 1024.
        #[serde(default = "sixteen")]
        samples: u32,
        /// World units; a tenth of the scene's diagonal when null.
        #[serde(default)]
        distance: Option<f32>,
    },
    /// Light that arrives over so many bounces: paths of that length, with the shadow ray of each vertex.
    Indirect {
        /// 1 to 8.
        #[serde(default = "one")]
        bounces: u32,
    },
    /// Path tracing under the scene's own light.
    Path {
        /// 0 to 64.
        #[serde(default = "four")]
        max_bounces: u32,
    },
}

fn one() -> u32 {
    1
}

fn three() -> u32 {
    3
}

fn four() -> u32 {
    4
}

fn ten() -> u32 {
    10
}

fn sixteen() -> u32 {
    16
}

fn twenty_five() -> u32 {
    25
}

/// Tables of Keul's dissertation (2020, "Efficient ray tracing with line space").
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
pub enum BenchmarkPreset {
    #[serde(rename = "keul-4.1")]
    Keul41,
    #[serde(rename = "keul-4.2")]
    Keul42,
    #[serde(rename = "keul-5.1")]
    Keul51,
    #[serde(rename = "keul-6.1")]
    Keul61,
    #[serde(rename = "keul-7.2")]
    Keul72,
    #[serde(rename = "keul-7.3")]
    Keul73,
    #[serde(rename = "keul-7.4")]
    Keul74,
    #[serde(rename = "keul-8.1")]
    Keul81,
    #[serde(rename = "keul-8.2")]
    Keul82,
    #[serde(rename = "keul-8.3")]
    Keul83,
}

impl BenchmarkPreset {
    pub const ALL: [Self; 10] = [
        Self::Keul41,
        Self::Keul42,
        Self::Keul51,
        Self::Keul61,
        Self::Keul72,
        Self::Keul73,
        Self::Keul74,
        Self::Keul81,
        Self::Keul82,
        Self::Keul83,
    ];

    pub fn as_str(self) -> &'static str {
        match self {
            Self::Keul41 => "keul-4.1",
            Self::Keul42 => "keul-4.2",
            Self::Keul51 => "keul-5.1",
            Self::Keul61 => "keul-6.1",
            Self::Keul72 => "keul-7.2",
            Self::Keul73 => "keul-7.3",
            Self::Keul74 => "keul-7.4",
            Self::Keul81 => "keul-8.1",
            Self::Keul82 => "keul-8.2",
            Self::Keul83 => "keul-8.3",
        }
    }

    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|preset| preset.as_str() == name)
    }
}

impl Effect {
    /// In words, such as `soft shadow, 25 rays`.
    pub fn describe(&self) -> String {
        match self {
            Self::Primary {} => "primary rays".into(),
            Self::Whitted { reflections, lights } => format!("Whitted, {reflections} reflections, {lights} lights"),
            Self::SoftShadow { samples } => format!("soft shadow, {samples} rays"),
            Self::Ao { samples, distance: None } => format!("ambient occlusion, {samples} rays"),
            Self::Ao { samples, distance: Some(reach) } => format!("ambient occlusion, {samples} rays to {reach}"),
            Self::Indirect { bounces } => format!("indirect light, {bounces} bounces"),
            Self::Path { max_bounces } => format!("path tracing, {max_bounces} bounces"),
        }
    }

    fn validate(&self, prefix: &str, errors: &mut Vec<FieldError>) {
        let mut c = Checker { prefix, errors };
        let rays = |samples: u32| (1..=1024).contains(&samples);
        match *self {
            Self::Primary {} => {}
            Self::Whitted { reflections, lights } => {
                c.check(reflections <= 64, "reflections", "must be 0 to 64");
                c.check((1..=16).contains(&lights), "lights", "must be 1 to 16");
            }
            Self::SoftShadow { samples } => c.check(rays(samples), "samples", "must be 1 to 1024"),
            Self::Ao { samples, distance } => {
                c.check(rays(samples), "samples", "must be 1 to 1024");
                let reaches = distance.is_none_or(|distance| distance.is_finite() && distance > 0.0);
                c.check(reaches, "distance", "must be a positive distance in world units, or null");
            }
            Self::Indirect { bounces } => c.check((1..=8).contains(&bounces), "bounces", "must be 1 to 8"),
            Self::Path { max_bounces } => c.check(max_bounces <= 64, "max_bounces", "must be 0 to 64"),
        }
    }
}

impl BenchmarkSettings {
    /// In words, such as `keul-4.1` or `2 effects, 3 configurations`.
    pub fn describe(&self) -> String {
        match self.preset {
            Some(preset) => preset.as_str().to_owned(),
            None => format!("{} effects, {} configurations", self.effects.len(), self.configurations.len()),
        }
    }

    /// Every field that is out of range, with a pointer below `prefix`. What depends on the scenes is not known here.
    pub fn validate(&self, prefix: &str) -> Vec<FieldError> {
        let mut errors = Vec::new();
        let mut c = Checker { prefix, errors: &mut errors };
        let side = |side: Option<u32>| side.is_none_or(|side| (16..=4096).contains(&side));
        c.check(side(self.width), "width", "must be 16 to 4096 pixels, or null");
        c.check(side(self.height), "height", "must be 16 to 4096 pixels, or null");
        c.check((3..=1000).contains(&self.repetitions), "repetitions", "must be 3 to 1000");
        let lasts = self.min_sample_s.is_finite() && (0.001..=60.0).contains(&self.min_sample_s);
        c.check(lasts, "min_sample_s", "must be 0.001 to 60 seconds");
        c.check((1..=1024).contains(&self.spp), "spp", "must be 1 to 1024 samples per pixel");
        c.check((1..=65536).contains(&self.picture_spp), "picture_spp", "must be 1 to 65536 samples per pixel");
        c.check(self.scenes.len() <= MAX_SCENES, "scenes", "must be at most 16 scenes");
        let repeats = |i: usize| self.scenes[..i].contains(&self.scenes[i]);
        c.check(!(0..self.scenes.len()).any(repeats), "scenes", "must not name a scene twice");
        c.check(self.views.len() <= MAX_VIEWS, "views", "must be at most 16 views");
        c.check(
            self.adapter.as_ref().is_none_or(|name| (1..=256).contains(&name.chars().count())),
            "adapter",
            "must have 1 to 256 characters, or be null",
        );
        if self.preset.is_some() {
            let by_preset = "must be left out: the preset gives it";
            c.check(self.effects.is_empty(), "effects", by_preset);
            c.check(self.configurations.is_empty(), "configurations", by_preset);
            c.check(self.reference.is_none(), "reference", by_preset);
        } else {
            c.check((1..=MAX_EFFECTS).contains(&self.effects.len()), "effects", "must be 1 to 16 effects");
            let count = self.configurations.len();
            c.check((1..=MAX_CONFIGURATIONS).contains(&count), "configurations", "must be 1 to 32 configurations");
            let known = |name: &String| self.configurations.iter().any(|c| c.name == *name);
            c.check(self.reference.as_ref().is_none_or(known), "reference", "must be the name of a configuration");
        }
        for (i, view) in self.views.iter().take(MAX_VIEWS).enumerate() {
            if let CameraChoice::Custom(camera) = view {
                camera.validate(&format!("{prefix}/views/{i}"), &mut errors);
            }
        }
        for (i, effect) in self.effects.iter().take(MAX_EFFECTS).enumerate() {
            effect.validate(&format!("{prefix}/effects/{i}"), &mut errors);
        }
        for (i, configuration) in self.configurations.iter().take(MAX_CONFIGURATIONS).enumerate() {
            let at = format!("{prefix}/configurations/{i}");
            let earlier = &self.configurations[..i];
            if !is_name(&configuration.name) {
                let detail = "must have 1 to 64 letters, digits, spaces and .,_+()-";
                errors.push(FieldError::new(format!("{at}/name"), detail));
            } else if earlier.iter().any(|other| file_name(&other.name) == file_name(&configuration.name)) {
                errors.push(FieldError::new(format!("{at}/name"), "must differ from the others by letters or digits"));
            }
            errors.extend(validate_acceleration(&configuration.acceleration, self.device, &at));
        }
        errors
    }
}

/// What is wrong with one configuration on a device, with pointers below `prefix`.
pub fn validate_acceleration(acceleration: &Acceleration, device: DeviceChoice, prefix: &str) -> Vec<FieldError> {
    let render = RenderSettings { acceleration: acceleration.clone(), device, ..RenderSettings::default() };
    render.validate(prefix)
}

/// A name as part of a file's: what is neither letter nor digit is one dash.
pub fn file_name(name: &str) -> String {
    let mut text = String::new();
    for c in name.chars() {
        if c.is_ascii_alphanumeric() {
            text.push(c.to_ascii_lowercase());
        } else if !text.is_empty() && !text.ends_with('-') {
            text.push('-');
        }
    }
    text.trim_end_matches('-').to_owned()
}

fn is_name(name: &str) -> bool {
    let allowed = |c: char| c.is_ascii_alphanumeric() || " .,_+()-".contains(c);
    (1..=64).contains(&name.chars().count()) && name.chars().all(allowed) && !file_name(name).is_empty()
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;

    fn pointers(settings: Value) -> Vec<String> {
        let settings: BenchmarkSettings = serde_json::from_value(settings).unwrap();
        settings.validate("/settings").into_iter().map(|error| error.pointer).collect()
    }

    #[test]
    fn a_preset_alone_and_effects_with_configurations_are_valid() {
        for preset in BenchmarkPreset::ALL {
            let name = preset.as_str();
            assert_eq!(json!(preset), json!(name));
            assert_eq!(BenchmarkPreset::from_name(name), Some(preset));
            assert_eq!(pointers(json!({ "preset": name })), [""; 0]);
        }
        let own = json!({
            "effects": [{ "kind": "primary" }, { "kind": "whitted" }, { "kind": "soft_shadow", "samples": 49 },
                        { "kind": "ao" }, { "kind": "indirect", "bounces": 3 }, { "kind": "path", "max_bounces": 0 }],
            "configurations": [{ "name": "base" }, { "name": "N-tree (6,3)", "acceleration": { "structure": "ntree" } }],
            "reference": "base",
        });
        assert_eq!(pointers(own), [""; 0]);
    }

    #[test]
    fn every_mistake_is_named_at_once() {
        let wrong = json!({
            "scenes": ["a", "a"], "views": [{ "position": [0, 0, 0], "target": [0, 0, 0] }],
            "effects": [{ "kind": "ao", "samples": 0, "distance": -1 }, { "kind": "indirect", "bounces": 9 }],
            "configurations": [{ "name": "a" }, { "name": "A" }, { "name": "?" },
                               { "name": "b", "acceleration": { "structure": "grid", "n": 3 } }],
            "reference": "c", "repetitions": 2, "min_sample_s": 0, "spp": 0, "picture_spp": 0, "width": 8, "height": 5000,
        });
        let expected = [
            "width",
            "height",
            "repetitions",
            "min_sample_s",
            "spp",
            "picture_spp",
            "scenes",
            "reference",
            "views/0/target",
            "effects/0/samples",
            "effects/0/distance",
            "effects/1/bounces",
            "configurations/1/name",
            "configurations/2/name",
            "configurations/3/acceleration/n",
        ];
        assert_eq!(pointers(wrong), expected.map(|field| format!("/settings/{field}")));
        assert_eq!(pointers(json!({})), ["/settings/effects", "/settings/configurations"]);
        let both = json!({ "preset": "keul-4.1", "effects": [{ "kind": "primary" }], "reference": "x" });
        assert_eq!(pointers(both), ["/settings/effects", "/settings/reference"]);
        let on_gpu = json!({ "device": "gpu", "effects": [{ "kind": "primary" }],
            "configurations": [{ "name": "a", "acceleration": { "structure": "ntree" } }] });
        assert_eq!(pointers(on_gpu), [""; 0]);
    }

    #[test]
    fn names_make_file_names() {
        assert_eq!(file_name("LS (9,3)"), "ls-9-3");
        assert_eq!(file_name("-"), "");
    }
}
