//! Materials, textures, and what shading needs of vertices.

use glam::Vec3;
use image::ExtendedColorType;
use serde_json::json;

use super::{Draft, png};
use crate::scene::{AlphaMode, Filter, ImportErrorKind, Limits, Wrap};

/// A triangle whose material shows `image` as its base colour and normal map.
fn textured(image: &[u8], mime: &str) -> Draft {
    let mut draft = Draft::triangle();
    let view = draft.view(image);
    let uvs = draft.floats("VEC2", &[0., 1., 1., 1., 0., 0.]);
    draft.primitive()["attributes"]["TEXCOORD_0"] = json!(uvs);
    draft.primitive()["material"] = json!(0);
    draft.json["images"] = json!([{ "bufferView": view, "mimeType": mime }]);
    draft.json["textures"] = json!([{ "source": 0 }]);
    draft.json["materials"] = json!([{ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }]);
    draft
}

fn red_png() -> Vec<u8> {
    png(1, 1, ExtendedColorType::Rgb8, &[255, 0, 0])
}

#[test]
fn materials_keep_every_factor() {
    let mut draft = textured(&red_png(), "image/png");
    draft.json["textures"] = json!([{ "source": 0, "sampler": 0 }, { "source": 0 }]);
    draft.json["samplers"] = json!([{ "wrapS": 33071, "wrapT": 33648, "magFilter": 9728, "minFilter": 9987 }]);
    draft.json["materials"] = json!([{
        "name": "all",
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.1, 0.2, 0.3, 0.4], "metallicFactor": 0.5, "roughnessFactor": 0.6,
            "baseColorTexture": { "index": 0 }, "metallicRoughnessTexture": { "index": 1 },
        },
        "normalTexture": { "index": 0, "scale": 2.0 },
        "occlusionTexture": { "index": 0, "strength": 0.25 },
        "emissiveTexture": { "index": 1, "texCoord": 1 },
        "emissiveFactor": [1, 0.5, 0],
        "alphaMode": "MASK", "alphaCutoff": 0.3, "doubleSided": true,
        "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": 4 }, "KHR_materials_unlit": {} },
    }]);
    let scene = draft.scene();
    let material = &scene.materials[0];
    assert_eq!(material.base_color, [0.1, 0.2, 0.3, 0.4]);
    assert_eq!((material.metallic, material.roughness, material.normal_scale), (0.5, 0.6, 2.0));
    assert_eq!(material.alpha_cutoff, 0.3);
    assert_eq!((material.emissive, material.alpha_mode), (Vec3::new(4.0, 2.0, 0.0), AlphaMode::Mask));
    assert!(material.unlit);
    let first = scene.textures[material.base_color_texture.unwrap().texture as usize];
    assert_eq!((first.wrap_u, first.wrap_v, first.filter), (Wrap::ClampToEdge, Wrap::MirroredRepeat, Filter::Nearest));
    let second = scene.textures[material.metallic_roughness_texture.unwrap().texture as usize];
    assert_eq!((second.wrap_u, second.wrap_v, second.filter), (Wrap::Repeat, Wrap::Repeat, Filter::Linear));
    assert_eq!(material.emissive_texture.unwrap().uv_set, 1);
    assert!(material.normal_texture.is_some());
    assert_eq!((scene.images.len(), scene.textures.len()), (1, 2), "one image serves both textures");
}

#[test]
fn specular_and_glossiness_are_kept_with_their_texture() {
    let mut draft = textured(&red_png(), "image/png");
    let material = |texture: u32| {
        json!([{ "extensions": { "KHR_materials_pbrSpecularGlossiness": {
            "diffuseFactor": [0.1, 0.2, 0.3, 0.4], "specularFactor": [0.5, 0.6, 0.7], "glossinessFactor": 0.75,
            "specularGlossinessTexture": { "index": texture },
        } } }])
    };
    draft.json["extensionsRequired"] = json!(["KHR_materials_pbrSpecularGlossiness"]);
    draft.json["materials"] = material(0);
    let scene = draft.scene();
    let got = &scene.materials[0];
    assert_eq!((got.base_color, got.metallic, got.roughness), ([0.1, 0.2, 0.3, 0.4], 0.0, 0.25));
    assert_eq!((got.dielectric_f0, got.specular_glossiness), (Vec3::new(0.5, 0.6, 0.7), true));
    assert!(got.metallic_roughness_texture.is_some() && scene.warnings.is_empty(), "{:?}", scene.warnings);
    draft.json["materials"] = material(7);
    let place = "materials/0/extensions/KHR_materials_pbrSpecularGlossiness/specularGlossinessTexture/index";
    draft.refused(ImportErrorKind::Malformed, place, "7");
}

