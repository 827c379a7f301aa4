use super::*;
use crate::scene::{Limits, Scene, Source, import};

fn made(kind: &str, params: &Params) -> Scene {
    let file = generate(kind, params).expect(kind);
    let limits = Limits::default();
    let source = Source::from_bytes(&format!("{kind}.glb"), file, &limits).expect(kind);
    import(&source, &limits, &|| false).expect(kind)
}

#[test]
fn every_kind_imports_with_a_camera_called_main() {
    for kind in KINDS {
        let scene = made(kind.name, &Params::default());
        assert!(scene.cameras.iter().any(|camera| camera.name == "main"), "{}", kind.name);
        assert!(!scene.instances.is_empty(), "{}", kind.name);
        assert_eq!(scene.name, kind.name);
        let expected_warnings = usize::from(matches!(kind.name, "soup" | "far-sphere"));
        assert!(scene.warnings.len() <= expected_warnings, "{}: {:?}", kind.name, scene.warnings);
    }
}

#[test]
fn the_same_seed_gives_the_same_file_and_another_seed_another() {
    for kind in KINDS {
        let small = Params {
            seed: 7,
            triangles: (kind.default_triangles > 0).then_some(2_000),
            count: (kind.default_count > 0).then_some(40),
        };
        let file = generate(kind.name, &small).expect(kind.name);
        assert_eq!(file, generate(kind.name, &small).expect(kind.name), "{}", kind.name);
        let is_random =
            matches!(kind.name, "demo" | "soup" | "foliage-cards" | "hairball" | "terrain" | "forest" | "pile");
        let other = generate(kind.name, &Params { seed: 8, ..small }).expect(kind.name);
        assert_eq!(file != other, is_random, "{}", kind.name);
    }
}

#[test]
fn asked_for_amounts_are_met() {
    for (kind, asked) in [("terrain", 100_000), ("hairball", 50_000), ("furnace-sphere", 10_000), ("stadium", 100_000)]
    {
        let scene = made(kind, &Params { triangles: Some(asked), ..Params::default() });
        let triangles = scene.summary().triangles_total;
        let asked = u64::from(asked);
        assert!(triangles > asked * 7 / 10 && triangles < asked * 14 / 10, "{kind}: {triangles} for {asked}");
    }
    for kind in ["forest", "pile"] {
        let scene = made(kind, &Params { count: Some(300), triangles: Some(4_000), ..Params::default() });
        assert_eq!(scene.instances.len(), 301, "{kind}: the objects and the ground");
        assert!(scene.meshes.len() < 8, "{kind}: instances share their meshes");
    }
    let flake = made("sphere-flake", &Params { count: Some(7_381), ..Params::default() });
    assert_eq!(flake.summary().spheres_total, 1 + 9 + 81 + 729 + 6_561);
    let flake = made("sphere-flake", &Params { count: Some(7_380), ..Params::default() });
    assert_eq!(flake.summary().spheres_total, 1 + 9 + 81 + 729);
}

#[test]
fn wrong_parameters_are_refused_by_name() {
    let unknown = generate("teapot", &Params::default()).unwrap_err().to_string();
    assert!(unknown.contains("\"teapot\"") && unknown.contains("sphere-flake"), "{unknown}");
    let none = generate("pile", &Params { count: Some(0), ..Params::default() }).unwrap_err();
    assert_eq!(none, GenerateError::OutOfRange { field: "count", given: 0, most: MOST_OBJECTS });
    let fixed = generate("cornell-box", &Params { triangles: Some(5), ..Params::default() }).unwrap_err();
    assert_eq!(fixed, GenerateError::Fixed { field: "triangles", kind: "cornell-box" });
}

#[test]
fn staircase_depths_are_exact() {
    let scene = made("staircase", &Params { count: Some(5), ..Params::default() });
    let camera = scene.cameras.iter().find(|camera| camera.name == "main").expect("a camera");
    assert_eq!((camera.position.z, camera.forward), (0.0, glam::Vec3::NEG_Z));
    let depths: std::collections::BTreeSet<i32> = scene.meshes[0].positions.iter().map(|p| -p.z as i32).collect();
    assert_eq!(depths.into_iter().collect::<Vec<_>>(), [1, 2, 3, 4, 5, 6]);
}

#[test]
fn soup_loses_its_empty_triangles_and_keeps_its_slivers() {
    let scene = made("soup", &Params { triangles: Some(4_000), ..Params::default() });
    let kept = scene.summary().triangles_total;
    assert!((3_200..3_900).contains(&kept), "{kept}");
    assert!(scene.warnings[0].contains("without area"), "{:?}", scene.warnings);
}
