//! Patches and shafts: how a box groups the lines through it (Keul 2020, sections 3.1 and 3.2).
//!
//! Each face of a box is cut into N x N equal patches. A line that crosses the box enters through one patch and leaves
//! through another, on another face, and the pair names its shaft: the convex hull of the two.
//!
//! [`ShaftGrid::locate`] finds the shaft of a ray. Its decisions are comparisons of products, each operand of which is
//! rounded once, so `shaders/shared/shaft.wgsl` comes to the same shaft bit for bit: a quotient only guesses where to
//! compare (WGSL's division is not exact), and no product is added to anything (so none can be fused).

use glam::{DVec3, Vec3};

use crate::scene::Aabb;
use crate::trace::Ray;

/// Finest subdivision: 32 x 32 patches on each face.
pub const MAX_N: u32 = 32;
pub const FACES: u32 = 6;

/// By how much a shaft grows before anything is claimed of it, as a part of the box's extent on each axis. It holds what
/// float arithmetic moves a ray by: in [`ShaftGrid::locate`], and in the tests of primitives.
pub const DILATION: f64 = 1.0 / 2048.0;

/// The box grows by this part of its longest edge on every side, so that it is never flat, and no surface comes near
/// a patch.
const PADDING: f64 = 1.0 / 256.0;
/// The same against coarse coordinates far from the origin, as a part of the largest of them.
const COORDINATE_PADDING: f64 = 1.0 / (1 << 20) as f64;

/// Coordinates nearer to the box's corner than this count as on it: they would vanish in products.
const TINY: f32 = 1.0 / (1_u64 << 40) as f32;
/// Components of a direction below this part of the longest are raised to it.
const SLIGHT: f32 = 1.0 / (1 << 30) as f32;
/// No located ray is still in the box after this time, at a speed of 1 to 2 patches along its longest axis.
const LATEST: f32 = (1_u64 << 48) as f32;
/// Longest components of a direction, in patches, from 2^-79 to 2^79: so no number below overflows.
const LEAST_EXPONENT: u32 = (127 - 79) << 23;
const GREATEST_EXPONENT: u32 = (127 + 79) << 23;

/// A patch of a box. Faces are numbered -x, +x, -y, +y, -z, +z; `u` and `v` count along the other two axes, the
/// lower axis first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Patch {
    pub face: u32,
    pub u: u32,
    pub v: u32,
}

impl Patch {
    /// The axis that the face is orthogonal to.
    pub fn axis(self) -> usize {
        self.face as usize >> 1
    }

    /// Whether it is the face at the upper end of its axis.
    pub fn is_upper(self) -> bool {
        self.face & 1 == 1
    }

    /// The axes of `u` and `v`.
    pub fn tangents(self) -> [usize; 2] {
        tangents(self.axis())
    }

    /// Its number among the 6 N^2 patches.
    pub fn index(self, n: u32) -> u32 {
        (self.face * n + self.v) * n + self.u
    }

    /// The patch of number `index`, below 6 N^2.
    pub fn from_index(n: u32, index: u32) -> Self {
        Self { face: index / (n * n), v: index / n % n, u: index % n }
    }

    /// The patch that holds it when every `1 << levels` patches are one.
    pub fn coarser(self, levels: u32) -> Self {
        Self { face: self.face, u: self.u >> levels, v: self.v >> levels }
    }

    /// Its corners of least and greatest coordinates in a box from 0 to 1.
    pub fn unit_bounds(self, n: u32) -> [DVec3; 2] {
        let mut bounds = [DVec3::ZERO, DVec3::ONE];
        let [u, v] = self.tangents();
        let plane = f64::from(self.face & 1);
        for (end, corner) in bounds.iter_mut().enumerate() {
            corner[self.axis()] = plane;
            corner[u] = f64::from(self.u + end as u32) / f64::from(n);
            corner[v] = f64::from(self.v + end as u32) / f64::from(n);
        }
        bounds
    }
}

/// The two axes beside `axis`, in increasing order.
fn tangents(axis: usize) -> [usize; 2] {
    [usize::from(axis == 0), 2 - usize::from(axis == 2)]
}

/// Shafts when a shaft and its reverse are one: 15 N^4.
pub fn symmetric_count(n: u32) -> u64 {
    15 * u64::from(n).pow(4)
}

/// Shafts when direction counts: 30 N^4.
pub fn directed_count(n: u32) -> u64 {
    30 * u64::from(n).pow(4)
}

/// The number of the shaft between two patches on different faces, in either order.
#[inline]
pub fn symmetric_index(n: u32, a: Patch, b: Patch) -> u32 {
    let (a, b) = if a.face < b.face { (a, b) } else { (b, a) };
    let pair = a.face * (11 - a.face) / 2 + b.face - a.face - 1;
    let square = n * n;
    (pair * square + a.v * n + a.u) * square + b.v * n + b.u
}

