//! What rays are traced against: one or more structures, placed in the world.

use std::sync::Arc;

use glam::Affine3A;
use rayon::prelude::*;

use super::approximate::{Approximating, Approximation, CellsWalk, ObjectWalk, Purpose, Question};
use super::compressed::CompressedBvh;
use super::flat::{NamedSink, Names};
use super::line_space::{CellSpaces, Gates, LineSpace, NodeSpaces, SurfaceShafts, pays, pays_in_cells};
use super::two_level::TwoLevel;
use super::{Bvh2, CellShafts, Structure};
use crate::scene::MeshHash;
use crate::trace::{Counters, Hit, Kernels, ObjectRay, Ray, Sink};

/// One placed mesh, as the top level sees it.
#[derive(Clone, Copy, Debug)]
pub struct Placement {
    /// Index into the scene's structures.
    pub mesh: u32,
    pub transform: Affine3A,
    /// Candidate hits of this instance go through the [`HitFilter`].
    pub filtered: bool,
}

/// Where a ray starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SurfaceStart {
    /// Index into the scene's placements.
    pub instance: u32,
    /// Of the instance's mesh.
    pub triangle: u32,
    /// Whether it leaves to the side from which the triangle's corners are seen counter-clockwise, in the mesh's space.
    pub is_front: bool,
}

/// Decides whether a candidate hit counts (alpha mask and blend). Must depend on the hit alone, never on the order of
/// the calls: the same ray gives the same answers on every device.
pub trait HitFilter {
    fn accept(&self, ray: &Ray, hit: &Hit) -> bool;
}

/// A scene of placed structures: a top level over one structure for each mesh, or one structure over everything.
#[derive(Debug)]
pub struct SceneAccel {
    structures: Vec<Structure>,
    form: Form,
    gates: Gates,
    approximating: Option<Approximating>,
    kernels: Kernels,
}

#[derive(Debug)]
enum Form {
    TwoLevel(TwoLevel),
    /// One structure in world space.
    Flat {
        names: Names,
        shafts: Option<Arc<CellShafts>>,
        asks: bool,
    },
}

/// The top level of a scene that has none.
static NO_TOP: Bvh2 = Bvh2 { nodes: Vec::new(), primitives: Vec::new() };

impl SceneAccel {
    /// Builds the top level over structures of any kind. An instance whose transform cannot be inverted has no surface
    /// and is left out.
    ///
    /// # Panics
    /// When a placement refers to a structure that is not there, or with more than 2^27 placements.
    pub fn build<T: Into<Structure>>(structures: Vec<T>, placements: &[Placement]) -> Self {
        let structures: Vec<Structure> = structures.into_iter().map(Into::into).collect();
        let top = TwoLevel::build(&structures, placements);
        let form = Form::TwoLevel(top);
        Self { structures, form, gates: Gates::default(), approximating: None, kernels: Kernels::detect() }
    }

    /// One structure over the mesh that [`flatten`](super::flatten) made, with the names that it gave.
    pub fn flat(structure: impl Into<Structure>, names: Names) -> Self {
        let (form, gates) = (Form::Flat { names, shafts: None, asks: false }, Gates::default());
        Self { structures: vec![structure.into()], form, gates, approximating: None, kernels: Kernels::detect() }
    }

    /// The same scene, walked by other kernels than the best for this CPU: their answers are the same.
    pub fn with_kernels(self, kernels: Kernels) -> Self {
        Self { kernels, ..self }
    }

    /// The same scene, with Line Spaces that are asked before the structure of a mesh is walked: one, or none, for each of
    /// [`Self::structures`]. All answers stay the same; those with a payload of classes spare work.
    ///
    /// # Errors
    /// In a flat scene, when there are more or fewer than structures, or one is for another mesh.
    pub fn with_line_spaces(self, line_spaces: Vec<Option<Arc<LineSpace>>>) -> Result<Self, String> {
        self.check_two_level("line spaces")?;
        self.check_gates("line spaces", line_spaces.iter().map(|space| space.as_ref().map(|space| space.mesh())))?;
        let asked = line_spaces.clone();
        Ok(Self { gates: Gates { line_spaces, asked, measured: false, ..self.gates }, ..self })
    }