#[test]
fn texture_transforms_and_their_uv_set_are_taken_over() {
    let mut draft = textured(&red_png(), "image/png");
    draft.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["extensions"] =
        json!({ "KHR_texture_transform": { "offset": [0.5, 0.25], "scale": [2, 3], "texCoord": 1 } });
    let texture = draft.scene().materials[0].base_color_texture.unwrap();
    assert_eq!((texture.uv_set, texture.transform), (1, [[2.0, 0.0, 0.5], [0.0, 3.0, 0.25]]));
}

#[test]
fn occlusion_textures_are_ignored_with_a_warning() {
    let mut draft = textured(&red_png(), "image/png");
    draft.json["materials"][0] = json!({ "occlusionTexture": { "index": 0 } });
    let scene = draft.scene();
    assert!(scene.images.is_empty() && scene.textures.is_empty(), "nothing is decoded that nobody reads");
    assert!(scene.warnings[0].starts_with("materials: 1 have an occlusion texture"), "{:?}", scene.warnings);
}

#[test]
fn every_pixel_format_becomes_rgba8() {
    let mut palette = Vec::new();
    let mut encoder = ::png::Encoder::new(&mut palette, 1, 1);
    encoder.set_color(::png::ColorType::Indexed);
    encoder.set_palette(vec![10, 20, 30]);
    encoder.write_header().unwrap().write_image_data(&[0]).unwrap();
    let cases: [(Vec<u8>, [u8; 4]); 6] = [
        (red_png(), [255, 0, 0, 255]),
        (png(1, 1, ExtendedColorType::L8, &[77]), [77, 77, 77, 255]),
        (png(1, 1, ExtendedColorType::La8, &[77, 9]), [77, 77, 77, 9]),
        (png(1, 1, ExtendedColorType::Rgba8, &[1, 2, 3, 4]), [1, 2, 3, 4]),
        (png(1, 1, ExtendedColorType::L16, &0x8080_u16.to_ne_bytes()), [128, 128, 128, 255]),
        (palette, [10, 20, 30, 255]),
    ];
    for (file, expected) in cases {
        assert_eq!(textured(&file, "image/png").scene().images[0].rgba8, expected);
    }
    let mut jpeg = Vec::new();
    image::codecs::jpeg::JpegEncoder::new(&mut jpeg).encode(&[200; 48], 4, 4, ExtendedColorType::Rgb8).unwrap();
    let scene = textured(&jpeg, "image/jpeg").scene();
    assert_eq!((scene.images[0].width, scene.images[0].rgba8.len()), (4, 64));
    assert!(scene.images[0].rgba8[0].abs_diff(200) < 3);
}

#[test]
fn a_wrong_mime_type_is_a_warning_and_the_bytes_decide() {
    let scene = textured(&red_png(), "image/jpeg").scene();
    assert_eq!(scene.images.len(), 1);
    assert!(scene.warnings[0].starts_with("images/0: says that it is \"image/jpeg\" but is image/png"));
}

#[test]
fn broken_and_missing_images_cost_a_texture_only() {
    let mut truncated = png(64, 64, ExtendedColorType::Rgb8, &[9; 64 * 64 * 3]);
    truncated.truncate(truncated.len() / 2);
    for image in [truncated, b"not an image".to_vec(), Vec::new(), b"RIFF\x10\0\0\0WEBPVP8 ".to_vec()] {
        let scene = textured(&image, "image/png").scene();
        assert_eq!(scene.materials[0].base_color_texture, None);
        let told =
            scene.warnings.iter().any(|warning| warning.starts_with("images/0: ") && warning.contains("without"));
        assert!(told, "{:?}", scene.warnings);
    }
    let mut draft = textured(&red_png(), "image/png");
    draft.json["images"] = json!([{ "uri": "not%20there.png" }]);
    let scene = draft.scene();
    assert_eq!(scene.materials[0].base_color_texture, None);
    assert!(scene.warnings[0].contains("\"not there.png\" did not come with the scene"), "{:?}", scene.warnings);
}

