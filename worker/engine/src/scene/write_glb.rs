//! A small writer of .glb files, for generated scenes and for tests: geometry in, valid glTF 2.0 out.

use glam::{Quat, Vec3};
use serde_json::{Map, Value, json};

/// Vertices and triangles of one primitive. `normals`, `uvs` and `colors` are empty or as long as `positions`.
#[derive(Clone, Debug, Default)]
pub(crate) struct Geometry {
    pub(crate) positions: Vec<Vec3>,
    /// Unit vectors.
    pub(crate) normals: Vec<Vec3>,
    pub(crate) uvs: Vec<[f32; 2]>,
    /// Linear RGB.
    pub(crate) colors: Vec<[f32; 3]>,
    pub(crate) triangles: Vec<[u32; 3]>,
}

/// What a primitive of a mesh is made of.
#[derive(Clone, Debug)]
pub(crate) enum Shape {
    Triangles(Geometry),
    /// Centres and radii (extension LIGHTSHAFT_spheres).
    Spheres(Vec<(Vec3, f32)>),
}

/// A material in glTF's terms; textures are numbers given out by [`GlbWriter::texture`].
#[derive(Clone, Debug)]
pub(crate) struct MaterialSpec {
    pub(crate) name: &'static str,
    pub(crate) base_color: [f32; 3],
    pub(crate) base_color_texture: Option<usize>,
    pub(crate) metallic: f32,
    pub(crate) roughness: f32,
    /// Linear colour up to 1; `emissive_strength` multiplies it.
    pub(crate) emissive: [f32; 3],
    pub(crate) emissive_strength: f32,
    /// Alpha below this is a hole.
    pub(crate) alpha_cutoff: Option<f32>,
    pub(crate) double_sided: bool,
}

impl Default for MaterialSpec {
    fn default() -> Self {
        Self {
            name: "material",
            base_color: [0.8; 3],
            base_color_texture: None,
            metallic: 0.0,
            roughness: 1.0,
            emissive: [0.0; 3],
            emissive_strength: 1.0,
            alpha_cutoff: None,
            double_sided: false,
        }
    }
}

/// Where a node is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    pub(crate) translation: Vec3,
    pub(crate) rotation: Quat,
    pub(crate) scale: Vec3,
}

impl Default for Place {
    fn default() -> Self {
        Self { translation: Vec3::ZERO, rotation: Quat::IDENTITY, scale: Vec3::ONE }
    }
}

impl Place {
    pub(crate) fn at(translation: Vec3) -> Self {
        Self { translation, ..Self::default() }
    }
}

/// Collects a scene; [`finish`](Self::finish) makes the file.
#[derive(Debug, Default)]
pub(crate) struct GlbWriter {
    binary: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    meshes: Vec<Value>,
    materials: Vec<Value>,
    images: Vec<Value>,
    textures: Vec<Value>,
    cameras: Vec<Value>,
    lights: Vec<Value>,
    nodes: Vec<Value>,
    extensions: Vec<&'static str>,
}

impl GlbWriter {
    pub(crate) fn new() -> Self {
        Self::default()
    }

    pub(crate) fn material(&mut self, spec: &MaterialSpec) -> usize {
        let [r, g, b] = spec.base_color;
        let mut pbr = json!({
            "baseColorFactor": [r, g, b, 1.0],
            "metallicFactor": spec.metallic,
            "roughnessFactor": spec.roughness,
        });
        if let Some(texture) = spec.base_color_texture {
            pbr["baseColorTexture"] = json!({ "index": texture });
        }
        let mut material = json!({ "name": spec.name, "pbrMetallicRoughness": pbr });
        if spec.emissive != [0.0; 3] {
            material["emissiveFactor"] = json!(spec.emissive);
        }
        if spec.emissive_strength != 1.0 {
            self.use_extension("KHR_materials_emissive_strength");
            let strength = json!({ "emissiveStrength": spec.emissive_strength });
            material["extensions"] = json!({ "KHR_materials_emissive_strength": strength });
        }
        if let Some(cutoff) = spec.alpha_cutoff {
            material["alphaMode"] = json!("MASK");
            material["alphaCutoff"] = json!(cutoff);
        }
        if spec.double_sided {
            material["doubleSided"] = json!(true);
        }
        push(&mut self.materials, material)
    }

    /// A texture of its own for an encoded PNG, repeating and linearly filtered.
    pub(crate) fn texture(&mut self, name: &str, png: &[u8]) -> usize {
        let view = self.view(png, None);
        let image = push(&mut self.images, json!({ "name": name, "mimeType": "image/png", "bufferView": view }));
        push(&mut self.textures, json!({ "source": image }))
    }

