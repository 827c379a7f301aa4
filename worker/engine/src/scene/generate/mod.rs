//! Generated scenes: for tests, benchmarks and demonstrations. The same kind and parameters give the same file.

mod analytic;
mod crowd;
mod demo;
mod nature;
mod rng;
mod shapes;
mod textures;

use super::write_glb::GlbWriter;

/// A kind of scene that [`generate`] makes.
#[derive(Clone, Copy, Debug)]
pub struct Kind {
    pub name: &'static str,
    /// One line for people.
    pub help: &'static str,
    /// Triangles (or, where the help says so, spheres) made when nothing is asked for; 0 where they are fixed.
    pub default_triangles: u32,
    /// Objects placed when nothing is asked for; 0 where they are fixed.
    pub default_count: u32,
    make: fn(&Amounts) -> GlbWriter,
}

/// What a scene is to be. `None` leaves the choice to the kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Params {
    pub seed: u64,
    /// Triangles over unique meshes, roughly.
    pub triangles: Option<u32>,
    /// Objects: instances, steps, hairs, cards.
    pub count: Option<u32>,
}

/// Parameters with the kind's own choices filled in.
#[derive(Clone, Copy, Debug)]
struct Amounts {
    seed: u64,
    triangles: u32,
    count: u32,
}

/// Why a scene cannot be generated.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GenerateError {
    #[error("there is no kind {given:?}; the kinds are {known}")]
    UnknownKind { given: String, known: String },
    #[error("{field} is {given}; it must be from 1 to {most}")]
    OutOfRange { field: &'static str, given: u32, most: u32 },
    #[error("{field} has no meaning for {kind}, which is always the same size")]
    Fixed { field: &'static str, kind: &'static str },
}

/// Most triangles that are generated: about 1.5 GB of file.
const MOST_TRIANGLES: u32 = 20_000_000;
const MOST_OBJECTS: u32 = 100_000;

/// Every kind, in the order in which they are listed for people.
pub const KINDS: &[Kind] = &[
    Kind {
        name: "demo",
        help: "a lit still life of metal, ceramic, glowing spheres and a potted plant, with a camera called main",
        default_triangles: 0,
        default_count: 0,
        make: demo::demo,
    },
    Kind {
        name: "cornell-box",
        help: "the Cornell box: two blocks in a closed room under an area light",
        default_triangles: 0,
        default_count: 0,
        make: analytic::cornell_box,
    },
    Kind {
        name: "furnace-sphere",
        help: "a white diffuse sphere, which must vanish under a constant environment: all of the picture is 1",
        default_triangles: 20_000,
        default_count: 0,
        make: analytic::furnace_sphere,
    },
    Kind {
        name: "staircase",
        help: "COUNT steps seen from the front by an orthographic camera, step i at depth exactly i + 1",
        default_triangles: 0,
        default_count: 8,
        make: analytic::staircase,
    },
    Kind {
        name: "sphere-flake",
        help: "spheres on spheres (LIGHTSHAFT_spheres): the most levels that COUNT spheres allow, 597871 for six",
        default_triangles: 0,
        default_count: 8_000,
        make: analytic::sphere_flake,
    },
    Kind {
        name: "far-sphere",
        help: "a sphere 130 km from the origin, where 32-bit coordinates are 8 mm apart: watertightness",
        default_triangles: 40_000,
        default_count: 0,
        make: analytic::far_sphere,
    },
    Kind {
        name: "soup",
        help: "random triangles with slivers, specks, giants, duplicates and triangles without area",
        default_triangles: 10_000,
        default_count: 0,
        make: analytic::soup,
    },
    Kind {
        name: "foliage-cards",
        help: "COUNT textured leaves with an alpha mask around a trunk",
        default_triangles: 0,
        default_count: 4_000,
        make: nature::foliage_cards,
    },
    Kind {
        name: "hairball",
        help: "long thin triangles: curly hairs around a sphere",
        default_triangles: 200_000,
        default_count: 0,
        make: nature::hairball,
    },
    Kind {
        name: "terrain",
        help: "mountains with vertex colours under a sun",
        default_triangles: 500_000,
        default_count: 0,
        make: nature::terrain,
    },
    Kind {
        name: "forest",
        help: "COUNT instances of three trees on uneven ground",
        default_triangles: 60_000,
        default_count: 800,
        make: nature::forest,
    },
    Kind {
        name: "pile",
        help: "COUNT overlapping instances of five objects, heaped up",
        default_triangles: 50_000,
        default_count: 400,
        make: crowd::pile,
    },
    Kind {
        name: "stadium",
        help: "a finely tessellated object, a hand wide, in the middle of a stadium of a quarter of a kilometre",
        default_triangles: 300_000,
        default_count: 0,
        make: crowd::stadium,
    },
];

/// Makes a scene and returns it as the bytes of a .glb.
///
/// # Errors
/// An unknown kind, or parameters out of range or without meaning for it.
pub fn generate(kind: &str, params: &Params) -> Result<Vec<u8>, GenerateError> {
    let Some(found) = KINDS.iter().find(|known| known.name == kind) else {
        let known: Vec<&str> = KINDS.iter().map(|kind| kind.name).collect();
        return Err(GenerateError::UnknownKind { given: kind.to_owned(), known: known.join(", ") });
    };
    let choose = |field: &'static str, given: Option<u32>, default: u32, most: u32| match given {
        None => Ok(default),
        Some(_) if default == 0 => Err(GenerateError::Fixed { field, kind: found.name }),
        Some(given) if given == 0 || given > most => Err(GenerateError::OutOfRange { field, given, most }),
        Some(given) => Ok(given),
    };
    let most_objects = if found.name == "sphere-flake" { MOST_TRIANGLES } else { MOST_OBJECTS };
    let amounts = Amounts {
        seed: params.seed,
        triangles: choose("triangles", params.triangles, found.default_triangles, MOST_TRIANGLES)?,
        count: choose("count", params.count, found.default_count, most_objects)?,
    };
    Ok((found.make)(&amounts).finish())
}

/// The least number of rows for which a sphere of `2 * rows` x `rows` cells has at least `triangles` triangles.
fn sphere_rows(triangles: u32) -> u32 {
    (((triangles as f32 / 4.0).sqrt().ceil()) as u32).max(4)
}

#[cfg(test)]
mod tests;
