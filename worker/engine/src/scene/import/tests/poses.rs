//! Morph targets, skins and flattening nodes: what they move, and what they may cost.

use glam::{Affine3A, Vec3};
use serde_json::{Value, json};

use super::{Draft, check_refusal, import_bytes};
use crate::scene::ImportErrorKind::{Limit, Malformed};
use crate::scene::{Limits, Scene};

fn corners(scene: &Scene, mesh: usize) -> Vec<Vec3> {
    let mesh = &scene.meshes[mesh];
    mesh.triangles.iter().flatten().map(|vertex| mesh.positions[*vertex as usize]).collect()
}

/// The triangle with a morph target that lifts it by 4.
fn lifted() -> Draft {
    let mut draft = Draft::triangle();
    let deltas = draft.floats("VEC3", &[0., 0., 4., 0., 0., 4., 0., 0., 4.]);
    draft.primitive()["targets"] = json!([{ "POSITION": deltas }]);
    draft
}

fn show(draft: &mut Draft, nodes: Vec<Value>) {
    draft.json["scenes"][0]["nodes"] = json!((0..nodes.len()).collect::<Vec<_>>());
    draft.json["nodes"] = json!(nodes);
}

fn normal_mapped(draft: &mut Draft) {
    let image = super::png(1, 1, image::ExtendedColorType::Rgb8, &[128, 128, 255]);
    let view = draft.view(&image);
    draft.json["images"] = json!([{ "bufferView": view, "mimeType": "image/png" }]);
    draft.json["textures"] = json!([{ "source": 0 }]);
    draft.json["materials"] = json!([{ "normalTexture": { "index": 0 } }]);
    draft.primitive()["material"] = json!(0);
}

#[test]
fn each_pose_of_a_mesh_counts_and_equal_poses_count_once() {
    let mut draft = lifted();
    show(&mut draft, (1..=100).map(|i| json!({ "mesh": 0, "weights": [i] })).collect());
    let limits = |triangles| Limits { triangles, ..Limits::default() };
    let part = "meshes/0/primitives/0";
    check_refusal(import_bytes(draft.file(), &limits(99)), Limit, part, "100 triangles and spheres");
    assert_eq!(import_bytes(draft.file(), &limits(100)).expect("a scene").meshes.len(), 100);
    let limits = Limits { geometry_bytes: 50_000, ..Limits::default() };
    check_refusal(import_bytes(draft.file(), &limits), Limit, part, "bytes of geometry");

    show(&mut draft, (0..100).map(|_| json!({ "mesh": 0, "weights": [0.5] })).collect());
    let scene = import_bytes(draft.file(), &Limits { triangles: 1, ..Limits::default() }).expect("a scene");
    assert_eq!((scene.meshes.len(), scene.instances.len()), (1, 100));
    assert_eq!(corners(&scene, 0)[0], Vec3::Z * 2.0);
}

#[test]
fn empty_primitives_of_many_poses_count_too() {
    let mut draft = lifted();
    let nothing = draft.indices(&[]);
    let mut part = draft.primitive().clone();
    part["indices"] = json!(nothing);
    draft.json["meshes"][0]["primitives"] = json!(vec![part; 1000]);
    show(&mut draft, (1..=1000).map(|i| json!({ "mesh": 0, "weights": [i] })).collect());
    let limits = Limits { geometry_bytes: 100 << 20, ..Limits::default() };
    let error = import_bytes(draft.file(), &limits).expect_err("a refusal");
    assert_eq!(error.kind, Limit, "{error}");
}

