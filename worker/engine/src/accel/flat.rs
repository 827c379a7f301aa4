//! A whole scene as one mesh in world space, for structures that know no instances.
//!
//! A flat structure needs no transform of rays and no top level, and pays with a copy of each instance's geometry. Its
//! hits are named by instance and primitive like those of two levels. They are equal to the last bit where transforms are
//! the identity; elsewhere corners are rounded once on their way into the world instead of rays on their way into the
//! object, so `t` may differ by that.

use glam::{Mat3, Vec3};

use super::two_level::is_visible;
use super::{BuildError, HitFilter, Placement};
use crate::scene::{Mesh, MeshHash, Sphere};
use crate::trace::{Hit, Ray, Sink};

/// How unequal the axes of a placed sphere may be, relative to their squared length.
const SPHERE_TOLERANCE: f32 = 1e-5;

/// Which primitive of a flat mesh belongs to which instance.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Names {
    /// Instances that have geometry, ascending.
    instances: Vec<InstanceRange>,
    triangle_count: u32,
    any_filtered: bool,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct InstanceRange {
    instance: u32,
    first_triangle: u32,
    /// Counted from the flat mesh's first sphere.
    first_sphere: u32,
    /// Triangles of the instance's mesh: its spheres are numbered after them.
    triangles: u32,
    filtered: bool,
}

/// The hash that [`flatten`] gives a scene: over its meshes and where they are, in their order. The flags of placements
/// do not count.
pub fn flat_hash(meshes: &[impl AsRef<Mesh>], placements: &[Placement]) -> MeshHash {
    let mut hasher = blake3::Hasher::new();
    hasher.update(b"lightshaft flat scene 1");
    for placement in placements {
        hasher.update(&meshes[placement.mesh as usize].as_ref().hash.0);
        for value in placement.transform.to_cols_array() {
            // Zero has two signs, and one meaning.
            hasher.update(&(value + 0.0).to_le_bytes());
        }
    }
    MeshHash(*hasher.finalize().as_bytes())
}

/// All instances as one mesh: their triangles in the order of the instances, then their spheres. Of what structures do
/// not look at (normals, texture coordinates) it has nothing.
///
/// # Errors
/// More primitives than can be numbered, and a sphere that its instance's transform makes an ellipsoid.
///
/// # Panics
/// When a placement refers to a mesh that is not there.
pub fn flatten(meshes: &[impl AsRef<Mesh>], placements: &[Placement]) -> Result<(Mesh, Names), BuildError> {
    let mut flat = Mesh::of_shapes("scene", Vec::new(), Vec::new(), Vec::new());
    flat.hash = flat_hash(meshes, placements);
    let visible = || (0_u32..).zip(placements).filter(|(_, placement)| is_visible(placement));
    let placed = |count: fn(&Mesh) -> usize| -> usize {
        visible().map(|(_, placement)| count(meshes[placement.mesh as usize].as_ref())).sum()
    };
    let vertices = placed(|mesh| mesh.positions.len());
    let (triangles, spheres) = (placed(|mesh| mesh.triangles.len()), placed(|mesh| mesh.spheres.len()));
    if vertices.max(triangles + spheres) >= 1 << 31 {
        return Err(BuildError::Unsupported(format!(
            "the scene has {vertices} vertices and {} primitives with all its instances; a flat structure holds 2^31 \
             (two_level holds each mesh once)",
            triangles + spheres
        )));
    }
    flat.positions.reserve_exact(vertices);
    flat.triangles.reserve_exact(triangles);
    flat.spheres.reserve_exact(spheres);
    let any_filtered = visible().any(|(_, placement)| placement.filtered);
    let mut names = Names { instances: Vec::new(), triangle_count: triangles as u32, any_filtered };
    for (instance, placement) in visible() {
        let mesh: &Mesh = meshes[placement.mesh as usize].as_ref();
        names.instances.push(InstanceRange {
            instance,
            first_triangle: flat.triangles.len() as u32,
            first_sphere: flat.spheres.len() as u32,
            triangles: mesh.triangles.len() as u32,
            filtered: placement.filtered,
        });
        let base = flat.positions.len() as u32;
        flat.positions.extend(mesh.positions.iter().map(|&point| placement.transform.transform_point3(point)));
        flat.triangles.extend(mesh.triangles.iter().map(|triangle| triangle.map(|vertex| base + vertex)));
        if !mesh.spheres.is_empty() {
            let scale = even_scale(placement).ok_or_else(|| {
                BuildError::Unsupported(format!(
                    "instance {instance} scales its spheres unevenly, and a flat structure holds only spheres: use two_level"
                ))
            })?;
            flat.spheres.extend(mesh.spheres.iter().map(|sphere| Sphere {
                center: placement.transform.transform_point3(sphere.center),
                radius: scale * sphere.radius,
                slot: 0,
            }));
        }
    }
    flat.triangle_slots = vec![0; flat.triangles.len()];
    flat.bounds = flat.shape_bounds();
    Ok((flat, names))
}

/// By how much a transform scales in every direction alike, if it does.
fn even_scale(placement: &Placement) -> Option<f32> {
    let matrix = Mat3::from(placement.transform.matrix3);
    let axes = [matrix.x_axis, matrix.y_axis, matrix.z_axis];
    let squares = axes.map(Vec3::length_squared);
    let tolerance = SPHERE_TOLERANCE * squares[0];
    let is_even = squares.iter().all(|square| (square - squares[0]).abs() <= tolerance)
        && [(0, 1), (1, 2), (2, 0)].iter().all(|&(a, b)| axes[a].dot(axes[b]).abs() <= tolerance);
    is_even.then(|| squares[0].sqrt())
}

impl Names {
    pub(super) fn bytes(&self) -> usize {
        size_of_val(self.instances.as_slice())
    }

    /// Whether hits on some instance go through the filter.
    pub(crate) fn any_filtered(&self) -> bool {
        self.any_filtered
    }

    /// Instance and primitive of a primitive of the flat mesh, and whether its hits go through the filter.
    #[inline]
    pub(crate) fn of_primitive(&self, number: u32) -> (u32, u32, bool) {
        let at = |first: fn(&InstanceRange) -> u32, number: u32| {
            // The last that begins at or before it: those before, with the same first, have none.
            let behind = self.instances.partition_point(|range| first(range) <= number);
            &self.instances[behind - 1]
        };
        let (range, primitive) = if number < self.triangle_count {
            let range = at(|range| range.first_triangle, number);
            (range, number - range.first_triangle)
        } else {
            let sphere = number - self.triangle_count;
            let range = at(|range| range.first_sphere, sphere);
            (range, range.triangles + sphere - range.first_sphere)
        };
        (range.instance, primitive, range.filtered)
    }
}

/// Names hits, and lets those through that the filter accepts.
pub(super) struct NamedSink<'a, S> {
    pub names: &'a Names,
    pub filter: &'a dyn HitFilter,
    pub ray: &'a Ray,
    pub sink: &'a mut S,
}

impl<S: Sink> Sink for NamedSink<'_, S> {
    #[inline(always)]
    fn t_limit(&self) -> f32 {
        self.sink.t_limit()
    }

    #[inline(always)]
    fn offer(&mut self, hit: Hit) -> bool {
        if hit.t > self.sink.t_limit() {
            return false;
        }
        let (instance, primitive, filtered) = self.names.of_primitive(hit.primitive);
        let hit = Hit { instance, primitive, ..hit };
        (!filtered || self.filter.accept(self.ray, &hit)) && self.sink.offer(hit)
    }
}