#[test]
fn a_png_that_would_decode_to_gigabytes_is_refused_by_its_header() {
    let mut huge = red_png();
    huge[16..20].copy_from_slice(&30_000_u32.to_be_bytes());
    huge[20..24].copy_from_slice(&30_000_u32.to_be_bytes());
    let mut crc = png_crc(&huge[12..29]);
    huge[29..33].swap_with_slice(&mut crc);
    textured(&huge, "image/png").refused(ImportErrorKind::Limit, "images/0", "900000000 pixels over all images");
    huge[16..20].copy_from_slice(&2_000_000_u32.to_be_bytes());
    let mut crc = png_crc(&huge[12..29]);
    huge[29..33].swap_with_slice(&mut crc);
    textured(&huge, "image/png").refused(ImportErrorKind::Limit, "images/0", "pixels along one side");
    let limits = Limits { texture_pixels: 15, ..Limits::default() };
    let small = textured(&png(4, 4, ExtendedColorType::L8, &[0; 16]), "image/png");
    let result = super::import_bytes(small.file(), &limits);
    super::check_refusal(result, ImportErrorKind::Limit, "images/0", "16 pixels over all images");
}

/// CRC-32 as PNG chunks carry it, so that the header passes for sound.
fn png_crc(bytes: &[u8]) -> [u8; 4] {
    let mut crc = u32::MAX;
    for byte in bytes {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = if crc & 1 == 1 { (crc >> 1) ^ 0xEDB8_8320 } else { crc >> 1 };
        }
    }
    (!crc).to_be_bytes()
}

#[test]
fn a_uv_set_beyond_the_second_drops_the_texture() {
    let mut draft = textured(&red_png(), "image/png");
    draft.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["texCoord"] = json!(2);
    let scene = draft.scene();
    assert_eq!(scene.materials[0].base_color_texture, None);
    assert!(scene.warnings[0].starts_with("materials/0/baseColorTexture/texCoord: 2"));
}

#[test]
fn a_normal_map_brings_tangents_and_flat_normals() {
    let mut draft = textured(&red_png(), "image/png");
    draft.json["materials"][0] = json!({ "normalTexture": { "index": 0 } });
    let scene = draft.scene();
    let mesh = &scene.meshes[0];
    assert_eq!(mesh.normals, [Vec3::Z; 3]);
    // u grows along +X; v grows along -Y, so that up in the picture is +Y: right-handed.
    for tangent in &mesh.tangents {
        assert!(Vec3::new(tangent[0], tangent[1], tangent[2]).distance(Vec3::X) < 1e-6, "{tangent:?}");
        assert_eq!(tangent[3], 1.0);
    }
    let mirrored = draft.floats("VEC2", &[1., 1., 0., 1., 1., 0.]);
    draft.primitive()["attributes"]["TEXCOORD_0"] = json!(mirrored);
    let tangent = draft.scene().meshes[0].tangents[0];
    assert!(tangent[0] < -0.999 && tangent[3] == -1.0, "{tangent:?}");
}

#[test]
fn tangents_follow_the_transform_of_the_normal_map() {
    let mut draft = textured(&red_png(), "image/png");
    let rotated = json!({ "KHR_texture_transform": { "rotation": std::f32::consts::FRAC_PI_2 } });
    draft.json["materials"][0] = json!({ "normalTexture": { "index": 0, "extensions": rotated } });
    // A quarter turn: the map's u is v, which grows along -Y.
    for [x, y, z, handedness] in &draft.scene().meshes[0].tangents {
        assert!(Vec3::new(*x, *y, *z).distance(Vec3::NEG_Y) < 1e-6 && *handedness == 1.0, "{x} {y} {z} {handedness}");
    }
    let mirrored = json!({ "KHR_texture_transform": { "scale": [-1, 1] } });
    draft.json["materials"][0]["normalTexture"]["extensions"] = mirrored;
    for [x, _, _, handedness] in &draft.scene().meshes[0].tangents {
        assert!(*x < -0.999 && *handedness == -1.0, "{x} {handedness}");
    }
}