    /// The same scene, in which only those Line Spaces are asked that are found, by a short measurement, to be faster than the
    /// structures behind them. The measurement is the CPU's: a GPU asks none of them.
    pub fn asking_where_it_pays(mut self) -> Self {
        if let Form::Flat { shafts: Some(shafts), asks, .. } = &mut self.form {
            *asks = self.structures[0].cells().is_some_and(|tree| pays_in_cells(shafts, tree, self.kernels));
            return self;
        }
        let pairs = self.gates.line_spaces.par_iter().zip(&self.structures);
        let kept = |(space, structure): (&Option<Arc<LineSpace>>, &Structure)| {
            space.clone().filter(|space| pays(space, structure, self.kernels))
        };
        let mut asked: Vec<_> = pairs.map(kept).collect();
        if asked.iter().all(Option::is_none) {
            asked.clear();
        }
        Self { gates: Gates { asked, measured: true, ..self.gates }, ..self }
    }

    /// The same scene, with surface shafts that [`Self::occluded_from`] asks: one, or none, for each of
    /// [`Self::structures`]. Its answers are as exact as they are.
    ///
    /// # Errors
    /// In a flat scene, when there are more or fewer than structures, or one is for another mesh.
    pub fn with_surface_shafts(self, surfaces: Vec<Option<Arc<SurfaceShafts>>>) -> Result<Self, String> {
        self.check_two_level("surface shafts")?;
        self.check_gates("surface shafts", surfaces.iter().map(|shafts| shafts.as_ref().map(|shafts| shafts.mesh())))?;
        Ok(Self { gates: Gates { surfaces, ..self.gates }, ..self })
    }

    /// The same scene, whose occlusion rays are blocked by every shaft that holds something: see
    /// [`Self::with_line_spaces`], all of which are asked. Rays that start or end in a mesh's box, and instances with filtered hits, are
    /// traced exactly; so are nearest hits.
    pub fn approximating_occlusion(self) -> Self {
        let asked = self.gates.line_spaces.clone();
        Self { gates: Gates { asked, measured: false, approximate: true, ..self.gates }, ..self }
    }

    /// The same flat scene, whose rays pass by the nodes of its N-tree in which their shaft is empty. All answers stay the same.
    ///
    /// # Errors
    /// When the scene is no single tree of cells, or `shafts` are those of another one.
    pub fn with_cell_shafts(self, shafts: Arc<CellShafts>) -> Result<Self, String> {
        let Form::Flat { names, .. } = self.form else {
            return Err("line spaces of nodes need a flat scene".into());
        };
        match self.structures[0].cells() {
            Some(tree) if shafts.fit(tree) => {
                Ok(Self { form: Form::Flat { names, shafts: Some(shafts), asks: true }, ..self })
            }
            _ => Err(format!("line spaces of the nodes of a tree over {}, but the scene has another", shafts.mesh())),
        }
    }

    /// The Line Spaces of the nodes of a flat scene's N-tree.
    pub fn cell_shafts(&self) -> Option<&Arc<CellShafts>> {
        match &self.form {
            Form::Flat { shafts, .. } => shafts.as_ref(),
            Form::TwoLevel(_) => None,
        }
    }

    /// Whether those are asked: see [`Self::asking_where_it_pays`].
    pub fn asks_cell_shafts(&self) -> bool {
        matches!(self.form, Form::Flat { asks: true, .. })
    }

    fn check_two_level(&self, what: &str) -> Result<(), String> {
        if self.is_flat() { Err(format!("{what} belong to meshes, and a flat scene has none")) } else { Ok(()) }
    }