#[test]
fn a_long_sparse_accessor_of_matrices_is_read_as_far_as_there_are_joints() {
    let mut draft = Draft::triangle();
    let joints = draft.accessor("VEC4", 5121, 3, &[0; 12]);
    let weights = draft.floats("VEC4", &[1., 0., 0., 0., 1., 0., 0., 0., 1., 0., 0., 0.]);
    draft.primitive()["attributes"]["JOINTS_0"] = json!(joints);
    draft.primitive()["attributes"]["WEIGHTS_0"] = json!(weights);
    let matrix: Vec<u8> = Affine3A::from_translation(Vec3::X * 3.0)
        .to_cols_array()
        .chunks(3)
        .zip([0.0, 0.0, 0.0, 1.0])
        .flat_map(|(column, last)| [column[0], column[1], column[2], last])
        .flat_map(f32::to_le_bytes)
        .collect();
    let numbers = draft.view(&[0]);
    let values = draft.view(&matrix);
    let sparse = json!({
        "componentType": 5126, "count": 134_217_727, "type": "MAT4",
        "sparse": {
            "count": 1,
            "indices": { "bufferView": numbers, "componentType": 5121 },
            "values": { "bufferView": values },
        },
    });
    let accessor = super::push(&mut draft.json["accessors"], sparse);
    draft.json["skins"] = json!([{ "joints": [20], "inverseBindMatrices": accessor }]);
    let mut nodes = vec![json!({ "mesh": 0, "skin": 0 }); 20];
    nodes.push(json!({ "translation": [0, 1, 0] }));
    show(&mut draft, nodes);
    let scene = draft.scene();
    // Twenty nodes, one joint: one mesh, since they all follow it.
    assert_eq!((scene.meshes.len(), scene.instances.len()), (1, 20));
    assert_eq!(corners(&scene, 0)[0], Vec3::new(3.0, 1.0, 0.0));
    draft.json["accessors"][accessor]["count"] = json!(1);
    draft.json["skins"][0]["joints"] = json!([20, 20]);
    draft.refused(Malformed, "skins/0/inverseBindMatrices", "has 1 matrices for 2 joints");
}

#[test]
fn flat_normals_are_those_of_the_pose() {
    // Two primitives; only the second has normals, so the first gets flat ones. It is turned over by its morph target.
    let mut draft = Draft::triangle();
    let up = draft.floats("VEC3", &[0., 0., 0., 0., 0., 0., 0., -2., 0.]);
    let normals = draft.floats("VEC3", &[0., 0., 1., 0., 0., 1., 0., 0., 1.]);
    let plain = draft.primitive().clone();
    let mut turned = plain.clone();
    turned["targets"] = json!([{ "POSITION": up }]);
    let mut smooth = plain;
    smooth["attributes"]["NORMAL"] = json!(normals);
    smooth["targets"] = json!([{}]);
    draft.json["meshes"][0]["primitives"] = json!([turned, smooth]);
    draft.json["meshes"][0]["weights"] = json!([1]);
    let mesh = draft.scene().meshes[0].clone();
    assert_eq!(mesh.normals, [[Vec3::NEG_Z; 3], [Vec3::Z; 3]].concat());
}

#[test]
fn a_triangle_without_area_may_be_opened_by_its_pose() {
    let mut draft = Draft::triangle();
    let closed = draft.floats("VEC3", &[0., 0., 0., 1., 0., 0., 2., 0., 0.]);
    let open = draft.floats("VEC3", &[0., 0., 0., 0., 0., 0., 0., 1., 0.]);
    draft.primitive()["attributes"]["POSITION"] = json!(closed);
    draft.primitive()["targets"] = json!([{ "POSITION": open }]);
    assert!(draft.scene().meshes.is_empty());
    draft.json["meshes"][0]["weights"] = json!([1]);
    assert_eq!(corners(&draft.scene(), 0), [Vec3::ZERO, Vec3::X, Vec3::new(2.0, 1.0, 0.0)]);
}

#[test]
fn morph_targets_move_normals_and_tangents() {
    let mut draft = Draft::triangle();
    let normals = draft.floats("VEC3", &[0., 0., 1., 0., 0., 1., 0., 0., 1.]);
    let tangents = draft.floats("VEC4", &[1., 0., 0., -1., 1., 0., 0., -1., 1., 0., 0., -1.]);
    let normal_deltas = draft.floats("VEC3", &[0., 3., 3., 0., 3., 3., 0., 3., 3.]);
    let tangent_deltas = draft.floats("VEC3", &[-1., 2., 0., -1., 2., 0., -1., 2., 0.]);
    let uvs = draft.floats("VEC2", &[0., 1., 1., 1., 0., 0.]);
    let attributes = json!({ "POSITION": 0, "NORMAL": normals, "TANGENT": tangents, "TEXCOORD_0": uvs });
    draft.primitive()["attributes"] = attributes;
    // Two targets of half the weight each: deltas add up before anything is normalised.
    let target = json!({ "NORMAL": normal_deltas, "TANGENT": tangent_deltas });
    draft.primitive()["targets"] = json!([target, target]);
    draft.json["meshes"][0]["weights"] = json!([0.5, 0.5]);
    let mesh = draft.scene().meshes[0].clone();
    assert!(mesh.normals[0].distance(Vec3::new(0.0, 0.6, 0.8)) < 1e-6, "{}", mesh.normals[0]);
    assert_eq!(mesh.tangents, [[0.0, 1.0, 0.0, -1.0]; 3]);
}

