//! Every way in which a file may lie is refused where it lies, and nothing is allocated on its word.

use serde_json::json;

use super::{Draft, check_refusal, import_bytes};
use crate::scene::ImportErrorKind::{Cancelled, Limit, Malformed, MissingFile, Unsupported};
use crate::scene::{Limits, Source, import};

#[test]
fn truncated_containers() {
    let whole = Draft::triangle().file();
    for length in [4, 11, 12, 19, 20, 100, whole.len() - 4] {
        let error = import_bytes(whole[..length].to_vec(), &Limits::default()).expect_err("a refusal");
        assert_eq!(error.kind, Malformed, "{length}: {error}");
        assert!(error.message.contains("truncated"), "{length}: {error}");
    }
}

#[test]
fn lying_containers() {
    let with = |at: usize, value: u32| {
        let mut file = Draft::triangle().file();
        file[at..at + 4].copy_from_slice(&value.to_le_bytes());
        import_bytes(file, &Limits::default())
    };
    check_refusal(with(4, 1), Unsupported, "", "container version 1");
    check_refusal(with(8, u32::MAX), Malformed, "", "4294967295 bytes long");
    check_refusal(with(12, u32::MAX - 3), Malformed, "", "beyond the end");
    check_refusal(with(16, 0x004E_4942), Malformed, "", "first chunk");
    check_refusal(import_bytes(b"hello, world".to_vec(), &Limits::default()), Malformed, "", "JSON");
    check_refusal(import_bytes(Vec::new(), &Limits::default()), Malformed, "", "JSON");
}

#[test]
fn versions_and_required_extensions() {
    let mut draft = Draft::triangle();
    draft.json["asset"]["version"] = json!("1.0");
    // As glTF 1.0 has it: an object, which would fail to parse if the version did not come first.
    draft.json["meshes"] = json!({ "mesh": {} });
    draft.refused(Unsupported, "asset/version", "glTF version \"1.0\" is not supported");
    let mut draft = Draft::triangle();
    draft.json.as_object_mut().unwrap().remove("asset");
    draft.refused(Malformed, "asset", "is missing");
    let mut draft = Draft::triangle();
    draft.json["asset"]["minVersion"] = json!("2.1");
    draft.refused(Unsupported, "asset/minVersion", "2.1");
    let mut draft = Draft::triangle();
    draft.json["extensionsRequired"] =
        json!(["EXT_meshopt_compression", "KHR_lights_punctual", "KHR_draco_mesh_compression"]);
    draft.refused(
        Unsupported,
        "extensionsRequired",
        "requires EXT_meshopt_compression, KHR_draco_mesh_compression; supported are EXT_mesh_gpu_instancing",
    );
    let mut draft = Draft::triangle();
    draft.json["extensionsUsed"] = json!(["KHR_materials_clearcoat", "KHR_materials_unlit"]);
    let warnings = draft.scene().warnings;
    assert_eq!(warnings, ["extensionsUsed: \"KHR_materials_clearcoat\" is not supported and has no effect"]);
}

#[test]
fn wrong_json_names_its_place() {
    let mut draft = Draft::triangle();
    draft.primitive()["attributes"]["POSITION"] = json!("zero");
    draft.refused(Malformed, "meshes/0/primitives/0/attributes/POSITION", "invalid type");
    let mut draft = Draft::triangle();
    draft.json["accessors"][1]["count"] = json!(-1);
    draft.refused(Malformed, "accessors/1/count", "-1");
    let nested = format!("{}{}", "[".repeat(10_000), "]".repeat(10_000));
    let error = import_bytes(nested.into_bytes(), &Limits::default()).expect_err("a refusal");
    assert_eq!(error.kind, Malformed);
}

