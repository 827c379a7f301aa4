//! Line Spaces of the nodes of a scene's BVHs: within their budgets, and from the cache wherever possible.

use std::sync::Arc;

use lightshaft_api::job::Metrics;
use lightshaft_api::settings::OnOverBudget;
use lightshaft_engine::accel::line_space::{NodeSpaceParams, NodeSpaces};
use lightshaft_engine::accel::{BuildParams, SceneAccel, Structure, StructureParams};
use lightshaft_engine::scene::Mesh;

use super::prepare::build_error;
use super::{Executor, Task, TaskError};
use crate::cache::{NodeSpacesRecipe, Obtained};
use crate::settings::{LineSpaces, Structures, Wanted};

impl Executor {
    /// The scene, approximating as it is wanted. `meshes` are those of its structures.
    ///
    /// # Errors
    /// When the job refuses to go over its budgets, with the figure.
    pub(super) fn with_node_spaces(
        &self,
        task: &Task<'_>,
        accel: SceneAccel,
        meshes: &[&Mesh],
        wanted: &Wanted,
        metrics: &mut Metrics,
    ) -> Result<SceneAccel, TaskError> {
        let Wanted { structures, line_spaces: Some(wanted) } = wanted else { return Ok(accel) };
        let (
            Structures::PerMesh(StructureParams::Bvh(over)) | Structures::Flat(StructureParams::Bvh(over)),
            Some(rules),
        ) = (*structures, &wanted.rules)
        else {
            return Ok(accel);
        };
        let keeps = matches!(structures, Structures::PerMesh(_));
        let mut params = wanted.of_nodes();
        loop {
            let largest = meshes.iter().map(|mesh| params.bytes_at_most(mesh.primitive_count())).max().unwrap_or(0);
            let is_over = largest > wanted.mesh_budget_bytes && wanted.on_over_budget != OnOverBudget::Skip;
            let why = if is_over {
                format!("mesh_budget_bytes: {} may take {largest} bytes for a mesh", params.canonical())
            } else {
                let mut obtained =
                    self.obtain_node_spaces(task, accel.structures(), meshes, &params, (wanted, over, keeps))?;
                let bytes = |obtained: &[Option<Obtained<Arc<NodeSpaces>>>]| -> u64 {
                    obtained.iter().flatten().map(|obtained| obtained.structure.bytes() as u64).sum()
                };
                let total = bytes(&obtained);
                if total > wanted.job_budget_bytes && wanted.on_over_budget == OnOverBudget::Skip {
                    drop_largest(&mut obtained, wanted.job_budget_bytes);
                }
                if bytes(&obtained) <= wanted.job_budget_bytes {
                    let without = meshes.len() - obtained.iter().flatten().count();
                    if wanted.on_over_budget == OnOverBudget::Skip && without > 0 {
                        task.warn(
                            metrics,
                            format!("{without} meshes have no line spaces: they would go over a budget"),
                        );
                    }
                    if params != wanted.of_nodes() {
                        task.warn(metrics, format!("line spaces have n = {}: their budget", params.each.n));
                    }
                    let nodes = obtained.into_iter().map(|obtained| {
                        let Obtained { structure, report, warnings } = obtained?;
                        warnings.into_iter().for_each(|warning| task.warn(metrics, warning));
                        metrics.cache.push(report);
                        Some(structure)
                    });
                    let nodes = nodes.collect();
                    return accel.approximating(nodes, rules.clone()).map_err(TaskError::worker);
                }
                format!("job_budget_bytes: {} takes {total} bytes for all meshes", params.canonical())
            };
            match (wanted.on_over_budget, params.coarser()) {
                (OnOverBudget::Shrink, Some(coarser)) => params = coarser,
                _ => {
                    return Err(TaskError::bad_input(format!(
                        "/settings/acceleration/line_space/{why}; allow more, a smaller n or depth, or on_over_budget shrink or \
                         skip"
                    )));
                }
            }
        }
    }

    fn obtain_node_spaces(
        &self,
        task: &Task<'_>,
        structures: &[Structure],
        meshes: &[&Mesh],
        params: &NodeSpaceParams,
        (wanted, over, keeps): (&LineSpaces, BuildParams, bool),
    ) -> Result<Vec<Option<Obtained<Arc<NodeSpaces>>>>, TaskError> {
        let budget_bytes = wanted.mesh_budget_bytes;
        let recipes = meshes.iter().zip(structures).map(|(&mesh, structure)| {
            let bvh = structure.bvh()?;
            let fits = params.bytes_at_most(mesh.primitive_count()) <= budget_bytes;
            let recipe = NodeSpacesRecipe { params: *params, structure: bvh, over, budget_bytes };
            fits.then_some((mesh, recipe))
        });
        let asked: Vec<Option<(&Mesh, NodeSpacesRecipe<'_>)>> = recipes.collect();
        if keeps {
            return self.obtain_all(task, &asked);
        }
        // Of this arrangement of meshes alone: the service knows structures by mesh.
        let obtain = |(mesh, recipe): &(&Mesh, _)| self.structures.get(mesh, recipe, None, task.stop);
        let obtained = asked.iter().map(|asked| asked.as_ref().map(obtain).transpose());
        obtained.collect::<Result<_, _>>().map_err(build_error)
    }
}

/// Leaves so many out, the largest first, that the rest fits.
fn drop_largest(obtained: &mut [Option<Obtained<Arc<NodeSpaces>>>], budget_bytes: u64) {
    let size = |one: &Option<Obtained<Arc<NodeSpaces>>>| one.as_ref().map_or(0, |one| one.structure.bytes() as u64);
    let mut left: u64 = obtained.iter().map(size).sum();
    while left > budget_bytes {
        let Some(largest) = obtained.iter_mut().max_by_key(|one| size(one)) else { break };
        left -= size(largest);
        *largest = None;
    }
}