    /// The same scene, in which [`Self::nearest`] and [`Self::blocked`] take for true what the Line Spaces of nodes say: one, or
    /// none, for each of [`Self::structures`], which are BVHs.
    ///
    /// # Errors
    /// When there are more or fewer than structures, or one is for another mesh.
    pub fn approximating(self, nodes: Vec<Option<Arc<NodeSpaces>>>, rules: Approximation) -> Result<Self, String> {
        self.check_gates("line spaces", nodes.iter().map(|nodes| nodes.as_ref().map(|nodes| nodes.mesh())))?;
        Ok(Self { approximating: Some(Approximating { nodes, cells: None, rules }), ..self })
    }

    /// The same flat scene, in which [`Self::nearest`] and [`Self::blocked`] take for true what the Line Spaces of the nodes of its
    /// N-tree say. A scene in which hits are filtered is traced exactly.
    ///
    /// # Errors
    /// When the scene is no single tree of cells, or `cells` are those of another one.
    pub fn approximating_in_cells(self, cells: Arc<CellSpaces>, rules: Approximation) -> Result<Self, String> {
        match self.structures.first().and_then(Structure::cells) {
            Some(tree) if self.is_flat() && cells.fit(tree) => {
                Ok(Self { approximating: Some(Approximating { nodes: vec![], cells: Some(cells), rules }), ..self })
            }
            _ => Err(format!("line spaces of the nodes of a tree over {}, but the scene has another", cells.mesh())),
        }
    }

    /// The Line Spaces of an N-tree's nodes that the scene takes for true.
    pub fn cell_spaces(&self) -> Option<&Arc<CellSpaces>> {
        self.approximating.as_ref()?.cells.as_ref()
    }

    /// The Line Spaces of nodes that the scene was given.
    pub fn node_spaces(&self) -> &[Option<Arc<NodeSpaces>>] {
        self.approximating.as_ref().map_or(&[], |approximating| &approximating.nodes)
    }

    fn check_gates(&self, what: &str, meshes: impl ExactSizeIterator<Item = Option<MeshHash>>) -> Result<(), String> {
        if meshes.len() != self.structures.len() {
            return Err(format!("{} {what} for {} structures", meshes.len(), self.structures.len()));
        }
        for (structure, mesh) in self.structures.iter().zip(meshes) {
            if let Some(mesh) = mesh.filter(|&mesh| mesh != structure.mesh()) {
                return Err(format!("{what} of mesh {mesh} for {}", structure.mesh()));
            }
        }
        Ok(())
    }

    /// The nearest hit in `(t_min, t_max)`. Of several at the same `t` the one of the lowest instance counts, and in it
    /// that of the lowest primitive: so the answer does not depend on the structure.
    pub fn closest(&self, ray: &Ray, filter: &dyn HitFilter, counters: &mut Counters) -> Option<Hit> {
        let nothing = Hit { t: ray.t_max, u: 0.0, v: 0.0, instance: 0, primitive: 0 };
        let mut sink = Closest { best: nothing, found: false };
        self.walk::<false>(ray, filter, &mut sink, counters);
        sink.found.then_some(sink.best)
    }

    /// Whether anything is hit in `(t_min, t_max)`.
    pub fn occluded(&self, ray: &Ray, filter: &dyn HitFilter, counters: &mut Counters) -> bool {
        self.walk::<true>(ray, filter, &mut Any { t_max: ray.t_max }, counters)
    }

    /// Like [`Self::closest`], of a ray that leaves its `bounce`-th bounce (0: the camera), with what the scene takes for true of it.
    /// A hit on a candidate may lie outside of its triangle.
    pub fn nearest(&self, ray: &Ray, bounce: u32, filter: &dyn HitFilter, counters: &mut Counters) -> Option<Hit> {
        let Some(question) = self.approximating.as_ref().and_then(|asked| asked.nearest(bounce)) else {
            return self.closest(ray, filter, counters);
        };
        let nothing = Hit { t: ray.t_max, u: 0.0, v: 0.0, instance: 0, primitive: 0 };
        let mut sink = Closest { best: nothing, found: false };
        self.walk_nodes(&question, ray, filter, &mut sink, counters);
        sink.found.then_some(sink.best)
    }

