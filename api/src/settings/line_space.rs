//! Line Spaces: what is stored for the lines between two patches of a mesh's box, and what it is used for.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::StructureKind;
use super::validate::Checker;
use crate::problem::FieldError;

/// Of budgets: enough for any coarse Line Space.
const MIN_BUDGET_BYTES: u64 = 1 << 10;
/// Deepest boxes of a mesh's BVH that can have Line Spaces.
const MAX_DEPTH: u32 = 12;

/// A Line Space for each mesh of the scene, or for each node of its N-tree: the faces of a box are cut into patches, and
/// something is stored for each pair of patches. Those of meshes are cached and shared by mesh, as structures are.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LineSpace {
    pub payload: LineSpacePayload,
    /// Patches along the edge of a face. Of `tri_state`: 1 to 32, 16 when null. Of `binary`: 1 to 12 with builder `mask`, 1 to
    /// 32 with the others, 8 when null. Of `candidate`: 1 to 32, 6 when null. Of `coverage`: 1 to 32, 8 when null. With masks in an
    /// `ntree`: at most its own `n`, for patches are whole cells wide; when null two cells right below the root and four cells below that,
    /// and one cell with an approximate policy.
    pub n: Option<u32>,
    /// Levels of the structure below its root whose boxes have Line Spaces. Of `two_level`: 0, the mesh's own box, when null.
    /// Of `ntree`: with policy `exact` those of all levels down to it, 1 when null, the nodes right below the root; with others the
    /// nodes at that depth, when null the deepest, or of `candidate` 1.
    pub depth: Option<u32>,
    /// How it is made. Of `binary`: `mask` (when null), `clip` or `ray_cast`. Of `tri_state`: `layered`. Of the others:
    /// `ray_cast`.
    pub builder: Option<LineSpaceBuilder>,
    /// Of `tri_state`: a tree that is fine only where shafts are undecided, instead of a table. Needs an `n` of 4, 8, 16 or
    /// 32, and is true for those when null.
    pub hierarchical: Option<bool>,
    /// Of `tri_state`: voxels along each axis while it is built: 16, 32, 64, 128 or 256; 128 when null.
    pub resolution: Option<u32>,
    /// Of `coverage`: bits for each shaft, 2 to 8; 8 when null.
    pub bits: Option<u32>,
    /// Of `coverage`: lines cast for each shaft, 1 to 1024; 16 when null.
    pub rays: Option<u32>,
    /// What the Line Space of one mesh may take, 1024 and more; 256 MiB when null.
    pub mesh_budget_bytes: Option<u64>,
    /// What all Line Spaces of the job may take, 1024 and more; 4 GiB when null.
    pub job_budget_bytes: Option<u64>,
    pub on_over_budget: OnOverBudget,
    pub ask: Ask,
}

/// What is stored for a shaft: all lines between two patches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LineSpacePayload {
    /// Whether it may hold geometry.
    Binary,
    /// A primitive that stands for all that is in it.
    Candidate,
    /// Proven: no line of it meets the mesh, or all do, or neither is certain.
    #[default]
    TriState,
    /// Which part of its lines is blocked.
    Coverage,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LineSpaceBuilder {
    /// By masks of cells: conservative.
    Mask,
    /// By clipping triangles against shafts: conservative, exact, slow.
    Clip,
    /// By sampled lines: not conservative.
    RayCast,
    /// By layers of voxels: each class with a proof.
    Layered,
}

/// What to do where a Line Space needs more than its budget.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum OnOverBudget {
    /// The job fails, and says what would be needed.
    #[default]
    Refuse,
    /// Half as many patches along an edge, until it fits.
    Shrink,
    /// The mesh has none.
    Skip,
}

/// Which Line Spaces policy `exact` asks before the structure of their mesh is walked. The answers are the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Ask {
    /// Those that a short measurement finds to be faster than the structure.
    #[default]
    WhereItPays,
    Always,
}

impl LineSpace {
    /// The `n` that is given, or the default of the payload.
    pub fn n_or_default(&self) -> u32 {
        self.n.unwrap_or(match self.payload {
            LineSpacePayload::Binary | LineSpacePayload::Coverage => 8,
            LineSpacePayload::Candidate => 6,
            LineSpacePayload::TriState => 16,
        })
    }

    /// The builder that is given, or the first of the payload.
    pub fn builder_or_default(&self) -> LineSpaceBuilder {
        self.builder.unwrap_or(self.payload.builders()[0])
    }

    /// Whether the classes of `tri_state` are a tree.
    pub fn is_hierarchical(&self) -> bool {
        self.hierarchical.unwrap_or([4, 8, 16, 32].contains(&self.n_or_default()))
    }

