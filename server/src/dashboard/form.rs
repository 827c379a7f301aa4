//! Settings of a job as fields with labels, help and units.
//!
//! One description serves the form that submits a job, the page that shows a job's settings, and the test that no
//! setting was forgotten. Each field knows the JSON pointer of the value it stands for; the script builds the request
//! from the pointers and puts the API's complaints beside the field that they point at.

mod acceleration;
mod camera;
pub(super) mod light;
mod policy;

use lightshaft_api::scene::Scene;
use lightshaft_api::settings::{RenderSettings, Split};
use serde::Serialize;

use super::filters::human_words;

/// A group of fields under one heading.
pub(super) struct Section {
    pub(super) title: &'static str,
    pub(super) intro: &'static str,
    pub(super) fields: Vec<Field>,
}

pub(super) struct Field {
    /// HTML id; unique in the form.
    pub(super) id: String,
    /// JSON pointer into the request body.
    pub(super) pointer: String,
    pub(super) label: &'static str,
    pub(super) help: &'static str,
    pub(super) unit: &'static str,
    pub(super) control: Control,
    /// Shown only while the choice field `.0` has the value `.1` (one of several, separated by spaces).
    pub(super) only_if: Option<(String, &'static str)>,
    /// Whether `only_if` holds now.
    pub(super) visible: bool,
}

pub(super) enum Control {
    /// An empty number is left out of the request: the default applies.
    Number {
        value: String,
        min: &'static str,
        max: &'static str,
        whole: bool,
    },
    Text {
        value: String,
        placeholder: &'static str,
    },
    /// Values are JSON, except those that start with `@`: they choose which other fields apply and are not sent.
    Choice {
        options: Vec<ChoiceOption>,
    },
    Switch {
        on: bool,
    },
    /// Any number of values; sent as an array.
    Several {
        options: Vec<ChoiceOption>,
    },
    /// Three numbers.
    Vector {
        values: [String; 3],
        parts: [&'static str; 3],
    },
}

pub(super) struct ChoiceOption {
    pub(super) value: String,
    pub(super) label: String,
    pub(super) selected: bool,
}

impl Field {
    fn new(pointer: &str, label: &'static str, unit: &'static str, help: &'static str, control: Control) -> Self {
        let id = format!("f{}", pointer.replace('/', "-"));
        Self { id, pointer: pointer.to_owned(), label, help, unit, control, only_if: None, visible: true }
    }

    fn when(mut self, field: &str, wanted: &'static str, current: &str) -> Self {
        self.visible = wanted.split(' ').any(|value| value == current);
        self.only_if = Some((format!("f{}", field.replace('/', "-")), wanted));
        self
    }

    /// Choices that are not sent need an id that differs from the fields which are.
    fn named(mut self, id: &str) -> Self {
        self.id = format!("f{}", id.replace('/', "-"));
        self
    }