#[test]
fn tangents_are_made_for_the_pose() {
    let mut draft = Draft::triangle();
    let uvs = draft.floats("VEC2", &[0., 1., 1., 1., 0., 0.]);
    draft.primitive()["attributes"]["TEXCOORD_0"] = json!(uvs);
    normal_mapped(&mut draft);
    // The corner in which u grows moves from +X to +Z.
    let deltas = draft.floats("VEC3", &[0., 0., 0., -1., 0., 1., 0., 0., 0.]);
    draft.primitive()["targets"] = json!([{ "POSITION": deltas }]);
    draft.json["meshes"][0]["weights"] = json!([1]);
    let mesh = draft.scene().meshes[0].clone();
    assert_eq!(mesh.normals[0], Vec3::NEG_X);
    let [x, y, z, _] = mesh.tangents[0];
    assert!(Vec3::new(x, y, z).distance(Vec3::Z) < 1e-6, "{:?}", mesh.tangents);
}

#[test]
fn a_scale_of_zero_along_one_axis_flattens_a_mesh() {
    let mut draft = Draft::triangle();
    let slanted = draft.floats("VEC3", &[0., 0., 1., 1., 0., 0., 0., 1., -1.]);
    let normals = draft.floats("VEC3", &[1., 0., 0., 0., 1., 0., 0., 0., 1.]);
    draft.primitive()["attributes"] = json!({ "POSITION": slanted, "NORMAL": normals });
    let flat = json!({ "mesh": 0, "scale": [2, 1, 0], "translation": [0, 0, 5] });
    show(&mut draft, vec![flat, json!({ "mesh": 0 })]);
    let scene = draft.scene();
    assert_eq!(scene.warnings, [""; 0]);
    assert_eq!((scene.meshes.len(), scene.instances.len()), (2, 2));
    assert_eq!(scene.instances[0].transform, Affine3A::IDENTITY);
    let flattened = &scene.meshes[scene.instances[0].mesh as usize];
    assert_eq!(flattened.positions, [Vec3::Z * 5.0, Vec3::new(2.0, 0.0, 5.0), Vec3::new(0.0, 1.0, 5.0)]);
    assert!(flattened.normals.is_empty(), "the plane's normal is the only one left");
    let limits = Limits { triangles: 1, ..Limits::default() };
    check_refusal(import_bytes(draft.file(), &limits), Limit, "meshes/0/primitives/0", "2 triangles");
}

#[test]
fn instances_without_any_area_are_skipped_with_a_warning() {
    for scale in [[1, 0, 0], [0, 0, 0]] {
        let mut draft = Draft::triangle();
        draft.json["nodes"][0]["scale"] = json!(scale);
        let scene = draft.scene();
        assert!(scene.instances.is_empty() && scene.meshes.is_empty());
        assert!(scene.warnings[0].starts_with("nodes/0: 1 instances have a scale of zero"), "{:?}", scene.warnings);
    }
    // Flattened along an axis in which it extends, the triangle becomes a line.
    let mut draft = Draft::triangle();
    draft.json["nodes"][0]["scale"] = json!([1, 0, 1]);
    assert!(draft.scene().meshes.is_empty());
}

#[test]
fn spheres_follow_morph_targets_and_are_no_discs() {
    let mut draft = lifted();
    draft.primitive()["mode"] = json!(0);
    draft.primitive()["extensions"] = json!({ "LIGHTSHAFT_spheres": { "radius": 0.5 } });
    draft.json["meshes"][0]["weights"] = json!([0.5]);
    assert_eq!(draft.scene().meshes[0].spheres[1].center, Vec3::new(1.0, 0.0, 2.0));
    draft.json["nodes"][0]["scale"] = json!([1, 1, 0]);
    let scene = draft.scene();
    assert!(scene.instances.is_empty());
    assert!(scene.warnings.iter().any(|warning| warning.contains("flattens its spheres")), "{:?}", scene.warnings);
}
