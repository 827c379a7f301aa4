//! What Line Spaces are used for, and what cannot be combined.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::validate::Checker;
use super::{Acceleration, DeviceChoice, LineSpace, LineSpaceBuilder, LineSpacePayload, StructureKind};
use crate::problem::FieldError;

const ADAPTIVE_BY_OBJECT: &str = "adaptive chooses by object: structure two_level";

/// Bounces that can be told apart: as many as a path has.
const MAX_BOUNCES: usize = 65;

/// What Line Spaces are used for.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Policy {
    /// Only for what they prove: the picture is that of the structure alone, bit for bit.
    #[default]
    Exact,
    /// Shadow and ambient-occlusion rays that cross a whole box are blocked by every shaft that holds something; with payload
    /// `coverage`, with the probability that it gives.
    ApproximateOcclusion,
    /// As that, where an object is far enough for its size and for the light's, at a depth that follows from it.
    Adaptive,
    /// Indirect rays end on candidates.
    Representative,
    /// A policy for each bounce, the last one repeating. The first is that of what the camera sees: its shadow rays.
    PerBounce(Vec<BouncePolicy>),
}

/// What Line Spaces are used for in one bounce.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum BouncePolicy {
    Exact,
    ApproximateOcclusion,
    Adaptive,
    Representative,
}

/// What is done in the box in which an occlusion ray starts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum OriginNode {
    /// Its geometry is tested.
    #[default]
    Exact,
    /// Nothing: what is near casts no shadow.
    Skip,
}

/// The usage heuristic: `gamma` is the distance of an object's box in diagonals of it, times the size of the light by its
/// distance (1 for ambient occlusion and the sky, 0 for punctual lights), times `delta`. Below 1 the object is exact; at 1
/// the deepest boxes answer, and each further 1 takes one level less.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Adaptive {
    /// 0 to 1000000; 0 gives the exact picture.
    pub delta: f32,
    /// Between two depths one is chosen at random, by the fraction.
    pub interpolate: bool,
    /// Ambient-occlusion rays are moved at random within a disc before their shaft is looked up.
    pub disc_sampling: bool,
    pub origin_object: OriginObject,
}

impl Default for Adaptive {
    fn default() -> Self {
        Self { delta: 1.0, interpolate: true, disc_sampling: true, origin_object: OriginObject::Exact }
    }
}

/// How an object is met by rays that start in its box.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum OriginObject {
    /// All of its geometry is tested.
    #[default]
    Exact,
    /// The deepest boxes answer, but for those in which the ray starts.
    LineSpace,
}

/// When a candidate counts as hit: its triangle stands for its whole plane.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Representative {
    /// Greatest angle between the normal, extrapolated beyond the triangle, and the triangle's mean normal; 0 to 180 (any).
    pub angle_threshold_deg: f32,
    /// By how much of its diagonal a box grows before hits outside it are dropped, 0 to 1.
    pub range_slack: f32,
    pub origin_node: RepresentativeOrigin,
}

impl Default for Representative {
    fn default() -> Self {
        Self { angle_threshold_deg: 60.0, range_slack: 0.0, origin_node: RepresentativeOrigin::Exact }
    }
}

/// What is done in the box in which an indirect ray starts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum RepresentativeOrigin {
    /// Its geometry is tested.
    #[default]
    Exact,
    /// Its candidates are asked too: light leaks where surfaces touch.
    Approximate,
}

impl Policy {
    /// One for each bounce, the last repeating.
    pub fn bounces(&self) -> Vec<BouncePolicy> {
        match self {
            Self::Exact => vec![BouncePolicy::Exact],
            Self::ApproximateOcclusion => vec![BouncePolicy::ApproximateOcclusion],
            Self::Adaptive => vec![BouncePolicy::Adaptive],
            Self::Representative => vec![BouncePolicy::Representative],
            Self::PerBounce(bounces) => bounces.clone(),
        }
    }
}

