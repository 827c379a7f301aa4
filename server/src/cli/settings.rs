//! Options that describe a picture, the same for `render` and `job submit`.
//!
//! They are put together as JSON and read as the API reads it, so a wrong value gets the message that the API would give.
//! Later wins: `--settings FILE`, then the single options, then `--setting KEY=VALUE`.

use std::path::PathBuf;

use lightshaft_api::job::{JobKind, NewJob};
use lightshaft_api::settings::{JobSettings, RenderSettings};
use serde_json::{Map, Value, json};

use super::error::{CliError, Result};

#[derive(Debug, Default, clap::Args)]
#[command(next_help_heading = "Picture")]
pub(crate) struct SettingsArgs {
    /// A JSON file of settings as the API takes them.
    #[arg(long, value_name = "FILE")]
    settings: Option<PathBuf>,
    /// One setting by its name, dots for fields within, such as `ground.height=-1` or `outputs=["exr"]`.
    #[arg(long = "setting", value_name = "KEY=VALUE")]
    setting: Vec<String>,
    /// aov, ao, direct, whitted or path.
    #[arg(long)]
    integrator: Option<String>,
    /// Pixels.
    #[arg(long)]
    width: Option<u32>,
    /// Pixels.
    #[arg(long)]
    height: Option<u32>,
    /// Samples per pixel.
    #[arg(long)]
    spp: Option<u32>,
    #[arg(long)]
    seed: Option<u32>,
    /// Longest path after the first hit.
    #[arg(long)]
    max_bounces: Option<u32>,
    /// Rays of ambient occlusion per sample.
    #[arg(long)]
    ao_samples: Option<u32>,
    /// Reach of ambient occlusion, world units.
    #[arg(long)]
    ao_distance: Option<f32>,
    /// auto, cpu or gpu.
    #[arg(long)]
    device: Option<String>,
    /// Part of the GPU's name.
    #[arg(long)]
    adapter: Option<String>,
    /// A camera by name or number, or a JSON object with position and target.
    #[arg(long, value_name = "NAME|INDEX|JSON", allow_hyphen_values = true)]
    camera: Option<String>,
    /// A grey radiance, a colour `r,g,b`, or an equirectangular .hdr or .exr.
    #[arg(long, value_name = "C|R,G,B|FILE")]
    environment: Option<String>,
    /// Structure, Line Space and policy with their parameters.
    #[arg(long, value_name = "JSON")]
    acceleration: Option<String>,
    /// Payload of a Line Space for each mesh: tri_state, binary, candidate or coverage; or a JSON object with its parameters.
    #[arg(long, value_name = "PAYLOAD|JSON")]
    line_space: Option<String>,
    /// pbr_neutral, agx or none.
    #[arg(long)]
    tone_map: Option<String>,
    /// Stops.
    #[arg(long, allow_hyphen_values = true)]
    exposure: Option<f32>,
    /// Layers for the EXR, such as depth,albedo,line_space_answer.
    #[arg(long, value_delimiter = ',', value_name = "NAME,…")]
    aovs: Vec<String>,
    /// Stop after so many seconds with the samples there are.
    #[arg(long, value_name = "SECONDS")]
    time_limit_s: Option<f64>,
}

/// Settings, and the file of the environment map if they need one that has no hash yet.
#[derive(Debug)]
pub(crate) struct Chosen {
    json: Map<String, Value>,
    pub(crate) environment_file: Option<PathBuf>,
}

impl SettingsArgs {
    pub(crate) fn read(&self) -> Result<Chosen> {
        let mut json = match &self.settings {
            None => Map::new(),
            Some(path) => {
                let text = std::fs::read_to_string(path)
                    .map_err(|error| CliError::usage(format!("--settings {}: {error}", path.display())))?;
                serde_json::from_str(&text).map_err(|error| {
                    CliError::usage(format!("--settings {}: not a JSON object of settings: {error}", path.display()))
                })?
            }
        };
        self.put_options(&mut json)?;
        let environment_file = self.put_environment(&mut json)?;
        for assignment in &self.setting {
            put_setting("--setting", &mut json, assignment)?;
        }
        Ok(Chosen { json, environment_file })
    }

