//! The embedded WGSL: one stage per file in `shaders/`, common parts in `shaders/shared/`.
//!
//! A line `//!include NAME` is replaced by `shared/NAME.wgsl` (once per stage), a line `//!pool NAME` by the bindings
//! and the accessor of a [`Pool`](super::pool::Pool). Constants that a variant fixes, such as the stack size, are put
//! in front.

use super::pool::PoolLayout;

/// A composed stage, ready to compile.
#[derive(Clone, Debug)]
pub(super) struct Source {
    pub stage: &'static str,
    pub wgsl: String,
}

/// What distinguishes a variant of a stage.
#[derive(Clone, Debug, Default)]
pub(super) struct Variant<'a> {
    pub constants: Vec<(&'static str, String)>,
    /// Every pool that the stage's files mention.
    pub pools: &'a [PoolLayout],
    /// Shared files that stand in for others: (asked for, taken).
    pub replacements: &'a [(&'static str, &'static str)],
}

/// Composes a stage.
///
/// # Panics
/// When a file asks for an unknown part: a fault of this program that the tests would have found.
pub(super) fn compose(stage: &'static str, variant: &Variant<'_>) -> Source {
    compose_text(stage, lookup(STAGES, stage), variant)
}

/// Composes `text` as [`compose`] does a file.
pub(super) fn compose_text(stage: &'static str, text: &str, variant: &Variant<'_>) -> Source {
    let mut wgsl = String::new();
    for (name, value) in &variant.constants {
        wgsl.push_str(&format!("const {name} = {value};\n"));
    }
    append(&mut wgsl, stage, text, variant, &mut Vec::new());
    Source { stage, wgsl }
}

fn append(out: &mut String, stage: &str, text: &str, variant: &Variant<'_>, included: &mut Vec<String>) {
    for line in text.lines() {
        if let Some(asked) = line.strip_prefix("//!include ") {
            if !included.iter().any(|known| known == asked) {
                included.push(asked.to_owned());
                let stand_ins = STAND_INS.iter().filter(|(of, _)| *of == stage).flat_map(|(_, all)| all.iter());
                let replacement = variant.replacements.iter().chain(stand_ins).find(|(from, _)| *from == asked);
                append(out, stage, lookup(SHARED, replacement.map_or(asked, |(_, to)| to)), variant, included);
            }
        } else if let Some(name) = line.strip_prefix("//!pool ") {
            let pool = variant.pools.iter().find(|pool| pool.name == name);
            out.push_str(&pool.unwrap_or_else(|| panic!("no pool `{name}`")).wgsl());
        } else {
            out.push_str(line);
            out.push('\n');
        }
    }
}

fn lookup(files: &[(&'static str, &'static str)], name: &str) -> &'static str {
    files.iter().find(|(known, _)| *known == name).unwrap_or_else(|| panic!("no shader file `{name}`")).1
}

macro_rules! embed {
    ($folder:literal: $($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!("../../../../../shaders/", $folder, $name, ".wgsl")))),*]
    };
}

/// Shared files that stand in for others in all variants of a stage: (asked for, taken).
const STAND_INS: &[(&str, &[(&str, &str)])] = &[
    ("build_cast", &[("intersect", "intersect_bounds"), ("candidates", "candidates_nearest")]),
    ("build_classes", &[("intersect", "intersect_bounds"), ("candidates", "candidates_all")]),
];

pub(super) const STAGES: &[(&str, &str)] = embed!(
    "": "accumulate", "build_cast", "build_classes", "build_mask", "build_voxels", "first_hit", "generate", "locate_shafts", "prepare", "shade_ao", "shade_normal", "shade_path", "shade_whitted",
    "tally", "trace_closest", "trace_shadow"
);
const SHARED: &[(&str, &str)] = embed!(
    "shared/": "accept_all", "accept_alpha", "bsdf", "camera", "candidates", "candidates_all", "candidates_nearest", "environment", "found", "gate", "gate_tell", "intersect", "intersect_bounds", "lights", "lines",
    "math", "paths", "queue", "rays", "sampler", "scattering", "scene", "shading", "shaft", "surface", "texture", "trace_ray", "traverse",
    "traverse_baseline", "traverse_cells", "vertex"
);
