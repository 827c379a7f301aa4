//! The gate in front of a mesh: what its Line Space says of a ray, before the ray is traced through the mesh.

use std::sync::Arc;

use super::{Chord, Class, LineSpace, Location, Shafts, SurfaceShafts};
use crate::trace::Ray;

/// What a scene may ask before it walks the structure of a mesh. Each list is empty, or has an entry for each structure.
#[derive(Debug, Default)]
pub(crate) struct Gates {
    /// All that the scene was given.
    pub line_spaces: Vec<Option<Arc<LineSpace>>>,
    /// Those that are asked.
    pub asked: Vec<Option<Arc<LineSpace>>>,
    /// Whether those are the ones that were found to pay, on this CPU.
    pub measured: bool,
    pub surfaces: Vec<Option<Arc<SurfaceShafts>>>,
    /// Whether occlusion rays take for true what is not proven.
    pub approximate: bool,
}

impl Gates {
    /// Those that a GPU asks: what a measurement on the CPU says does not hold there, and the look-up has not been found to
    /// pay on one.
    pub(crate) fn asked_on_gpu(&self) -> &[Option<Arc<LineSpace>>] {
        if self.measured { &[] } else { &self.asked }
    }

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
    /// Of those looked up, the ones for which more was taken for true than is proven.
    pub approximated: u64,
    /// Rays that pass the box by.
    pub beside: u64,
    /// Rays from too far away to be located.
    pub too_far: u64,
    /// Nodes of a tree whose shaft was looked up.
    pub node_look_ups: u64,
    /// Of those, the ones that were passed by with all below them.
    pub skipped_nodes: u64,
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
        self.approximated += other.approximated;
        self.beside += other.beside;
        self.too_far += other.too_far;
        self.node_look_ups += other.node_look_ups;
        self.skipped_nodes += other.skipped_nodes;
    }
}

impl LineSpace {
    /// What is certain of a ray in the mesh's space: nothing, unless the payload is proven.
    #[inline]
    pub(crate) fn verdict(&self, ray: &Ray, counters: &mut GateCounters) -> Verdict {
        let (shafts, chord) = match self.chord(ray, counters) {
            Ok(found) => found,
            Err(verdict) => return verdict,
        };
        let Some(class) = self.class_of(shafts, chord) else { return Verdict::Unknown };
        count(class, chord, counters);
        match class {
            Class::Empty => Verdict::Miss,
            Class::Opaque if is_whole(chord) => Verdict::Hit,
            _ => Verdict::Unknown,
        }
    }

    /// What is taken for true of an occlusion ray in the mesh's space: one that crosses the whole box is blocked by a shaft
    /// that holds something (Keul 2020, section 5.4.1); of coverage, with the probability that it gives. Of other rays only
    /// what is certain.
    #[inline]
    pub(crate) fn approximate_verdict(&self, ray: &Ray, counters: &mut GateCounters) -> Verdict {
        let (shafts, chord) = match self.chord(ray, counters) {
            Ok(found) => found,
            Err(verdict) => return verdict,
        };
        if !is_whole(chord) {
            counters.ends_inside[Class::Mixed as usize] += 1;
            return Verdict::Unknown;
        }
        let class = self.class_of(shafts, chord);
        count(class.unwrap_or(Class::Mixed), chord, counters);
        match (class, shafts) {
            (Some(Class::Empty), _) => return Verdict::Miss,
            (Some(Class::Opaque), _) => return Verdict::Hit,
            _ => counters.approximated += 1,
        }
        let is_blocked = match shafts {
            Shafts::Table(_) | Shafts::Tree(_) => true,
            Shafts::Binary(binary) => binary.is_marked(chord.entry, chord.exit),
            Shafts::Candidates(candidates) => candidates.candidate(chord.entry, chord.exit).is_some(),
            Shafts::Coverage(coverage) => coverage.blocked(chord.entry, chord.exit) > chance(ray, 0),
        };
        if is_blocked { Verdict::Hit } else { Verdict::Miss }
    }

    /// Where the ray crosses the box; else what follows from that it does not, or that nobody looks.
    #[inline(always)]
    fn chord(&self, ray: &Ray, counters: &mut GateCounters) -> Result<(&Shafts, Chord), Verdict> {
        let Some((grid, shafts)) = &self.content else { return Err(Verdict::Unknown) };
        let is_valid = ray.origin.is_finite() && ray.direction.is_finite() && ray.t_min.max(0.0) < ray.t_max;
        if !is_valid {
            return Err(Verdict::Unknown);
        }
        if grid.holds(ray.origin) {
            counters.starts_inside += 1;
            return Err(Verdict::Unknown);
        }
        match grid.locate(ray) {
            Location::Beside => {
                counters.beside += 1;
                Err(Verdict::Miss)
            }
            Location::TooFar => {
                counters.too_far += 1;
                Err(Verdict::Unknown)
            }
            Location::Through(chord) => Ok((shafts, chord)),
        }
    }

    /// What is proven of a shaft, by a payload that proves anything.
    #[inline(always)]
    fn class_of(&self, shafts: &Shafts, Chord { entry, exit, .. }: Chord) -> Option<Class> {
        match shafts {
            Shafts::Tree(tree) => Some(tree.class(entry, exit)),
            Shafts::Table(table) => Some(table.class(entry, exit)),
            Shafts::Binary(binary) if self.params.is_conservative() => {
                Some(if binary.is_marked(entry, exit) { Class::Mixed } else { Class::Empty })
            }
            Shafts::Binary(_) | Shafts::Candidates(_) | Shafts::Coverage(_) => None,
        }
    }
}

/// Whether the ray crosses the whole box. One that starts outside may still begin inside, by its `t_min`.
#[inline(always)]
fn is_whole(chord: Chord) -> bool {
    chord.starts_outside && chord.reaches_exit
}

#[inline(always)]
fn count(class: Class, chord: Chord, counters: &mut GateCounters) {
    let kind = if is_whole(chord) { &mut counters.full_chord } else { &mut counters.ends_inside };
    kind[class as usize] += 1;
}

/// A number from 0 to 1, below 1, that follows from the ray and `salt` alone: so pictures do not depend on who traces it
/// when (the finalizer of MurmurHash3 over its bits).
#[inline]
pub(crate) fn chance(ray: &Ray, salt: u32) -> f32 {
    let mut hash = salt;
    for value in [ray.origin.x, ray.origin.y, ray.origin.z, ray.direction.x, ray.direction.y, ray.direction.z] {
        hash = (hash ^ value.to_bits()).wrapping_mul(0x85eb_ca6b);
        hash ^= hash >> 13;
        hash = hash.wrapping_mul(0xc2b2_ae35);
        hash ^= hash >> 16;
    }
    (hash >> 8) as f32 / (1 << 24) as f32
}
