//! Suites: what is rendered, and what still passes.

use std::collections::{BTreeMap, BTreeSet};

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use utoipa::ToSchema;

use super::run::SettingsPatch;
use super::text::{check_name, check_text};
use super::tolerance::{ImageTolerance, TimeTolerance};
use crate::problem::{FieldError, escape_pointer};
use crate::read::from_value;
use crate::settings::{CameraChoice, DeviceChoice, Output, RenderSettings};

const MOST_CASES: usize = 1000;
const MOST_REPEATS: u32 = 50;
const DEFAULT_REPEATS: u32 = 3;

/// A suite as it is written, in TOML (one `[[case]]` each) or JSON.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({
    "name": "generated",
    "scenes": { "cornell": { "generate": "cornell-box" } },
    "defaults": { "device": "cpu", "image": "identical", "settings": { "width": 64, "height": 64, "spp": 4 } },
    "case": [
        { "name": "cornell-path", "scene": "cornell" },
        {
            "name": "cornell-ao", "scene": "cornell", "settings": { "integrator": "ao" }, "repeat": 5,
            "image": { "max_flip": 0.01 }, "time": { "max_ratio": 1.2 }
        }
    ]
}))]
pub struct NewSuite {
    /// Baselines and histories belong to the name: versions of a suite share them.
    pub name: String,
    #[serde(default)]
    pub description: String,
    /// Where scenes that cases call by a name come from. For whoever starts runs: the service only knows the names.
    #[serde(default)]
    pub scenes: BTreeMap<String, SceneSource>,
    #[serde(default)]
    pub defaults: CaseDefaults,
    #[serde(default)]
    pub case: Vec<SuiteCase>,
}

/// A file beside the suite, or a scene of the generator.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SceneSource {
    /// Path, relative to the suite's file.
    pub file: Option<String>,
    /// What follows `lightshaft scene generate`: a kind, and options.
    pub generate: Option<String>,
}

/// What cases have that say nothing else.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CaseDefaults {
    pub camera: Option<CameraChoice>,
    /// Settings of a render; a case's own go before.
    pub settings: SettingsPatch,
    pub device: Option<DeviceChoice>,
    pub device_class: Option<String>,
    pub repeat: Option<u32>,
    pub image: Option<ImageTolerance>,
    pub time: Option<TimeTolerance>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct SuiteCase {
    /// Unique in the suite.
    pub name: String,
    /// A name that a run maps to a scene, or a scene's id or hash.
    pub scene: String,
    #[serde(default)]
    pub camera: Option<CameraChoice>,
    /// Settings of a render.
    #[serde(default)]
    pub settings: SettingsPatch,
    #[serde(default)]
    pub device: Option<DeviceChoice>,
    /// What baselines know the device by; when null, its kind and name as the worker reports them.
    #[serde(default)]
    pub device_class: Option<String>,
    /// Repetitions, 1 to 50; when null 3, or 1 where times are off. One more is rendered first, to warm up, unless it is 1.
    #[serde(default)]
    pub repeat: Option<u32>,
    /// `"identical"` when null.
    #[serde(default)]
    pub image: Option<ImageTolerance>,
    /// `{ max_ratio = 1.1, metric = "render_s" }` when null.
    #[serde(default)]
    pub time: Option<TimeTolerance>,
}

/// A case with every default filled in.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SuiteTestCase {
    pub name: String,
    pub scene: String,
    pub settings: RenderSettings,
    pub device_class: Option<String>,
    pub repeat: u32,
    pub image: ImageTolerance,
    pub time: TimeTolerance,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct SuiteSummary {
    pub id: String,
    pub name: String,
    pub description: String,
    /// BLAKE3 of the content: the version.
    pub hash: String,
    pub cases: u32,
    pub created_at: Timestamp,
}

/// A version of a suite.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Suite {
    pub id: String,
    pub name: String,
    pub description: String,
    /// BLAKE3 of the content: the version.
    pub hash: String,
    pub scenes: BTreeMap<String, SceneSource>,
    pub cases: Vec<SuiteTestCase>,
    pub created_at: Timestamp,
}

impl NewSuite {
    /// Reads a suite in TOML.
    ///
    /// # Errors
    /// Where its syntax is wrong (with an empty pointer), or every field that is.
    pub fn from_toml(text: &str) -> Result<Self, Vec<FieldError>> {
        let value: Value = toml::from_str(text).map_err(|error| vec![FieldError::new("", error.to_string())])?;
        from_value(value)
    }

