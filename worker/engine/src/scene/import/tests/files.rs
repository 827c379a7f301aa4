//! Scenes of several files: archives, uploads in parts, folders.

use std::io::{Cursor, Write as _};

use serde_json::json;
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

use super::{Draft, check_refusal, import_bytes};
use crate::scene::ImportErrorKind::{Limit, Malformed, MissingFile, Unsupported};
use crate::scene::{Content, ImportError, Limits, Scene, Source, import, import_file};

/// A .gltf with its buffer in `uri`, and that buffer.
fn split(uri: &str) -> (Vec<u8>, Vec<u8>) {
    let mut draft = Draft::triangle();
    draft.json["buffers"][0]["uri"] = json!(uri);
    (draft.json.to_string().into_bytes(), draft.binary)
}

fn zipped(files: &[(&str, &[u8])]) -> Vec<u8> {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in files {
        writer.start_file(*name, SimpleFileOptions::default()).expect("an entry");
        writer.write_all(bytes).expect("its data");
    }
    writer.finish().expect("a zip").into_inner()
}

fn import_zip(files: &[(&str, &[u8])]) -> Result<Scene, ImportError> {
    import_bytes(zipped(files), &Limits::default())
}

#[test]
fn a_zip_at_its_top_or_in_a_folder() {
    let (gltf, buffer) = split("data/my%20buffer.bin");
    let clutter: (&str, &[u8]) = ("__MACOSX/scene.gltf", b"x");
    let top = import_zip(&[("scene.gltf", &gltf), ("data/my buffer.bin", &buffer), clutter]).expect("a scene");
    let folder = import_zip(&[("model/scene.gltf", &gltf), ("model/data/my buffer.bin", &buffer)]).expect("a scene");
    assert_eq!(top.meshes[0].hash, folder.meshes[0].hash);
    let glb = import_zip(&[("readme.txt", b"hello"), ("thing.glb", &Draft::triangle().file())]).expect("a scene");
    assert_eq!((glb.meshes[0].hash, glb.name.as_str()), (top.meshes[0].hash, "thing"));
    let (gltf, buffer) = split("../data/b.bin");
    assert!(import_zip(&[("source/scene.gltf", &gltf), ("data/b.bin", &buffer)]).is_ok(), "within the zip");
}

#[test]
fn a_zip_without_or_with_two_scenes() {
    check_refusal(import_zip(&[("a.txt", b"")]), Malformed, "", "no .gltf or .glb");
    let glb = Draft::triangle().file();
    check_refusal(import_zip(&[("a.glb", &glb), ("b.gltf", b"{}")]), Malformed, "", "\"a.glb\" and \"b.gltf\"");
    let (gltf, _) = split("b.bin");
    check_refusal(import_zip(&[("scene.gltf", &gltf)]), MissingFile, "buffers/0/uri", "\"b.bin\" did not come");
}

#[test]
fn names_that_escape_a_zip() {
    let glb = Draft::triangle().file();
    for name in ["../a.glb", "x/../../a.glb", "/a.glb", "C:\\a.glb", "x/../a.glb"] {
        // The writer would tidy these names, so the directory is edited afterwards.
        let stand_in = "n".repeat(name.len());
        let mut file = zipped(&[("scene.glb", &glb), (&stand_in, b"evil")]);
        replace_all(&mut file, stand_in.as_bytes(), name.as_bytes());
        let error = import_bytes(file, &Limits::default()).expect_err(name);
        assert_eq!(error.kind, Malformed, "{name}: {error}");
        assert!(error.message.contains("relative paths without"), "{name}: {error}");
    }
}

fn replace_all(bytes: &mut [u8], from: &[u8], to: &[u8]) {
    for start in 0..=bytes.len() - from.len() {
        if &bytes[start..start + from.len()] == from {
            bytes[start..start + from.len()].copy_from_slice(to);
        }
    }
}

#[test]
fn twins_links_and_encryption_in_a_zip() {
    let glb = Draft::triangle().file();
    let mut twins = zipped(&[("scene.glb", &glb), ("twin1", b"a"), ("twin2", b"b")]);
    replace_all(&mut twins, b"twin2", b"twin1");
    check_refusal(import_bytes(twins, &Limits::default()), Malformed, "", "two files of the same name");

    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    writer.add_symlink("scene.glb", "/etc/passwd", SimpleFileOptions::default()).expect("a link");
    let link = writer.finish().expect("a zip").into_inner();
    check_refusal(import_bytes(link, &Limits::default()), Unsupported, "\"scene.glb\"", "symbolic link");

    let mut encrypted = zipped(&[("scene.glb", &glb)]);
    // Bit 0 of the flags, in the local and the central header.
    let central = encrypted.windows(4).position(|window| window == b"PK\x01\x02").expect("a directory");
    encrypted[6] |= 1;
    encrypted[central + 8] |= 1;
    check_refusal(import_bytes(encrypted, &Limits::default()), Unsupported, "\"scene.glb\"", "encrypted");
}