    /// Like [`Self::occluded`], with what the scene takes for true of rays for this purpose.
    pub fn blocked(&self, ray: &Ray, purpose: Purpose, filter: &dyn HitFilter, counters: &mut Counters) -> bool {
        match self.approximating.as_ref().and_then(|asked| asked.occlusion(purpose)) {
            None => self.occluded(ray, filter, counters),
            Some(question) => self.walk_nodes(&question, ray, filter, &mut Any { t_max: ray.t_max }, counters),
        }
    }

    /// The largest gamma of the objects that a ray for this purpose comes to (thesis, section 8.3.2); 0 where its policy is not
    /// adaptive.
    pub(crate) fn largest_gamma(&self, ray: &Ray, purpose: Purpose) -> f32 {
        match (&self.form, &self.approximating) {
            (Form::TwoLevel(top), Some(approximating)) => {
                top.scene(&self.structures, &self.gates, self.kernels).largest_gamma(approximating, purpose, ray)
            }
            _ => 0.0,
        }
    }

    fn walk_nodes(
        &self,
        question: &Question<'_>,
        ray: &Ray,
        filter: &dyn HitFilter,
        sink: &mut impl Sink,
        counters: &mut Counters,
    ) -> bool {
        match &self.form {
            Form::TwoLevel(top) => {
                let scene = top.scene(&self.structures, &self.gates, self.kernels);
                scene.walk_nodes(question, ray, filter, sink, counters)
            }
            Form::Flat { names, .. } => {
                let mut sink = NamedSink { names, filter, ray, sink };
                let structure = &self.structures[0];
                let asked = if names.any_filtered() { None } else { Some(question.asked) };
                let stopped = match (structure, asked.and_then(|a| a.spaces(0)), asked.and_then(|a| a.cells.as_ref())) {
                    (Structure::Bvh(bvh), Some(spaces), _) => {
                        let walk = ObjectWalk { spaces, bvh, kernels: self.kernels, question, number: 0 };
                        walk.ask(ray, &mut sink, counters)
                    }
                    (Structure::Cells(tree), _, Some(spaces)) => {
                        CellsWalk::walk(spaces, tree, self.kernels, question, ray, &mut sink, counters)
                    }
                    _ => None,
                };
                if let Some(stopped) = stopped {
                    return stopped;
                }
                let Some(object_ray) = ObjectRay::new(ray, &structure.bounds()) else { return false };
                structure.walk(self.kernels, &object_ray, 0, &mut sink, counters)
            }
        }
    }

    /// Like [`Self::occluded`], for a ray that starts just above a triangle. With surface shafts, the mesh that it starts on
    /// is asked first: it blocks most rays that are blocked at all.
    pub fn occluded_from(
        &self,
        ray: &Ray,
        start: &SurfaceStart,
        filter: &dyn HitFilter,
        counters: &mut Counters,
    ) -> bool {
        match &self.form {
            Form::TwoLevel(top) if !self.gates.surfaces.is_empty() => {
                let mut sink = Any { t_max: ray.t_max };
                let scene = top.scene(&self.structures, &self.gates, self.kernels);
                scene.walk_from(start, ray, filter, &mut sink, counters)
            }
            _ => self.occluded(ray, filter, counters),
        }
    }

