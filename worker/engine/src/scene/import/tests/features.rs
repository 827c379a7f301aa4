//! Geometry, transforms, cameras and lights.

use std::sync::Arc;

use glam::Vec3;
use serde_json::json;

use super::Draft;
use crate::scene::{Projection, PunctualKind, Scene};

fn corners(scene: &Scene) -> Vec<Vec3> {
    let mesh = &scene.meshes[0];
    mesh.triangles.iter().flatten().map(|vertex| mesh.positions[*vertex as usize]).collect()
}

const TRIANGLE: [Vec3; 3] = [Vec3::ZERO, Vec3::X, Vec3::Y];

#[test]
fn a_triangle_gets_the_default_material_and_no_normals() {
    let scene = Draft::triangle().scene();
    assert_eq!(corners(&scene), TRIANGLE);
    assert!(scene.meshes[0].normals.is_empty());
    assert_eq!(scene.materials.len(), 1);
    assert_eq!((scene.materials[0].metallic, scene.materials[0].roughness), (1.0, 1.0));
    assert_eq!(*scene.instances[0].materials, [0]);
    assert_eq!(scene.warnings, [""; 0]);
}

#[test]
fn without_indices_vertices_come_in_order() {
    let mut draft = Draft::triangle();
    draft.primitive().as_object_mut().unwrap().remove("indices");
    assert_eq!(corners(&draft.scene()), TRIANGLE);
}

#[test]
fn strips_and_fans_become_triangles() {
    for (mode, expected) in [(5, [[0, 1, 2], [1, 3, 2]]), (6, [[0, 1, 2], [0, 2, 3]])] {
        let mut draft = Draft::empty();
        let positions = draft.floats("VEC3", &[0., 0., 0., 1., 0., 0., 0., 1., 0., 1.5, 1., 0.]);
        draft.json["meshes"] = json!([{ "primitives": [{ "attributes": { "POSITION": positions }, "mode": mode }] }]);
        draft.json["nodes"] = json!([{ "mesh": 0 }]);
        draft.json["scenes"][0]["nodes"] = json!([0]);
        assert_eq!(draft.scene().meshes[0].triangles, expected, "mode {mode}");
    }
}

#[test]
fn points_and_lines_are_skipped_with_a_warning() {
    for mode in 0..4 {
        let mut draft = Draft::triangle();
        draft.primitive()["mode"] = json!(mode);
        let scene = draft.scene();
        assert!(scene.meshes.is_empty() && scene.instances.is_empty());
        assert!(scene.warnings[0].starts_with("meshes/0/primitives/0: points and lines"), "{:?}", scene.warnings);
    }
}

#[test]
fn indices_of_8_16_and_32_bits_mean_the_same() {
    let plain = Draft::triangle().scene();
    for (component, bytes) in [(5121, vec![0, 1, 2]), (5125, vec![0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0])] {
        let mut draft = Draft::triangle();
        let indices = draft.accessor("SCALAR", component, 3, &bytes);
        draft.primitive()["indices"] = json!(indices);
        assert_eq!(draft.scene().meshes[0], plain.meshes[0]);
    }
}

#[test]
fn quantized_and_normalized_positions_are_decoded() {
    let cases: [(u32, Vec<u8>, bool, f32); 4] = [
        (5120, vec![0, 0, 0, 127, 0, 0, 0, 0x81, 0], true, 1.0),
        (5121, vec![0, 0, 0, 51, 0, 0, 0, 51, 0], true, 0.2),
        (5122, [0_i16, 0, 0, -300, 0, 0, 0, 7, 0].iter().flat_map(|v| v.to_le_bytes()).collect(), false, -300.0),
        (5123, [0_u16, 0, 0, 65535, 0, 0, 0, 9, 0].iter().flat_map(|v| v.to_le_bytes()).collect(), true, 1.0),
    ];
    for (component, bytes, normalized, x) in cases {
        let mut draft = Draft::triangle();
        let positions = draft.accessor("VEC3", component, 3, &bytes);
        draft.json["accessors"][positions]["normalized"] = json!(normalized);
        draft.primitive()["attributes"]["POSITION"] = json!(positions);
        draft.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
        draft.json["extensionsUsed"] = json!(["KHR_mesh_quantization"]);
        let scene = draft.scene();
        assert!((corners(&scene)[1].x - x).abs() < 1e-6, "{component}: {:?}", corners(&scene));
        assert!(scene.warnings.is_empty());
    }
}