impl Acceleration {
    /// Whether rays are answered by the Line Spaces of boxes of the structure, not only by those of whole meshes.
    pub fn asks_nodes(&self) -> bool {
        match self.policy {
            Policy::Exact => false,
            Policy::ApproximateOcclusion => {
                self.structure != StructureKind::TwoLevel
                    || self.line_space.as_ref().is_some_and(|l| l.depth.unwrap_or(0) > 0)
            }
            Policy::Adaptive | Policy::Representative | Policy::PerBounce(_) => true,
        }
    }

    /// What is wrong with Line Spaces and policy, with pointers below `prefix`.
    pub(super) fn validate_line_space(&self, device: DeviceChoice, prefix: &str, errors: &mut Vec<FieldError>) {
        let mut c = Checker { prefix, errors };
        if let Policy::PerBounce(bounces) = &self.policy {
            let is_right = (1..=MAX_BOUNCES).contains(&bounces.len());
            c.check(is_right, "policy", &format!("per_bounce must have 1 to {MAX_BOUNCES} policies"));
        }
        c.check(in_range(self.adaptive.delta, 0.0, 1e6), "adaptive/delta", "must be 0 to 1000000");
        c.check(in_range(self.origin_reach, 0.0, 16.0), "origin_reach", "must be 0 to 16");
        let angle = self.representative.angle_threshold_deg;
        c.check(in_range(angle, 0.0, 180.0), "representative/angle_threshold_deg", "must be 0 to 180");
        let slack = self.representative.range_slack;
        c.check(in_range(slack, 0.0, 1.0), "representative/range_slack", "must be 0 to 1");
        let needs_none = self.policy == Policy::Exact;
        c.check(needs_none || self.line_space.is_some(), "policy", "any policy but exact needs a line_space");
        let Some(line_space) = &self.line_space else { return };
        c.check(
            matches!(self.structure, StructureKind::TwoLevel | StructureKind::NTree | StructureKind::Bvh),
            "line_space",
            "line spaces are available with structures two_level, bvh and ntree alone",
        );
        c.check(
            device != DeviceChoice::Gpu || (self.structure == StructureKind::TwoLevel && !self.asks_nodes()),
            "line_space",
            "must be null on device gpu: there, only those of meshes' own boxes (structure two_level, depth 0, policy exact or \
             approximate_occlusion) are asked; device auto chooses the CPU",
        );
        if self.structure == StructureKind::NTree {
            self.validate_cells(line_space, prefix, errors);
        } else {
            self.validate_nodes(line_space, prefix, errors);
        }
        line_space.validate(self.structure, &format!("{prefix}/line_space"), errors);
    }

    /// Line Spaces of the nodes of an N-tree. Masks are made of its cells, so their patches are whole cells wide.
    fn validate_cells(&self, line_space: &LineSpace, prefix: &str, errors: &mut Vec<FieldError>) {
        let mut c = Checker { prefix, errors };
        let (n, levels) = (self.n.unwrap_or(6), self.depth.unwrap_or(3));
        let (payload, builder) = (line_space.payload, line_space.builder_or_default());
        let bounces = self.policy.bounces();
        c.check(!bounces.contains(&BouncePolicy::Adaptive), "policy", ADAPTIVE_BY_OBJECT);
        let asks_nodes = self.asks_nodes();
        let (fits, which) = if bounces.contains(&BouncePolicy::Representative) {
            (payload == LineSpacePayload::Candidate, "candidate with policy representative")
        } else if asks_nodes {
            (
                payload != LineSpacePayload::TriState,
                "binary, candidate or coverage with structure ntree and this policy",
            )
        } else {
            (payload == LineSpacePayload::Binary, "binary with structure ntree and policy exact")
        };
        c.check(fits, "line_space/payload", &format!("must be {which}"));
        let is_masked = payload == LineSpacePayload::Binary && builder == LineSpaceBuilder::Mask;
        let is_cast = asks_nodes && builder == LineSpaceBuilder::RayCast;
        let which = if asks_nodes {
            "mask or ray_cast with structure ntree"
        } else {
            "mask with structure ntree and policy exact"
        };
        let is_right = !fits || is_masked || is_cast;
        c.check(is_right, "line_space/builder", &format!("must be {which}"));
        let fits = !is_masked || line_space.n.is_none_or(|patches| patches <= n);
        c.check(fits, "line_space/n", &format!("must be at most the structure's n, {n}: patches are whole cells wide"));
        c.check(levels > 1, "depth", "must be at least 2 with a line_space: nodes below the root have them");
        let fits = line_space.depth.is_none_or(|depth| (1..levels).contains(&depth)) || levels <= 1;
        let deepest = levels.max(1) - 1;
        c.check(fits, "line_space/depth", &format!("must be 1 to {deepest}, below the structure's depth, or null"));
    }