/// The patches of a shaft's number, the lower face first.
pub fn symmetric_patches(n: u32, index: u32) -> (Patch, Patch) {
    let square = n * n;
    let (pair, a, b) = (index / (square * square), index / square % square, index % square);
    let (low, high) = face_pair(pair);
    (Patch { face: low, v: a / n, u: a % n }, Patch { face: high, v: b / n, u: b % n })
}

/// The faces of pair 0 to 14, the lower one first.
fn face_pair(pair: u32) -> (u32, u32) {
    let mut pair = pair;
    let mut low = 0;
    while pair >= FACES - 1 - low {
        pair -= FACES - 1 - low;
        low += 1;
    }
    (low, low + 1 + pair)
}

/// The number of the shaft from `start` to `end`, which are on different faces.
#[inline]
pub fn directed_index(n: u32, start: Patch, end: Patch) -> u32 {
    let other = end.face - u32::from(end.face > start.face);
    start.index(n) * 5 * n * n + (other * n + end.v) * n + end.u
}

/// Start and end of a directed shaft.
pub fn directed_patches(n: u32, index: u32) -> (Patch, Patch) {
    let ends = 5 * n * n;
    let start = Patch::from_index(n, index / ends);
    let mut end = Patch::from_index(n, index % ends);
    end.face += u32::from(end.face >= start.face);
    (start, end)
}

/// Where the line of a ray crosses the box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Chord {
    pub entry: Patch,
    /// Never on the entry's face.
    pub exit: Patch,
    /// Whether the ray begins before it enters, or just there.
    pub starts_outside: bool,
    /// Whether the ray goes on to where it leaves, or beyond.
    pub reaches_exit: bool,
}

/// What a box knows of a ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Location {
    /// The ray meets nothing in the box: its line passes by, or it ends before or begins behind.
    Beside,
    Through(Chord),
    /// The ray starts so far away that rounding moves it by more than [`DILATION`], or its numbers overflow: ask the
    /// base structure.
    TooFar,
}

/// A padded box with N x N patches on each face.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShaftGrid {
    n: u32,
    min: [f32; 3],
    /// Patches per unit of length.
    scale: [f32; 3],
    /// Rays whose origin is farther from `min`, on any axis, are not located.
    limit: f32,
}

impl ShaftGrid {
    /// The grid around `bounds`. None where single precision cannot express it: an empty box or a point, a box that is
    /// not finite, or edges so long or short that their reciprocal overflows.
    ///
    /// # Panics
    /// When `n` is not from 1 to [`MAX_N`].
    pub fn new(bounds: &Aabb, n: u32) -> Option<Self> {
        assert!((1..=MAX_N).contains(&n), "N is {n}, not from 1 to {MAX_N}");
        if bounds.is_empty() || !(bounds.min.is_finite() && bounds.max.is_finite()) {
            return None;
        }
        let (low, high) = (bounds.min.as_dvec3(), bounds.max.as_dvec3());
        let longest = (high - low).max_element();
        if longest <= 0.0 {
            return None;
        }
        let padding = (longest * PADDING).max(low.abs().max(high.abs()).max_element() * COORDINATE_PADDING);
        let min = (low - padding).to_array().map(|value| value as f32);
        let extent: [f64; 3] = std::array::from_fn(|k| high[k] + padding - f64::from(min[k]));
        let scale = extent.map(|extent| (f64::from(n) / extent) as f32);
        let shortest = extent.iter().copied().fold(f64::INFINITY, f64::min);
        let longest = extent.iter().copied().fold(0.0, f64::max);
        // Rounding moves a ray by a few ulps of its distance: 2^-11 of the box are 2^8 boxes away 2^-19 of it. A
        // primitive test moves it by at most 2^-21 of its distance to the farthest corner.
        let limit = (256.0 * shortest).min(512.0 * shortest - longest) as f32;
        let usable = scale.iter().all(|s| s.is_normal()) && min.iter().all(|m| m.is_finite()) && limit.is_normal();
        usable.then_some(Self { n, min, scale, limit })
    }

    /// The same, which locates rays from any distance: for approximations, to which rounding is no harm.
    pub(super) fn without_limit(self) -> Self {
        Self { limit: f32::MAX, ..self }
    }

    pub fn n(&self) -> u32 {
        self.n
    }

    /// As the shaders take it: `min` and N, then `scale` and the limit.
    pub fn to_words(&self) -> [f32; 8] {
        let ([x, y, z], [sx, sy, sz]) = (self.min, self.scale);
        [x, y, z, self.n as f32, sx, sy, sz, self.limit]
    }

    /// A point of the box's space, scaled so that the padded box is the unit cube.
    pub fn to_unit(&self, point: DVec3) -> DVec3 {
        (point - self.corner()) * self.unit_scale()
    }

