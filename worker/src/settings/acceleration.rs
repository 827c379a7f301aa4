//! Which structures and Line Spaces a job asks for.

use lightshaft_api::settings::{self as api, Ask, LineSpaceBuilder, LineSpacePayload, OnOverBudget, Policy};
use lightshaft_engine::accel::line_space::{
    BinaryBuilder, CandidateRules, CastPattern, CellSpaceParams, ClassLayout, LineSpaceParams, MAX_MASK_N,
    NodeSpaceParams, Payload,
};
use lightshaft_engine::accel::{
    AdaptiveRules, Approximation, BouncePolicy, BuildParams, GridParams, GridResolution, NTreeParams, OctreeParams,
    Quality, StructureParams,
};

/// What a structure of cells may take when the job does not say.
const DEFAULT_BUDGET_BYTES: u64 = 4 << 30;
/// What the Line Space of one mesh, and those of all, may take when the job does not say.
const DEFAULT_MESH_BUDGET_BYTES: u64 = 256 << 20;
const DEFAULT_JOB_BUDGET_BYTES: u64 = 4 << 30;

/// All that is built before rays are traced.
#[derive(Clone, Debug, PartialEq)]
pub struct Wanted {
    pub structures: Structures,
    pub line_spaces: Option<LineSpaces>,
}

impl Wanted {
    /// Of settings that have been validated.
    pub fn of(acceleration: &api::Acceleration) -> Self {
        let approximate = acceleration.policy == Policy::ApproximateOcclusion;
        let line_spaces = acceleration.line_space.as_ref().map(|line_space| LineSpaces {
            rules: acceleration.asks_nodes().then(|| approximation(acceleration)),
            ..LineSpaces::of(line_space, acceleration, approximate)
        });
        Self { structures: Structures::of(acceleration), line_spaces }
    }

    /// Whether a job that leaves the device to us is one for the CPU: the GPU asks Line Spaces only when told to, and not all.
    pub fn needs_cpu(&self) -> bool {
        self.line_spaces.is_some()
    }
}

/// A Line Space for each mesh, within budgets.
#[derive(Clone, Debug, PartialEq)]
pub struct LineSpaces {
    pub params: LineSpaceParams,
    /// Patches along an edge, if the job says how many.
    pub n: Option<u32>,
    /// Levels below the root that have them; None for what the structure likes.
    pub depth: Option<u32>,
    pub mesh_budget_bytes: u64,
    pub job_budget_bytes: u64,
    pub on_over_budget: OnOverBudget,
    pub ask: Ask,
    /// Whether occlusion rays take for true what is not proven.
    pub approximate: bool,
    /// What the Line Spaces of the boxes of BVHs are used for; None for a policy that asks whole meshes, or cells.
    pub rules: Option<Approximation>,
}

impl LineSpaces {
    fn of(line_space: &api::LineSpace, acceleration: &api::Acceleration, approximate: bool) -> Self {
        let payload = match line_space.payload {
            LineSpacePayload::Binary => Payload::Binary {
                builder: match line_space.builder_or_default() {
                    LineSpaceBuilder::Clip => BinaryBuilder::Clipping,
                    LineSpaceBuilder::RayCast => BinaryBuilder::Casting(CastPattern::Nine),
                    LineSpaceBuilder::Mask | LineSpaceBuilder::Layered => BinaryBuilder::Masking,
                },
            },
            LineSpacePayload::Candidate => Payload::Candidates { pattern: CastPattern::Nine },
            LineSpacePayload::TriState => Payload::Classes {
                layout: if line_space.is_hierarchical() { ClassLayout::Tree } else { ClassLayout::Table },
                resolution: line_space.resolution.unwrap_or(128),
            },
            LineSpacePayload::Coverage => {
                Payload::Coverage { bits: line_space.bits.unwrap_or(8), rays: line_space.rays.unwrap_or(16) }
            }
        };
        // Masks of an N-tree's nodes are made of their cells.
        let of_cells = acceleration.structure == api::StructureKind::NTree
            && payload == Payload::Binary { builder: BinaryBuilder::Masking };
        let default_n = if of_cells { cells_on_axis(acceleration).min(MAX_MASK_N) } else { line_space.n_or_default() };
        Self {
            params: LineSpaceParams { n: line_space.n.unwrap_or(default_n), payload },
            n: line_space.n,
            depth: line_space.depth,
            mesh_budget_bytes: line_space.mesh_budget_bytes.unwrap_or(DEFAULT_MESH_BUDGET_BYTES),
            job_budget_bytes: line_space.job_budget_bytes.unwrap_or(DEFAULT_JOB_BUDGET_BYTES),
            on_over_budget: line_space.on_over_budget,
            ask: line_space.ask,
            approximate,
            rules: None,
        }
    }
}

impl LineSpaces {
    /// Those of the boxes of a BVH.
    pub fn of_nodes(&self) -> NodeSpaceParams {
        NodeSpaceParams { each: self.params, depth: self.depth.unwrap_or(0) }
    }