    /// Line Spaces of meshes, and of the nodes of their BVHs.
    fn validate_nodes(&self, line_space: &LineSpace, prefix: &str, errors: &mut Vec<FieldError>) {
        let mut c = Checker { prefix, errors };
        let bounces = self.policy.bounces();
        let asks = |policy| bounces.contains(&policy);
        let is_flat = self.structure == StructureKind::Bvh;
        c.check(
            !(is_flat && self.policy == Policy::Exact),
            "policy",
            "must not be exact with structure bvh: a ray inside the scene's only box is told nothing",
        );
        c.check(!(is_flat && asks(BouncePolicy::Adaptive)), "policy", ADAPTIVE_BY_OBJECT);
        let is_deep = line_space.depth.is_some_and(|depth| depth > 0);
        c.check(
            !(is_deep && self.policy == Policy::Exact),
            "policy",
            "must not be exact with a depth above 0: exact asks the mesh's own box alone",
        );
        let fits = !self.asks_nodes() || line_space.payload != LineSpacePayload::TriState;
        c.check(fits, "line_space/payload", "must be binary, candidate or coverage for this policy and depth");
        let fits = !asks(BouncePolicy::Representative) || line_space.payload == LineSpacePayload::Candidate;
        c.check(fits, "line_space/payload", "must be candidate with policy representative");
    }
}

