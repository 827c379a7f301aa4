//! The fields of the spatial structure and of Line Spaces.

use lightshaft_api::settings::{Acceleration, LineSpace, StructureKind};

use super::{ChoiceOption, Control, Field, chosen, name_of, options, policy, whole};

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
const WITH_LINE_SPACES: &str = "\"two_level\" \"bvh\" \"ntree\"";
const CELLS: &str = "\"grid\" \"octree\" \"ntree\"";

pub(super) fn fields(a: &Acceleration) -> Vec<Field> {
    let structures = options(&[a.structure], &STRUCTURES.map(|(name, _)| name), &STRUCTURES);
    let current = chosen(&structures);
    let qualities = options(&[a.quality], &["fast", "medium", "high"], &[]);
    let field = |name: &str, label, unit, help, control| {
        Field::new(&format!("/settings/acceleration/{name}"), label, unit, help, control)
    };
    let n = perhaps(a.n, "2", "16");
    let depth = perhaps(a.depth, "1", "16");
    let max_leaf = perhaps(a.max_leaf, "0", "1024");
    let density = perhaps(a.cells_per_primitive, "1", "64");
    let resolution = perhaps(a.resolution, "1", "4096");
    let budget = perhaps(a.budget_bytes, "1048576", "");
    let mut fields = vec![
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
    ];
    fields.extend(line_space_fields(a, &current));
    fields
}

const PAYLOAD: &str = "/settings/acceleration/line_space/payload";
const PAYLOADS: [(&str, &str); 4] = [
    ("tri_state", "Free, blocked or undecided, proven"),
    ("binary", "Empty or not"),
    ("candidate", "A triangle for each shaft"),
    ("coverage", "The blocked share of each shaft"),
];
const ANY_PAYLOAD: &str = "\"tri_state\" \"binary\" \"candidate\" \"coverage\"";

fn line_space_fields(a: &Acceleration, structure: &str) -> Vec<Field> {
    let given = a.line_space.as_ref().filter(|_| !matches!(a.structure, StructureKind::Grid | StructureKind::Octree));
    let start = LineSpace::default();
    let l = given.unwrap_or(&start);
    let payload: Vec<_> = given.iter().map(|line_space| line_space.payload).collect();
    let mut payloads = options(&payload, &PAYLOADS.map(|(name, _)| name), &PAYLOADS);
    let none = ChoiceOption { value: String::new(), label: "None".to_owned(), selected: given.is_none() };
    payloads.insert(0, none);
    let current = chosen(&payloads);
    let choice = |current: &[&str], all: &[(&str, &str)]| {
        let mut options = options(current, &all.iter().map(|(name, _)| *name).collect::<Vec<_>>(), all);
        options.insert(
            0,
            ChoiceOption { value: String::new(), label: "Automatic".to_owned(), selected: current.is_empty() },
        );
        Control::Choice { options }
    };
    let builder = l.builder.as_ref().map(name_of);
    let builders = choice(
        &builder.as_deref().map(|name| vec![name]).unwrap_or_default(),
        &[("mask", "Masks"), ("clip", "Clipping"), ("ray_cast", "Ray casting"), ("layered", "Layers, with proofs")],
    );
    let layouts = Control::Choice {
        options: [("", "Automatic", None), ("true", "A tree", Some(true)), ("false", "A table", Some(false))]
            .map(|(value, label, means)| ChoiceOption {
                value: value.to_owned(),
                label: label.to_owned(),
                selected: l.hierarchical == means,
            })
            .into(),
    };
    let budget_choices = ["refuse", "shrink", "skip"];
    let over_budget = options(&[l.on_over_budget], &budget_choices, &[("shrink", "Shrink it"), ("skip", "Do without")]);
    let asks = options(&[l.ask], &["where_it_pays", "always"], &[("where_it_pays", "Where it is found to pay")]);
    let field = |name: &str, label, unit, help, control| {
        Field::new(&format!("/settings/acceleration/line_space/{name}"), label, unit, help, control)
    };
    let payload = vec![
        field(
            "payload",
            "Line Space",
            "",
            "What is known of the lines through each mesh.",
            Control::Choice { options: payloads },
        )
        .when(STRUCTURE, WITH_LINE_SPACES, structure),
    ];
    let used_for = policy::fields(a).into_iter().map(|field| match field.pointer.as_str() {
        policy::POLICY => field.when(PAYLOAD, ANY_PAYLOAD, &current),
        _ => field,
    });
    let details = vec![
        field("n", "Patches", "per edge", "Empty: as the payload likes it.", perhaps(l.n, "1", "32")).when(
            PAYLOAD,
            ANY_PAYLOAD,
            &current,
        ),
        field("depth", "Depth", "levels", "0 or empty: the mesh's own box.", perhaps(l.depth, "0", "12")).when(
            PAYLOAD,
            ANY_PAYLOAD,
            &current,
        ),
        field("builder", "Made by", "", "", builders).when(PAYLOAD, ANY_PAYLOAD, &current),
        field("hierarchical", "Layout", "", "A tree is smaller.", layouts).when(PAYLOAD, "\"tri_state\"", &current),
        field("resolution", "Voxels", "per axis", "A power of two. Empty: 128.", perhaps(l.resolution, "16", "256"))
            .when(PAYLOAD, "\"tri_state\"", &current),
        field("bits", "Bits of a shaft", "", "Empty: 8.", perhaps(l.bits, "2", "8")).when(
            PAYLOAD,
            "\"coverage\"",
            &current,
        ),
        field("rays", "Lines of a shaft", "", "Empty: 16.", perhaps(l.rays, "1", "1024")).when(
            PAYLOAD,
            "\"coverage\"",
            &current,
        ),
        field(
            "mesh_budget_bytes",
            "Most for a mesh",
            "bytes",
            "Empty: 256 MiB.",
            perhaps(l.mesh_budget_bytes, "1024", ""),
        )
        .when(PAYLOAD, ANY_PAYLOAD, &current),
        field("job_budget_bytes", "Most for all", "bytes", "Empty: 4 GiB.", perhaps(l.job_budget_bytes, "1024", ""))
            .when(PAYLOAD, ANY_PAYLOAD, &current),
        field("ask", "Ask them", "", "The picture is the same.", Control::Choice { options: asks }).when(
            PAYLOAD,
            ANY_PAYLOAD,
            &current,
        ),
        field("on_over_budget", "Over a budget", "", "", Control::Choice { options: over_budget }).when(
            PAYLOAD,
            ANY_PAYLOAD,
            &current,
        ),
    ];
    payload.into_iter().chain(used_for).chain(details).collect()
}

/// A whole number that may be left out.
fn perhaps<T: ToString>(value: Option<T>, min: &'static str, max: &'static str) -> Control {
    whole(value.map(|value| value.to_string()).unwrap_or_default(), min, max)
}
