//! The walk through a tree of cells: from cell to cell along the ray (Amanatides, Woo 1987, "A fast voxel traversal
//! algorithm for ray tracing"), down into the cells that are nodes, and up again where the ray leaves them. Cells are
//! met in the order of the ray, so the walk ends at the first cell behind the nearest hit.
//!
//! Where a plane of cells is crossed is computed from the plane's number, never summed up, so that errors do not grow
//! along the way. In any cell the ray then lies, to within a few roundings, inside the cell as it is walked; primitives
//! are listed in all cells that come close enough for that ([`CellTree::growth`]). A ray from far away, whose roundings
//! are larger, takes [`Margins`] instead: slab by slab it looks at all cells that are as close as its roundings.

use std::mem::MaybeUninit;

use super::Counters;
use super::kernel::{NodeSink, Sink, Way};
use super::object_ray::ObjectRay;
use super::packet::{PacketRay, test_packet};
use super::simd::{Isa, Portable};
use crate::accel::cells::{CellShafts, CellTree, LEAF, MAX_LEVELS, NodeMarks, ROUNDING};
use crate::accel::line_space::Patch;
use crate::accel::wide::LANES;

/// Packets that a walk remembers as tested: large primitives stand in many cells one after the other.
const REMEMBERED: usize = 8;

/// Offers the sink what `ray` hits; true when it wants no more. Nodes whose shaft is empty are passed by.
#[inline(always)]
pub(super) fn walk_cells<I: Isa, S: Sink>(
    tree: &CellTree,
    shafts: Option<&CellShafts>,
    ray: &ObjectRay,
    instance: u32,
    sink: &mut S,
    counters: &mut Counters,
) -> bool {
    match shafts {
        None => walk_guided::<I, S, Unguided>(tree, &Unguided, ray, instance, sink, counters),
        Some(shafts) => walk_guided::<I, S, _>(tree, &PastEmpty { shafts }, ray, instance, sink, counters),
    }
}

/// The same; the sink decides what is done with the nodes of a level. A ray from far away is not asked about any.
#[inline(always)]
pub(super) fn walk_cells_to_nodes<I: Isa, S: NodeSink>(
    tree: &CellTree,
    level: usize,
    ray: &ObjectRay,
    instance: u32,
    sink: &mut S,
    counters: &mut Counters,
) -> bool {
    walk_guided::<I, S, _>(tree, &ToLevel { level }, ray, instance, sink, counters)
}

#[inline(always)]
fn walk_guided<I: Isa, S: Sink, G: Guide<S>>(
    tree: &CellTree,
    guide: &G,
    ray: &ObjectRay,
    instance: u32,
    sink: &mut S,
    counters: &mut Counters,
) -> bool {
    let lattice = LatticeRay::new(tree, ray);
    let margin = ray.reach * ROUNDING;
    if margin > tree.growth() {
        // It calls itself, so it is compiled for any CPU; the answers are the same.
        let mut tester = Tester::<Portable, S>::new(tree, ray, instance, sink);
        let margins = Margins { tree, lattice: &lattice, margin, t_min: ray.t_min };
        let stopped = margins.visit(0, 0, [0; 3], &mut tester);
        tester.count(counters);
        return stopped;
    }
    let Some((start, end)) = lattice.root_interval(tree) else { return false };
    let (start, end) = (start.max(ray.t_min), end.min(sink.t_limit()));
    if start > end {
        return false;
    }
    let mut tester = Tester::<I, S>::new(tree, ray, instance, sink);
    let stopped = step_through(tree, guide, &lattice, start, &mut tester);
    tester.count(counters);
    stopped
}

/// Says what is done with nodes below the root before a walk goes down into them.
trait Guide<S> {
    /// Whether it is to be asked at all.
    const IS_ASKED: bool;

    fn at(&self, arrival: &Arrival<'_>, sink: &mut S, look_ups: &mut LookUps) -> Way;
}

/// A node that a walk comes to.
struct Arrival<'a> {
    tree: &'a CellTree,
    lattice: &'a LatticeRay<'a>,
    level: usize,
    node: u32,
    /// Where the walk would begin in it.
    place: &'a Place,
    /// Across which axis the ray came into it; none where it starts in it.
    entered: Option<usize>,
    /// `t` at which the ray leaves it on each axis.
    far: [f32; 3],
}

/// What guides did.
#[derive(Default)]
struct LookUps {
    asked: u64,
    skipped: u64,
}

struct Unguided;

impl<S> Guide<S> for Unguided {
    const IS_ASKED: bool = false;

    #[inline(always)]
    fn at(&self, _: &Arrival<'_>, _: &mut S, _: &mut LookUps) -> Way {
        Way::Down
    }
}

