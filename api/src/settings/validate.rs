//! Ranges of every setting, all checked at once so that a client learns of every mistake from one answer.

use super::{
    Acceleration, CameraChoice, CustomCamera, Environment, Ground, Light, LightKind, Output, RenderSettings, Split,
    StructureKind,
};
use crate::blob::is_hash;
use crate::problem::FieldError;

/// Pixels of one picture: 8192 x 8192.
const MAX_PIXELS: u64 = 1 << 26;

/// Pixels of all passes of a job together: each pass leaves a whole picture of sums, 24 bytes a pixel, which the service
/// keeps until they are merged, and the merge reads them all.
const MAX_PASS_PIXELS: u64 = 1 << 28;

/// Of a structure of cells: enough for any small scene.
const MIN_BUDGET_BYTES: u64 = 1 << 20;

/// Lights that one job may add.
const MAX_LIGHTS: usize = 1024;

/// Collects what is wrong under one JSON pointer.
pub(super) struct Checker<'a> {
    pub(super) prefix: &'a str,
    pub(super) errors: &'a mut Vec<FieldError>,
}

impl Checker<'_> {
    pub(super) fn check(&mut self, ok: bool, field: &str, detail: &str) {
        if !ok {
            self.errors.push(FieldError::new(format!("{}/{field}", self.prefix), detail));
        }
    }

    fn finite3(&mut self, value: [f32; 3], field: &str) {
        self.check(value.iter().all(|v| v.is_finite()), field, "must be three finite numbers");
    }

    fn radiance(&mut self, value: &[f32], field: &str) {
        self.check(value.iter().all(|v| v.is_finite() && *v >= 0.0), field, "must be finite and not negative");
    }
}

impl RenderSettings {
    /// Every field that is out of range, with a pointer below `prefix` (such as `/settings`). What depends on the
    /// scene (a camera's name, a map's existence) is not known here.
    pub fn validate(&self, prefix: &str) -> Vec<FieldError> {
        let mut errors = Vec::new();
        let mut c = Checker { prefix, errors: &mut errors };
        c.check((1..=16384).contains(&self.width), "width", "must be 1 to 16384 pixels");
        c.check((1..=16384).contains(&self.height), "height", "must be 1 to 16384 pixels");
        let pixels = u64::from(self.width) * u64::from(self.height);
        let sides_fit = self.width <= 16384 && self.height <= 16384;
        c.check(!sides_fit || pixels <= MAX_PIXELS, "height", "width times height must be at most 67108864 pixels");
        c.check((1..=1 << 20).contains(&self.spp), "spp", "must be 1 to 1048576 samples per pixel");
        c.check(self.max_bounces <= 64, "max_bounces", "must be 0 to 64");
        c.check((1..=1024).contains(&self.ao_samples), "ao_samples", "must be 1 to 1024");
        c.check(
            positive_or_none(self.ao_distance),
            "ao_distance",
            "must be a positive distance in world units, or null",
        );
        c.check(
            self.adapter.as_ref().is_none_or(|name| (1..=256).contains(&name.chars().count())),
            "adapter",
            "must have 1 to 256 characters, or be null",
        );
        c.check(self.exposure.is_finite() && self.exposure.abs() <= 32.0, "exposure", "must be -32 to 32 stops");
        c.check(
            self.time_limit_s.is_none_or(|s| s.is_finite() && s > 0.0 && s <= 604_800.0),
            "time_limit_s",
            "must be more than 0 and at most 604800 seconds, or null",
        );
        c.check(!self.outputs.is_empty(), "outputs", "must name at least one of png, exr");
        c.check(
            self.aovs.is_empty() || self.outputs.contains(&Output::Exr),
            "aovs",
            "layers are written to the EXR: add \"exr\" to outputs",
        );
        c.check(no_repeats(&self.outputs), "outputs", "must not name an output twice");
        c.check(no_repeats(&self.aovs), "aovs", "must not name a layer twice");
        c.check(self.lights.len() <= MAX_LIGHTS, "lights", "must be at most 1024 lights");
        self.validate_layers(&mut c);
        self.validate_split(&mut c);
        let of_acceleration = format!("{prefix}/acceleration");
        self.acceleration.validate(&of_acceleration, &mut errors);
        self.acceleration.validate_line_space(self.device, &of_acceleration, &mut errors);
        if let Some(environment) = &self.environment {
            environment.validate(&format!("{prefix}/environment"), &mut errors);
        }
        if let Some(CameraChoice::Custom(camera)) = &self.camera {
            camera.validate(&format!("{prefix}/camera"), &mut errors);
        }
        for (i, light) in self.lights.iter().take(MAX_LIGHTS).enumerate() {
            light.validate(&format!("{prefix}/lights/{i}"), &mut errors);
        }
        if let Some(ground) = &self.ground {
            ground.validate(&format!("{prefix}/ground"), &mut errors);
        }
        errors
    }