    /// The point at `unit`, which is in the unit cube when it is in the padded box.
    pub fn from_unit(&self, unit: DVec3) -> DVec3 {
        self.corner() + unit / self.unit_scale()
    }

    fn corner(&self) -> DVec3 {
        DVec3::from_array(self.min.map(f64::from))
    }

    /// Unit cubes per unit of length.
    pub fn unit_scale(&self) -> DVec3 {
        DVec3::from_array(self.scale.map(f64::from)) / f64::from(self.n)
    }

    /// Whether a point is in the padded box. False for a NaN.
    #[inline]
    pub fn holds(&self, point: Vec3) -> bool {
        let point = point.to_array();
        let n = self.n as f32;
        (0..3).all(|k| (0.0..=n).contains(&((point[k] - self.min[k]) * self.scale[k])))
    }

    /// Where the ray, which must be finite, crosses the box.
    ///
    /// Every line of a ray that is located passes within [`DILATION`] of both of its patches, and within it of all that
    /// a primitive test finds on it, in a box scaled to the unit cube.
    #[inline]
    pub fn locate(&self, ray: &Ray) -> Location {
        let (origin, direction) = (ray.origin.to_array(), ray.direction.to_array());
        let offset: [f32; 3] = std::array::from_fn(|k| origin[k] - self.min[k]);
        let scaled: [f32; 3] = std::array::from_fn(|k| direction[k] * self.scale[k]);
        let distance = offset[0].abs().max(offset[1].abs()).max(offset[2].abs());
        let longest = scaled[0].abs().max(scaled[1].abs()).max(scaled[2].abs());
        let exponent = longest.to_bits() & 0x7f80_0000;
        let is_near = distance <= self.limit;
        if !is_near || !(LEAST_EXPONENT..=GREATEST_EXPONENT).contains(&exponent) {
            return Location::TooFar;
        }
        // Powers of two: the first makes the longest component 1 to 2, the second is its reciprocal.
        let (shrink, grow) = (f32::from_bits(0x7f00_0000 - exponent), f32::from_bits(exponent));
        let n = self.n as f32;
        let negative = direction.map(|d| d < 0.0);
        let position: [f32; 3] = std::array::from_fn(|k| {
            let position = offset[k] * self.scale[k];
            if position.abs() < TINY { 0.0 } else { position }
        });
        let speed: [f32; 3] = std::array::from_fn(|k| (scaled[k].abs() * shrink).max(SLIGHT));
        // How far the planes where the ray enters and leaves each slab lie ahead, along the axis.
        let near: [f32; 3] = std::array::from_fn(|k| if negative[k] { position[k] - n } else { 0.0 - position[k] });
        let far: [f32; 3] = std::array::from_fn(|k| if negative[k] { position[k] } else { n - position[k] });
        // Times are distance by speed, and compare as products.
        let mut enter = usize::from(near[1] * speed[0] > near[0] * speed[1]);
        enter = if near[2] * speed[enter] > near[enter] * speed[2] { 2 } else { enter };
        let mut leave = usize::from(far[1] * speed[0] < far[0] * speed[1]);
        leave = if far[2] * speed[leave] < far[leave] * speed[2] { 2 } else { leave };
        let latest = LATEST * shrink;
        let (t_min, t_max) = (ray.t_min.max(0.0).min(latest) * grow, ray.t_max.min(latest) * grow);
        let (begin, end) = (t_min * speed[leave], t_max * speed[enter]);
        let misses = near[enter] * speed[leave] > far[leave] * speed[enter];
        if misses || far[leave] < begin || near[enter] > end {
            return Location::Beside;
        }
        let crossing = |axis: usize, ahead: f32, upper: bool| {
            let ratio = ahead / speed[axis];
            let [u, v] = tangents(axis).map(|k| {
                let step = if negative[k] { -speed[k] } else { speed[k] };
                self.patch_at(position[k], ratio * step, ahead * step, speed[axis])
            });
            Patch { face: 2 * axis as u32 + u32::from(upper), u, v }
        };
        Location::Through(Chord {
            entry: crossing(enter, near[enter], negative[enter]),
            exit: crossing(leave, far[leave], !negative[leave]),
            starts_outside: t_min * speed[enter] <= near[enter],
            reaches_exit: far[leave] <= t_max * speed[leave],
        })
    }

    /// The patch along one axis at `position + moved`, where `moved` is about `product / speed`: the last whose lower
    /// border is not behind that point.
    #[inline]
    fn patch_at(&self, position: f32, moved: f32, product: f32, speed: f32) -> u32 {
        let last = self.n - 1;
        let guess = (position + moved).clamp(0.0, last as f32) as u32;
        let is_behind = |border: u32| (border as f32 - position) * speed <= product;
        if guess > 0 && !is_behind(guess) {
            guess - 1
        } else if guess < last && is_behind(guess + 1) {
            guess + 1
        } else {
            guess
        }
    }
}
