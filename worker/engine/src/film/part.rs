//! Parts of a split job: what one task rendered, as bytes that another worker merges.
//!
//! Layout, little-endian: `LSPART` and a `u16` version; region (`x y width height`) and samples as `u32`; the RGB sums
//! as `f64`; the number of AOV layers as `u32`, each a `u32` number in [`Aov::ALL`] and its values of 4 bytes; BLAKE3
//! of all that. Sums travel unrounded, so a merged picture equals the unsplit one.

use super::{AovBuffers, AovLayer, PassFilm};
use crate::device::Region;
use crate::settings::Aov;

const MAGIC: &[u8; 6] = b"LSPART";
const VERSION: u16 = 1;
const HASH_BYTES: usize = 32;

#[derive(Debug, thiserror::Error, PartialEq)]
#[error("bad part file: {0}")]
pub struct PartError(pub String);

/// Bytes of a task's film and, where it rendered any, its AOV layers (of the same region).
pub fn encode_part(film: &PassFilm, aovs: Option<&AovBuffers>) -> Vec<u8> {
    let mut out = Vec::with_capacity(64 + film.sum.len() * 24);
    out.extend_from_slice(MAGIC);
    out.extend_from_slice(&VERSION.to_le_bytes());
    let r = film.region;
    for value in [r.x, r.y, r.width, r.height, film.samples] {
        out.extend_from_slice(&value.to_le_bytes());
    }
    for value in film.sum.iter().flatten() {
        out.extend_from_slice(&value.to_le_bytes());
    }
    let layers = aovs.map(|a| a.layers.as_slice()).unwrap_or_default();
    out.extend_from_slice(&(layers.len() as u32).to_le_bytes());
    for (aov, layer) in layers {
        let number = Aov::ALL.iter().position(|a| a == aov).unwrap_or_default() as u32;
        out.extend_from_slice(&number.to_le_bytes());
        match layer {
            AovLayer::Scalar(v) => v.iter().for_each(|x| out.extend_from_slice(&x.to_le_bytes())),
            AovLayer::Vector(v) => v.iter().flatten().for_each(|x| out.extend_from_slice(&x.to_le_bytes())),
            AovLayer::Integer(v) => v.iter().for_each(|x| out.extend_from_slice(&x.to_le_bytes())),
        }
    }
    let hash = blake3::hash(&out);
    out.extend_from_slice(hash.as_bytes());
    out
}

/// Reads what [`encode_part`] wrote, after checking the checksum and every length.
pub fn decode_part(bytes: &[u8]) -> Result<(PassFilm, Option<AovBuffers>), PartError> {
    let error = |detail: &str| PartError(detail.to_owned());
    let body = bytes.len().checked_sub(HASH_BYTES).ok_or_else(|| error("shorter than its checksum"))?;
    let (body, hash) = bytes.split_at(body);
    if blake3::hash(body).as_bytes() != hash {
        return Err(error("the checksum does not match"));
    }
    let mut reader = Reader { rest: body };
    if reader.take(MAGIC.len())? != MAGIC {
        return Err(error("it does not start with LSPART"));
    }
    let version = u16::from_le_bytes(reader.array()?);
    if version != VERSION {
        return Err(PartError(format!("version {version}, this build reads version {VERSION}")));
    }
    let region = Region { x: reader.u32()?, y: reader.u32()?, width: reader.u32()?, height: reader.u32()? };
    let samples = reader.u32()?;
    let count = region.pixels();
    let sums = reader.take(count.checked_mul(24).ok_or_else(|| error("the region is too large"))?)?;
    let mut sums = Reader { rest: sums };
    let mut sum = Vec::with_capacity(count);
    for _ in 0..count {
        let mut pixel = [0.0; 3];
        for c in &mut pixel {
            *c = f64::from_le_bytes(sums.array()?);
        }
        sum.push(pixel);
    }
    let layers = reader.u32()?;
    let mut wanted = Vec::new();
    let mut aovs = AovBuffers { region, layers: Vec::new() };
    for _ in 0..layers {
        let number = reader.u32()?;
        let aov = *Aov::ALL.get(number as usize).ok_or_else(|| PartError(format!("layer number {number}")))?;
        if wanted.contains(&aov) {
            return Err(PartError(format!("layer {} stands twice", aov.name())));
        }
        wanted.push(aov);
        let mut layer = AovBuffers::new(region, &[aov]);
        for (_, values) in &mut layer.layers {
            match values {
                AovLayer::Scalar(v) => v.iter_mut().try_for_each(|x| reader.f32().map(|r| *x = r))?,
                AovLayer::Vector(v) => v.iter_mut().flatten().try_for_each(|x| reader.f32().map(|r| *x = r))?,
                AovLayer::Integer(v) => v.iter_mut().try_for_each(|x| reader.u32().map(|r| *x = r))?,
            }
        }
        aovs.layers.append(&mut layer.layers);
    }
    if !reader.rest.is_empty() {
        return Err(PartError(format!("{} bytes too many", reader.rest.len())));
    }
    Ok((PassFilm { region, sum, samples }, (layers > 0).then_some(aovs)))
}

