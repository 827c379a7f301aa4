//! What a job will take, told before it runs.

use lightshaft_api::settings::{Acceleration, OnOverBudget};
use lightshaft_engine::accel::line_space::NodeSpaceParams;
use lightshaft_engine::accel::{CellShaftParams, NTreeParams, StructureParams};

use crate::executor::{DEFAULT_CELL_DEPTH, MIN_LINE_SPACE_PRIMITIVES};
use crate::settings::{LineSpaces, Structures, Wanted};

/// Bytes that the Line Spaces of a job take at most, over unique meshes of so many primitives each and `instanced`
/// primitives over all instances; of N-trees roughly, since only building tells which nodes there are. 0 without Line Spaces;
/// `None` of structures that have none.
pub fn line_space_bytes(acceleration: &Acceleration, meshes: &[u64], instanced: u64) -> Option<u64> {
    let wanted = Wanted::of(acceleration);
    let Some(line_spaces) = wanted.line_spaces else { return Some(0) };
    match wanted.structures {
        Structures::PerMesh(_) => Some(of_all(&line_spaces, meshes)),
        Structures::Flat(StructureParams::Bvh(_)) => Some(of_all(&line_spaces, &[instanced])),
        Structures::Flat(StructureParams::NTree(tree)) => Some(of_cells(&line_spaces, &tree, instanced)),
        Structures::Flat(StructureParams::Grid(_) | StructureParams::Octree(_)) => None,
    }
}

/// Those of the nodes of an N-tree. A level has at most so many nodes as the one above has cells, and hardly more than there
/// are primitives: each is divided for holding several.
fn of_cells(wanted: &LineSpaces, tree: &NTreeParams, primitives: u64) -> u64 {
    let nodes = |level: u32| u64::from(tree.n).saturating_pow(3 * level).min(primitives);
    let deepest = tree.depth.saturating_sub(1);
    let needed = match &wanted.rules {
        None => {
            let levels = wanted.depth.unwrap_or(DEFAULT_CELL_DEPTH).min(deepest);
            let params = CellShaftParams { levels, patches: wanted.n };
            (1..=levels).map(|level| nodes(level).saturating_mul(params.bytes_of_node(level, tree.n))).sum()
        }
        Some(_) if deepest == 0 => 0,
        Some(_) => {
            let params = wanted.of_cells(tree.depth);
            nodes(params.level.min(deepest)).saturating_mul(params.each.bytes_at_most())
        }
    };
    match wanted.on_over_budget {
        OnOverBudget::Refuse => needed,
        OnOverBudget::Shrink | OnOverBudget::Skip => needed.min(wanted.budget_of_flat()),
    }
}

/// Within the budgets, as far as the job says what to do where more would be needed; else as asked for.
fn of_all(wanted: &LineSpaces, meshes: &[u64]) -> u64 {
    let mut params = wanted.of_nodes();
    let of_mesh = |params: &NodeSpaceParams, primitives: u64| match wanted.rules {
        Some(_) => params.bytes_at_most(usize::try_from(primitives).unwrap_or(usize::MAX)),
        None => params.each.bytes_at_most(),
    };
    let asked = || meshes.iter().copied().filter(|&primitives| primitives >= MIN_LINE_SPACE_PRIMITIVES as u64);
    let largest = asked().max().unwrap_or_default();
    while wanted.on_over_budget == OnOverBudget::Shrink && of_mesh(&params, largest) > wanted.mesh_budget_bytes {
        match params.coarser() {
            Some(coarser) => params = coarser,
            None => return 0,
        }
    }
    let each = asked().map(|primitives| of_mesh(&params, primitives));
    match wanted.on_over_budget {
        OnOverBudget::Refuse => each.sum(),
        OnOverBudget::Shrink | OnOverBudget::Skip => {
            each.filter(|&bytes| bytes <= wanted.mesh_budget_bytes).sum::<u64>().min(wanted.job_budget_bytes)
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn bytes(acceleration: serde_json::Value) -> Option<u64> {
        let acceleration: Acceleration = serde_json::from_value(acceleration).unwrap();
        line_space_bytes(&acceleration, &[1000, 2000, 10], 50_000)
    }

    #[test]
    fn the_papers_figure_for_each_mesh_that_is_worth_one() {
        // Bits of 15 N^4 shafts, rounded up to words.
        let of_mesh = 15 * 8_u64.pow(4) / 8;
        assert_eq!(bytes(json!({})), Some(0));
        assert_eq!(bytes(json!({ "line_space": { "payload": "binary" } })), Some(2 * of_mesh));
        assert_eq!(bytes(json!({ "structure": "bvh", "line_space": { "payload": "binary" } })), Some(of_mesh));
    }

    #[test]
    fn nodes_of_an_n_tree_are_counted_by_its_cells_and_by_primitives() {
        let tree = |line_space: serde_json::Value, more: serde_json::Value| {
            let mut acceleration = json!({ "structure": "ntree", "line_space": line_space });
            acceleration.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
            bytes(acceleration).unwrap()
        };
        let binary = |depth: u32| json!({ "payload": "binary", "depth": depth });
        // 6^3 nodes below the root, whose patches are two of six cells wide: 15 * 3^4 bits in words, and where they are.
        let one_level = 216 * (4 + 4 * (15 * 3_u64.pow(4)).div_ceil(32));
        assert_eq!(tree(json!({ "payload": "binary" }), json!({})), one_level);
        // Below that as many as there are primitives, and 15 * 2^4 bits.
        let two_levels = one_level + 6_u64.pow(6).min(50_000) * (4 + 4 * (15 * 2_u64.pow(4)).div_ceil(32));
        assert_eq!(tree(binary(2), json!({})), two_levels);
        assert_eq!(tree(binary(2), json!({ "depth": 2 })), one_level, "a tree of two levels");
        assert_eq!(tree(binary(2), json!({ "depth": 1 })), 0, "the root has none");
        let small = json!({ "payload": "binary", "depth": 2, "on_over_budget": "shrink", "mesh_budget_bytes": 5000 });
        assert_eq!(tree(small, json!({})), 5000);
        let candidates = tree(json!({ "payload": "candidate" }), json!({ "policy": "representative" }));
        assert!(candidates > one_level, "{candidates}");
    }

    #[test]
    fn budgets_bound_what_may_shrink_or_be_left_out() {
        let with = |on_over_budget: &str, mesh_budget_bytes: u64| {
            bytes(json!({ "line_space": { "payload": "binary", "on_over_budget": on_over_budget,
                "mesh_budget_bytes": mesh_budget_bytes } }))
        };
        let (n8, n4) = (15 * 8_u64.pow(4) / 8, 15 * 4_u64.pow(4) / 8);
        assert_eq!(with("refuse", 1024), Some(2 * n8), "what it would need");
        assert_eq!(with("shrink", n8 - 1), Some(2 * n4));
        assert_eq!(with("skip", n8 - 1), Some(0));
    }
}
