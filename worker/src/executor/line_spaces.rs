//! Line Spaces of a scene's meshes: within their budgets, and from the cache wherever possible.

use std::cmp::Reverse;
use std::sync::Arc;

use lightshaft_api::job::CacheReport;
use lightshaft_api::settings::{Ask, OnOverBudget};
use lightshaft_engine::accel::line_space::{LineSpace, LineSpaceParams};
use lightshaft_engine::accel::{SceneAccel, Structure};
use lightshaft_engine::scene::{Mesh, Scene};

use super::{Executor, Task, TaskError};
use crate::cache::{LineSpaceRecipe, Obtained};
use crate::settings::LineSpaces;

/// Meshes with fewer primitives have none: a ray is through them before it has found its shaft.
pub(crate) const MIN_PRIMITIVES: usize = 64;

/// One, or none, for each mesh; and what there is to tell about them.
#[derive(Debug, Default)]
pub(super) struct ObtainedLineSpaces {
    pub spaces: Vec<Option<Arc<LineSpace>>>,
    pub reports: Vec<CacheReport>,
    pub warnings: Vec<String>,
    use_for: Use,
}

/// How a scene is to use them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Use {
    #[default]
    WhereItPays,
    Always,
    Approximately,
}

impl Executor {
    /// # Errors
    /// When the job refuses to go over its budgets, with the figure.
    pub(super) fn obtain_line_spaces(
        &self,
        task: &Task<'_>,
        scene: &Scene,
        structures: &[Structure],
        wanted: &LineSpaces,
    ) -> Result<ObtainedLineSpaces, TaskError> {
        let mut params = wanted.params;
        loop {
            let of_mesh = params.bytes_at_most();
            let why = if of_mesh > wanted.mesh_budget_bytes {
                format!("mesh_budget_bytes: {} may take {of_mesh} bytes a mesh", params.canonical())
            } else {
                let mut obtained = self.obtain_with(task, scene, structures, &params, wanted)?;
                let total = obtained.bytes();
                if total <= wanted.job_budget_bytes {
                    return Ok(obtained);
                }
                if wanted.on_over_budget == OnOverBudget::Skip {
                    obtained.drop_largest(wanted.job_budget_bytes);
                    return Ok(obtained);
                }
                format!("job_budget_bytes: {} takes {total} bytes for all meshes", params.canonical())
            };
            match (wanted.on_over_budget, params.coarser()) {
                (OnOverBudget::Refuse, _) => {
                    return Err(TaskError::bad_input(format!(
                        "/settings/acceleration/line_space/{why}; allow more, a smaller n, or on_over_budget shrink or skip"
                    )));
                }
                (OnOverBudget::Shrink, Some(coarser)) => params = coarser,
                (OnOverBudget::Shrink | OnOverBudget::Skip, _) => {
                    let warnings = vec![format!("no mesh has a line space: {why}")];
                    let spaces = vec![None; structures.len()];
                    return Ok(ObtainedLineSpaces { spaces, warnings, ..ObtainedLineSpaces::default() });
                }
            }
        }
    }

    fn obtain_with(
        &self,
        task: &Task<'_>,
        scene: &Scene,
        structures: &[Structure],
        params: &LineSpaceParams,
        wanted: &LineSpaces,
    ) -> Result<ObtainedLineSpaces, TaskError> {
        let builder = self.devices.line_space_builder(task.settings.device, task.settings.adapter.as_deref());
        let meshes = scene.meshes.iter().zip(structures).map(|(mesh, structure)| match structure {
            Structure::Bvh(bvh) if mesh.primitive_count() >= MIN_PRIMITIVES => {
                let (budget_bytes, on_gpu) = (wanted.mesh_budget_bytes, builder.as_deref());
                Some((&**mesh, LineSpaceRecipe { params: *params, structure: bvh, budget_bytes, on_gpu }))
            }
            Structure::Bvh(_) | Structure::Cells(_) => None,
        });
        let asked: Vec<Option<(&Mesh, LineSpaceRecipe<'_>)>> = meshes.collect();
        let mut all = ObtainedLineSpaces { use_for: Use::of(wanted), ..ObtainedLineSpaces::default() };
        for obtained in self.obtain_all(task, &asked)? {
            all.spaces.push(obtained.map(|Obtained { structure, report, warnings }| {
                all.reports.push(report);
                all.warnings.extend(warnings);
                structure
            }));
        }
        if !params.is_conservative() && !wanted.approximate {
            all.warnings.push(format!(
                "line spaces of sampled lines ({}) prove nothing: policy exact asks them nothing",
                params.canonical()
            ));
        }
        if params.n != wanted.params.n {
            all.warnings.push(format!("line spaces have n = {}, not {}: their budget", params.n, wanted.params.n));
        }
        Ok(all)
    }
}

impl Use {
    fn of(wanted: &LineSpaces) -> Self {
        match (wanted.approximate, wanted.ask) {
            (true, _) => Self::Approximately,
            (false, Ask::Always) => Self::Always,
            (false, Ask::WhereItPays) => Self::WhereItPays,
        }
    }
}

impl ObtainedLineSpaces {
    /// The scene, with them.
    pub(super) fn given_to(self, accel: SceneAccel) -> Result<SceneAccel, String> {
        let accel = accel.with_line_spaces(self.spaces)?;
        Ok(match self.use_for {
            Use::WhereItPays => accel.asking_where_it_pays(),
            Use::Always => accel,
            Use::Approximately => accel.approximating_occlusion(),
        })
    }

    fn bytes(&self) -> u64 {
        self.spaces.iter().flatten().map(|space| space.bytes() as u64).sum()
    }

    /// Leaves so many out, the largest first, that the rest fits.
    fn drop_largest(&mut self, budget_bytes: u64) {
        let mut order: Vec<usize> = (0..self.spaces.len()).collect();
        order.sort_by_key(|&i| Reverse(self.spaces[i].as_ref().map_or(0, |space| space.bytes())));
        let mut left = self.bytes();
        let mut dropped = 0;
        for i in order {
            if left <= budget_bytes {
                break;
            }
            if let Some(space) = self.spaces[i].take() {
                left -= space.bytes() as u64;
                dropped += 1;
                let mesh = space.mesh().to_string();
                self.reports.retain(|report| report.mesh != mesh);
            }
        }
        self.warnings.push(format!("{dropped} meshes have no line space: job_budget_bytes is {budget_bytes}"));
    }
}