#[test]
fn interleaved_attributes_are_read_by_their_stride() {
    let mut draft = Draft::triangle();
    let mut bytes = Vec::new();
    for position in TRIANGLE {
        for value in position.to_array().into_iter().chain([0.0, 0.0, 1.0]) {
            bytes.extend(value.to_le_bytes());
        }
    }
    let view = draft.view(&bytes);
    draft.json["bufferViews"][view]["byteStride"] = json!(24);
    let mut accessor = |offset: u32| {
        let value =
            json!({ "bufferView": view, "byteOffset": offset, "componentType": 5126, "count": 3, "type": "VEC3" });
        super::push(&mut draft.json["accessors"], value)
    };
    let (positions, normals) = (accessor(0), accessor(12));
    draft.primitive()["attributes"] = json!({ "POSITION": positions, "NORMAL": normals });
    let scene = draft.scene();
    assert_eq!(corners(&scene), TRIANGLE);
    assert_eq!(scene.meshes[0].normals, [Vec3::Z; 3]);
}

#[test]
fn sparse_values_replace_the_base_and_stand_without_one() {
    for with_base in [true, false] {
        let mut draft = Draft::triangle();
        let numbers = draft.view(&[1, 2]);
        let moved: Vec<u8> = [5.0_f32, 0.0, 0.0, 0.0, 6.0, 0.0].iter().flat_map(|value| value.to_le_bytes()).collect();
        let values = draft.view(&moved);
        draft.json["accessors"][0]["sparse"] = json!({
            "count": 2,
            "indices": { "bufferView": numbers, "componentType": 5121 },
            "values": { "bufferView": values },
        });
        if !with_base {
            draft.json["accessors"][0].as_object_mut().unwrap().remove("bufferView");
        }
        assert_eq!(corners(&draft.scene()), [Vec3::ZERO, Vec3::X * 5.0, Vec3::Y * 6.0]);
    }
}

#[test]
fn an_accessor_without_a_buffer_view_is_all_zeros() {
    let mut draft = Draft::triangle();
    let colors = draft.floats("VEC4", &[0.5; 12]);
    draft.json["accessors"][colors].as_object_mut().unwrap().remove("bufferView");
    draft.primitive()["attributes"]["COLOR_0"] = json!(colors);
    assert_eq!(draft.scene().meshes[0].colors, [[0.0; 4]; 3]);
}

#[test]
fn unused_vertices_are_dropped() {
    let mut draft = Draft::triangle();
    let positions = draft.floats("VEC3", &[9., 9., 9., 0., 0., 0., 9., 9., 9., 1., 0., 0., 0., 1., 0.]);
    let indices = draft.indices(&[1, 3, 4]);
    draft.primitive()["attributes"]["POSITION"] = json!(positions);
    draft.primitive()["indices"] = json!(indices);
    let scene = draft.scene();
    assert_eq!(scene.meshes[0], Draft::triangle().scene().meshes[0]);
}

#[test]
fn primitives_merge_into_slots_and_equal_meshes_share_one() {
    let mut draft = Draft::triangle();
    let far = draft.floats("VEC3", &[0., 0., 5., 1., 0., 5., 0., 1., 5.]);
    let first = draft.primitive().clone();
    let second = json!({ "attributes": { "POSITION": far } });
    let mut second_red = second.clone();
    second_red["material"] = json!(0);
    draft.json["materials"] = json!([{ "name": "red" }]);
    draft.json["meshes"] =
        json!([{ "name": "a", "primitives": [first, second] }, { "name": "b", "primitives": [first, second_red] }]);
    draft.json["nodes"] = json!([{ "mesh": 0 }, { "mesh": 1, "translation": [3, 0, 0] }, { "mesh": 1 }]);
    draft.json["scenes"][0]["nodes"] = json!([0, 1, 2]);
    let scene = draft.scene();
    assert_eq!(scene.meshes.len(), 1, "the same content has the same hash");
    let mesh = &scene.meshes[0];
    assert_eq!((mesh.slots, mesh.triangle_slots.as_slice()), (2, [0, 1].as_slice()));
    assert_eq!(mesh.triangles, [[0, 1, 2], [3, 4, 5]]);
    let slots: Vec<&[u32]> = scene.instances.iter().map(|instance| &*instance.materials).collect();
    assert_eq!(slots, [[1, 1], [1, 0], [1, 0]]);
}