    fn put_options(&self, json: &mut Map<String, Value>) -> Result<()> {
        let mut put = |name: &str, value: Option<Value>| {
            if let Some(value) = value {
                json.insert(name.to_owned(), value);
            }
        };
        let text = |value: &Option<String>| value.clone().map(Value::from);
        put("integrator", text(&self.integrator));
        put("width", self.width.map(Value::from));
        put("height", self.height.map(Value::from));
        put("spp", self.spp.map(Value::from));
        put("seed", self.seed.map(Value::from));
        put("max_bounces", self.max_bounces.map(Value::from));
        put("ao_samples", self.ao_samples.map(Value::from));
        put("ao_distance", self.ao_distance.map(Value::from));
        put("device", text(&self.device));
        put("adapter", text(&self.adapter));
        put("tone_map", text(&self.tone_map));
        put("exposure", self.exposure.map(Value::from));
        put("time_limit_s", self.time_limit_s.map(Value::from));
        put("aovs", (!self.aovs.is_empty()).then(|| json!(self.aovs)));
        put("camera", self.camera.as_deref().map(camera).transpose()?);
        put("acceleration", self.acceleration.as_deref().map(|text| parse("--acceleration", text)).transpose()?);
        if let Some(text) = &self.line_space {
            let line_space = line_space(text)?;
            let acceleration = json.entry("acceleration").or_insert_with(|| json!({}));
            let Some(acceleration) = acceleration.as_object_mut() else {
                return Err(CliError::usage("--line-space: acceleration is no object"));
            };
            acceleration.insert("line_space".to_owned(), line_space);
        }
        Ok(())
    }

    fn put_environment(&self, json: &mut Map<String, Value>) -> Result<Option<PathBuf>> {
        let Some(text) = &self.environment else { return Ok(None) };
        if let Ok(grey) = text.parse::<f32>() {
            json.insert("environment".into(), json!(grey));
            return Ok(None);
        }
        let color: std::result::Result<Vec<f32>, _> =
            text.trim_matches(['[', ']']).split(',').map(|part| part.trim().parse()).collect();
        if let Ok(color) = color {
            json.insert("environment".into(), json!(color));
            return Ok(None);
        }
        let path = PathBuf::from(text);
        if path.is_file() {
            return Ok(Some(path));
        }
        Err(CliError::usage(format!("--environment {text}: neither a number, nor a colour r,g,b, nor a file")))
    }
}

impl Chosen {
    pub(crate) fn set(&mut self, name: &str, value: Value) {
        self.json.insert(name.to_owned(), value);
    }

    /// Whether the settings name it already.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.json.contains_key(name)
    }

    /// Puts the map in by its hash.
    pub(crate) fn set_environment_map(&mut self, hash: &str) {
        self.set("environment", json!({ "map": hash }));
    }

    /// Settings of a kind.
    ///
    /// # Errors
    /// Names every field that is wrong.
    pub(crate) fn finish_as(self, kind: JobKind) -> Result<JobSettings> {
        if kind == JobKind::Render {
            return self.finish().map(JobSettings::from);
        }
        // Read as a job's, so that a mistake gets the message that the service would give.
        let job = json!({ "kind": kind, "scene": "", "settings": self.json });
        let errors = match lightshaft_api::read::from_value::<NewJob>(job) {
            Ok(job) => match job.settings.validate("/settings") {
                errors if errors.is_empty() => return Ok(job.settings),
                errors => errors,
            },
            Err(errors) => errors,
        };
        Err(CliError::fields(&errors, "/settings/"))
    }

    /// Settings of a picture.
    ///
    /// # Errors
    /// Names every field that is wrong.
    pub(crate) fn finish(self) -> Result<RenderSettings> {
        let errors = match lightshaft_api::read::from_value::<RenderSettings>(Value::Object(self.json)) {
            Err(errors) => errors,
            Ok(settings) => {
                let errors = settings.validate("");
                if errors.is_empty() {
                    return Ok(settings);
                }
                errors
            }
        };
        Err(CliError::fields(&errors, "/"))
    }
}

fn camera(text: &str) -> Result<Value> {
    if text.trim_start().starts_with('{') {
        return parse("--camera", text);
    }
    Ok(text.parse::<u32>().map_or_else(|_| Value::from(text), Value::from))
}

fn line_space(text: &str) -> Result<Value> {
    if text.trim_start().starts_with('{') { parse("--line-space", text) } else { Ok(json!({ "payload": text })) }
}

fn parse(option: &str, text: &str) -> Result<Value> {
    serde_json::from_str(text).map_err(|error| CliError::usage(format!("{option}: not JSON: {error}")))
}