    /// `ANY`: the sink stops at any hit, so that a gate may answer for it.
    #[inline(always)]
    fn walk<const ANY: bool>(
        &self,
        ray: &Ray,
        filter: &dyn HitFilter,
        sink: &mut impl Sink,
        counters: &mut Counters,
    ) -> bool {
        match &self.form {
            Form::TwoLevel(top) => {
                let scene = top.scene(&self.structures, &self.gates, self.kernels);
                // Scenes without gates go a way that knows nothing of them.
                if self.gates.asked.is_empty() {
                    scene.walk::<ANY, false>(ray, filter, sink, counters)
                } else {
                    scene.walk::<ANY, true>(ray, filter, sink, counters)
                }
            }
            Form::Flat { names, shafts, asks } => {
                let structure = &self.structures[0];
                let Some(object_ray) = ObjectRay::new(ray, &structure.bounds()) else { return false };
                let mut sink = NamedSink { names, filter, ray, sink };
                match (structure.cells(), shafts) {
                    (Some(tree), Some(shafts)) if *asks => {
                        self.kernels.walk_cells(tree, Some(shafts), &object_ray, 0, &mut sink, counters)
                    }
                    _ => structure.walk(self.kernels, &object_ray, 0, &mut sink, counters),
                }
            }
        }
    }

    /// Bytes of the top level alone.
    pub fn top_bytes(&self) -> usize {
        match &self.form {
            Form::TwoLevel(top) => top.bytes(),
            Form::Flat { names, .. } => names.bytes(),
        }
    }

    /// The top level over world-space instance bounds, whose primitives are instance numbers; empty in a flat scene.
    pub fn top(&self) -> &Bvh2 {
        match &self.form {
            Form::TwoLevel(top) => top.tree(),
            Form::Flat { .. } => &NO_TOP,
        }
    }

    /// The top level as GPUs walk it; empty in a flat scene.
    pub(crate) fn compressed_top(&self) -> CompressedBvh {
        match &self.form {
            Form::TwoLevel(top) => top.compressed(),
            Form::Flat { .. } => CompressedBvh::default(),
        }
    }

    /// One structure for each mesh, or the one of a flat scene.
    pub fn structures(&self) -> &[Structure] {
        &self.structures
    }

    /// The Line Spaces that the scene was given: none at all, or one, or none, for each structure.
    pub fn line_spaces(&self) -> &[Option<Arc<LineSpace>>] {
        &self.gates.line_spaces
    }

    /// What is asked before the structure of a mesh is walked.
    pub(crate) fn gates(&self) -> &Gates {
        &self.gates
    }

    /// How many Line Spaces are asked before the structure of their mesh is walked.
    pub fn asked_line_spaces(&self) -> usize {
        self.gates.asked.iter().flatten().count()
    }

    /// How many of them a GPU asks.
    pub fn line_spaces_asked_on_gpu(&self) -> usize {
        self.gates.asked_on_gpu().iter().flatten().count()
    }

    /// Which primitive of the one structure belongs to which instance, in a flat scene.
    pub(crate) fn names(&self) -> Option<&Names> {
        match &self.form {
            Form::Flat { names, .. } => Some(names),
            Form::TwoLevel(_) => None,
        }
    }

    /// Whether one structure holds all instances.
    pub fn is_flat(&self) -> bool {
        matches!(self.form, Form::Flat { .. })
    }
}

struct Closest {
    best: Hit,
    found: bool,
}

impl Sink for Closest {
    #[inline(always)]
    fn t_limit(&self) -> f32 {
        self.best.t
    }

    #[inline(always)]
    fn offer(&mut self, hit: Hit) -> bool {
        let tie = hit.t == self.best.t && (hit.instance, hit.primitive) < (self.best.instance, self.best.primitive);
        if hit.t < self.best.t || tie {
            *self = Self { best: hit, found: true };
        }
        false
    }
}

struct Any {
    t_max: f32,
}

impl Sink for Any {
    #[inline(always)]
    fn t_limit(&self) -> f32 {
        self.t_max
    }

    #[inline(always)]
    fn offer(&mut self, hit: Hit) -> bool {
        hit.t < self.t_max
    }
}