    /// The cases with every default filled in.
    ///
    /// # Errors
    /// Every field that is out of range, unknown, or missing.
    pub fn resolve(&self) -> Result<Vec<SuiteTestCase>, Vec<FieldError>> {
        let mut errors = Vec::new();
        errors.extend(check_name(&self.name, 100, "/name"));
        errors.extend(check_text(&self.description, 4000, "/description"));
        for (name, source) in &self.scenes {
            let pointer = format!("/scenes/{}", escape_pointer(name));
            errors.extend(check_name(name, 100, &pointer));
            if source.file.is_some() == source.generate.is_some() {
                errors.push(FieldError::new(pointer, "must have either `file` or `generate`"));
            }
        }
        if self.case.is_empty() || self.case.len() > MOST_CASES {
            errors.push(FieldError::new("/case", format!("must be 1 to {MOST_CASES} cases")));
        }
        let mut names = BTreeSet::new();
        let mut cases = Vec::with_capacity(self.case.len());
        for (i, case) in self.case.iter().enumerate() {
            let pointer = format!("/case/{i}");
            if !names.insert(&case.name) {
                let detail = format!("`{}` is the name of an earlier case, too", case.name);
                errors.push(FieldError::new(format!("{pointer}/name"), detail));
            }
            cases.extend(self.resolve_case(case, &pointer, &mut errors));
        }
        if errors.is_empty() { Ok(cases) } else { Err(errors) }
    }

    fn resolve_case(&self, case: &SuiteCase, pointer: &str, errors: &mut Vec<FieldError>) -> Option<SuiteTestCase> {
        let before = errors.len();
        errors.extend(check_name(&case.name, 100, &format!("{pointer}/name")));
        errors.extend(check_name(&case.scene, 100, &format!("{pointer}/scene")));
        let time = case.time.clone().or_else(|| self.defaults.time.clone()).unwrap_or_default();
        let unsaid = if time.limit().is_some() { DEFAULT_REPEATS } else { 1 };
        let repeat = case.repeat.or(self.defaults.repeat).unwrap_or(unsaid);
        if !(1..=MOST_REPEATS).contains(&repeat) {
            errors.push(FieldError::new(format!("{pointer}/repeat"), format!("must be 1 to {MOST_REPEATS}")));
        }
        let device_class = case.device_class.clone().or_else(|| self.defaults.device_class.clone());
        if let Some(class) = &device_class {
            errors.extend(check_name(class, 200, &format!("{pointer}/device_class")));
        }
        let image = case.image.clone().or_else(|| self.defaults.image.clone()).unwrap_or(ImageTolerance::IDENTICAL);
        image.validate(&format!("{pointer}/image"), errors);
        if image.z_test().is_some() && repeat < 4 {
            let detail = "must be at least 4 where pictures are judged by a Z-test: it needs their variance";
            errors.push(FieldError::new(format!("{pointer}/repeat"), detail));
        }
        time.validate(&format!("{pointer}/time"), errors);
        let settings = self.settings_of(case, pointer, errors);
        let settings = settings.filter(|_| errors.len() == before)?;
        let has_hdr_limit = image.limits().is_some_and(|limits| limits.max_hdr_flip.is_some());
        if has_hdr_limit && !settings.outputs.contains(&Output::Exr) {
            let detail = "needs `exr` among the outputs: HDR-FLIP is for linear colour";
            errors.push(FieldError::new(format!("{pointer}/image/max_hdr_flip"), detail));
        }
        let (name, scene) = (case.name.clone(), case.scene.clone());
        Some(SuiteTestCase { name, scene, settings, device_class, repeat, image, time })
    }

    fn settings_of(&self, case: &SuiteCase, pointer: &str, errors: &mut Vec<FieldError>) -> Option<RenderSettings> {
        let prefix = format!("{pointer}/settings");
        let mut fields = Map::new();
        for layer in [&self.defaults.settings, &case.settings] {
            layer.apply(&mut fields);
        }
        for (field, own, default) in [
            ("camera", to_value(&case.camera), to_value(&self.defaults.camera)),
            ("device", to_value(&case.device), to_value(&self.defaults.device)),
        ] {
            if let Some(value) = own.or(default) {
                if fields.contains_key(field) {
                    let detail = format!("stands in the settings, too: give `{field}` only once");
                    errors.push(FieldError::new(format!("{pointer}/{field}"), detail));
                }
                fields.insert(field.to_owned(), value);
            }
        }
        match from_value::<RenderSettings>(Value::Object(fields)) {
            Ok(settings) => {
                errors.extend(settings.validate(&prefix));
                if settings.time_limit_s.is_some() {
                    let detail = "must be null: what is compared must have all its samples";
                    errors.push(FieldError::new(format!("{prefix}/time_limit_s"), detail));
                }
                Some(settings)
            }
            Err(wrong) => {
                let below = |error: FieldError| FieldError::new(format!("{prefix}{}", error.pointer), error.detail);
                errors.extend(wrong.into_iter().map(below));
                None
            }
        }
    }