    fn validate_split(&self, c: &mut Checker<'_>) {
        match self.split {
            None => {}
            Some(Split::Tiles([columns, rows])) => {
                let in_range = (1..=64).contains(&columns) && (1..=64).contains(&rows);
                c.check(in_range, "split/tiles", "must be 1 to 64 columns and 1 to 64 rows");
                let fits = columns <= self.width && rows <= self.height;
                c.check(!in_range || fits, "split/tiles", "must not be more columns or rows than pixels");
                c.check(
                    self.time_limit_s.is_none(),
                    "time_limit_s",
                    "tiles with a time limit would differ in samples: leave it null, or split by passes",
                );
            }
            Some(Split::Passes(passes)) => {
                let in_range = (2..=256).contains(&passes);
                c.check(in_range, "split/passes", "must be 2 to 256");
                c.check(!in_range || passes <= self.spp, "split/passes", "must not be more than spp");
                let pixels = u64::from(self.width) * u64::from(self.height);
                let most = MAX_PASS_PIXELS / pixels.max(1);
                c.check(
                    !in_range || pixels > MAX_PIXELS || u64::from(passes) <= most,
                    "split/passes",
                    &format!(
                        "must be at most {most} for a picture of this size: passes times pixels at most 268435456"
                    ),
                );
            }
        }
    }
}

impl Acceleration {
    fn validate(&self, prefix: &str, errors: &mut Vec<FieldError>) {
        let mut c = Checker { prefix, errors };
        let mut applies = |is_given: bool, field: &str, to: &[StructureKind], detail: &str| {
            c.check(!is_given || to.contains(&self.structure), field, detail);
        };
        let trees = [StructureKind::NTree, StructureKind::Octree];
        let cells = [StructureKind::NTree, StructureKind::Octree, StructureKind::Grid];
        applies(self.n.is_some(), "n", &[StructureKind::NTree], "applies to structure ntree alone");
        applies(self.depth.is_some(), "depth", &trees, "applies to structures ntree and octree alone");
        applies(self.max_leaf.is_some(), "max_leaf", &trees, "applies to structures ntree and octree alone");
        let of_grids = "applies to structure grid alone";
        applies(self.cells_per_primitive.is_some(), "cells_per_primitive", &[StructureKind::Grid], of_grids);
        applies(self.resolution.is_some(), "resolution", &[StructureKind::Grid], of_grids);
        let of_cells = "applies to structures grid, octree and ntree alone";
        applies(self.budget_bytes.is_some(), "budget_bytes", &cells, of_cells);

        let within = |value: Option<u32>, min: u32, max: u32| value.is_none_or(|value| (min..=max).contains(&value));
        c.check(within(self.n, 2, 16), "n", "must be 2 to 16");
        match self.structure {
            StructureKind::NTree => c.check(within(self.depth, 1, 6), "depth", "must be 1 to 6 for an ntree"),
            StructureKind::Octree => c.check(within(self.depth, 1, 16), "depth", "must be 1 to 16 for an octree"),
            _ => {}
        }
        c.check(within(self.max_leaf, 0, 1024), "max_leaf", "must be 0 to 1024");
        c.check(within(self.cells_per_primitive, 1, 64), "cells_per_primitive", "must be 1 to 64");
        c.check(within(self.resolution, 1, 4096), "resolution", "must be 1 to 4096");
        c.check(
            self.resolution.is_none() || self.cells_per_primitive.is_none(),
            "resolution",
            "a grid has cells_per_primitive or resolution, not both",
        );
        c.check(
            self.budget_bytes.is_none_or(|bytes| bytes >= MIN_BUDGET_BYTES),
            "budget_bytes",
            "must be at least 1048576 (1 MiB)",
        );
    }
}

impl Environment {
    fn validate(&self, prefix: &str, errors: &mut Vec<FieldError>) {
        let not_radiance = "must be finite and not negative";
        match self {
            Self::Grey(value) if !(value.is_finite() && *value >= 0.0) => {
                errors.push(FieldError::new(prefix, not_radiance));
            }
            Self::Color(color) if !color.iter().all(|v| v.is_finite() && *v >= 0.0) => {
                errors.push(FieldError::new(prefix, not_radiance));
            }
            Self::Map(map) => {
                let mut c = Checker { prefix, errors };
                c.check(is_hash(&map.map), "map", "must be the hash of a blob: 64 lower-case hex digits");
                c.radiance(&[map.intensity], "intensity");
                c.check(map.rotation_deg.is_finite(), "rotation_deg", "must be finite");
            }
            _ => {}
        }
    }
}