    /// The value as a person reads it; `None` where a default applies.
    pub(super) fn shown(&self) -> Option<String> {
        let with_unit = |value: &str| match self.unit {
            "" => value.to_owned(),
            unit => format!("{value} {unit}"),
        };
        match &self.control {
            Control::Number { value, .. } | Control::Text { value, .. } if value.is_empty() => None,
            Control::Number { value, .. } | Control::Text { value, .. } => Some(with_unit(value)),
            Control::Choice { options } => options.iter().find(|option| option.selected).map(|o| o.label.clone()),
            Control::Switch { on } => Some(if *on { "yes" } else { "no" }.to_owned()),
            Control::Several { options } => {
                let chosen: Vec<_> = options.iter().filter(|o| o.selected).map(|o| o.label.as_str()).collect();
                Some(if chosen.is_empty() { "none".to_owned() } else { chosen.join(", ") })
            }
            Control::Vector { values, .. } => Some(with_unit(&values.join(", "))),
        }
    }
}

fn number(value: impl ToString, min: &'static str, max: &'static str) -> Control {
    Control::Number { value: value.to_string(), min, max, whole: false }
}

fn whole(value: impl ToString, min: &'static str, max: &'static str) -> Control {
    Control::Number { value: value.to_string(), min, max, whole: true }
}

fn optional<T: ToString>(value: Option<T>, min: &'static str, max: &'static str) -> Control {
    number(value.map(|value| value.to_string()).unwrap_or_default(), min, max)
}

fn vector(values: [f32; 3], parts: [&'static str; 3]) -> Control {
    Control::Vector { values: values.map(|value| value.to_string()), parts }
}

const XYZ: [&str; 3] = ["x", "y", "z"];
const RGB: [&str; 3] = ["red", "green", "blue"];

/// Options of an enum of the API, from its own names, with a label for those whose name does not explain itself.
fn options<T: Serialize>(current: &[T], all: &[&str], labels: &[(&str, &str)]) -> Vec<ChoiceOption> {
    let current: Vec<_> = current.iter().map(name_of).collect();
    all.iter()
        .map(|name| ChoiceOption {
            value: format!("\"{name}\""),
            label: labels
                .iter()
                .find(|(known, _)| known == name)
                .map_or_else(|| human_words(name), |(_, label)| (*label).to_owned()),
            selected: current.iter().any(|value| value == name),
        })
        .collect()
}

/// A choice between the values of an enum, all with labels.
fn choice<T: Serialize>(current: T, all: &[(&str, &str)]) -> Control {
    let names: Vec<&str> = all.iter().map(|(name, _)| *name).collect();
    Control::Choice { options: options(&[current], &names, all) }
}

/// The value of the chosen option; empty when there is none.
fn chosen(options: &[ChoiceOption]) -> String {
    options.iter().find(|option| option.selected).map(|option| option.value.clone()).unwrap_or_default()
}

/// The snake-case name of an enum's value, as in JSON.
pub(super) fn name_of(value: &impl Serialize) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(name)) => name,
        _ => String::new(),
    }
}

/// A choice between forms of a value: `(value, label)`, of which `current` is chosen.
fn modes(current: &str, all: &[(&str, &str)]) -> Control {
    let option = |&(value, label): &(&str, &str)| ChoiceOption {
        value: value.to_owned(),
        label: label.to_owned(),
        selected: value == current,
    };
    Control::Choice { options: all.iter().map(option).collect() }
}

/// All settings, in the order in which people think of them. `scene` gives the cameras to choose from.
pub(super) fn sections(settings: &RenderSettings, scene: Option<&Scene>) -> Vec<Section> {
    vec![
        picture(settings),
        camera::section(settings.camera.as_ref(), scene),
        light::section(settings),
        light::ground(settings.ground.as_ref()),
        output(settings),
        execution(settings),
    ]
}

fn picture(s: &RenderSettings) -> Section {
    let integrator = name_of(&s.integrator);
    let mode = format!("\"{integrator}\"");
    let integrators = [
        ("path", "Path tracing"),
        ("direct", "Direct light"),
        ("whitted", "Whitted"),
        ("ao", "Ambient occlusion"),
        ("aov", "First hit only"),
    ];
    let fields = vec![
        Field::new(
            "/settings/integrator",
            "Integrator",
            "",
            "Path tracing gives full global illumination; Whitted adds mirrors to direct light.",
            choice(s.integrator, &integrators),
        ),
        Field::new("/settings/width", "Width", "px", "", whole(s.width, "1", "16384")),
        Field::new("/settings/height", "Height", "px", "", whole(s.height, "1", "16384")),
        Field::new(
            "/settings/spp",
            "Samples per pixel",
            "",
            "Four times the samples halve the noise.",
            whole(s.spp, "1", "1048576"),
        ),
        Field::new(
            "/settings/max_bounces",
            "Bounces",
            "",
            "Longest path after the first hit, or longest chain of mirrors.",
            whole(s.max_bounces, "0", "64"),
        )
        .when("/settings/integrator", "\"path\" \"whitted\"", &mode),
        Field::new(
            "/settings/ao_samples",
            "Occlusion rays",
            "",
            "Rays per pixel sample.",
            whole(s.ao_samples, "1", "1024"),
        )
        .when("/settings/integrator", "\"ao\"", &mode),
        Field::new(
            "/settings/ao_distance",
            "Occlusion reach",
            "units",
            "How far occluders count. Empty: a tenth of the scene's diagonal.",
            optional(s.ao_distance, "0", ""),
        )
        .when("/settings/integrator", "\"ao\"", &mode),
        Field::new(
            "/settings/seed",
            "Seed",
            "",
            "The same seed gives the same picture, on every device.",
            whole(s.seed, "0", "4294967295"),
        ),
    ];
    Section { title: "Picture", intro: "", fields }
}