/// Past nodes in which nothing is on the line of the ray.
struct PastEmpty<'a> {
    shafts: &'a CellShafts,
}

impl<S> Guide<S> for PastEmpty<'_> {
    const IS_ASKED: bool = true;

    #[inline(always)]
    fn at(&self, arrival: &Arrival<'_>, _: &mut S, look_ups: &mut LookUps) -> Way {
        // The node in which a ray starts is asked nothing: it holds what the ray starts on.
        let Some(axis) = arrival.entered else { return Way::Down };
        let Some(marks) = self.shafts.of_node(arrival.level, arrival.node) else { return Way::Down };
        look_ups.asked += 1;
        if is_empty(marks, arrival, axis) {
            look_ups.skipped += 1;
            return Way::Past;
        }
        Way::Down
    }
}

/// To the nodes of one level, of which the sink decides.
struct ToLevel {
    level: usize,
}

impl<S: NodeSink> Guide<S> for ToLevel {
    const IS_ASKED: bool = true;

    #[inline(always)]
    fn at(&self, arrival: &Arrival<'_>, sink: &mut S, _: &mut LookUps) -> Way {
        if arrival.level == self.level { sink.node(arrival.node) } else { Way::Down }
    }
}

/// The ray in coordinates from the root's lowest corner.
struct LatticeRay<'a> {
    origin: [f32; 3],
    direction: [f32; 3],
    inverse: [f32; 3],
    /// `t` at which the planes through the root's lowest corner are crossed; infinite on axes along which the ray does
    /// not move.
    t_origin: [f32; 3],
    /// Cell edges of each level.
    cell: &'a [[f32; 3]; MAX_LEVELS],
}

impl<'a> LatticeRay<'a> {
    #[inline(always)]
    fn new(tree: &'a CellTree, ray: &ObjectRay) -> Self {
        let origin = (ray.origin - tree.origin()).to_array();
        let direction = ray.direction.to_array();
        let moves = direction.map(|d| d != 0.0);
        let inverse = std::array::from_fn(|k| if moves[k] { 1.0 / direction[k] } else { 0.0 });
        Self {
            origin,
            direction,
            inverse,
            t_origin: std::array::from_fn(|k| if moves[k] { -origin[k] * inverse[k] } else { f32::INFINITY }),
            cell: tree.level_cells(),
        }
    }

    /// `t` at which plane `number` of a level is crossed.
    #[inline(always)]
    fn t_at(&self, level: usize, axis: usize, number: u32) -> f32 {
        number as f32 * (self.cell[level][axis] * self.inverse[axis]) + self.t_origin[axis]
    }

    /// Where the ray is inside the root.
    #[inline(always)]
    fn root_interval(&self, tree: &CellTree) -> Option<(f32, f32)> {
        let (mut start, mut end) = (f32::NEG_INFINITY, f32::INFINITY);
        for axis in 0..3 {
            let dim = tree.dims()[axis];
            if self.direction[axis] == 0.0 {
                let at = self.origin[axis];
                if at < 0.0 || at > dim as f32 * self.cell[0][axis] {
                    return None;
                }
                continue;
            }
            let (a, b) = (self.t_at(0, axis, 0), self.t_at(0, axis, dim));
            start = start.max(a.min(b));
            end = end.min(a.max(b));
        }
        Some((start, end))
    }
}

/// The node that is being walked through, and where in it.
#[derive(Clone, Copy)]
struct Place {
    first_word: usize,
    /// Among all cells of the level: the node's first, and the one behind its last.
    low: [u32; 3],
    high: [u32; 3],
    cell: [u32; 3],
    /// `t` at which the cell is left on each axis.
    t_next: [f32; 3],
}

