//! The fields that say what Line Spaces are used for.

use lightshaft_api::settings::{Acceleration, Policy};

use super::{ChoiceOption, Control, Field, choice, chosen, number, options};

pub(super) const POLICY: &str = "/settings/acceleration/policy";
const POLICIES: [(&str, &str); 4] = [
    ("exact", "What is proven: the same picture"),
    ("approximate_occlusion", "Approximate shadows and ambient occlusion"),
    ("adaptive", "The same, of objects that are far for their size"),
    ("representative", "Approximate indirect light"),
];
const ADAPTIVE: &str = "\"adaptive\"";
const REPRESENTATIVE: &str = "\"representative\"";

/// The choice of a policy, then the parameters of each. A list by bounce cannot be put together here, but is kept.
pub(super) fn fields(a: &Acceleration) -> Vec<Field> {
    let mut policies = options(&[&a.policy], &POLICIES.map(|(name, _)| name), &POLICIES);
    if let Policy::PerBounce(_) = a.policy {
        let value = serde_json::to_string(&a.policy).unwrap_or_default();
        policies.push(ChoiceOption { value, label: "Bounce by bounce, as given".to_owned(), selected: true });
    }
    let current = chosen(&policies);
    let field = |name: &str, label, unit, help, control| {
        Field::new(&format!("/settings/acceleration/{name}"), label, unit, help, control)
    };
    let switch = |on| Control::Switch { on };
    let (adaptive, candidates) = (&a.adaptive, &a.representative);
    let origin_node = choice(a.origin_node, &[("exact", "Test its geometry"), ("skip", "Skip it")]);
    let origin_object =
        choice(adaptive.origin_object, &[("exact", "Test its geometry"), ("line_space", "Ask its boxes")]);
    let origin_candidate = choice(
        candidates.origin_node,
        &[("exact", "Test its geometry"), ("approximate", "Ask its candidates: leaks light")],
    );
    vec![
        field(
            "policy",
            "Used for",
            "",
            "Approximate: where a shaft holds something, it blocks.",
            Control::Choice { options: policies },
        ),
        field("origin_node", "Box where a ray starts", "", "", origin_node).when(
            POLICY,
            "\"approximate_occlusion\"",
            &current,
        ),
        field(
            "origin_reach",
            "and all nearer than",
            "of their edges",
            "Less: faster, and surfaces darken themselves.",
            number(a.origin_reach, "0", "16"),
        )
        .when(POLICY, "\"approximate_occlusion\"", &current),
        field(
            "adaptive/delta",
            "Delta",
            "",
            "0: exact. More: nearer objects are approximated.",
            number(adaptive.delta, "0", "1000000"),
        )
        .when(POLICY, ADAPTIVE, &current),
        field("adaptive/interpolate", "Mix two depths", "", "", switch(adaptive.interpolate))
            .when(POLICY, ADAPTIVE, &current),
        field(
            "adaptive/disc_sampling",
            "Move ambient-occlusion rays",
            "",
            "Less banding.",
            switch(adaptive.disc_sampling),
        )
        .when(POLICY, ADAPTIVE, &current),
        field("adaptive/origin_object", "Object where a ray starts", "", "", origin_object)
            .when(POLICY, ADAPTIVE, &current),
        field(
            "representative/angle_threshold_deg",
            "Greatest angle of normals",
            "degrees",
            "180: any.",
            number(candidates.angle_threshold_deg, "0", "180"),
        )
        .when(POLICY, REPRESENTATIVE, &current),
        field(
            "representative/range_slack",
            "Boxes grow by",
            "of a diagonal",
            "",
            number(candidates.range_slack, "0", "1"),
        )
        .when(POLICY, REPRESENTATIVE, &current),
        field("representative/origin_node", "Box where a ray starts", "", "", origin_candidate).when(
            POLICY,
            REPRESENTATIVE,
            &current,
        ),
    ]
}
