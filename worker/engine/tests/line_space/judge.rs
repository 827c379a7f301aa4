//! How far the approximate policies are from the truth, ray by ray.

use lightshaft_engine::accel::line_space::CandidateRules;
use lightshaft_engine::accel::{AdaptiveRules, Approximation, BouncePolicy, Purpose, SceneAccel};
use lightshaft_engine::trace::{Counters, Ray};

use crate::common::{AcceptAll, closest, occluded};

/// Of what the camera sees, from a light that is as large as it is far.
pub(crate) const SHADOW: Purpose = Purpose { bounce: 0, light: 1.0, is_ambient: false };

/// One policy for all bounces; the nodes in which a ray starts are exact, and those alone.
pub(crate) fn rules(policy: BouncePolicy) -> Approximation {
    Approximation {
        bounces: vec![policy],
        exact_origin: true,
        origin_reach: 0.0,
        adaptive: AdaptiveRules::default(),
        candidates: CandidateRules::default(),
    }
}

/// Shares of the occlusion rays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Wrong {
    /// Something blocks them.
    pub let_through: f64,
    /// Nothing does.
    pub blocked: f64,
}

impl Wrong {
    pub(crate) fn total(self) -> f64 {
        self.let_through + self.blocked
    }
}

/// Which answers differ, and what the approximating scene counted.
pub(crate) fn wrong(
    plain: &SceneAccel,
    approximating: &SceneAccel,
    rays: &[Ray],
    purpose: Purpose,
) -> (Wrong, Counters) {
    let mut counters = Counters::default();
    let (mut let_through, mut blocked) = (0, 0);
    for ray in rays {
        let truth = occluded(plain, ray);
        let found = approximating.blocked(ray, purpose, &AcceptAll, &mut counters);
        let_through += u32::from(truth && !found);
        blocked += u32::from(found && !truth);
    }
    let share = |count: u32| f64::from(count) / rays.len() as f64;
    (Wrong { let_through: share(let_through), blocked: share(blocked) }, counters)
}

/// Share of the rays of the first bounce that hit something in one scene alone, and the mean error of the distance of those that hit
/// in both. The camera's rays must not err.
pub(crate) fn candidate_errors(plain: &SceneAccel, approximating: &SceneAccel, rays: &[Ray]) -> [f64; 2] {
    let (mut missed, mut hits, mut error) = (0, 0, 0.0);
    let nearest = |ray, bounce| approximating.nearest(ray, bounce, &AcceptAll, &mut Counters::default());
    for ray in rays {
        let truth = closest(plain, ray);
        assert_eq!(nearest(ray, 0), truth, "the camera's are exact");
        match (truth, nearest(ray, 1)) {
            (Some(truth), Some(found)) => {
                hits += 1;
                error += f64::from(ray.direction.length() * (truth.t - found.t).abs());
            }
            (None, None) => {}
            _ => missed += 1,
        }
    }
    assert!(hits > 1000, "{hits}");
    [f64::from(missed) / rays.len() as f64, error / f64::from(hits)]
}