    /// Names of scenes that a run must map: those that cases use, and that are no ids or hashes of their own accord.
    pub fn scene_names(&self) -> BTreeSet<&str> {
        self.case.iter().map(|case| case.scene.as_str()).collect()
    }
}

fn to_value(value: &Option<impl Serialize>) -> Option<Value> {
    value.as_ref().and_then(|value| serde_json::to_value(value).ok())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::farm::{ImageLimits, TimeLimit, TimeMetric};
    use crate::settings::Integrator;

    const SUITE: &str = r#"
        name = "generated"
        [scenes.cornell]
        generate = "cornell-box"
        [defaults]
        device = "cpu"
        time = "off"
        settings = { width = 64, height = 48, spp = 4 }
        [[case]]
        name = "path"
        scene = "cornell"
        [[case]]
        name = "ao"
        scene = "cornell"
        camera = "front"
        settings = { integrator = "ao", spp = 2 }
        repeat = 5
        image = { max_flip = 0.01 }
        time = { max_ratio = 1.5, metric = "total_s" }
    "#;

    fn pointers(text: &str) -> Vec<String> {
        let errors = match NewSuite::from_toml(text) {
            Ok(suite) => suite.resolve().unwrap_err(),
            Err(errors) => errors,
        };
        errors.into_iter().map(|error| error.pointer).collect()
    }

    #[test]
    fn a_case_takes_what_it_does_not_say_from_the_defaults() {
        let suite = NewSuite::from_toml(SUITE).unwrap();
        let cases = suite.resolve().unwrap();
        assert_eq!(cases[0].settings.width, 64);
        assert_eq!((cases[0].settings.device, cases[0].settings.spp), (DeviceChoice::Cpu, 4));
        assert_eq!(
            (cases[0].repeat, &cases[0].image, &cases[0].time),
            (1, &ImageTolerance::IDENTICAL, &TimeTolerance::OFF)
        );
        assert_eq!((cases[1].settings.integrator, cases[1].settings.spp), (Integrator::Ao, 2));
        assert_eq!(cases[1].settings.camera, Some(CameraChoice::Name("front".to_owned())));
        let limits = ImageLimits { max_flip: Some(0.01), ..ImageLimits::default() };
        assert_eq!(cases[1].image, ImageTolerance::Limits(limits));
        assert_eq!(cases[1].time.limit(), Some(&TimeLimit { metric: TimeMetric::TotalS, max_ratio: 1.5 }));
        let text = serde_json::to_string(&suite).unwrap();
        assert_eq!(serde_json::from_str::<NewSuite>(&text).unwrap(), suite);
    }

    #[test]
    fn a_misspelt_field_is_named_with_its_place() {
        let case = "[[case]]\nname = \"a\"\nscene = \"s\"\n";
        assert_eq!(pointers(&format!("nam = \"x\"\n{case}")), ["/nam", "/name"]);
        assert_eq!(pointers(&format!("name = \"x\"\n{case}imag = 1\n")), ["/case/0/imag"]);
        assert_eq!(pointers(&format!("name = \"x\"\n{case}image = \"same\"\n")), ["/case/0/image"]);
        assert_eq!(pointers(&format!("name = \"x\"\n{case}image = {{ max_flop = 1 }}\n")), ["/case/0/image/max_flop"]);
        assert_eq!(pointers(&format!("name = \"x\"\n{case}settings = {{ sppp = 1 }}\n")), ["/case/0/settings/sppp"]);
    }

    #[test]
    fn everything_that_is_out_of_range_is_named_at_once() {
        let wrong = r#"
            name = " "
            [scenes.a]
            [[case]]
            name = "a"
            scene = "a"
            repeat = 0
            device = "cpu"
            settings = { spp = 0, device = "gpu", time_limit_s = 3 }
            time = { max_ratio = 1 }
            [[case]]
            name = "a"
            scene = ""
            image = { max_flip = 2, z_test = { significance = 1 } }
        "#;
        let expected = [
            "/name",
            "/scenes/a",
            "/case/0/repeat",
            "/case/0/time/max_ratio",
            "/case/0/device",
            "/case/0/settings/spp",
            "/case/0/settings/time_limit_s",
            "/case/1/name",
            "/case/1/scene",
            "/case/1/image/max_flip",
            "/case/1/image/z_test/significance",
            "/case/1/repeat",
        ];
        assert_eq!(pointers(wrong), expected);
        assert_eq!(pointers("name = \"x\""), ["/case"]);
    }

    #[test]
    fn broken_toml_is_named_by_its_line() {
        let errors = NewSuite::from_toml("name = \"x\"\n[[case]\n").unwrap_err();
        assert!(errors[0].pointer.is_empty() && errors[0].detail.contains("line 2"), "{errors:?}");
    }
}
