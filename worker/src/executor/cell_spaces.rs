//! Line Spaces of the nodes of a flat scene's N-tree, within their budgets. They belong to this arrangement of meshes and to no single
//! one, so they are made for the job and kept as long as its scene is.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use lightshaft_api::settings::{Ask, OnOverBudget};
use lightshaft_engine::accel::line_space::CellSpaces;
use lightshaft_engine::accel::{Approximation, BuildError, CellShaftParams, CellShafts, CellTree, SceneAccel};
use lightshaft_engine::scene::Mesh;

use super::TaskError;
use crate::settings::LineSpaces;

/// Levels of nodes below the root that rays can pass by, when the job does not say: they are few enough to stay in the CPU's cache,
/// where those of all levels cost more than they spare.
pub(crate) const DEFAULT_CELL_DEPTH: u32 = 1;

/// The scene, whose structure is a tree of cells over `flat`, with the Line Spaces that are wanted.
///
/// # Errors
/// When the job refuses to go over its budgets, with the figure.
pub(super) fn with_cells(
    accel: SceneAccel,
    flat: &Mesh,
    wanted: &LineSpaces,
    stop: &AtomicBool,
    warn: &mut dyn FnMut(String),
) -> Result<SceneAccel, TaskError> {
    let Some(structure) = accel.structures().first().cloned() else { return Ok(accel) };
    match (structure.cells(), &wanted.rules) {
        (None, _) => Ok(accel),
        (Some(tree), None) => passing_by(accel, tree, wanted, stop, warn),
        (Some(tree), Some(rules)) => approximating(accel, (flat, tree), wanted, rules, stop, warn),
    }
}

/// Rays pass by the nodes in which their shaft is empty. Made from the tree's own cells in less time than it takes to read them.
fn passing_by(
    accel: SceneAccel,
    tree: &CellTree,
    wanted: &LineSpaces,
    stop: &AtomicBool,
    warn: &mut dyn FnMut(String),
) -> Result<SceneAccel, TaskError> {
    let budget_bytes = wanted.budget_of_flat();
    let asked = wanted.depth.unwrap_or(DEFAULT_CELL_DEPTH).min(tree.levels().saturating_sub(1));
    let params = |levels| CellShaftParams { levels, patches: wanted.n };
    let of_levels = |levels| CellShafts::bytes_at_most(tree, &params(levels));
    let levels = match wanted.on_over_budget {
        OnOverBudget::Refuse => asked,
        OnOverBudget::Shrink => (1..=asked).rev().find(|&levels| of_levels(levels) <= budget_bytes).unwrap_or(0),
        OnOverBudget::Skip if of_levels(asked) <= budget_bytes => asked,
        OnOverBudget::Skip => 0,
    };
    if levels < asked {
        let needed = of_levels(asked);
        warn(format!(
            "{levels} of {asked} levels below the root have line spaces: all may take {needed} bytes, the budget is {budget_bytes}"
        ));
    }
    if levels == 0 {
        return Ok(accel);
    }
    let shafts = CellShafts::build(tree, &params(levels), budget_bytes, stop).map_err(build_error)?;
    let accel = accel.with_cell_shafts(Arc::new(shafts)).map_err(TaskError::worker)?;
    Ok(if wanted.ask == Ask::Always { accel } else { accel.asking_where_it_pays() })
}

/// Rays take for true what the nodes of one level say.
fn approximating(
    accel: SceneAccel,
    (flat, tree): (&Mesh, &CellTree),
    wanted: &LineSpaces,
    rules: &Approximation,
    stop: &AtomicBool,
    warn: &mut dyn FnMut(String),
) -> Result<SceneAccel, TaskError> {
    let whole = wanted.of_cells(tree.levels());
    let mut params = whole;
    let spaces = loop {
        match (CellSpaces::build(flat, tree, &params, wanted.budget_of_flat(), stop), params.coarser()) {
            (Ok(spaces), _) => break spaces,
            (Err(BuildError::Unsupported(_)), Some(coarser)) if wanted.on_over_budget == OnOverBudget::Shrink => {
                params = coarser;
            }
            (Err(BuildError::Unsupported(why)), _) if wanted.on_over_budget == OnOverBudget::Skip => {
                warn(format!("no node has a line space: {why}"));
                return Ok(accel);
            }
            (Err(error), _) => return Err(build_error(error)),
        }
    };
    if params != whole {
        warn(format!("line spaces have n = {}: their budget", params.each.n));
    }
    if spaces.count() == 0 {
        warn("no node has a line space: the tree has none below its root".into());
    }
    accel.approximating_in_cells(Arc::new(spaces), rules.clone()).map_err(TaskError::worker)
}

fn build_error(error: BuildError) -> TaskError {
    match error {
        BuildError::Cancelled => TaskError::Stopped,
        BuildError::Unsupported(why) => TaskError::bad_input(format!(
            "/settings/acceleration/line_space/mesh_budget_bytes: {why}; allow more, fewer levels (depth), a smaller n, or \
             on_over_budget shrink or skip"
        )),
    }
}