impl CustomCamera {
    pub(super) fn validate(&self, prefix: &str, errors: &mut Vec<FieldError>) {
        let mut c = Checker { prefix, errors };
        c.finite3(self.position, "position");
        c.finite3(self.target, "target");
        c.finite3(self.up, "up");
        let forward: [f32; 3] = std::array::from_fn(|i| self.target[i] - self.position[i]);
        c.check(length(forward) > 0.0, "target", "must differ from position");
        let sine = length(cross(forward, self.up)) / (length(forward) * length(self.up));
        c.check(length(forward) == 0.0 || sine > 1e-6, "up", "must not be zero, nor parallel to the direction of view");
        c.check(
            self.fov_y_deg.is_none_or(|fov| fov > 0.0 && fov < 180.0),
            "fov_y_deg",
            "must be more than 0 and less than 180 degrees",
        );
        c.check(positive_or_none(self.half_height), "half_height", "must be positive");
        c.check(
            self.fov_y_deg.is_none() || self.half_height.is_none(),
            "half_height",
            "a camera is perspective (fov_y_deg) or orthographic (half_height), not both",
        );
    }
}

impl Light {
    fn validate(&self, prefix: &str, errors: &mut Vec<FieldError>) {
        let mut c = Checker { prefix, errors };
        c.radiance(&self.color, "color");
        c.radiance(&[self.intensity], "intensity");
        c.check(positive_or_none(self.range), "range", "must be positive");
        if let Some(position) = self.position {
            c.finite3(position, "position");
        }
        if let Some(direction) = self.direction {
            c.finite3(direction, "direction");
            c.check(length(direction) > 0.0, "direction", "must not be zero");
        }
        let placed = matches!(self.kind, LightKind::Point | LightKind::Spot);
        c.check(!placed || self.position.is_some(), "position", "is required for point and spot lights");
        let directed = matches!(self.kind, LightKind::Directional | LightKind::Spot);
        c.check(!directed || self.direction.is_some(), "direction", "is required for directional and spot lights");
        let inner = self.inner_cone_deg.unwrap_or(0.0);
        let outer = self.outer_cone_deg.unwrap_or(45.0);
        c.check((0.0..=90.0).contains(&inner), "inner_cone_deg", "must be 0 to 90 degrees");
        c.check(outer > 0.0 && outer <= 90.0, "outer_cone_deg", "must be more than 0 and at most 90 degrees");
        c.check(inner.is_nan() || inner < outer, "inner_cone_deg", "must be less than outer_cone_deg (45 by default)");
    }
}

impl Ground {
    fn validate(&self, prefix: &str, errors: &mut Vec<FieldError>) {
        let mut c = Checker { prefix, errors };
        c.check(self.height.is_none_or(f32::is_finite), "height", "must be finite");
        c.check(positive_or_none(self.half_size), "half_size", "must be positive");
        c.check(self.albedo.iter().all(|v| (0.0..=1.0).contains(v)), "albedo", "must be three numbers from 0 to 1");
        c.check((0.0..=1.0).contains(&self.roughness), "roughness", "must be 0 to 1");
    }
}

fn positive_or_none(value: Option<f32>) -> bool {
    value.is_none_or(|v| v.is_finite() && v > 0.0)
}

fn no_repeats<T: PartialEq>(values: &[T]) -> bool {
    values.iter().enumerate().all(|(i, value)| !values[..i].contains(value))
}