fn output(s: &RenderSettings) -> Section {
    let layers = [
        "depth",
        "position",
        "geometric_normal",
        "shading_normal",
        "albedo",
        "instance_id",
        "primitive_id",
        "material_id",
        "box_tests",
        "triangle_tests",
        "line_space_gamma",
        "line_space_answer",
        "line_space_look_ups",
        "line_space_skipped",
    ];
    let tone_maps = [("pbr_neutral", "Khronos PBR Neutral"), ("agx", "AgX"), ("none", "None: clamp to 0..1")];
    let fields = vec![
        Field::new(
            "/settings/outputs",
            "Files",
            "",
            "EXR keeps linear values.",
            Control::Several { options: options(&s.outputs, &["png", "exr"], &[("png", "PNG"), ("exr", "EXR")]) },
        ),
        Field::new("/settings/tone_map", "Tone mapping", "", "Of the PNG.", choice(s.tone_map, &tone_maps)),
        Field::new(
            "/settings/exposure",
            "Exposure",
            "stops",
            "+1 is twice as bright.",
            number(s.exposure, "-32", "32"),
        ),
        Field::new(
            "/settings/aovs",
            "Layers",
            "",
            "For the EXR: of first hits, and what Line Spaces did for the first sample's rays.",
            Control::Several { options: options(&s.aovs, &layers, &[]) },
        ),
    ];
    Section { title: "Output", intro: "", fields }
}

fn execution(s: &RenderSettings) -> Section {
    let devices = [("auto", "Automatic"), ("cpu", "CPU"), ("gpu", "GPU (wgpu)")];
    let (split, tiles, passes) = match s.split {
        None => ("", [2, 2], 2),
        Some(Split::Tiles(tiles)) => ("@tiles", tiles, 2),
        Some(Split::Passes(passes)) => ("@passes", [2, 2], passes),
    };
    let mode = "/split_mode";
    let mut fields = vec![
        Field::new(
            "/settings/device",
            "Device",
            "",
            "Automatic: a GPU where there is a real one.",
            choice(s.device, &devices),
        ),
        Field::new(
            "/settings/adapter",
            "Adapter",
            "",
            "Part of the GPU's name. Empty: any.",
            Control::Text { value: s.adapter.clone().unwrap_or_default(), placeholder: "any" },
        ),
    ];
    fields.extend(acceleration::fields(&s.acceleration));
    fields.extend([
        Field::new(
            "/settings/time_limit_s",
            "Time limit",
            "s",
            "Stops after the pass in which it passes. Empty: none.",
            optional(s.time_limit_s, "0", ""),
        ),
        Field::new(
            "/settings/split",
            "Share among workers",
            "",
            "",
            modes(split, &[("", "One task"), ("@tiles", "By tiles"), ("@passes", "By samples")]),
        )
        .named(mode),
        Field::new("/settings/split/tiles/0", "Columns of tiles", "", "", whole(tiles[0], "1", "64"))
            .when(mode, "@tiles", split),
        Field::new("/settings/split/tiles/1", "Rows of tiles", "", "", whole(tiles[1], "1", "64"))
            .when(mode, "@tiles", split),
        Field::new("/settings/split/passes", "Shares", "", "Equal shares of the samples.", whole(passes, "2", "256"))
            .when(mode, "@passes", split),
    ]);
    Section { title: "Execution", intro: "", fields }
}

/// Settings as label and value, without those that a default decides or that do not apply.
pub(super) fn summary(settings: &RenderSettings, scene: Option<&Scene>) -> Vec<(&'static str, Vec<(String, String)>)> {
    let shown = |fields: &[Field]| -> Vec<(String, String)> {
        fields
            .iter()
            .filter(|field| field.visible)
            .filter_map(|field| Some((field.label.to_owned(), field.shown()?)))
            .collect()
    };
    let mut groups: Vec<_> =
        sections(settings, scene).iter().map(|section| (section.title, shown(&section.fields))).collect();
    for (index, row) in settings.lights.iter().enumerate() {
        let values: Vec<_> =
            shown(&light::fields(&index.to_string(), row)).into_iter().map(|(l, v)| format!("{l}: {v}")).collect();
        groups[2].1.push((format!("Light {}", index + 1), values.join("; ")));
    }
    groups
}