    /// A mesh of one or more shapes, each with its material.
    pub(crate) fn mesh(&mut self, name: &str, shapes: &[(Shape, usize)]) -> usize {
        let primitives: Vec<Value> = shapes
            .iter()
            .map(|(shape, material)| match shape {
                Shape::Triangles(geometry) => self.triangles(geometry, *material),
                Shape::Spheres(spheres) => self.spheres(spheres, *material),
            })
            .collect();
        push(&mut self.meshes, json!({ "name": name, "primitives": primitives }))
    }

    pub(crate) fn instance(&mut self, name: &str, mesh: usize, place: Place) {
        self.node(name, place, "mesh", json!(mesh));
    }

    /// A perspective camera at `position` that looks at `target`; +Y is up in the picture.
    pub(crate) fn perspective_camera(&mut self, name: &str, position: Vec3, target: Vec3, fov_y_deg: f32) {
        let camera = json!({
            "name": name, "type": "perspective",
            "perspective": { "yfov": fov_y_deg.to_radians(), "znear": 0.01 },
        });
        let camera = push(&mut self.cameras, camera);
        self.node(name, looking(position, target), "camera", json!(camera));
    }

    /// An orthographic camera; `half_height` in world units.
    pub(crate) fn orthographic_camera(&mut self, name: &str, position: Vec3, target: Vec3, half_height: f32) {
        let camera = json!({
            "name": name, "type": "orthographic",
            "orthographic": { "xmag": half_height, "ymag": half_height, "znear": 0.0, "zfar": 1e4 },
        });
        let camera = push(&mut self.cameras, camera);
        self.node(name, looking(position, target), "camera", json!(camera));
    }

    /// A directional light that shines from `from` towards the origin; `illuminance` in lux.
    pub(crate) fn sun(&mut self, name: &str, from: Vec3, color: [f32; 3], illuminance: f32) {
        self.use_extension("KHR_lights_punctual");
        let light = json!({ "name": name, "type": "directional", "color": color, "intensity": illuminance });
        let light = push(&mut self.lights, light);
        let place = Place { translation: Vec3::ZERO, ..looking(from, Vec3::ZERO) };
        self.node(name, place, "extensions", json!({ "KHR_lights_punctual": { "light": light } }));
    }

    /// The file.
    pub(crate) fn finish(self) -> Vec<u8> {
        let node_numbers: Vec<usize> = (0..self.nodes.len()).collect();
        let mut root = Map::new();
        root.insert("asset".into(), json!({ "version": "2.0", "generator": "Lightshaft scene generator" }));
        root.insert("scene".into(), json!(0));
        root.insert("scenes".into(), json!([{ "nodes": node_numbers }]));
        if !self.binary.is_empty() {
            root.insert("buffers".into(), json!([{ "byteLength": self.binary.len() }]));
        }
        let arrays = [
            ("nodes", self.nodes),
            ("meshes", self.meshes),
            ("materials", self.materials),
            ("textures", self.textures),
            ("images", self.images),
            ("cameras", self.cameras),
            ("accessors", self.accessors),
            ("bufferViews", self.views),
        ];
        for (name, array) in arrays {
            if !array.is_empty() {
                root.insert(name.into(), Value::Array(array));
            }
        }
        if !self.lights.is_empty() {
            root.insert("extensions".into(), json!({ "KHR_lights_punctual": { "lights": self.lights } }));
        }
        if !self.extensions.is_empty() {
            root.insert("extensionsUsed".into(), json!(self.extensions));
        }
        container(&Value::Object(root), &self.binary)
    }

    fn triangles(&mut self, geometry: &Geometry, material: usize) -> Value {
        let mut attributes = Map::new();
        attributes.insert("POSITION".into(), json!(self.positions(&geometry.positions)));
        if !geometry.normals.is_empty() {
            let normals = self.vertices(geometry.normals.iter().map(|normal| normal.to_array()));
            attributes.insert("NORMAL".into(), json!(normals));
        }
        // Without a texture nobody reads them.
        let is_textured = self.materials[material]["pbrMetallicRoughness"].get("baseColorTexture").is_some();
        if is_textured && !geometry.uvs.is_empty() {
            attributes.insert("TEXCOORD_0".into(), json!(self.vertices(geometry.uvs.iter().copied())));
        }
        if !geometry.colors.is_empty() {
            attributes.insert("COLOR_0".into(), json!(self.vertices(geometry.colors.iter().copied())));
        }
        let indices: Vec<u32> = geometry.triangles.iter().flatten().copied().collect();
        // 65535 is the restart value of 16-bit indices and must not occur.
        let (bytes, component): (Vec<u8>, u32) = if geometry.positions.len() < 65_535 {
            (indices.iter().flat_map(|index| (*index as u16).to_le_bytes()).collect(), 5123)
        } else {
            (indices.iter().flat_map(|index| index.to_le_bytes()).collect(), 5125)
        };
        let view = self.view(&bytes, Some(34963));
        let accessor =
            json!({ "bufferView": view, "componentType": component, "count": indices.len(), "type": "SCALAR" });
        let indices = push(&mut self.accessors, accessor);
        json!({ "attributes": attributes, "indices": indices, "material": material })
    }

