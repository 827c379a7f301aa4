//! No bytes make import panic: whole files with a few of them changed, and files cut short.

use image::ExtendedColorType;
use proptest::prelude::*;
use serde_json::json;

use super::{Draft, import_bytes, png};
use crate::scene::Limits;

/// A file that uses most of what import knows.
fn rich() -> Vec<u8> {
    let mut draft = Draft::triangle();
    let normals = draft.floats("VEC3", &[0., 0., 1., 0., 0., 1., 0., 0., 1.]);
    let uvs = draft.floats("VEC2", &[0., 1., 1., 1., 0., 0.]);
    let joints = draft.accessor("VEC4", 5121, 3, &[0; 12]);
    let weights = draft.floats("VEC4", &[1., 0., 0., 0., 1., 0., 0., 0., 1., 0., 0., 0.]);
    let radii = draft.floats("SCALAR", &[0.5, 0.25, 2.0]);
    let places = draft.floats("VEC3", &[0., 0., 0., 1., 2., 3.]);
    let numbers = draft.view(&[1]);
    let moved = draft.view(&[0; 12]);
    let image = draft.view(&png(2, 2, ExtendedColorType::Rgb8, &[9; 12]));
    draft.json["accessors"][normals]["sparse"] = json!({
        "count": 1,
        "indices": { "bufferView": numbers, "componentType": 5121 },
        "values": { "bufferView": moved },
    });
    draft.json["images"] = json!([{ "bufferView": image, "mimeType": "image/png" }]);
    draft.json["textures"] = json!([{ "source": 0 }]);
    draft.json["materials"] = json!([{ "normalTexture": { "index": 0 } }]);
    let attributes = json!({
        "POSITION": 0, "NORMAL": normals, "TEXCOORD_0": uvs, "JOINTS_0": joints, "WEIGHTS_0": weights,
    });
    draft.json["meshes"] = json!([{ "weights": [0.5], "primitives": [
        { "attributes": attributes, "indices": 1, "material": 0, "targets": [{ "POSITION": normals }] },
        { "attributes": { "POSITION": 0 }, "mode": 5 },
        { "attributes": { "POSITION": 0, "_RADIUS": radii }, "mode": 0, "extensions": { "LIGHTSHAFT_spheres": {} } },
    ] }]);
    draft.json["skins"] = json!([{ "joints": [1] }]);
    draft.json["cameras"] = json!([{ "type": "perspective", "perspective": { "yfov": 1, "znear": 1 } }]);
    let instancing = json!({ "EXT_mesh_gpu_instancing": { "attributes": { "TRANSLATION": places } } });
    draft.json["nodes"] =
        json!([{ "mesh": 0, "skin": 0 }, { "camera": 0, "children": [2] }, { "mesh": 0, "extensions": instancing }]);
    draft.json["scenes"] = json!([{ "nodes": [0, 1] }]);
    draft.file()
}

/// Small enough that a mutated count cannot make a test slow.
fn limits() -> Limits {
    Limits { geometry_bytes: 1 << 20, texture_pixels: 1 << 16, ..Limits::default() }
}

#[test]
fn the_unchanged_file_imports() {
    let scene = import_bytes(rich(), &limits()).expect("a scene");
    assert_eq!((scene.instances.len(), scene.cameras.len(), scene.images.len()), (3, 1, 1));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 3_000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn changed_bytes_never_panic(changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8)) {
        let mut file = rich();
        for (place, value) in changes {
            let place = place.index(file.len());
            file[place] = value;
        }
        let _ = import_bytes(file, &limits());
    }

    /// Digits become other digits, so that the JSON stays whole and its numbers lie.
    #[test]
    fn lying_numbers_never_panic(changes in prop::collection::vec((any::<prop::sample::Index>(), b'0'..=b'9'), 1..5)) {
        let mut file = rich();
        let digits: Vec<usize> = (20..file.len()).filter(|at| file[*at].is_ascii_digit()).collect();
        for (place, digit) in changes {
            file[digits[place.index(digits.len())]] = digit;
        }
        let _ = import_bytes(file, &limits());
    }

    /// Words of the binary chunk become special floats and large integers.
    #[test]
    fn extreme_data_never_panics(changes in prop::collection::vec((any::<prop::sample::Index>(), 0..6_usize), 1..5)) {
        const WORDS: [u32; 6] = [0x7FC0_0000, 0x7F80_0000, 0x7F7F_FFFF, 1, u32::MAX, 0x8000_0000];
        let mut file = rich();
        let json_bytes = u32::from_le_bytes([file[12], file[13], file[14], file[15]]) as usize;
        let start = 28 + json_bytes;
        let words = (file.len() - start) / 4;
        for (place, word) in changes {
            let at = start + 4 * place.index(words);
            file[at..at + 4].copy_from_slice(&WORDS[word].to_le_bytes());
        }
        let _ = import_bytes(file, &limits());
    }

    #[test]
    fn cut_files_are_refused(length in any::<prop::sample::Index>()) {
        let file = rich();
        let length = length.index(file.len());
        prop_assert!(import_bytes(file[..length].to_vec(), &limits()).is_err());
    }
}