struct Reader<'a> {
    rest: &'a [u8],
}

impl<'a> Reader<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], PartError> {
        if count > self.rest.len() {
            return Err(PartError(format!("{} bytes are missing", count - self.rest.len())));
        }
        let (head, tail) = self.rest.split_at(count);
        self.rest = tail;
        Ok(head)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], PartError> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    fn u32(&mut self) -> Result<u32, PartError> {
        self.array().map(u32::from_le_bytes)
    }

    fn f32(&mut self) -> Result<f32, PartError> {
        self.array().map(f32::from_le_bytes)
    }
}

/// Puts the films of a job's tasks together. Together they must cover every pixel of `region`, each with the same number
/// of samples; tiles and passes may be mixed. Sums are added in the order of `parts`.
pub fn merge_films(region: Region, parts: &[PassFilm]) -> Result<PassFilm, PartError> {
    let mut merged = PassFilm::new(region);
    let mut samples = vec![0u32; region.pixels()];
    for part in parts {
        check_inside(part.region, region)?;
        if part.sum.len() != part.region.pixels() {
            return Err(PartError(format!("{} sums for {} pixels", part.sum.len(), part.region.pixels())));
        }
        for (k, sum) in part.sum.iter().enumerate() {
            let i = place(part.region, region, k);
            (0..3).for_each(|c| merged.sum[i][c] += sum[c]);
            samples[i] = samples[i].saturating_add(part.samples);
        }
    }
    merged.samples = samples.first().copied().unwrap_or(0);
    if let Some(i) = samples.iter().position(|&s| s != merged.samples) {
        let (x, y) = (i % region.width as usize, i / region.width as usize);
        let (got, expected) = (samples[i], merged.samples);
        return Err(PartError(format!("pixel ({x}, {y}) has {got} samples, the first pixel {expected}")));
    }
    Ok(merged)
}

/// Puts the AOV layers of a job's tasks together; every part has the same layers. Pixels that no part covers keep the
/// values of a miss, and passes over the same pixels carry the same values.
pub fn merge_aovs(region: Region, parts: &[AovBuffers]) -> Result<AovBuffers, PartError> {
    let names: Vec<Aov> = parts.first().map(|p| p.layers.iter().map(|l| l.0).collect()).unwrap_or_default();
    let mut merged = AovBuffers::new(region, &names);
    for part in parts {
        check_inside(part.region, region)?;
        if part.layers.iter().map(|l| l.0).ne(names.iter().copied()) {
            return Err(PartError("parts have different layers".into()));
        }
        let pixels = part.region.pixels();
        for ((aov, target), (_, source)) in merged.layers.iter_mut().zip(&part.layers) {
            let fits = match (target, source) {
                (AovLayer::Scalar(t), AovLayer::Scalar(s)) => paste(t, region, s, part.region, pixels),
                (AovLayer::Vector(t), AovLayer::Vector(s)) => paste(t, region, s, part.region, pixels),
                (AovLayer::Integer(t), AovLayer::Integer(s)) => paste(t, region, s, part.region, pixels),
                _ => false,
            };
            if !fits {
                return Err(PartError(format!("layer {} has another type or length", aov.name())));
            }
        }
    }
    Ok(merged)
}

fn paste<T: Copy>(target: &mut [T], region: Region, source: &[T], part: Region, pixels: usize) -> bool {
    if source.len() != pixels {
        return false;
    }
    source.iter().enumerate().for_each(|(k, value)| target[place(part, region, k)] = *value);
    true
}

/// Place in `outer`'s row-major buffer of pixel `k` of `inner`.
fn place(inner: Region, outer: Region, k: usize) -> usize {
    let x = (inner.x - outer.x) as usize + k % inner.width as usize;
    let y = (inner.y - outer.y) as usize + k / inner.width as usize;
    y * outer.width as usize + x
}