#[inline(always)]
fn step_through<I: Isa, S: Sink, G: Guide<S>>(
    tree: &CellTree,
    guide: &G,
    lattice: &LatticeRay<'_>,
    start: f32,
    tester: &mut Tester<'_, I, S>,
) -> bool {
    let n = tree.n();
    let forward: [bool; 3] = std::array::from_fn(|k| lattice.direction[k] > 0.0);
    let enter = |level: usize, node: u32, low: [u32; 3], t: f32| -> Place {
        let high = std::array::from_fn(|k| low[k] + if level == 0 { tree.dims()[k] } else { n });
        let mut place = Place { first_word: tree.first_word(node), low, high, cell: low, t_next: [f32::INFINITY; 3] };
        for axis in 0..3 {
            let at = (lattice.origin[axis] + t * lattice.direction[axis]) * tree.inverse_cell(level, axis);
            // The cast saturates, and makes 0 of NaN.
            place.cell[axis] = (at as u32).clamp(low[axis], place.high[axis] - 1);
            if lattice.direction[axis] != 0.0 {
                place.t_next[axis] = lattice.t_at(level, axis, place.cell[axis] + u32::from(forward[axis]));
            }
        }
        place
    };
    let mut level = 0;
    // Where the ray came into the current cell, and through a plane across which axis; across none where it starts there.
    let mut t = start;
    let mut entered = None;
    let mut place = enter(0, 0, [0; 3], t);
    let mut above = [const { MaybeUninit::<Place>::uninit() }; MAX_LEVELS];
    loop {
        tester.cells += 1;
        let [x, y, z] = std::array::from_fn(|k| place.cell[k] - place.low[k]);
        let [nx, ny] = std::array::from_fn(|k| place.high[k] - place.low[k]);
        let index = ((z * ny + y) * nx + x) as usize;
        if let Some(child) = tree.child(place.first_word, index) {
            if child & LEAF == 0 {
                let below = enter(level + 1, child, place.cell.map(|at| at * n), t);
                let way = if G::IS_ASKED {
                    let (level, far) = (level + 1, place.t_next);
                    let arrival = Arrival { tree, lattice, level, node: child, place: &below, entered, far };
                    guide.at(&arrival, tester.sink, &mut tester.look_ups)
                } else {
                    Way::Down
                };
                match way {
                    Way::Down => {
                        above[level].write(place);
                        level += 1;
                        place = below;
                        continue;
                    }
                    Way::Past => {}
                    Way::Stop => return true,
                }
            } else if tester.test_list((child & !LEAF) as usize) {
                return true;
            }
        }
        // To the next cell, up as many levels as end here.
        loop {
            let [a, b, c] = place.t_next;
            let axis = if a <= b {
                if a <= c { 0 } else { 2 }
            } else if b <= c {
                1
            } else {
                2
            };
            t = place.t_next[axis];
            // Also where it is NaN or infinite: the ray does not get there.
            if !(t <= tester.sink.t_limit() && t < f32::INFINITY) {
                return false;
            }
            let at = place.cell[axis].wrapping_add(if forward[axis] { 1 } else { u32::MAX });
            if at >= place.low[axis] && at < place.high[axis] {
                entered = Some(axis);
                place.cell[axis] = at;
                place.t_next[axis] = lattice.t_at(level, axis, at + u32::from(forward[axis]));
                break;
            }
            if level == 0 {
                return false;
            }
            level -= 1;
            // SAFETY: on the way down every level was written before the next was entered.
            place = unsafe { above[level].assume_init() };
        }
    }
}

/// Whether the line of the ray meets nothing in the node, which it enters across `axis`.
#[inline(always)]
fn is_empty(marks: NodeMarks<'_>, arrival: &Arrival<'_>, axis: usize) -> bool {
    let Arrival { tree, lattice, level, place, far, .. } = *arrival;
    let n = tree.n();
    let mut leave = usize::from(far[1] < far[0]);
    leave = if far[2] < far[leave] { 2 } else { leave };
    let t = far[leave];
    let patch = |axis: usize, is_upper: bool, at: &dyn Fn(usize) -> u32| Patch {
        face: 2 * axis as u32 + u32::from(is_upper),
        u: at(usize::from(axis == 0)),
        v: at(2 - usize::from(axis == 2)),
    };
    let entry = patch(axis, lattice.direction[axis] <= 0.0, &|k| place.cell[k] - place.low[k]);
    let exit = patch(leave, lattice.direction[leave] > 0.0, &|k| {
        let at = (lattice.origin[k] + t * lattice.direction[k]) * tree.inverse_cell(level, k);
        // The cast saturates.
        (at as u32).clamp(place.low[k], place.low[k] + n - 1) - place.low[k]
    });
    // False where `t` is not a number.
    let is_crossed = t.abs() < f32::MAX && entry.face != exit.face;
    is_crossed && marks.is_empty(entry, exit)
}

/// The careful walk: within a node it goes slab by slab along the axis on which the ray crosses most cells, and looks at
/// all cells of the slab that the ray, thickened by `margin`, can touch.
struct Margins<'a> {
    tree: &'a CellTree,
    lattice: &'a LatticeRay<'a>,
    /// World units.
    margin: f32,
    t_min: f32,
}