#[test]
fn zip_bombs_are_held_to_what_they_really_decompress_to() {
    let (gltf, _) = split("b.bin");
    let zeros = vec![0; 40 << 20];
    let mut bomb = zipped(&[("scene.gltf", &gltf), ("b.bin", &zeros)]);
    let result = import_bytes(bomb.clone(), &Limits::default());
    check_refusal(result, Limit, "b.bin", "more than 200 times its size");
    let generous = Limits { zip_ratio: 2_000, input_bytes: 30 << 20, ..Limits::default() };
    check_refusal(import_bytes(bomb.clone(), &generous), Limit, "\"b.bin\"", "41943040 bytes (decompressed)");
    // The same with a directory that claims eight bytes.
    let real = (zeros.len() as u32).to_le_bytes();
    replace_all(&mut bomb, &real, &8_u32.to_le_bytes());
    let error = import_bytes(bomb, &generous).expect_err("a refusal");
    assert!(matches!(error.kind, Limit | Malformed), "{error}");

    let files: Vec<(String, Vec<u8>)> = (0..20).map(|i| (format!("{i}.txt"), Vec::new())).collect();
    let many: Vec<(&str, &[u8])> = files.iter().map(|(name, bytes)| (name.as_str(), bytes.as_slice())).collect();
    let few = Limits { files: 19, ..Limits::default() };
    check_refusal(import_bytes(zipped(&many), &few), Limit, "", "20 files in the zip");
}

#[test]
fn one_file_named_often_counts_each_time() {
    let mut draft = Draft::triangle();
    draft.json["buffers"][0]["uri"] = json!("b.bin");
    for _ in 0..20 {
        super::push(&mut draft.json["buffers"], json!({ "byteLength": 1, "uri": "b.bin" }));
    }
    let mut buffer = draft.binary.clone();
    buffer.resize(100_000, 1);
    let file = zipped(&[("scene.gltf", draft.json.to_string().as_bytes()), ("b.bin", &buffer)]);
    assert!(import_bytes(file.clone(), &Limits::default()).is_ok());
    let limits = Limits { input_bytes: 1_000_000, ..Limits::default() };
    assert_eq!(import_bytes(file, &limits).expect_err("a refusal").kind, Limit);
}

#[test]
fn damaged_zips() {
    let file = zipped(&[("scene.glb", &Draft::triangle().file())]);
    for length in [4, 30, file.len() / 2, file.len() - 1] {
        let error = import_bytes(file[..length].to_vec(), &Limits::default()).expect_err("a refusal");
        assert_eq!(error.kind, Malformed, "{error}");
    }
    let mut flipped = file;
    flipped[60] ^= 0xFF;
    assert!(import_bytes(flipped, &Limits::default()).is_err(), "the checksum does not fit");
}

#[test]
fn an_upload_in_parts() {
    let limits = Limits::default();
    let (gltf, buffer) = split("data/b.bin");
    let folder = tempfile::tempdir().expect("a folder");
    let on_disk = folder.path().join("anything");
    std::fs::write(&on_disk, &buffer).expect("written");
    let parts = |buffer_name: &str| {
        [
            ("scene.gltf".to_owned(), Content::Bytes(gltf.clone())),
            (buffer_name.to_owned(), Content::File(on_disk.clone())),
        ]
    };
    let source = Source::from_files(parts("data/b.bin"), &limits).expect("a source");
    let scene = import(&source, &limits, &|| false).expect("a scene");
    assert_eq!(scene.meshes[0].hash, Draft::triangle().scene().meshes[0].hash);
    for (name, kind) in
        [("../b.bin", Malformed), ("/b.bin", Malformed), ("scene.gltf", Malformed), ("x.glb", Malformed)]
    {
        let error = Source::from_files(parts(name), &limits).expect_err(name);
        assert_eq!(error.kind, kind, "{name}");
    }
    let few = Limits { files: 1, ..limits };
    assert_eq!(Source::from_files(parts("b.bin"), &few).expect_err("a refusal").kind, Limit);
}

#[test]
fn a_gltf_on_disk_reads_its_folder_and_nothing_else() {
    let folder = tempfile::tempdir().expect("a folder");
    let inside = folder.path().join("scene");
    std::fs::create_dir(&inside).expect("a folder");
    let limits = Limits::default();
    let write = |uri: &str| {
        let (gltf, buffer) = split(uri);
        std::fs::write(inside.join("scene.gltf"), gltf).expect("written");
        buffer
    };
    let buffer = write("b%20c.bin");
    std::fs::write(inside.join("b c.bin"), &buffer).expect("written");
    std::fs::write(folder.path().join("secret.bin"), &buffer).expect("written");
    assert!(import_file(&inside.join("scene.gltf"), &limits).is_ok());
    write("../secret.bin");
    check_refusal(import_file(&inside.join("scene.gltf"), &limits), Malformed, "buffers/0/uri", "leads outside");
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(folder.path().join("secret.bin"), inside.join("link.bin")).expect("a link");
        write("link.bin");
        check_refusal(import_file(&inside.join("scene.gltf"), &limits), Malformed, "link.bin", "leads outside");
    }
    let missing = import_file(&inside.join("nothing.glb"), &limits).expect_err("a refusal");
    assert_eq!((missing.kind, missing.position.as_str()), (crate::scene::ImportErrorKind::Io, "nothing.glb"));
}

#[test]
fn buffers_in_data_uris() {
    use base64::Engine as _;
    let mut draft = Draft::triangle();
    let encoded = base64::engine::general_purpose::STANDARD.encode(&draft.binary);
    draft.json["buffers"][0]["uri"] = json!(format!("data:application/octet-stream;base64,{encoded}"));
    let json = draft.json.to_string().into_bytes();
    let scene = import_bytes(json, &Limits::default()).expect("a scene");
    assert_eq!(scene.meshes[0].hash, Draft::triangle().scene().meshes[0].hash);
    draft.json["buffers"][0]["uri"] = json!("data:;base64,*");
    draft.refused(Malformed, "buffers/0/uri", "base64");
}