#[test]
fn every_reference_out_of_range() {
    type Change = fn(&mut serde_json::Value);
    let cases: [(&str, Change); 18] = [
        ("scene", |json| json["scene"] = json!(1)),
        ("scenes/0/nodes/0", |json| json["scenes"][0]["nodes"] = json!([7])),
        ("nodes/0/children/1", |json| {
            json["nodes"] = json!([{ "children": [1, 2] }, {}]);
        }),
        ("nodes/0/mesh", |json| json["nodes"][0]["mesh"] = json!(1)),
        ("nodes/0/camera", |json| json["nodes"][0]["camera"] = json!(0)),
        ("nodes/0/skin", |json| json["nodes"][0]["skin"] = json!(0)),
        ("nodes/0/extensions/KHR_lights_punctual/light", |json| {
            json["nodes"][0]["extensions"] = json!({ "KHR_lights_punctual": { "light": 0 } });
        }),
        ("nodes/0/extensions/EXT_mesh_gpu_instancing/attributes/SCALE", |json| {
            json["nodes"][0]["extensions"] = json!({ "EXT_mesh_gpu_instancing": { "attributes": { "SCALE": 9 } } });
        }),
        ("meshes/0/primitives/0/attributes/POSITION", |json| {
            json["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = json!(2);
        }),
        ("meshes/0/primitives/0/indices", |json| json["meshes"][0]["primitives"][0]["indices"] = json!(2)),
        ("meshes/0/primitives/0/material", |json| json["meshes"][0]["primitives"][0]["material"] = json!(0)),
        ("meshes/0/primitives/0/targets/0/POSITION", |json| {
            json["meshes"][0]["primitives"][0]["targets"] = json!([{ "POSITION": 2 }]);
        }),
        ("accessors/0/bufferView", |json| json["accessors"][0]["bufferView"] = json!(2)),
        ("bufferViews/1/buffer", |json| json["bufferViews"][1]["buffer"] = json!(1)),
        ("materials/0/normalTexture/index", |json| {
            json["materials"] = json!([{ "normalTexture": { "index": 0 } }]);
        }),
        ("textures/0/source", |json| json["textures"] = json!([{ "source": 0 }])),
        ("images/0/bufferView", |json| json["images"] = json!([{ "bufferView": 5 }])),
        ("skins/0/joints/0", |json| json["skins"] = json!([{ "joints": [3] }])),
    ];
    for (position, change) in cases {
        let mut draft = Draft::triangle();
        change(&mut draft.json);
        draft.refused(Malformed, position, "is out of range");
    }
}

#[test]
fn indices_beyond_the_vertices() {
    let mut draft = Draft::triangle();
    let indices = draft.indices(&[0, 1, 3]);
    draft.primitive()["indices"] = json!(indices);
    let message = "index 3 at place 2 is out of range: POSITION has 3 vertices";
    draft.refused(Malformed, "meshes/0/primitives/0/indices", message);
}

#[test]
fn node_graphs_that_are_no_trees() {
    let mut draft = Draft::triangle();
    draft.json["nodes"] = json!([{ "mesh": 0 }, { "children": [2] }, { "children": [1] }]);
    draft.refused(Malformed, "nodes/1", "is its own ancestor");
    draft.json["nodes"] = json!([{ "children": [0] }]);
    draft.refused(Malformed, "nodes/0", "is its own ancestor");
    draft.json["nodes"] = json!([{ "children": [2] }, { "children": [2] }, {}]);
    draft.refused(Malformed, "nodes/1/children/0", "node 2 is already a child of node 0");
    draft.json["nodes"] = json!([{ "mesh": 0 }, { "children": [0] }]);
    draft.refused(Malformed, "scenes/0/nodes/0", "a scene lists root nodes only");
    draft.json["nodes"] = json!([{ "mesh": 0 }]);
    draft.json["scenes"][0]["nodes"] = json!([0, 0]);
    draft.refused(Malformed, "scenes/0/nodes/1", "listed twice");
}

#[test]
fn a_chain_of_a_hundred_thousand_nodes_is_no_trouble() {
    let mut draft = Draft::triangle();
    let mut nodes: Vec<serde_json::Value> = (1..100_000).map(|next| json!({ "children": [next] })).collect();
    nodes.push(json!({ "mesh": 0 }));
    draft.json["nodes"] = json!(nodes);
    assert_eq!(draft.scene().instances.len(), 1);
    let limits = Limits { nodes: 99_999, ..Limits::default() };
    check_refusal(import_bytes(draft.file(), &limits), Limit, "nodes", "100000 nodes");
}

#[test]
fn positions_that_are_not_finite() {
    for value in [f32::NAN, f32::INFINITY] {
        let mut draft = Draft::triangle();
        let positions = draft.floats("VEC3", &[0., 0., 0., 1., value, 0., 0., 1., 0.]);
        draft.primitive()["attributes"]["POSITION"] = json!(positions);
        draft.refused(Malformed, "meshes/0/primitives/0/attributes/POSITION", "vertex 1 is");
    }
}

#[test]
fn triangles_without_area_and_empty_meshes() {
    let mut draft = Draft::triangle();
    let indices = draft.indices(&[0, 1, 2, 0, 0, 1, 2, 1, 2]);
    draft.primitive()["indices"] = json!(indices);
    let scene = draft.scene();
    assert_eq!(scene.meshes[0].triangles.len(), 1);
    assert_eq!(scene.warnings, ["meshes/0/primitives/0: 2 triangles without area dropped"]);
    let nothing = draft.indices(&[0, 0, 0]);
    draft.primitive()["indices"] = json!(nothing);
    let scene = draft.scene();
    assert!(scene.meshes.is_empty() && scene.instances.is_empty());
    assert!(scene.warnings.iter().any(|warning| warning.starts_with("meshes/0: has no triangles")));
    draft.json["meshes"][0]["primitives"] = json!([]);
    assert!(draft.scene().instances.is_empty());
    let mut empty = Draft::empty();
    empty.json.as_object_mut().unwrap().remove("buffers");
    assert_eq!(empty.scene().warnings, ["the scene shows no mesh"]);
}

#[test]
fn tiny_triangles_have_an_area() {
    let mut draft = Draft::triangle();
    let positions = draft.floats("VEC3", &[0., 0., 0., 1e-25, 0., 0., 0., 1e-25, 0.]);
    draft.primitive()["attributes"]["POSITION"] = json!(positions);
    assert_eq!(draft.scene().meshes[0].triangles.len(), 1);
}

#[test]
fn huge_counts_in_a_small_file() {
    let mut draft = Draft::triangle();
    draft.json["accessors"][1]["count"] = json!(4_000_000_000_u64);
    draft.refused(Malformed, "accessors/1", "do not fit buffer view 1");
    draft.json["accessors"][1]["count"] = json!(u64::MAX);
    draft.refused(Malformed, "accessors/1", "do not fit buffer view 1");
    // Sparse without a base: no buffer stands behind the count, so only the budget can refuse it.
    let mut draft = Draft::triangle();
    let numbers = draft.view(&[0]);
    let values = draft.view(&[0; 12]);
    draft.json["accessors"][0] = json!({
        "componentType": 5126, "count": 4_000_000_000_u64, "type": "VEC3",
        "sparse": {
            "count": 1,
            "indices": { "bufferView": numbers, "componentType": 5121 },
            "values": { "bufferView": values },
        },
    });
    draft.refused(Limit, "accessors/0/count", "bytes of geometry");
}

#[test]
fn buffers_shorter_than_they_say() {
    let mut draft = Draft::triangle();
    draft.json["buffers"][0]["byteLength"] = json!(5_000);
    draft.refused(Malformed, "buffers/0/byteLength", "5000 bytes are declared but the buffer holds");
    let mut draft = Draft::triangle();
    draft.json["bufferViews"][0]["byteLength"] = json!(5_000);
    draft.refused(Malformed, "bufferViews/0", "do not fit buffer 0");
    draft.json["bufferViews"][0]["byteOffset"] = json!(u64::MAX);
    draft.refused(Malformed, "bufferViews/0", "do not fit buffer 0");
    let mut draft = Draft::triangle();
    draft.json["bufferViews"][0]["byteStride"] = json!(8);
    draft.refused(Malformed, "bufferViews/0/byteStride", "8 is less than the 12 bytes");
}

#[test]
fn accessors_of_the_wrong_kind() {
    let mut draft = Draft::triangle();
    draft.json["accessors"][0]["type"] = json!("VEC2");
    draft.refused(Malformed, "meshes/0/primitives/0/attributes/POSITION", "VEC2, but 3 components");
    draft.json["accessors"][0]["type"] = json!("VEC5");
    draft.refused(Malformed, "accessors/0/type", "VEC5");
    let mut draft = Draft::triangle();
    draft.json["accessors"][1]["componentType"] = json!(5122);
    draft.refused(Malformed, "meshes/0/primitives/0/indices", "indices must be SCALAR");
    draft.json["accessors"][1]["componentType"] = json!(7);
    draft.refused(Malformed, "accessors/1/componentType", "7 is not a component type");
    let mut draft = Draft::triangle();
    let short = draft.floats("VEC3", &[0., 0., 1.]);
    draft.primitive()["attributes"]["NORMAL"] = json!(short);
    draft.refused(Malformed, "meshes/0/primitives/0/attributes/NORMAL", "has 1 elements, but POSITION has 3");
    let mut draft = Draft::triangle();
    draft.primitive()["mode"] = json!(7);
    draft.refused(Malformed, "meshes/0/primitives/0/mode", "7 is not a topology");
}

#[test]
fn sparse_indices_that_do_not_increase_or_lie_outside() {
    for numbers in [[1, 1], [2, 1], [1, 3]] {
        let mut draft = Draft::triangle();
        let numbers = draft.view(&numbers);
        let values = draft.view(&[0; 24]);
        draft.json["accessors"][0]["sparse"] = json!({
            "count": 2,
            "indices": { "bufferView": numbers, "componentType": 5121 },
            "values": { "bufferView": values },
        });
        draft.refused(Malformed, "accessors/0/sparse/indices", "must increase strictly");
        draft.json["accessors"][0]["sparse"]["count"] = json!(4);
        draft.refused(Malformed, "accessors/0/sparse/count", "4 values cannot replace");
    }
}

#[test]
fn transforms_that_are_none() {
    let mut draft = Draft::triangle();
    draft.json["nodes"][0]["rotation"] = json!([0, 0, 0, 0]);
    draft.refused(Malformed, "nodes/0/rotation", "not zero");
    draft.json["nodes"][0] = json!({ "mesh": 0, "translation": [1e39, 0, 0] });
    draft.refused(Malformed, "nodes/0", "must be finite");
    draft.json["nodes"][0] = json!({ "mesh": 0, "matrix": [1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1] });
    draft.refused(Malformed, "nodes/0/matrix", "affine");
}

#[test]
fn budgets_hold() {
    let refused = |limits: Limits, position: &str, part: &str| {
        check_refusal(import_bytes(Draft::triangle().file(), &limits), Limit, position, part);
    };
    let part = "meshes/0/primitives/0";
    refused(Limits { triangles: 0, ..Limits::default() }, part, "1 triangles and spheres");
    refused(Limits { geometry_bytes: 100, ..Limits::default() }, part, "bytes of geometry");
    refused(Limits { instances: 0, ..Limits::default() }, "nodes/0", "1 instances");
    let mut draft = Draft::triangle();
    draft.json["materials"] = json!([{}, {}]);
    draft.json["textures"] = json!([{}, {}, {}]);
    draft.json["cameras"] = json!([{}]);
    draft.json["extensions"] = json!({ "KHR_lights_punctual": { "lights": [{ "type": "point" }] } });
    draft.json["nodes"] = json!([{ "camera": 0 }, { "extensions": { "KHR_lights_punctual": { "light": 0 } } }]);
    let refused_too = |limits: Limits, position: &str, part: &str| {
        check_refusal(import_bytes(draft.file(), &limits), Limit, position, part);
    };
    refused_too(Limits { materials: 1, ..Limits::default() }, "materials", "2 materials");
    refused_too(Limits { textures: 2, ..Limits::default() }, "textures", "3 textures");
    refused_too(Limits { cameras: 0, ..Limits::default() }, "nodes", "1 nodes with a camera");
    refused_too(Limits { lights: 0, ..Limits::default() }, "nodes", "1 nodes with a light");
    refused(Limits { input_bytes: 100, ..Limits::default() }, "test.glb", "more than the limit of 100");
}

#[test]
fn buffers_without_data() {
    let mut draft = Draft::triangle();
    draft.json["buffers"] = json!([{ "byteLength": 64 }]);
    let json = draft.json.to_string().into_bytes();
    check_refusal(import_bytes(json, &Limits::default()), MissingFile, "buffers/0", "has no uri");
    draft.json["buffers"] = json!([{ "byteLength": 64, "uri": "geometry.bin" }]);
    draft.refused(MissingFile, "buffers/0/uri", "\"geometry.bin\" did not come with the scene");
    draft.json["buffers"] = json!([{ "byteLength": 64, "uri": "http://example.com/geometry.bin" }]);
    draft.refused(Malformed, "buffers/0/uri", "nothing is downloaded");
}

#[test]
fn cancelling_stops() {
    let limits = Limits::default();
    let source = Source::from_bytes("a.glb", Draft::triangle().file(), &limits).expect("a source");
    let error = import(&source, &limits, &|| true).expect_err("a refusal");
    assert_eq!(error.kind, Cancelled);
}