/// `a.b=value`; a value that is not JSON is taken as text.
pub(crate) fn put_setting(option: &str, json: &mut Map<String, Value>, assignment: &str) -> Result<()> {
    let (key, value) = assignment
        .split_once('=')
        .ok_or_else(|| CliError::usage(format!("{option} {assignment}: expected KEY=VALUE")))?;
    let value = serde_json::from_str(value).unwrap_or_else(|_| Value::from(value));
    let mut path: Vec<&str> = key.split('.').collect();
    let last = path.pop().unwrap_or_default();
    let mut object = json;
    for part in path {
        let entry = object.entry(part).or_insert_with(|| json!({}));
        if !entry.is_object() {
            *entry = json!({});
        }
        match entry.as_object_mut() {
            Some(inner) => object = inner,
            None => return Err(CliError::usage(format!("{option} {assignment}: {part} is no object"))),
        }
    }
    object.insert(last.to_owned(), value);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;
    use lightshaft_api::settings::{BuildQuality, CameraChoice, Environment, Integrator, LineSpacePayload, Split};

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        settings: SettingsArgs,
    }

    fn read(line: &str) -> Result<Chosen> {
        Line::try_parse_from(format!("x {line}").split_whitespace()).unwrap().settings.read()
    }

    fn settings(line: &str) -> RenderSettings {
        read(line).unwrap().finish().unwrap()
    }

    fn error(line: &str) -> String {
        let error = read(line).and_then(Chosen::finish).unwrap_err();
        assert_eq!(error.code(), 2);
        format!("{error:?}")
    }

    #[test]
    fn options_become_settings_and_the_rest_keeps_its_default() {
        let s = settings("--width 64 --spp 3 --integrator ao --aovs depth,albedo --exposure -1.5");
        assert_eq!((s.width, s.height, s.spp, s.integrator), (64, 480, 3, Integrator::Ao));
        assert_eq!((s.aovs.len(), s.exposure), (2, -1.5));
    }

    #[test]
    fn cameras_and_environments_take_several_forms() {
        assert_eq!(settings("--camera 2").camera, Some(CameraChoice::Index(2)));
        assert_eq!(settings("--camera left").camera, Some(CameraChoice::Name("left".into())));
        let custom = settings(r#"--camera {"position":[0,0,5],"target":[0,0,0]}"#).camera;
        assert!(matches!(custom, Some(CameraChoice::Custom(_))));
        assert_eq!(settings("--environment 0.5").environment, Some(Environment::Grey(0.5)));
        assert_eq!(settings("--environment 1,0.5,0").environment, Some(Environment::Color([1.0, 0.5, 0.0])));
        assert!(error("--environment no-such.hdr").contains("no-such.hdr"));
    }

    #[test]
    fn single_settings_reach_into_objects() {
        let s = settings(
            "--width 1 --setting width=32 --setting ground.height=-1 --setting tone_map=agx \
                          --setting split.tiles=[2,2]",
        );
        assert_eq!(s.width, 32);
        assert_eq!(s.ground.unwrap().height, Some(-1.0));
        assert_eq!(s.split, Some(Split::Tiles([2, 2])));
    }

    #[test]
    fn a_line_space_is_a_payload_or_an_object_and_goes_with_the_structure() {
        let chosen = settings(r#"--line-space binary --acceleration {"quality":"high"}"#).acceleration;
        assert_eq!(chosen.quality, BuildQuality::High);
        assert_eq!(chosen.line_space.unwrap().payload, LineSpacePayload::Binary);
        assert_eq!(settings(r#"--line-space {"n":8}"#).acceleration.line_space.unwrap().n, Some(8));
        assert!(error("--line-space soup").contains("soup"));
        let representative = r#"--line-space candidate --acceleration {"policy":"representative"} --device gpu"#;
        assert!(error(representative).contains("must be null on device gpu"));
    }

    #[test]
    fn wrong_settings_are_named() {
        assert!(error("--setting widht=3").contains("widht"));
        let two = error("--aovs depth,magic --integrator magic");
        assert!(two.contains("aovs/1: unknown variant `magic`") && two.contains("integrator: "), "{two}");
        assert!(error("--width 0").contains("width"));
        assert!(error("--setting width").contains("KEY=VALUE"));
        assert!(error("--acceleration {").contains("--acceleration"));
    }
}
