//! The gate in front of a mesh: what its Line Space says of a ray, before the ray is traced through the mesh.

use std::sync::Arc;

use super::{Class, LineSpace, Location, Shafts, SurfaceShafts};
use crate::trace::Ray;

/// What a scene may ask before it walks the structure of a mesh. Each list is empty, or has an entry for each structure.
#[derive(Debug, Default)]
pub(crate) struct Gates {
    /// All that the scene was given.
    pub line_spaces: Vec<Option<Arc<LineSpace>>>,
    /// Those that are asked.
    pub asked: Vec<Option<Arc<LineSpace>>>,
    pub surfaces: Vec<Option<Arc<SurfaceShafts>>>,
}

impl Gates {
    #[inline(always)]
    pub(crate) fn asked(&self, structure: u32) -> Option<&LineSpace> {
        self.asked.get(structure as usize)?.as_deref()
    }

    #[inline(always)]
    pub(crate) fn surface(&self, structure: u32) -> Option<&SurfaceShafts> {
        self.surfaces.get(structure as usize)?.as_deref()
    }
}

/// What is certain of a ray and a mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
    Miss,
    /// There is a hit between `t_min` and `t_max`, wherever.
    Hit,
    Unknown,
}

/// How rays came to gates, and what they were told.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GateCounters {
    /// Rays that cross the whole box, by the class of their shaft: EMPTY, OPAQUE, MIXED.
    pub full_chord: [u64; 3],
    /// Rays of which a part may lie outside the box or end in it, likewise.
    pub ends_inside: [u64; 3],
    /// Rays that start on the mesh itself and asked its surface shafts, likewise.
    pub own_mesh: [u64; 3],
    /// Rays that start in the box: most such shafts are not empty, so they are not looked up.
    pub starts_inside: u64,
    /// Rays that pass the box by.
    pub beside: u64,
    /// Rays from too far away to be located.
    pub too_far: u64,
}

impl GateCounters {
    /// Rays that asked.
    pub fn rays(&self) -> u64 {
        self.look_ups() + self.starts_inside + self.beside + self.too_far
    }

    /// Rays whose shaft is of a class.
    pub fn of_class(&self, class: Class) -> u64 {
        [self.full_chord, self.ends_inside, self.own_mesh].map(|kind| kind[class as usize]).iter().sum()
    }

    /// Rays whose shaft was looked up.
    pub fn look_ups(&self) -> u64 {
        [self.full_chord, self.ends_inside, self.own_mesh].iter().flatten().sum()
    }
}

impl std::ops::AddAssign for GateCounters {
    fn add_assign(&mut self, other: Self) {
        for k in 0..3 {
            self.full_chord[k] += other.full_chord[k];
            self.ends_inside[k] += other.ends_inside[k];
            self.own_mesh[k] += other.own_mesh[k];
        }
        self.starts_inside += other.starts_inside;
        self.beside += other.beside;
        self.too_far += other.too_far;
    }
}

impl LineSpace {
    /// What is certain of a ray in the mesh's space: nothing, unless the payload is proven.
    #[inline]
    pub(crate) fn verdict(&self, ray: &Ray, counters: &mut GateCounters) -> Verdict {
        let Some((grid, shafts)) = &self.content else { return Verdict::Unknown };
        let is_valid = ray.origin.is_finite() && ray.direction.is_finite() && ray.t_min.max(0.0) < ray.t_max;
        if !is_valid {
            return Verdict::Unknown;
        }
        if grid.holds(ray.origin) {
            counters.starts_inside += 1;
            return Verdict::Unknown;
        }
        let chord = match grid.locate(ray) {
            Location::Beside => {
                counters.beside += 1;
                return Verdict::Miss;
            }
            Location::TooFar => {
                counters.too_far += 1;
                return Verdict::Unknown;
            }
            Location::Through(chord) => chord,
        };
        let class = match shafts {
            Shafts::Tree(tree) => tree.class(chord.entry, chord.exit),
            Shafts::Table(table) => table.class(chord.entry, chord.exit),
            Shafts::Binary(binary) if self.params.is_conservative() => {
                match binary.is_marked(chord.entry, chord.exit) {
                    true => Class::Mixed,
                    false => Class::Empty,
                }
            }
            _ => return Verdict::Unknown,
        };
        // A ray that starts outside may still begin inside, by its `t_min`.
        let is_whole = chord.starts_outside && chord.reaches_exit;
        let kind = if is_whole { &mut counters.full_chord } else { &mut counters.ends_inside };
        kind[class as usize] += 1;
        match class {
            Class::Empty => Verdict::Miss,
            Class::Opaque if is_whole => Verdict::Hit,
            _ => Verdict::Unknown,
        }
    }
}
