//! What a job will take, told before it runs.

use lightshaft_api::settings::{Acceleration, OnOverBudget};
use lightshaft_engine::accel::StructureParams;
use lightshaft_engine::accel::line_space::NodeSpaceParams;

use crate::executor::MIN_LINE_SPACE_PRIMITIVES;
use crate::settings::{LineSpaces, Structures, Wanted};

/// Bytes that the Line Spaces of a job take at most, over unique meshes of so many primitives each and `instanced`
/// primitives over all instances. 0 without Line Spaces; `None` where only building tells, which is so of N-trees.
pub fn line_space_bytes(acceleration: &Acceleration, meshes: &[u64], instanced: u64) -> Option<u64> {
    let wanted = Wanted::of(acceleration);
    let Some(line_spaces) = wanted.line_spaces else { return Some(0) };
    match wanted.structures {
        Structures::PerMesh(_) => Some(of_all(&line_spaces, meshes)),
        Structures::Flat(structure) => {
            matches!(structure, StructureParams::Bvh(_)).then(|| of_all(&line_spaces, &[instanced]))
        }
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
        assert_eq!(bytes(json!({ "structure": "ntree", "line_space": { "payload": "binary" } })), None);
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
