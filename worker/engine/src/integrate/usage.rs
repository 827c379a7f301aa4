//! What Line Spaces did for a pixel: layers that show where they answer, and where the usage heuristic uses them.
//!
//! They tell of all rays of the pixel's first sample, traced as the integrator traces them for the picture: of the
//! camera's, and of those that follow. (A ray through the pixel's centre alone would tell nothing of shadow and
//! ambient-occlusion rays, which are what most policies answer.)

use glam::Vec3;

use super::{Sample, Tally, radiance};
use crate::accel::line_space::Class;
use crate::film::AovLayer;
use crate::pack::PackedScene;
use crate::settings::{Aov, Integrator};
use crate::trace::Counters;

/// What Line Spaces did for some rays.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Usage {
    rays: u32,
    /// Rays for which something was taken for true that is not proven; that passed a mesh or a node by, and met no
    /// primitive to test; that an OPAQUE shaft ended. All others were answered by the base structure.
    answers: [u32; 3],
    /// The largest of the usage heuristic; 0 where none was computed.
    gamma: f32,
    look_ups: u32,
    /// Meshes and nodes passed by.
    skipped: u32,
}

const APPROXIMATED: usize = 0;
const EMPTY: usize = 1;
const OPAQUE: usize = 2;

impl Usage {
    /// One more ray, with what it alone took.
    pub(super) fn add(&mut self, counters: &Counters, is_blocked: bool) {
        let gates = &counters.gates;
        let of_class = |class: Class| gates.full_chord[class as usize] + gates.ends_inside[class as usize];
        let skipped = of_class(Class::Empty) + gates.skipped_nodes;
        self.rays += 1;
        if gates.approximated > 0 {
            self.answers[APPROXIMATED] += 1;
        } else if is_blocked && gates.full_chord[Class::Opaque as usize] > 0 {
            self.answers[OPAQUE] += 1;
        } else if skipped > 0 && counters.triangle_tests == 0 {
            self.answers[EMPTY] += 1;
        }
        self.look_ups = self.look_ups.saturating_add(clamped(gates.look_ups() + gates.node_look_ups));
        self.skipped = self.skipped.saturating_add(clamped(skipped));
    }

    /// A gamma that was computed.
    pub(super) fn meet(&mut self, gamma: f32) {
        self.gamma = self.gamma.max(gamma);
    }

    /// The parts of all rays that were answered by approximation, by EMPTY and by OPAQUE shafts.
    fn shares(&self) -> Vec3 {
        Vec3::from(self.answers.map(|answered| answered as f32)) / self.rays.max(1) as f32
    }

    /// Writes the quantity of one layer to its place `i`.
    pub(crate) fn store(&self, aov: Aov, layer: &mut AovLayer, i: usize) {
        match layer {
            AovLayer::Scalar(values) => values[i] = self.gamma,
            AovLayer::Vector(values) => values[i] = self.shares().to_array(),
            AovLayer::Integer(values) => {
                values[i] = if aov == Aov::LineSpaceLookUps { self.look_ups } else { self.skipped };
            }
        }
    }
}

fn clamped(count: u64) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX)
}

/// What Line Spaces do for the first sample of pixel `(x, y)` of a job with `seed`.
pub fn usage(scene: &PackedScene, integrator: Integrator, x: u32, y: u32, seed: u32, tally: &mut Tally) -> Usage {
    let mut own = Tally { usage: Some(Usage::default()), ..Tally::default() };
    radiance(scene, integrator, Sample { x, y, index: 0, seed }, &mut own);
    tally.rays += own.rays;
    tally.counters += own.counters;
    own.usage.unwrap_or_default()
}
