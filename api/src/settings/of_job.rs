//! Settings of a job of any kind.

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

use super::{Acceleration, BenchmarkSettings, DeviceChoice, Environment, RenderSettings, validate_acceleration};
use crate::compare::CompareRequest;
use crate::job::JobKind;
use crate::problem::FieldError;

/// Settings of a render, a benchmark, a build or a comparison, as the job's `kind` says.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[serde(untagged)]
pub enum JobSettings {
    Render(Box<RenderSettings>),
    Benchmark(Box<BenchmarkSettings>),
    Build(Box<BuildSettings>),
    /// Pictures are artifacts of jobs or blobs. The service fills in each picture's `blob`.
    Compare(Box<CompareRequest>),
}

/// Makes the structures of a scene's meshes, so that later jobs find them ready.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct BuildSettings {
    pub acceleration: Acceleration,
}

impl Default for JobSettings {
    fn default() -> Self {
        Self::Render(Box::default())
    }
}

impl From<RenderSettings> for JobSettings {
    fn from(settings: RenderSettings) -> Self {
        Self::Render(Box::new(settings))
    }
}

impl JobSettings {
    pub fn kind(&self) -> JobKind {
        match self {
            Self::Render(_) => JobKind::Render,
            Self::Benchmark(_) => JobKind::Benchmark,
            Self::Build(_) => JobKind::Build,
            Self::Compare(_) => JobKind::Compare,
        }
    }

    /// Those of a kind, every one left to its default.
    pub fn default_of(kind: JobKind) -> Self {
        match kind {
            JobKind::Render => Self::default(),
            JobKind::Benchmark => Self::Benchmark(Box::default()),
            JobKind::Build => Self::Build(Box::default()),
            JobKind::Compare => Self::Compare(Box::default()),
        }
    }

    /// Reads settings of a kind; each field keeps its place in an error of `serde_path_to_error`.
    ///
    /// # Errors
    /// Those of the deserializer.
    pub fn read<'de, D: Deserializer<'de>>(kind: JobKind, deserializer: D) -> Result<Self, D::Error> {
        Ok(match kind {
            JobKind::Render => Self::Render(Deserialize::deserialize(deserializer)?),
            JobKind::Benchmark => Self::Benchmark(Deserialize::deserialize(deserializer)?),
            JobKind::Build => Self::Build(Deserialize::deserialize(deserializer)?),
            JobKind::Compare => Self::Compare(Deserialize::deserialize(deserializer)?),
        })
    }

    /// Every field that is out of range, with pointers below `prefix`.
    pub fn validate(&self, prefix: &str) -> Vec<FieldError> {
        match self {
            Self::Render(settings) => settings.validate(prefix),
            Self::Benchmark(settings) => settings.validate(prefix),
            Self::Build(settings) => validate_acceleration(&settings.acceleration, DeviceChoice::Auto, prefix),
            Self::Compare(request) => request.validate(prefix),
        }
    }

    /// The device that they demand.
    pub fn device(&self) -> DeviceChoice {
        match self {
            Self::Render(settings) => settings.device,
            Self::Benchmark(settings) => settings.device,
            Self::Build(_) | Self::Compare(_) => DeviceChoice::Auto,
        }
    }

    /// Part of the GPU's name.
    pub fn adapter(&self) -> Option<&str> {
        match self {
            Self::Render(settings) => settings.adapter.as_deref(),
            Self::Benchmark(settings) => settings.adapter.as_deref(),
            Self::Build(_) | Self::Compare(_) => None,
        }
    }

    /// Ids of scenes beside the job's own.
    pub fn further_scenes(&self) -> &[String] {
        match self {
            Self::Benchmark(settings) => &settings.scenes,
            Self::Render(_) | Self::Build(_) | Self::Compare(_) => &[],
        }
    }

    /// Blobs that they name.
    pub fn blobs(&self) -> Vec<&str> {
        match self {
            Self::Render(settings) => match &settings.environment {
                Some(Environment::Map(map)) => vec![&map.map],
                _ => Vec::new(),
            },
            Self::Compare(request) => {
                [&request.a, &request.b].into_iter().filter_map(|one| one.blob.as_deref()).collect()
            }
            Self::Benchmark(_) | Self::Build(_) => Vec::new(),
        }
    }
}

impl<'de> Deserialize<'de> for JobSettings {
    /// As the service writes them: with every field, by which the kinds differ. What people write is read with its kind.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = Value::deserialize(deserializer)?;
        let has = |field: &str| value.get(field).is_some();
        let kind = if has("repetitions") {
            JobKind::Benchmark
        } else if has("a") && has("b") {
            JobKind::Compare
        } else if has("integrator") || !has("acceleration") {
            JobKind::Render
        } else {
            JobKind::Build
        };
        Self::read(kind, value).map_err(D::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_of_every_kind_come_back_as_they_were_written() {
        for kind in JobKind::ALL {
            let settings = JobSettings::default_of(kind);
            assert_eq!(settings.kind(), kind);
            let text = serde_json::to_string(&settings).unwrap();
            assert_eq!(serde_json::from_str::<JobSettings>(&text).unwrap(), settings);
        }
    }
}