    pub(super) fn validate(&self, structure: StructureKind, prefix: &str, errors: &mut Vec<FieldError>) {
        let mut c = Checker { prefix, errors };
        let payload = self.payload;
        let is_masked = payload == LineSpacePayload::Binary && self.builder_or_default() == LineSpaceBuilder::Mask;
        let most = if is_masked { 12 } else { 32 };
        let of_masks = if is_masked { " with builder mask" } else { "" };
        let in_range = (1..=most).contains(&self.n_or_default());
        c.check(in_range, "n", &format!("must be 1 to {most}{of_masks}"));
        let is_deep = structure != StructureKind::NTree && self.depth.is_some_and(|depth| depth > MAX_DEPTH);
        c.check(!is_deep, "depth", "must be 0 to 12");
        let fits = payload.builders().contains(&self.builder_or_default());
        c.check(fits, "builder", &format!("must be {} for this payload", payload.builder_names()));
        let mut applies = |is_given: bool, field: &str, to: LineSpacePayload, name: &str| {
            c.check(!is_given || payload == to, field, &format!("applies to payload {name} alone"));
        };
        applies(self.hierarchical.is_some(), "hierarchical", LineSpacePayload::TriState, "tri_state");
        applies(self.resolution.is_some(), "resolution", LineSpacePayload::TriState, "tri_state");
        applies(self.bits.is_some(), "bits", LineSpacePayload::Coverage, "coverage");
        applies(self.rays.is_some(), "rays", LineSpacePayload::Coverage, "coverage");
        let can_be_tree = [4, 8, 16, 32].contains(&self.n_or_default());
        c.check(
            self.hierarchical != Some(true) || can_be_tree || payload != LineSpacePayload::TriState,
            "hierarchical",
            "needs an n of 4, 8, 16 or 32",
        );
        let resolutions = [16, 32, 64, 128, 256];
        let is_known = self.resolution.is_none_or(|resolution| resolutions.contains(&resolution));
        c.check(is_known, "resolution", "must be 16, 32, 64, 128 or 256");
        c.check(self.bits.is_none_or(|bits| (2..=8).contains(&bits)), "bits", "must be 2 to 8");
        c.check(self.rays.is_none_or(|rays| (1..=1024).contains(&rays)), "rays", "must be 1 to 1024");
        for (budget, field) in
            [(self.mesh_budget_bytes, "mesh_budget_bytes"), (self.job_budget_bytes, "job_budget_bytes")]
        {
            c.check(budget.is_none_or(|bytes| bytes >= MIN_BUDGET_BYTES), field, "must be at least 1024");
        }
    }
}

impl LineSpacePayload {
    /// Who can make it, the default first.
    fn builders(self) -> &'static [LineSpaceBuilder] {
        match self {
            Self::Binary => &[LineSpaceBuilder::Mask, LineSpaceBuilder::Clip, LineSpaceBuilder::RayCast],
            Self::TriState => &[LineSpaceBuilder::Layered],
            Self::Candidate | Self::Coverage => &[LineSpaceBuilder::RayCast],
        }
    }

    fn builder_names(self) -> &'static str {
        match self {
            Self::Binary => "mask, clip or ray_cast",
            Self::TriState => "layered",
            Self::Candidate | Self::Coverage => "ray_cast",
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use crate::settings::RenderSettings;

    fn wrong(settings: Value) -> Vec<String> {
        let settings: RenderSettings = serde_json::from_value(settings).unwrap();
        let errors = settings.validate("/settings").into_iter();
        errors.map(|error| error.pointer.trim_start_matches("/settings/acceleration/").to_owned()).collect()
    }

    fn wrong_line_space(line_space: Value) -> Vec<String> {
        let pointers = wrong(json!({ "acceleration": { "line_space": line_space } })).into_iter();
        pointers.map(|pointer| pointer.trim_start_matches("line_space/").to_owned()).collect()
    }

    #[test]
    fn none_and_exact_are_the_defaults() {
        assert_eq!(wrong(json!({ "acceleration": { "line_space": null, "policy": "exact" } })), [""; 0]);
        assert_eq!(wrong_line_space(json!({})), [""; 0]);
    }

    #[test]
    fn each_payload_has_its_own_parameters() {
        for good in [
            json!({ "payload": "tri_state", "n": 32, "hierarchical": true, "resolution": 256, "builder": "layered" }),
            json!({ "payload": "tri_state", "n": 10, "hierarchical": false }),
            json!({ "payload": "binary", "n": 12 }),
            json!({ "payload": "binary", "n": 32, "builder": "ray_cast" }),
            json!({ "payload": "candidate", "n": 1 }),
            json!({ "payload": "coverage", "bits": 2, "rays": 1024, "on_over_budget": "skip", "depth": 0 }),
        ] {
            assert_eq!(wrong_line_space(good.clone()), [""; 0], "{good}");
        }
        assert_eq!(wrong_line_space(json!({ "n": 0, "depth": 13 })), ["policy", "n", "depth"]);
        assert_eq!(wrong_line_space(json!({ "n": 33 })), ["n"]);
        assert_eq!(wrong_line_space(json!({ "payload": "binary", "n": 13 })), ["n"]);
        assert_eq!(wrong_line_space(json!({ "payload": "candidate", "builder": "mask" })), ["builder"]);
        assert_eq!(wrong_line_space(json!({ "n": 6, "hierarchical": true })), ["hierarchical"]);
        let misplaced = json!({ "payload": "binary", "hierarchical": true, "resolution": 100, "bits": 9, "rays": 0 });
        let fields = ["hierarchical", "resolution", "bits", "rays", "resolution", "bits", "rays"];
        assert_eq!(wrong_line_space(misplaced), fields);
        let budgets = json!({ "mesh_budget_bytes": 5, "job_budget_bytes": 1023 });
        assert_eq!(wrong_line_space(budgets), ["mesh_budget_bytes", "job_budget_bytes"]);
    }
}