fn in_range(value: f32, least: f32, most: f32) -> bool {
    (least..=most).contains(&value)
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

    fn wrong_with(policy: Value, line_space: Value) -> Vec<String> {
        wrong(json!({ "acceleration": { "policy": policy, "line_space": line_space } }))
    }

    #[test]
    fn what_cannot_be_combined_is_refused_at_its_place() {
        let on_gpu = |acceleration: Value| wrong(json!({ "device": "gpu", "acceleration": acceleration }));
        let binary = json!({ "payload": "binary" });
        assert_eq!(on_gpu(json!({ "line_space": {} })), [""; 0]);
        assert_eq!(on_gpu(json!({ "line_space": binary, "policy": "approximate_occlusion" })), [""; 0]);
        assert_eq!(on_gpu(json!({ "line_space": binary, "policy": "adaptive" })), ["line_space"]);
        assert_eq!(on_gpu(json!({ "structure": "ntree", "line_space": binary })), ["line_space"]);
        assert_eq!(wrong(json!({ "acceleration": { "structure": "octree", "line_space": {} } })), ["line_space"]);
        assert_eq!(wrong(json!({ "acceleration": { "structure": "bvh", "line_space": {} } })), ["policy"]);
        assert!(serde_json::from_value::<RenderSettings>(json!({ "acceleration": { "policy": "quick" } })).is_err());
    }

    #[test]
    fn nodes_of_an_ntree_have_line_spaces_of_what_their_policy_asks() {
        let with = |n: u32, policy: Value, line_space: Value| {
            let acceleration =
                json!({ "structure": "ntree", "n": n, "depth": 3, "line_space": line_space, "policy": policy });
            wrong(json!({ "acceleration": acceleration }))
        };
        let exact = |n: u32, line_space: Value| with(n, json!("exact"), line_space);
        for good in [
            json!({ "payload": "binary" }),
            json!({ "payload": "binary", "n": 8, "depth": 2, "builder": "mask" }),
            json!({ "payload": "binary", "n": 1, "depth": 1, "ask": "always", "on_over_budget": "skip" }),
        ] {
            assert_eq!(exact(8, good.clone()), [""; 0], "{good}");
        }
        assert_eq!(exact(8, json!({})), ["line_space/payload"]);
        assert_eq!(exact(8, json!({ "payload": "binary", "depth": 0 })), ["line_space/depth"]);
        assert_eq!(exact(8, json!({ "payload": "binary", "n": 9, "depth": 3 })), ["line_space/n", "line_space/depth"]);
        assert_eq!(exact(8, json!({ "payload": "binary", "builder": "clip" })), ["line_space/builder"]);
        assert_eq!(exact(8, json!({ "payload": "binary", "builder": "ray_cast" })), ["line_space/builder"]);
        assert_eq!(exact(16, json!({ "payload": "binary" })), [""; 0]);
        assert_eq!(exact(16, json!({ "payload": "binary", "n": 13 })), ["line_space/n"]);

        let (occlusion, representative) = (|| json!("approximate_occlusion"), || json!("representative"));
        let candidate = || json!({ "payload": "candidate", "n": 10 });
        for (policy, line_space) in [
            (occlusion(), json!({ "payload": "binary" })),
            (occlusion(), json!({ "payload": "binary", "builder": "ray_cast", "n": 20, "depth": 1 })),
            (occlusion(), json!({ "payload": "coverage", "depth": 2 })),
            (representative(), candidate()),
            (json!({ "per_bounce": ["exact", "approximate_occlusion", "representative"] }), candidate()),
        ] {
            assert_eq!(with(8, policy, line_space.clone()), [""; 0], "{line_space}");
        }
        assert_eq!(with(8, occlusion(), json!({})), ["line_space/payload"]);
        assert_eq!(with(8, representative(), json!({ "payload": "binary" })), ["line_space/payload"]);
        assert_eq!(with(8, occlusion(), json!({ "payload": "binary", "depth": 0 })), ["line_space/depth"]);
        assert_eq!(with(8, occlusion(), json!({ "payload": "binary", "builder": "clip" })), ["line_space/builder"]);
        assert_eq!(with(8, json!("adaptive"), json!({ "payload": "binary" })), ["policy"]);
        let flat = json!({
            "structure": "ntree", "depth": 1, "policy": "approximate_occlusion", "line_space": { "payload": "binary" },
        });
        assert_eq!(wrong(json!({ "acceleration": flat })), ["depth"]);
    }

    #[test]
    fn policies_need_what_they_ask() {
        let binary = || json!({ "payload": "binary", "depth": 6 });
        let candidate = || json!({ "payload": "candidate", "depth": 12 });
        for (policy, line_space) in [
            (json!("approximate_occlusion"), json!({})),
            (json!("approximate_occlusion"), json!({ "payload": "coverage", "depth": 3 })),
            (json!("adaptive"), binary()),
            (json!("adaptive"), candidate()),
            (json!("representative"), candidate()),
            (json!({ "per_bounce": ["exact", "adaptive", "representative"] }), candidate()),
        ] {
            assert_eq!(wrong_with(policy.clone(), line_space), [""; 0], "{policy}");
        }
        for policy in [json!("approximate_occlusion"), json!("adaptive"), json!({ "per_bounce": ["exact"] })] {
            assert_eq!(wrong_with(policy.clone(), Value::Null), ["policy"], "{policy}");
        }
        assert_eq!(wrong_with(json!("exact"), binary()), ["policy"]);
        assert_eq!(wrong_with(json!("adaptive"), json!({})), ["line_space/payload"]);
        assert_eq!(wrong_with(json!("approximate_occlusion"), json!({ "depth": 1 })), ["line_space/payload"]);
        assert_eq!(wrong_with(json!({ "per_bounce": ["exact", "representative"] }), binary()), ["line_space/payload"]);
        assert_eq!(wrong_with(json!({ "per_bounce": [] }), binary()), ["policy"]);
        let flat = json!({ "structure": "bvh", "policy": "adaptive", "line_space": binary() });
        assert_eq!(wrong(json!({ "acceleration": flat })), ["policy"]);
        let numbers = json!({
            "adaptive": { "delta": -1.0 },
            "origin_reach": 17.0,
            "representative": { "angle_threshold_deg": 181.0, "range_slack": 1.5 },
        });
        let fields =
            ["adaptive/delta", "origin_reach", "representative/angle_threshold_deg", "representative/range_slack"];
        assert_eq!(wrong(json!({ "acceleration": numbers })), fields);
    }
}
