//! Layers beside the picture.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::validate::Checker;
use super::{BouncePolicy, DeviceChoice, Integrator, RenderSettings};

/// A layer of the EXR. The first ten tell of the first hit of the ray through the pixel's centre, the others what Line Spaces
/// did for all rays of the pixel's first sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum AovName {
    Depth,
    Position,
    GeometricNormal,
    ShadingNormal,
    Albedo,
    InstanceId,
    PrimitiveId,
    MaterialId,
    BoxTests,
    TriangleTests,
    /// Largest gamma of the usage heuristic among the objects that shadow and ambient-occlusion rays come to: from 1 on their Line
    /// Spaces answer.
    LineSpaceGamma,
    /// The parts of the rays that were answered by approximation (R), by an EMPTY shaft (G) and by an OPAQUE one (B); the
    /// rest by the base structure.
    LineSpaceAnswer,
    /// Shafts that were looked up.
    LineSpaceLookUps,
    /// Meshes and nodes that were passed by, with all below them, because their shaft is empty.
    LineSpaceSkipped,
}

impl AovName {
    fn is_of_line_space(self) -> bool {
        matches!(self, Self::LineSpaceGamma | Self::LineSpaceAnswer | Self::LineSpaceLookUps | Self::LineSpaceSkipped)
    }
}

impl RenderSettings {
    /// Layers that tell of Line Spaces need some that are asked.
    pub(super) fn validate_layers(&self, c: &mut Checker<'_>) {
        let acceleration = &self.acceleration;
        for (i, &layer) in self.aovs.iter().enumerate().filter(|(_, layer)| layer.is_of_line_space()) {
            let field = format!("aovs/{i}");
            if acceleration.line_space.is_none() {
                c.check(false, &field, "tells what Line Spaces did: it needs acceleration.line_space");
                continue;
            }
            c.check(
                self.device != DeviceChoice::Gpu,
                &field,
                "is made by the CPU alone: device cpu, or auto, which takes it for jobs with Line Spaces",
            );
            let is_adaptive = acceleration.policy.bounces().contains(&BouncePolicy::Adaptive);
            c.check(
                layer != AovName::LineSpaceGamma || is_adaptive,
                &field,
                "is computed by the usage heuristic: it needs policy adaptive",
            );
            c.check(
                self.integrator != Integrator::Aov || !acceleration.asks_nodes(),
                &field,
                "would be 0 everywhere: camera rays, the only ones of integrator aov, are exact with this policy",
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use crate::settings::RenderSettings;

    fn wrong(layer: &str, settings: &Value) -> Vec<String> {
        let mut settings = settings.clone();
        settings["aovs"] = json!(["depth", layer]);
        let settings: RenderSettings = serde_json::from_value(settings).unwrap();
        settings.validate("/settings").into_iter().map(|error| format!("{}: {}", error.pointer, error.detail)).collect()
    }

    #[test]
    fn layers_of_line_spaces_need_line_spaces_that_are_asked() {
        let adaptive = json!({ "line_space": { "payload": "binary" }, "policy": "adaptive" });
        let exact = json!({ "line_space": {} });
        let layers = ["line_space_gamma", "line_space_answer", "line_space_look_ups", "line_space_skipped"];
        for layer in layers {
            assert_eq!(wrong(layer, &json!({ "acceleration": adaptive })), [""; 0], "{layer}");
            for (settings, why) in [
                (json!({}), "needs acceleration.line_space"),
                (json!({ "device": "gpu", "acceleration": exact }), "CPU alone"),
                (json!({ "integrator": "aov", "acceleration": adaptive }), "would be 0 everywhere"),
            ] {
                let errors = wrong(layer, &settings);
                let expected = |error: &String| error.starts_with("/settings/aovs/1: ") && error.contains(why);
                assert!(errors.iter().any(expected), "{layer} with {settings}: {errors:?}");
            }
        }
        assert!(wrong("line_space_gamma", &json!({ "acceleration": exact }))[0].contains("policy adaptive"));
        let seen_by_camera = json!({ "integrator": "aov", "acceleration": exact });
        assert_eq!(wrong("line_space_answer", &seen_by_camera), [""; 0]);
        assert_eq!(wrong("box_tests", &json!({})), [""; 0]);
    }
}