fn length(v: [f32; 3]) -> f64 {
    v.iter().map(|&x| f64::from(x) * f64::from(x)).sum::<f64>().sqrt()
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn pointers(settings: serde_json::Value) -> Vec<String> {
        let settings: RenderSettings = serde_json::from_value(settings).unwrap();
        settings.validate("/settings").into_iter().map(|error| error.pointer).collect()
    }

    #[test]
    fn the_defaults_are_valid() {
        assert_eq!(RenderSettings::default().validate("/settings"), []);
    }

    #[test]
    fn every_field_out_of_range_is_named_at_once() {
        let wrong = pointers(json!({
            "width": 0, "height": 20000, "spp": 0, "max_bounces": 65, "ao_samples": 0, "ao_distance": -1.0,
            "exposure": 33, "time_limit_s": 0, "outputs": [], "aovs": ["depth", "depth"], "adapter": "",
        }));
        let expected = [
            "width",
            "height",
            "spp",
            "max_bounces",
            "ao_samples",
            "ao_distance",
            "adapter",
            "exposure",
            "time_limit_s",
            "outputs",
            "aovs",
            "aovs",
        ];
        assert_eq!(wrong, expected.map(|field| format!("/settings/{field}")));
    }

    #[test]
    fn numbers_too_large_for_a_float_are_refused() {
        assert_eq!(pointers(json!({ "environment": 1e39 })), ["/settings/environment"]);
        assert_eq!(pointers(json!({ "environment": [0, 1e39, 0] })), ["/settings/environment"]);
        let camera = json!({ "camera": { "position": [1e39, 0, 0], "target": [0, 0, 0] } });
        assert!(pointers(camera).contains(&"/settings/camera/position".to_owned()));
    }

    #[test]
    fn lights_need_what_their_kind_needs() {
        let lights = json!({ "lights": [
            { "kind": "point" },
            { "kind": "directional" },
            { "kind": "spot", "position": [0, 1, 0], "direction": [0, 0, 0] },
            { "kind": "spot", "position": [0, 1, 0], "direction": [0, -1, 0], "inner_cone_deg": 50 },
        ] });
        assert_eq!(
            pointers(lights),
            [
                "/settings/lights/0/position",
                "/settings/lights/1/direction",
                "/settings/lights/2/direction",
                "/settings/lights/3/inner_cone_deg",
            ]
        );
    }

    #[test]
    fn a_camera_must_look_somewhere_and_have_an_up() {
        let at = |target, up| json!({ "camera": { "position": [0, 0, 0], "target": target, "up": up } });
        assert_eq!(pointers(at([0, 0, 0], [0, 1, 0])), ["/settings/camera/target"]);
        assert_eq!(pointers(at([0, 2, 0], [0, 1, 0])), ["/settings/camera/up"]);
        assert_eq!(pointers(at([0, 0, 1], [0, 0, 0])), ["/settings/camera/up"]);
        assert_eq!(pointers(at([0, 0, 1], [0, 1, 0])), [""; 0]);
    }

    #[test]
    fn structures_take_their_own_parameters_alone() {
        let wrong = |acceleration| pointers(json!({ "acceleration": acceleration }));
        let field = |name: &str| format!("/settings/acceleration/{name}");
        assert_eq!(wrong(json!({ "structure": "ntree", "n": 16, "depth": 6, "max_leaf": 0 })), [""; 0]);
        assert_eq!(wrong(json!({ "structure": "octree", "depth": 16, "budget_bytes": 1 << 20 })), [""; 0]);
        assert_eq!(wrong(json!({ "structure": "grid", "resolution": 4096 })), [""; 0]);
        assert_eq!(wrong(json!({ "structure": "bvh", "quality": "high", "spatial_splits": true })), [""; 0]);
        assert_eq!(wrong(json!({ "structure": "ntree", "n": 17, "depth": 7 })), [field("n"), field("depth")]);
        assert_eq!(wrong(json!({ "structure": "octree", "n": 4 })), [field("n")]);
        let both = json!({ "structure": "grid", "resolution": 8, "cells_per_primitive": 65 });
        assert_eq!(wrong(both), [field("cells_per_primitive"), field("resolution")]);
        let on_gpu = |structure: &str| json!({ "device": "gpu", "acceleration": { "structure": structure } });
        assert!(["two_level", "bvh", "grid", "octree", "ntree"].map(|s| pointers(on_gpu(s))).concat().is_empty());
        let misplaced = json!({ "max_leaf": 4, "resolution": 8, "budget_bytes": 5 });
        let fields = ["max_leaf", "resolution", "budget_bytes", "budget_bytes"];
        assert_eq!(wrong(misplaced), fields.map(field));
    }

    #[test]
    fn splits_fit_the_picture() {
        assert_eq!(pointers(json!({ "split": { "tiles": [65, 1] } })), ["/settings/split/tiles"]);
        assert_eq!(pointers(json!({ "width": 3, "split": { "tiles": [4, 1] } })), ["/settings/split/tiles"]);
        assert_eq!(pointers(json!({ "spp": 4, "split": { "passes": 5 } })), ["/settings/split/passes"]);
        assert_eq!(pointers(json!({ "spp": 4, "split": { "passes": 4 } })), [""; 0]);
        let passes = |passes: u32| json!({ "width": 8192, "height": 8192, "spp": 256, "split": { "passes": passes } });
        assert_eq!(pointers(passes(4)), [""; 0]);
        assert_eq!(pointers(passes(5)), ["/settings/split/passes"], "each leaves 1.5 GiB of sums");
        let tiles = json!({ "width": 8192, "height": 8192, "split": { "tiles": [64, 64] } });
        assert_eq!(pointers(tiles), [""; 0], "tiles together are one picture");
    }

    #[test]
    fn a_picture_has_at_most_64_mebipixels() {
        assert_eq!(pointers(json!({ "width": 16384, "height": 8192 })), ["/settings/height"]);
        assert_eq!(pointers(json!({ "width": 16384, "height": 4096 })), [""; 0]);
    }
}