#[test]
fn matrices_and_nested_transforms_place_instances() {
    let mut draft = Draft::triangle();
    draft.json["nodes"] = json!([
        { "children": [1], "translation": [10, 0, 0], "rotation": [0, 0, 1, 1] },
        { "children": [2], "scale": [-2, 3, 1] },
        { "mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 1, 0, 0, 1] },
    ]);
    let scene = draft.scene();
    let transform = scene.instances[0].transform;
    // x = 0 moves to 1, is mirrored and stretched to -2, turned to y = -2 and moved by 10.
    assert!(transform.transform_point3(Vec3::ZERO).distance(Vec3::new(10.0, -2.0, 0.0)) < 1e-5);
    assert!(transform.matrix3.determinant() < 0.0, "a mirrored scale stays mirrored");
}

#[test]
fn gpu_instancing_multiplies_a_node() {
    let mut draft = Draft::triangle();
    let translations = draft.floats("VEC3", &[0., 0., 0., 1., 2., 3.]);
    let rotations = draft.accessor("VEC4", 5120, 2, &[0, 0, 0, 127, 0, 127, 0, 0]);
    draft.json["accessors"][rotations]["normalized"] = json!(true);
    draft.json["nodes"][0]["translation"] = json!([0, 0, 100]);
    let attributes = json!({ "TRANSLATION": translations, "ROTATION": rotations, "_ID": translations });
    draft.json["nodes"][0]["extensions"] = json!({ "EXT_mesh_gpu_instancing": { "attributes": attributes } });
    let scene = draft.scene();
    assert_eq!((scene.meshes.len(), scene.instances.len()), (1, 2));
    let moved = scene.instances[1].transform;
    assert!(moved.transform_point3(Vec3::X).distance(Vec3::new(0.0, 2.0, 103.0)) < 1e-5, "{moved}");
    // A million instances of a node with a long name and many slots cost no more than their transforms.
    let [a, b] = scene.instances.as_slice() else { panic!("two") };
    assert!(Arc::ptr_eq(&a.name, &b.name) && Arc::ptr_eq(&a.materials, &b.materials));
}

#[test]
fn names_are_cut_at_a_whole_character() {
    let mut draft = Draft::triangle();
    draft.json["nodes"][0]["name"] = json!("ä".repeat(1000));
    draft.json["meshes"][0]["name"] = json!(format!("x{}", "ä".repeat(1000)));
    let scene = draft.scene();
    assert_eq!(&*scene.instances[0].name, "ä".repeat(128));
    assert_eq!(scene.meshes[0].name.len(), 255);
}

#[test]
fn no_two_cameras_have_the_same_name() {
    let mut draft = Draft::triangle();
    draft.json["cameras"] = json!([{ "type": "perspective", "perspective": { "yfov": 0.8, "znear": 0.1 } }]);
    let camera = |name: &str| json!({ "camera": 0, "name": name });
    let nodes: Vec<_> = ["x", "x", "x (1)", "x", "", "camera 4"].map(camera).into();
    draft.json["scenes"][0]["nodes"] = json!((0..nodes.len()).collect::<Vec<_>>());
    draft.json["nodes"] = json!(nodes);
    let scene = draft.scene();
    let names: Vec<&str> = scene.cameras.iter().map(|camera| camera.name.as_str()).collect();
    assert_eq!(names, ["x", "x (1)", "x (1) (1)", "x (2)", "camera 4", "camera 4 (1)"]);
}

#[test]
fn a_node_without_size_keeps_its_point_light() {
    let mut draft = Draft::triangle();
    draft.json["extensions"] =
        json!({ "KHR_lights_punctual": { "lights": [{ "type": "point" }, { "type": "spot" }] } });
    let light = |index: u32| json!({ "extensions": { "KHR_lights_punctual": { "light": index } } });
    draft.json["nodes"] =
        json!([{ "children": [1, 2], "scale": [0, 0, 0], "translation": [1, 2, 3] }, light(0), light(1)]);
    let scene = draft.scene();
    assert_eq!(scene.lights.len(), 1);
    assert_eq!((scene.lights[0].kind, scene.lights[0].position), (PunctualKind::Point, Vec3::new(1.0, 2.0, 3.0)));
    let told = scene.warnings.iter().any(|warning| warning.starts_with("extensions/KHR_lights_punctual/lights/1: "));
    assert!(told, "{:?}", scene.warnings);
}

#[test]
fn cameras_look_along_their_nodes_minus_z() {
    let mut draft = Draft::triangle();
    draft.json["cameras"] = json!([
        { "name": "eye", "type": "perspective", "perspective": { "yfov": 0.8, "znear": 0.1, "aspectRatio": 1.5 } },
        { "type": "orthographic", "orthographic": { "xmag": 2, "ymag": -3, "znear": 0, "zfar": 9 } },
        { "type": "perspective", "perspective": { "yfov": 4.0, "znear": 0.1 } },
    ]);
    draft.json["nodes"] = json!([
        { "mesh": 0 },
        { "camera": 0, "translation": [1, 2, 3], "rotation": [0, 1, 0, 1], "scale": [5, 5, 5] },
        { "camera": 1, "name": "plan" },
        { "camera": 2 },
    ]);
    draft.json["scenes"][0]["nodes"] = json!([0, 1, 2, 3]);
    let scene = draft.scene();
    assert_eq!(scene.cameras.len(), 2);
    let eye = &scene.cameras[0];
    assert_eq!((eye.name.as_str(), eye.position), ("eye", Vec3::new(1.0, 2.0, 3.0)));
    assert!(eye.forward.distance(Vec3::NEG_X) < 1e-6 && eye.up.distance(Vec3::Y) < 1e-6);
    assert_eq!((eye.projection, eye.frame_aspect), (Projection::Perspective { fov_y_rad: 0.8 }, Some(1.5)));
    assert_eq!(scene.cameras[1].name, "plan");
    assert_eq!(scene.cameras[1].projection, Projection::Orthographic { half_height: 3.0 });
    assert_eq!(scene.cameras[1].frame_aspect, Some(2.0 / 3.0));
    assert!(scene.warnings[0].starts_with("cameras/2/perspective/yfov: 4"), "{:?}", scene.warnings);
}

#[test]
fn punctual_lights_shine_in_world_space() {
    let mut draft = Draft::triangle();
    draft.json["extensionsRequired"] = json!(["KHR_lights_punctual"]);
    draft.json["extensions"] = json!({ "KHR_lights_punctual": { "lights": [
        { "type": "point", "color": [1, 0.5, 0], "intensity": 10, "range": 7 },
        { "type": "spot", "spot": { "innerConeAngle": 0.2 } },
        { "type": "directional" },
        { "type": "area" },
    ] } });
    let light = |index: u32| json!({ "KHR_lights_punctual": { "light": index } });
    draft.json["nodes"] = json!([
        { "extensions": light(0), "translation": [1, 2, 3] },
        { "extensions": light(1), "rotation": [-1, 0, 0, 1] },
        { "extensions": light(2), "name": "sun" },
        { "extensions": light(3) },
    ]);
    draft.json["scenes"][0]["nodes"] = json!([0, 1, 2, 3]);
    let scene = draft.scene();
    let [point, spot, sun] = scene.lights.as_slice() else { panic!("{:?}", scene.lights) };
    assert_eq!((point.position, point.intensity), (Vec3::new(1.0, 2.0, 3.0), Vec3::new(10.0, 5.0, 0.0)));
    assert_eq!((point.range, point.kind), (7.0, PunctualKind::Point));
    assert!(spot.direction.distance(Vec3::NEG_Y) < 1e-6, "{}", spot.direction);
    let outer = std::f32::consts::FRAC_PI_4;
    assert_eq!(spot.kind, PunctualKind::Spot { inner_cone_rad: 0.2, outer_cone_rad: outer });
    assert_eq!((sun.name.as_str(), sun.direction, sun.range), ("sun", Vec3::NEG_Z, f32::INFINITY));
    assert!(scene.warnings.iter().any(|warning| warning.contains("\"area\" is not point")));
}

#[test]
fn spheres_come_with_a_constant_radius_or_one_each() {
    let mut draft = Draft::triangle();
    let radii = draft.floats("SCALAR", &[0.5, 0.0, 2.0]);
    let each = json!({
        "mode": 0, "attributes": { "POSITION": 0, "_RADIUS": radii }, "extensions": { "LIGHTSHAFT_spheres": {} },
    });
    let same = json!({
        "mode": 0, "attributes": { "POSITION": 0 }, "indices": 1,
        "extensions": { "LIGHTSHAFT_spheres": { "radius": 0.25 } },
    });
    draft.json["meshes"][0]["primitives"] = json!([each, same]);
    draft.json["extensionsRequired"] = json!(["LIGHTSHAFT_spheres"]);
    let scene = draft.scene();
    let spheres: Vec<(Vec3, f32, u32)> =
        scene.meshes[0].spheres.iter().map(|sphere| (sphere.center, sphere.radius, sphere.slot)).collect();
    let expected =
        [(Vec3::ZERO, 0.5, 0), (Vec3::Y, 2.0, 0), (Vec3::ZERO, 0.25, 1), (Vec3::X, 0.25, 1), (Vec3::Y, 0.25, 1)];
    assert_eq!(spheres, expected);
    assert_eq!(scene.meshes[0].bounds.max.y, 3.0);
    assert!(scene.warnings[0].contains("1 spheres of radius 0 dropped"));
    draft.json["meshes"][0]["primitives"][1]["extensions"]["LIGHTSHAFT_spheres"] = json!({});
    let at = "meshes/0/primitives/1/extensions/LIGHTSHAFT_spheres";
    draft.refused(crate::scene::ImportErrorKind::Malformed, at, "_RADIUS");
}

#[test]
fn morph_weights_move_vertices() {
    let mut draft = Draft::triangle();
    let deltas = draft.floats("VEC3", &[0., 0., 4., 0., 0., 4., 0., 0., 4.]);
    draft.primitive()["targets"] = json!([{ "POSITION": deltas }]);
    assert_eq!(corners(&draft.scene()), TRIANGLE);
    draft.json["meshes"][0]["weights"] = json!([0.5]);
    assert_eq!(corners(&draft.scene()), TRIANGLE.map(|corner| corner + Vec3::Z * 2.0));
}

#[test]
fn a_skin_follows_its_joints_and_not_its_node() {
    let mut draft = Draft::triangle();
    let joints = draft.accessor("VEC4", 5121, 3, &[0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0]);
    let weights = draft.floats("VEC4", &[1., 0., 0., 0., 1., 0., 0., 0., 0.5, 0.5, 0., 0.]);
    draft.primitive()["attributes"]["JOINTS_0"] = json!(joints);
    draft.primitive()["attributes"]["WEIGHTS_0"] = json!(weights);
    draft.json["skins"] = json!([{ "joints": [1, 2] }]);
    draft.json["nodes"] = json!([
        { "mesh": 0, "skin": 0, "translation": [50, 50, 50] }, {}, { "translation": [0, 0, 2] },
    ]);
    draft.json["scenes"][0]["nodes"] = json!([0, 1, 2]);
    let scene = draft.scene();
    assert_eq!(corners(&scene), [Vec3::ZERO, Vec3::new(1.0, 0.0, 2.0), Vec3::new(0.0, 1.0, 1.0)]);
    assert_eq!(scene.instances[0].transform, glam::Affine3A::IDENTITY);
    assert!(scene.warnings.iter().any(|warning| warning.contains("1 skins")));
}

#[test]
fn the_named_scene_is_shown_and_without_one_all_roots() {
    let mut draft = Draft::triangle();
    draft.json["nodes"] = json!([{ "mesh": 0 }, { "mesh": 0 }, { "mesh": 0 }]);
    draft.json["scenes"] = json!([{ "nodes": [0] }, { "nodes": [1, 2], "name": "second" }]);
    draft.json["scene"] = json!(1);
    let scene = draft.scene();
    assert_eq!((scene.instances.len(), scene.name.as_str()), (2, "second"));
    draft.json.as_object_mut().unwrap().remove("scene");
    assert_eq!(draft.scene().instances.len(), 1);
    draft.json.as_object_mut().unwrap().remove("scenes");
    let scene = draft.scene();
    assert_eq!((scene.instances.len(), scene.name.as_str()), (3, "test"));
}

#[test]
fn the_summary_counts_unique_and_instanced() {
    let mut draft = Draft::triangle();
    draft.json["materials"] = json!([{ "name": "glow", "emissiveFactor": [1, 1, 1] }]);
    draft.primitive()["material"] = json!(0);
    draft.json["nodes"] = json!([{ "mesh": 0 }, { "mesh": 0, "translation": [4, 0, 0] }]);
    draft.json["scenes"][0]["nodes"] = json!([0, 1]);
    let summary = draft.scene().summary();
    assert_eq!((summary.triangles_total, summary.triangles_instanced, summary.emitters), (1, 2, 2));
    assert_eq!(summary.meshes[0].instances, 2);
    assert_eq!((summary.bounds.min, summary.bounds.max), (Vec3::ZERO, Vec3::new(5.0, 1.0, 0.0)));
    assert!(summary.estimated_bytes > 0);
}