    /// Those of the nodes of an N-tree with so many levels: the last but one, as in chapter 5 of the thesis, or right below the root, as
    /// candidates have them in chapter 6, when the job does not say.
    pub fn of_cells(&self, levels: u32) -> CellSpaceParams {
        let has_candidates = matches!(self.params.payload, Payload::Candidates { .. });
        let level = if has_candidates { 1 } else { levels.saturating_sub(1).max(1) };
        CellSpaceParams { each: self.params, level: self.depth.unwrap_or(level) }
    }

    /// What the Line Spaces of one structure over the whole scene may take.
    pub fn budget_of_flat(&self) -> u64 {
        self.mesh_budget_bytes.min(self.job_budget_bytes)
    }
}

/// Cells of an N-tree's nodes on each axis.
fn cells_on_axis(acceleration: &api::Acceleration) -> u32 {
    acceleration.n.unwrap_or(6)
}

fn approximation(acceleration: &api::Acceleration) -> Approximation {
    let (adaptive, candidates) = (&acceleration.adaptive, &acceleration.representative);
    let bounce = |policy| match policy {
        api::BouncePolicy::Exact => BouncePolicy::Exact,
        api::BouncePolicy::ApproximateOcclusion => BouncePolicy::Occlusion,
        api::BouncePolicy::Adaptive => BouncePolicy::Adaptive,
        api::BouncePolicy::Representative => BouncePolicy::Representative,
    };
    let angle = candidates.angle_threshold_deg;
    Approximation {
        bounces: acceleration.policy.bounces().into_iter().map(bounce).collect(),
        exact_origin: acceleration.origin_node == api::OriginNode::Exact,
        origin_reach: acceleration.origin_reach,
        adaptive: AdaptiveRules {
            delta: adaptive.delta,
            interpolate: adaptive.interpolate,
            disc: adaptive.disc_sampling,
            exact_origin: adaptive.origin_object == api::OriginObject::Exact,
        },
        candidates: CandidateRules {
            min_cosine: if angle >= 180.0 { -1.0 } else { angle.to_radians().cos() },
            range_slack: candidates.range_slack,
            exact_origin: candidates.origin_node == api::RepresentativeOrigin::Exact,
        },
    }
}

/// What is built, and over what.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Structures {
    /// One for each mesh, under a top level.
    PerMesh(StructureParams),
    /// One over all instances in world space.
    Flat(StructureParams),
}

impl Structures {
    fn of(acceleration: &api::Acceleration) -> Self {
        let budget_bytes = acceleration.budget_bytes.unwrap_or(DEFAULT_BUDGET_BYTES);
        let max_leaf = acceleration.max_leaf.unwrap_or(8);
        match acceleration.structure {
            api::StructureKind::TwoLevel => Self::PerMesh(bvh(acceleration).into()),
            api::StructureKind::Bvh => Self::Flat(bvh(acceleration).into()),
            api::StructureKind::Grid => {
                let resolution = match acceleration.resolution {
                    Some(cells) => GridResolution::LongestAxis(cells),
                    None => GridResolution::PerPrimitive(acceleration.cells_per_primitive.unwrap_or(4)),
                };
                Self::Flat(StructureParams::Grid(GridParams { resolution, budget_bytes }))
            }
            api::StructureKind::Octree => {
                let depth = acceleration.depth.unwrap_or(12);
                Self::Flat(StructureParams::Octree(OctreeParams { depth, max_leaf, budget_bytes }))
            }
            api::StructureKind::NTree => {
                let (n, depth) = (cells_on_axis(acceleration), acceleration.depth.unwrap_or(3));
                Self::Flat(StructureParams::NTree(NTreeParams { n, depth, max_leaf, budget_bytes }))
            }
        }
    }
}

fn bvh(acceleration: &api::Acceleration) -> BuildParams {
    BuildParams {
        quality: match acceleration.quality {
            api::BuildQuality::Fast => Quality::Fast,
            api::BuildQuality::Medium => Quality::Medium,
            api::BuildQuality::High => Quality::High,
        },
        spatial_splits: acceleration.spatial_splits,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lightshaft_api::settings::RenderSettings;
    use serde_json::json;

    #[test]
    fn whatever_the_api_accepts_the_engine_can_build() {
        for line_space in [
            json!({}),
            json!({ "n": 1 }),
            json!({ "n": 32, "resolution": 16 }),
            json!({ "n": 31, "resolution": 256 }),
            json!({ "n": 16, "hierarchical": false }),
            json!({ "payload": "binary", "n": 12 }),
            json!({ "payload": "binary", "n": 32, "builder": "clip" }),
            json!({ "payload": "binary", "n": 32, "builder": "ray_cast" }),
            json!({ "payload": "candidate", "n": 32 }),
            json!({ "payload": "coverage", "n": 32, "bits": 2, "rays": 1 }),
            json!({ "payload": "coverage", "n": 1, "bits": 8, "rays": 1024 }),
        ] {
            let settings = json!({ "acceleration": { "line_space": line_space } });
            let settings: RenderSettings = serde_json::from_value(settings).unwrap();
            assert_eq!(settings.validate(""), [], "{line_space}");
            let wanted = Wanted::of(&settings.acceleration).line_spaces.unwrap();
            assert_eq!(wanted.params.check(), Ok(()), "{line_space}");
        }
    }
}