impl Margins<'_> {
    fn visit<S: Sink>(&self, level: usize, node: u32, low: [u32; 3], tester: &mut Tester<'_, Portable, S>) -> bool {
        let dims = if level == 0 { self.tree.dims() } else { [self.tree.n(); 3] };
        let Some((start, end)) = self.interval(level, low, dims, tester.sink.t_limit()) else { return false };
        let cells_crossed = |k: usize| self.lattice.direction[k].abs() * self.tree.inverse_cell(level, k);
        let main = (0..3).max_by(|&a, &b| cells_crossed(a).total_cmp(&cells_crossed(b))).unwrap_or(0);
        let first_word = self.tree.first_word(node);
        let backward = self.lattice.direction[main] < 0.0;
        for slab in 0..dims[main] {
            let slab = if backward { dims[main] - 1 - slab } else { slab };
            let (mut from, mut size) = (low, dims);
            (from[main], size[main]) = (low[main] + slab, 1);
            let Some((a, b)) = self.interval(level, from, size, end.min(tester.sink.t_limit())) else { continue };
            let (a, b) = (a.max(start), b.min(end));
            let ranges: [(u32, u32); 3] = std::array::from_fn(|k| match k == main {
                true => (slab, slab),
                false => self.range(level, k, low[k], dims[k], a, b),
            });
            for z in ranges[2].0..=ranges[2].1 {
                for y in ranges[1].0..=ranges[1].1 {
                    for x in ranges[0].0..=ranges[0].1 {
                        tester.cells += 1;
                        let index = ((z * dims[1] + y) * dims[0] + x) as usize;
                        let Some(child) = self.tree.child(first_word, index) else { continue };
                        let stop = if child & LEAF == 0 {
                            let local = [x, y, z];
                            let below = std::array::from_fn(|k| (low[k] + local[k]) * self.tree.n());
                            self.visit(level + 1, child, below, tester)
                        } else {
                            tester.test_list((child & !LEAF) as usize)
                        };
                        if stop {
                            return true;
                        }
                    }
                }
            }
        }
        false
    }

    /// Where the thick ray is among some cells, before `limit`.
    fn interval(&self, level: usize, low: [u32; 3], dims: [u32; 3], limit: f32) -> Option<(f32, f32)> {
        let (mut start, mut end) = (self.t_min, limit);
        for k in 0..3 {
            let cell = self.lattice.cell[level][k];
            let (near, far) = (low[k] as f32 * cell - self.margin, (low[k] + dims[k]) as f32 * cell + self.margin);
            let at = self.lattice.origin[k];
            if self.lattice.direction[k] == 0.0 {
                if at < near || at > far {
                    return None;
                }
                continue;
            }
            let (a, b) = ((near - at) * self.lattice.inverse[k], (far - at) * self.lattice.inverse[k]);
            start = start.max(a.min(b));
            end = end.min(a.max(b));
        }
        (start <= end).then_some((start, end))
    }

    /// Cells of a node, on one axis, that the thick ray touches between two `t`.
    fn range(&self, level: usize, axis: usize, low: u32, dim: u32, a: f32, b: f32) -> (u32, u32) {
        // Zero times an infinite end would be NaN.
        let (origin, direction) = (self.lattice.origin[axis], self.lattice.direction[axis]);
        let at = |t: f32| if direction == 0.0 { origin } else { origin + t * direction };
        let (a, b) = (at(a), at(b));
        let cell = |at: f32| {
            let at = (at * self.tree.inverse_cell(level, axis)).floor();
            (at - low as f32).clamp(0.0, (dim - 1) as f32) as u32
        };
        (cell(a.min(b) - self.margin), cell(a.max(b) + self.margin))
    }
}

/// Tests packets, each once where it comes up again soon.
struct Tester<'a, I: Isa, S> {
    tree: &'a CellTree,
    ray: PacketRay<I>,
    instance: u32,
    sink: &'a mut S,
    recent: [u32; REMEMBERED],
    next: usize,
    cells: u64,
    packets: u64,
    look_ups: LookUps,
}

impl<'a, I: Isa, S: Sink> Tester<'a, I, S> {
    #[inline(always)]
    fn new(tree: &'a CellTree, ray: &ObjectRay, instance: u32, sink: &'a mut S) -> Self {
        let recent = [u32::MAX; REMEMBERED];
        Self {
            tree,
            ray: PacketRay::new(ray),
            instance,
            sink,
            recent,
            next: 0,
            cells: 0,
            packets: 0,
            look_ups: LookUps::default(),
        }
    }

    fn count(&self, counters: &mut Counters) {
        counters.box_tests += self.cells;
        counters.triangle_tests += self.packets * LANES as u64;
        counters.gates.node_look_ups += self.look_ups.asked;
        counters.gates.skipped_nodes += self.look_ups.skipped;
    }

    #[inline(always)]
    fn test_list(&mut self, start: usize) -> bool {
        let tree = self.tree;
        for number in tree.list(start) {
            if self.recent.contains(&number) {
                continue;
            }
            self.recent[self.next] = number;
            let packet = tree.packet(number);
            self.next = (self.next + 1) % REMEMBERED;
            self.packets += 1;
            if test_packet(packet, tree.is_triangles(packet), &self.ray, self.instance, self.sink) {
                return true;
            }
        }
        false
    }
}
