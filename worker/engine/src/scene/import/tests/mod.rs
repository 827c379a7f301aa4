//! Import, feature by feature and fault by fault, over small files built here.

mod bad_input;
mod features;
mod files;
mod fuzz;
mod poses;
mod shading;

use serde_json::{Value, json};

use crate::scene::write_glb::container;
use crate::scene::{ImportError, ImportErrorKind, Limits, Scene, Source, import};

/// A glTF document under construction: JSON that tests may bend, and its binary chunk.
struct Draft {
    json: Value,
    binary: Vec<u8>,
}

impl Draft {
    /// A document without any geometry.
    fn empty() -> Self {
        let json = json!({
            "asset": { "version": "2.0" },
            "scene": 0, "scenes": [{ "nodes": [] }], "nodes": [], "meshes": [],
            "accessors": [], "bufferViews": [], "buffers": [{ "byteLength": 0 }],
        });
        Self { json, binary: Vec::new() }
    }

    /// One right triangle in the plane z = 0, indexed, in one node.
    fn triangle() -> Self {
        let mut draft = Self::empty();
        let positions = draft.floats("VEC3", &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        let indices = draft.indices(&[0, 1, 2]);
        draft.json["meshes"] =
            json!([{ "primitives": [{ "attributes": { "POSITION": positions }, "indices": indices }] }]);
        draft.json["nodes"] = json!([{ "mesh": 0 }]);
        draft.json["scenes"][0]["nodes"] = json!([0]);
        draft
    }

    fn view(&mut self, bytes: &[u8]) -> usize {
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        let view = json!({ "buffer": 0, "byteOffset": self.binary.len(), "byteLength": bytes.len() });
        self.binary.extend_from_slice(bytes);
        self.json["buffers"][0]["byteLength"] = json!(self.binary.len());
        push(&mut self.json["bufferViews"], view)
    }

    fn accessor(&mut self, shape: &str, component: u32, count: usize, bytes: &[u8]) -> usize {
        let view = self.view(bytes);
        let accessor = json!({ "bufferView": view, "componentType": component, "count": count, "type": shape });
        push(&mut self.json["accessors"], accessor)
    }

    fn floats(&mut self, shape: &str, values: &[f32]) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        let components = match shape {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            _ => 16,
        };
        self.accessor(shape, 5126, values.len() / components, &bytes)
    }

    fn indices(&mut self, values: &[u16]) -> usize {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.accessor("SCALAR", 5123, values.len(), &bytes)
    }

    fn primitive(&mut self) -> &mut Value {
        &mut self.json["meshes"][0]["primitives"][0]
    }

    fn file(&self) -> Vec<u8> {
        container(&self.json, &self.binary)
    }

    fn import(&self) -> Result<Scene, ImportError> {
        import_bytes(self.file(), &Limits::default())
    }

    #[track_caller]
    fn scene(&self) -> Scene {
        self.import().expect("a scene")
    }

    /// Asserts a refusal at `position` whose message holds `part`.
    #[track_caller]
    fn refused(&self, kind: ImportErrorKind, position: &str, part: &str) {
        check_refusal(self.import(), kind, position, part);
    }
}

fn push(array: &mut Value, value: Value) -> usize {
    let array = array.as_array_mut().expect("an array");
    array.push(value);
    array.len() - 1
}

fn import_bytes(bytes: Vec<u8>, limits: &Limits) -> Result<Scene, ImportError> {
    import(&Source::from_bytes("test.glb", bytes, limits)?, limits, &|| false)
}

#[track_caller]
fn check_refusal(result: Result<Scene, ImportError>, kind: ImportErrorKind, position: &str, part: &str) {
    let error = result.expect_err("a refusal");
    assert_eq!((error.kind, error.position.as_str()), (kind, position), "{error}");
    assert!(error.message.contains(part), "{error}");
}

/// A PNG of the given pixels.
fn png(width: u32, height: u32, color: image::ExtendedColorType, pixels: &[u8]) -> Vec<u8> {
    use image::ImageEncoder as _;
    let mut file = Vec::new();
    image::codecs::png::PngEncoder::new(&mut file).write_image(pixels, width, height, color).expect("a PNG");
    file
}