#[test]
fn a_normal_map_uses_its_own_uv_set_and_given_tangents_stay() {
    let mut draft = textured(&red_png(), "image/png");
    draft.json["materials"][0] = json!({ "normalTexture": { "index": 0, "texCoord": 1 } });
    let turned = draft.floats("VEC2", &[0., 0., 0., 1., 1., 0.]);
    let normals = draft.floats("VEC3", &[0., 0., 1., 0., 0., 1., 0., 0., 1.]);
    draft.primitive()["attributes"]["TEXCOORD_1"] = json!(turned);
    draft.primitive()["attributes"]["NORMAL"] = json!(normals);
    let tangent = draft.scene().meshes[0].tangents[0];
    assert!(tangent[1] > 0.999, "u of the second set grows along +Y: {tangent:?}");
    let tangents = draft.floats("VEC4", &[0., 2., 0., -1., 0., 2., 0., -1., 0., 2., 0., -1.]);
    draft.primitive()["attributes"]["TANGENT"] = json!(tangents);
    assert_eq!(draft.scene().meshes[0].tangents, [[0.0, 1.0, 0.0, -1.0]; 3]);
}

#[test]
fn corners_of_one_vertex_with_different_tangents_become_two_vertices() {
    let mut draft = textured(&red_png(), "image/png");
    // Two triangles share an edge; the second one's texture is mirrored.
    let positions = draft.floats("VEC3", &[0., 0., 0., 1., 0., 0., 0., 1., 0., 1., 1., 0.]);
    let normals = draft.floats("VEC3", &[0., 0., 1., 0., 0., 1., 0., 0., 1., 0., 0., 1.]);
    let uvs = draft.floats("VEC2", &[0., 1., 1., 1., 0., 0., 0., 0.9]);
    let indices = draft.indices(&[0, 1, 2, 1, 3, 2]);
    let attributes = json!({ "POSITION": positions, "NORMAL": normals, "TEXCOORD_0": uvs });
    draft.primitive()["attributes"] = attributes;
    draft.primitive()["indices"] = json!(indices);
    draft.json["materials"][0] = json!({ "normalTexture": { "index": 0 } });
    let mesh = draft.scene().meshes[0].clone();
    assert_eq!((mesh.positions.len(), mesh.tangents.len(), mesh.uv0.len()), (6, 6, 6));
    assert_eq!(mesh.triangles.len(), 2);
}

#[test]
fn if_one_primitive_has_normals_the_others_are_flat() {
    let mut draft = Draft::triangle();
    let normals = draft.floats("VEC3", &[0., 0.6, 0.8, 0., 0.6, 0.8, 0., 0.6, 0.8]);
    let plain = draft.primitive().clone();
    let mut smooth = plain.clone();
    smooth["attributes"]["NORMAL"] = json!(normals);
    draft.json["meshes"][0]["primitives"] = json!([plain, smooth]);
    let mesh = draft.scene().meshes[0].clone();
    assert_eq!(mesh.normals[..3], [Vec3::Z; 3]);
    assert!(mesh.normals[3..].iter().all(|normal| normal.distance(Vec3::new(0.0, 0.6, 0.8)) < 1e-6));
}

#[test]
fn normals_without_direction_take_their_triangles() {
    let mut draft = Draft::triangle();
    let normals = draft.floats("VEC3", &[0., 0., 0., 0., 3., 4., 0., 0., 1.]);
    draft.primitive()["attributes"]["NORMAL"] = json!(normals);
    let scene = draft.scene();
    let normals = &scene.meshes[0].normals;
    assert!(normals[0] == Vec3::Z && normals[2] == Vec3::Z, "{normals:?}");
    assert!(normals[1].distance(Vec3::new(0.0, 0.6, 0.8)) < 1e-6, "{normals:?}");
    assert!(scene.warnings[0].starts_with("meshes/0/primitives/0/attributes/NORMAL"));
}

#[test]
fn vertex_colours_are_rgb_or_rgba_of_any_width() {
    let cases: [(&str, u32, Vec<u8>, [f32; 4]); 3] = [
        ("VEC3", 5121, [255, 51, 0].repeat(3), [1.0, 0.2, 0.0, 1.0]),
        ("VEC4", 5121, [255, 51, 0, 102].repeat(3), [1.0, 0.2, 0.0, 0.4]),
        ("VEC4", 5123, [65535_u16, 0, 0, 13107].map(u16::to_le_bytes).concat().repeat(3), [1.0, 0.0, 0.0, 0.2]),
    ];
    for (shape, component, bytes, expected) in cases {
        let mut draft = Draft::triangle();
        let colors = draft.accessor(shape, component, 3, &bytes);
        draft.json["accessors"][colors]["normalized"] = json!(true);
        draft.primitive()["attributes"]["COLOR_0"] = json!(colors);
        let color = draft.scene().meshes[0].colors[2];
        assert!(color.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{color:?}");
    }
}
