//! The approximate policies in a flat scene's N-tree: nodes of one level answer (Keul 2020, chapters 5 and 6).

use super::{AskedBox, BouncePolicy, Plan, Question};
use crate::accel::CellTree;
use crate::accel::line_space::{CellSpaces, GateCounters};
use crate::trace::{Counters, Hit, Kernels, NodeSink, ObjectRay, Ray, Sink, Way};

impl Question<'_> {
    /// How a ray goes on in the one object of a flat scene; none for one that is traced exactly.
    fn flat_plan(&self) -> Option<Plan> {
        match self.policy {
            BouncePolicy::Exact | BouncePolicy::Adaptive => None,
            BouncePolicy::Occlusion => Some(self.asked.rules.plan_of_occlusion(0)),
            BouncePolicy::Representative => Some(Plan::at(0, self.asked.rules.candidates.exact_origin)),
        }
    }
}

/// A ray on its way through an N-tree whose nodes at one level are asked.
pub(in crate::accel) struct CellsWalk<'a, S> {
    spaces: &'a CellSpaces,
    question: &'a Question<'a>,
    plan: Plan,
    ray: &'a Ray,
    sink: &'a mut S,
    gates: GateCounters,
}

impl<'a, S: Sink> CellsWalk<'a, S> {
    /// Whether the sink wants no more; none for a ray that is to be traced exactly.
    pub(in crate::accel) fn walk(
        spaces: &'a CellSpaces,
        tree: &CellTree,
        kernels: Kernels,
        question: &'a Question<'a>,
        ray: &'a Ray,
        sink: &'a mut S,
        counters: &mut Counters,
    ) -> Option<bool> {
        let plan = question.flat_plan()?;
        let Some(object_ray) = ObjectRay::new(ray, &tree.bounds()) else { return Some(false) };
        let level = spaces.level();
        let mut walk = CellsWalk { spaces, question, plan, ray, sink, gates: GateCounters::default() };
        let stopped = kernels.walk_cells_to_nodes(tree, level, &object_ray, 0, &mut walk, counters);
        counters.add_walk(&Counters { gates: walk.gates, ..Counters::default() });
        Some(stopped)
    }
}

impl<S: Sink> Sink for CellsWalk<'_, S> {
    #[inline(always)]
    fn t_limit(&self) -> f32 {
        self.sink.t_limit()
    }

    #[inline(always)]
    fn offer(&mut self, hit: Hit) -> bool {
        self.sink.offer(hit)
    }
}

impl<S: Sink> NodeSink for CellsWalk<'_, S> {
    #[inline(always)]
    fn node(&mut self, number: u32) -> Way {
        let Some(space) = self.spaces.of_node(number) else { return Way::Down };
        let Some((grid, shafts)) = &space.content else { return Way::Down };
        let triangles = self.spaces.triangles();
        let asked = AskedBox { grid, shafts, bounds: &space.bounds, salt: number, triangles, instance: 0 };
        self.question.ask(&asked, self.ray, &self.plan, self.sink, &mut self.gates)
    }
}
