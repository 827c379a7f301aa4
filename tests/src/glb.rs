//! Small glTF files made by hand, good ones and broken ones.

use std::io::Write;

use serde_json::{Value, json};
use zip::write::SimpleFileOptions;

/// A glTF document with one buffer.
#[derive(Clone, Debug)]
pub struct Gltf {
    pub document: Value,
    pub buffer: Vec<u8>,
}

impl Gltf {
    /// One grey triangle in the plane z = 0: positions, then three u16 indices.
    pub fn triangle() -> Self {
        let positions: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
        let mut buffer: Vec<u8> = positions.iter().flat_map(|v| v.to_le_bytes()).collect();
        buffer.extend([0_u16, 1, 2].iter().flat_map(|v| v.to_le_bytes()));
        let document = json!({
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
            "accessors": [
                {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
                {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"}
            ],
            "bufferViews": [
                {"buffer": 0, "byteOffset": 0, "byteLength": 36},
                {"buffer": 0, "byteOffset": 36, "byteLength": 6}
            ],
            "buffers": [{"byteLength": 42}]
        });
        Self { document, buffer }
    }

    /// Of a good .glb file.
    ///
    /// # Panics
    /// When it is none.
    pub fn from_glb(bytes: &[u8]) -> Self {
        let length = |at: usize| {
            let field: [u8; 4] = bytes[at..at + 4].try_into().expect("four bytes");
            u32::from_le_bytes(field) as usize
        };
        // A header of 12 bytes, then two chunks with headers of 8.
        let json_end = 20 + length(12);
        let document = serde_json::from_slice(&bytes[20..json_end]).expect("a JSON chunk");
        Self { document, buffer: bytes[json_end + 8..json_end + 8 + length(json_end)].to_vec() }
    }

    /// Changes the value at a JSON pointer, which must exist.
    pub fn with(mut self, pointer: &str, value: Value) -> Self {
        *self.document.pointer_mut(pointer).unwrap_or_else(|| panic!("{pointer} in the document")) = value;
        self
    }

    /// Adds a member to the document's root.
    pub fn adding(mut self, key: &str, value: Value) -> Self {
        self.document[key] = value;
        self
    }

    /// As a .glb file (glTF 2.0 section 4.4).
    pub fn glb(&self) -> Vec<u8> {
        let mut json = self.document.to_string().into_bytes();
        json.resize(json.len().next_multiple_of(4), b' ');
        let mut binary = self.buffer.clone();
        binary.resize(binary.len().next_multiple_of(4), 0);
        let length = 12 + 8 + json.len() + 8 + binary.len();
        let words = |a: usize, b: &[u8; 4]| [(a as u32).to_le_bytes(), *b].concat();
        [
            b"glTF".as_slice(),
            &2_u32.to_le_bytes(),
            &(length as u32).to_le_bytes(),
            &words(json.len(), b"JSON"),
            &json,
            &words(binary.len(), b"BIN\0"),
            &binary,
        ]
        .concat()
    }

    /// As a .gltf whose buffer is the file `name`.
    pub fn gltf(&self, name: &str) -> Vec<u8> {
        let mut document = self.document.clone();
        document["buffers"][0]["uri"] = json!(name);
        document.to_string().into_bytes()
    }
}

/// A zip of files by path.
pub fn zip(files: &[(&str, &[u8])]) -> Vec<u8> {
    let mut writer = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (path, bytes) in files {
        writer.start_file(*path, SimpleFileOptions::default()).expect("a zip entry");
        writer.write_all(bytes).expect("memory takes all");
    }
    writer.finish().expect("a zip").into_inner()
}

/// A PNG of a few bytes whose header claims `width` x `height` pixels.
pub fn lying_png(width: u32, height: u32) -> Vec<u8> {
    let mut png = b"\x89PNG\r\n\x1a\n".to_vec();
    let header = [&width.to_be_bytes(), &height.to_be_bytes(), [8, 6, 0, 0].as_slice(), &[0]].concat();
    png_chunk(&mut png, b"IHDR", &header);
    // A zlib stream with one empty stored block: valid, and far too short for the picture.
    png_chunk(&mut png, b"IDAT", &[0x78, 0x01, 0x01, 0, 0, 0xff, 0xff, 0, 0, 0, 1]);
    png_chunk(&mut png, b"IEND", &[]);
    png
}

fn png_chunk(png: &mut Vec<u8>, kind: &[u8; 4], data: &[u8]) {
    png.extend((data.len() as u32).to_be_bytes());
    let checked = [kind.as_slice(), data].concat();
    png.extend(&checked);
    png.extend(crc32(&checked).to_be_bytes());
}

fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| if crc & 1 == 1 { (crc >> 1) ^ 0xedb8_8320 } else { crc >> 1 })
    })
}