fn check_inside(inner: Region, outer: Region) -> Result<(), PartError> {
    if outer.contains(inner) { Ok(()) } else { Err(PartError(format!("{inner:?} does not lie within {outer:?}"))) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn film(region: Region, samples: u32, value: impl Fn(u32, u32) -> f64) -> PassFilm {
        let mut film = PassFilm::new(region);
        film.samples = samples;
        for (k, sum) in film.sum.iter_mut().enumerate() {
            let (x, y) = (region.x + k as u32 % region.width, region.y + k as u32 / region.width);
            *sum = [value(x, y), 2.0 * value(x, y), 0.1];
        }
        film
    }

    const WHOLE: Region = Region { x: 0, y: 0, width: 7, height: 4 };
    const LEFT: Region = Region { x: 0, y: 0, width: 3, height: 4 };
    const RIGHT: Region = Region { x: 3, y: 0, width: 4, height: 4 };

    #[test]
    fn parts_survive_the_journey() {
        let film = film(RIGHT, 9, |x, y| f64::from(x) / 3.0 + f64::from(y));
        let mut aovs = AovBuffers::new(RIGHT, &[Aov::Depth, Aov::Albedo, Aov::PrimitiveId]);
        if let AovLayer::Integer(v) = &mut aovs.layers[2].1 {
            v[3] = 77;
        }
        assert_eq!(decode_part(&encode_part(&film, Some(&aovs))).unwrap(), (film.clone(), Some(aovs)));
        assert_eq!(decode_part(&encode_part(&film, None)).unwrap(), (film, None));
    }

    #[test]
    fn damage_is_noticed() {
        let mut bytes = encode_part(&film(LEFT, 1, |_, _| 1.0), None);
        assert_eq!(decode_part(&bytes[..10]).unwrap_err().to_string(), "bad part file: shorter than its checksum");
        bytes[40] ^= 1;
        assert_eq!(decode_part(&bytes).unwrap_err().to_string(), "bad part file: the checksum does not match");
        // A correct checksum over a lying header.
        let mut body = bytes[..bytes.len() - HASH_BYTES].to_vec();
        body[16..20].copy_from_slice(&u32::MAX.to_le_bytes());
        let hash = blake3::hash(&body);
        body.extend_from_slice(hash.as_bytes());
        assert!(decode_part(&body).unwrap_err().to_string().contains("missing"));
    }

    #[test]
    fn tiles_and_passes_merge_into_the_unsplit_film() {
        let value = |x: u32, y: u32| f64::from((x * 31 + y * 17) as f32 * 0.123);
        let parts = [film(RIGHT, 8, value), film(LEFT, 4, value), film(LEFT, 4, value)];
        let merged = merge_films(WHOLE, &parts).unwrap();
        assert_eq!(merged.samples, 8);
        let v = value(3, 0);
        assert_eq!(merged.sum[3], [v, 2.0 * v, 0.1]);
        let v = value(2, 0);
        assert_eq!(merged.sum[2], [2.0 * v, 4.0 * v, 0.2]);
    }

    #[test]
    fn holes_and_strangers_are_refused() {
        let holes = merge_films(WHOLE, &[film(LEFT, 4, |_, _| 1.0)]).unwrap_err();
        assert_eq!(holes.to_string(), "bad part file: pixel (3, 0) has 0 samples, the first pixel 4");
        let outside = Region { x: 6, ..LEFT };
        assert!(merge_films(WHOLE, &[film(outside, 4, |_, _| 1.0)]).unwrap_err().to_string().contains("within"));
        let layers = [AovBuffers::new(LEFT, &[Aov::Depth]), AovBuffers::new(RIGHT, &[Aov::Albedo])];
        assert!(merge_aovs(WHOLE, &layers).unwrap_err().to_string().contains("different layers"));
    }

    #[test]
    fn aov_tiles_merge() {
        let mut parts = [AovBuffers::new(LEFT, &[Aov::Depth]), AovBuffers::new(RIGHT, &[Aov::Depth])];
        for (part, depth) in parts.iter_mut().zip([1.0, 2.0]) {
            if let AovLayer::Scalar(v) = &mut part.layers[0].1 {
                v.fill(depth);
            }
        }
        let merged = merge_aovs(WHOLE, &parts).unwrap();
        let row = [1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0];
        assert_eq!(merged.layers[0].1, AovLayer::Scalar(row.repeat(4)));
    }
}
