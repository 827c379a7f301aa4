//! The fields of the spatial structure.

use lightshaft_api::settings::Acceleration;

use super::{Control, Field, options};

const STRUCTURE: &str = "/settings/acceleration/structure";
const STRUCTURES: [(&str, &str); 5] = [
    ("two_level", "Two-level BVH"),
    ("bvh", "BVH over all instances"),
    ("grid", "Uniform grid"),
    ("octree", "Octree"),
    ("ntree", "N-tree"),
];
const BVHS: &str = "\"two_level\" \"bvh\"";
const TREES: &str = "\"octree\" \"ntree\"";
const CELLS: &str = "\"grid\" \"octree\" \"ntree\"";

pub(super) fn fields(a: &Acceleration) -> Vec<Field> {
    let names = STRUCTURES.map(|(name, _)| name);
    let structures = options(&[a.structure], &names, &STRUCTURES);
    let current = structures.iter().find(|option| option.selected).map(|option| option.value.clone());
    let current = current.unwrap_or_default();
    let qualities = options(&[a.quality], &["fast", "medium", "high"], &[]);
    let field = |name: &str, label, unit, help, control| {
        Field::new(&format!("/settings/acceleration/{name}"), label, unit, help, control)
    };
    let whole = |value: Option<u64>, min, max| Control::Number {
        value: value.map(|value| value.to_string()).unwrap_or_default(),
        min,
        max,
        whole: true,
    };
    let n = whole(a.n.map(u64::from), "2", "16");
    let depth = whole(a.depth.map(u64::from), "1", "16");
    let max_leaf = whole(a.max_leaf.map(u64::from), "0", "1024");
    let density = whole(a.cells_per_primitive.map(u64::from), "1", "64");
    let resolution = whole(a.resolution.map(u64::from), "1", "4096");
    let budget = whole(a.budget_bytes, "1048576", "");
    vec![
        field("structure", "Structure", "", "All give the same picture.", Control::Choice { options: structures }),
        field(
            "quality",
            "Build quality",
            "",
            "High builds longer and traces faster.",
            Control::Choice { options: qualities },
        )
        .when(STRUCTURE, BVHS, &current),
        field(
            "spatial_splits",
            "Spatial splits",
            "",
            "Better for long, thin triangles; takes more memory.",
            Control::Switch { on: a.spatial_splits },
        )
        .when(STRUCTURE, BVHS, &current),
        field("n", "Cells of a node", "per axis", "Empty: 6.", n).when(STRUCTURE, "\"ntree\"", &current),
        field("depth", "Levels", "", "Empty: 3 for an N-tree, 12 for an octree.", depth)
            .when(STRUCTURE, TREES, &current),
        field("max_leaf", "Primitives of a leaf", "", "Empty: 8.", max_leaf).when(STRUCTURE, TREES, &current),
        field("cells_per_primitive", "Cells per primitive", "", "Empty: 4, or by the resolution.", density)
            .when(STRUCTURE, "\"grid\"", &current),
        field(
            "resolution",
            "Resolution",
            "cells",
            "On the longest axis. Empty: by the number of primitives.",
            resolution,
        )
        .when(STRUCTURE, "\"grid\"", &current),
        field("budget_bytes", "Memory budget", "bytes", "What needs more is refused. Empty: 4 GiB.", budget)
            .when(STRUCTURE, CELLS, &current),
    ]
}