    fn spheres(&mut self, spheres: &[(Vec3, f32)], material: usize) -> Value {
        self.use_extension("LIGHTSHAFT_spheres");
        let centers: Vec<Vec3> = spheres.iter().map(|(center, _)| *center).collect();
        let position = self.positions(&centers);
        let radius = self.vertices(spheres.iter().map(|(_, radius)| [*radius]));
        json!({
            "mode": 0,
            "attributes": { "POSITION": position, "_RADIUS": radius },
            "material": material,
            "extensions": { "LIGHTSHAFT_spheres": {} },
        })
    }

    /// Positions need their bounds in the accessor (glTF 2.0, 3.7.2.1).
    fn positions(&mut self, positions: &[Vec3]) -> usize {
        let accessor = self.vertices(positions.iter().map(|position| position.to_array()));
        let min = positions.iter().copied().reduce(Vec3::min).unwrap_or(Vec3::ZERO);
        let max = positions.iter().copied().reduce(Vec3::max).unwrap_or(Vec3::ZERO);
        self.accessors[accessor]["min"] = json!(min.to_array());
        self.accessors[accessor]["max"] = json!(max.to_array());
        accessor
    }

    fn vertices<const N: usize>(&mut self, values: impl ExactSizeIterator<Item = [f32; N]>) -> usize {
        let count = values.len();
        let bytes: Vec<u8> = values.flat_map(|value| value.map(f32::to_le_bytes)).flatten().collect();
        let view = self.view(&bytes, Some(34962));
        let shape = ["SCALAR", "VEC2", "VEC3", "VEC4"][N - 1];
        let accessor = json!({ "bufferView": view, "componentType": 5126, "count": count, "type": shape });
        push(&mut self.accessors, accessor)
    }

    fn view(&mut self, bytes: &[u8], target: Option<u32>) -> usize {
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        let mut view = json!({ "buffer": 0, "byteOffset": self.binary.len(), "byteLength": bytes.len() });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.binary.extend_from_slice(bytes);
        push(&mut self.views, view)
    }

    fn node(&mut self, name: &str, place: Place, field: &str, value: Value) {
        let mut node = Map::new();
        node.insert("name".into(), json!(name));
        if place.translation != Vec3::ZERO {
            node.insert("translation".into(), json!(place.translation.to_array()));
        }
        if place.rotation != Quat::IDENTITY {
            node.insert("rotation".into(), json!(place.rotation.normalize().to_array()));
        }
        if place.scale != Vec3::ONE {
            node.insert("scale".into(), json!(place.scale.to_array()));
        }
        node.insert(field.into(), value);
        self.nodes.push(Value::Object(node));
    }

    fn use_extension(&mut self, name: &'static str) {
        if !self.extensions.contains(&name) {
            self.extensions.push(name);
        }
    }
}

/// A .glb of any JSON and binary chunk, valid or not (glTF 2.0, section 4).
pub(super) fn container(json: &Value, binary: &[u8]) -> Vec<u8> {
    let mut json = json.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let padded = binary.len().next_multiple_of(4);
    let binary_bytes = if binary.is_empty() { 0 } else { 8 + padded };
    let total = 12 + 8 + json.len() + binary_bytes;
    let mut file = Vec::with_capacity(total);
    file.extend_from_slice(b"glTF");
    file.extend_from_slice(&2_u32.to_le_bytes());
    file.extend_from_slice(&(total as u32).to_le_bytes());
    file.extend_from_slice(&(json.len() as u32).to_le_bytes());
    file.extend_from_slice(b"JSON");
    file.extend_from_slice(&json);
    if !binary.is_empty() {
        file.extend_from_slice(&(padded as u32).to_le_bytes());
        file.extend_from_slice(b"BIN\0");
        file.extend_from_slice(binary);
        file.resize(total, 0);
    }
    file
}

/// The place from which a node's -Z points at `target`, with +Y as upright as that allows.
fn looking(position: Vec3, target: Vec3) -> Place {
    let back = (position - target).try_normalize().unwrap_or(Vec3::Z);
    let right = Vec3::Y.cross(back).try_normalize().unwrap_or(Vec3::X);
    let up = back.cross(right);
    let rotation = Quat::from_mat3(&glam::Mat3::from_cols(right, up, back));
    Place { translation: position, rotation, scale: Vec3::ONE }
}

fn push(array: &mut Vec<Value>, value: Value) -> usize {
    array.push(value);
    array.len() - 1
}
