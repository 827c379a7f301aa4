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

/// What [`encode_part`] wrote, after its checksum and every length were checked. Sums and layers stay bytes.
struct Encoded<'a> {
    region: Region,
    samples: u32,
    sums: &'a [u8],
    layers: Vec<(Aov, &'a [u8])>,
}

impl<'a> Encoded<'a> {
    fn read(bytes: &'a [u8]) -> Result<Self, PartError> {
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
        let values = |reader: &mut Reader<'a>, bytes_each: usize| {
            reader.take(region.pixels().checked_mul(bytes_each).ok_or_else(|| error("the region is too large"))?)
        };
        let sums = values(&mut reader, size_of::<[f64; 3]>())?;
        let mut layers: Vec<(Aov, &[u8])> = Vec::new();
        for _ in 0..reader.u32()? {
            let number = reader.u32()?;
            let aov = *Aov::ALL.get(number as usize).ok_or_else(|| PartError(format!("layer number {number}")))?;
            if layers.iter().any(|(known, _)| *known == aov) {
                return Err(PartError(format!("layer {} stands twice", aov.name())));
            }
            layers.push((aov, values(&mut reader, value_bytes(aov))?));
        }
        if !reader.rest.is_empty() {
            return Err(PartError(format!("{} bytes too many", reader.rest.len())));
        }
        Ok(Self { region, samples, sums, layers })
    }
}

/// Bytes of one pixel's value.
fn value_bytes(aov: Aov) -> usize {
    let nothing = Region { x: 0, y: 0, width: 0, height: 0 };
    match AovBuffers::new(nothing, &[aov]).layers[..] {
        [(_, AovLayer::Vector(_))] => size_of::<[f32; 3]>(),
        _ => size_of::<u32>(),
    }
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
}

/// Puts the parts of a job's tasks together, one after the other, so that memory holds the whole picture and one part.
/// Tiles and passes may be mixed. Sums are added in the order in which parts come.
#[derive(Debug)]
pub struct Merger {
    film: PassFilm,
    /// Of every pixel so far.
    samples: Vec<u32>,
    /// As the first part has them.
    aovs: Option<AovBuffers>,
}

impl Merger {
    pub fn new(region: Region) -> Self {
        Self { film: PassFilm::new(region), samples: vec![0; region.pixels()], aovs: None }
    }

    /// Adds what [`encode_part`] wrote. Passes over the same pixels carry the same layers' values.
    ///
    /// # Errors
    /// A part that is damaged, lies outside of the picture, or has other layers than those before.
    pub fn add(&mut self, bytes: &[u8]) -> Result<(), PartError> {
        let part = Encoded::read(bytes)?;
        let (inner, outer) = (part.region, self.film.region);
        if !outer.contains(inner) {
            return Err(PartError(format!("{inner:?} does not lie within {outer:?}")));
        }
        let names = || part.layers.iter().map(|layer| layer.0);
        let aovs = self.aovs.get_or_insert_with(|| AovBuffers::new(outer, &names().collect::<Vec<_>>()));
        if names().ne(aovs.layers.iter().map(|layer| layer.0)) {
            return Err(PartError("parts have different layers".into()));
        }
        let (sums, _) = part.sums.as_chunks::<{ size_of::<[f64; 3]>() }>();
        for (i, sum) in inner.places_in(outer).zip(sums) {
            let (channels, _) = sum.as_chunks();
            for (total, channel) in self.film.sum[i].iter_mut().zip(channels) {
                *total += f64::from_le_bytes(*channel);
            }
            self.samples[i] = self.samples[i].saturating_add(part.samples);
        }
        for ((_, layer), (_, values)) in aovs.layers.iter_mut().zip(&part.layers) {
            let (words, _) = values.as_chunks();
            match layer {
                AovLayer::Scalar(all) => paste(all, inner, outer, words.iter().map(|w| f32::from_le_bytes(*w))),
                AovLayer::Integer(all) => paste(all, inner, outer, words.iter().map(|w| u32::from_le_bytes(*w))),
                AovLayer::Vector(all) => {
                    let (vectors, _) = words.as_chunks::<3>();
                    paste(all, inner, outer, vectors.iter().map(|v| v.map(f32::from_le_bytes)));
                }
            }
        }
        Ok(())
    }

    /// # Errors
    /// When some pixels have more samples than others, such as none.
    pub fn finish(mut self) -> Result<(PassFilm, Option<AovBuffers>), PartError> {
        let expected = self.samples.first().copied().unwrap_or(0);
        if let Some(i) = self.samples.iter().position(|&samples| samples != expected) {
            let width = self.film.region.width as usize;
            let (x, y, got) = (i % width, i / width, self.samples[i]);
            return Err(PartError(format!("pixel ({x}, {y}) has {got} samples, the first pixel {expected}")));
        }
        self.film.samples = expected;
        Ok((self.film, self.aovs.filter(|aovs| !aovs.layers.is_empty())))
    }
}

fn paste<T>(all: &mut [T], inner: Region, outer: Region, values: impl Iterator<Item = T>) {
    for (i, value) in inner.places_in(outer).zip(values) {
        all[i] = value;
    }
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

    fn merge(region: Region, parts: &[Vec<u8>]) -> Result<(PassFilm, Option<AovBuffers>), PartError> {
        let mut merger = Merger::new(region);
        parts.iter().try_for_each(|part| merger.add(part))?;
        merger.finish()
    }

    fn wrong(region: Region, parts: &[Vec<u8>]) -> String {
        merge(region, parts).unwrap_err().to_string()
    }

    #[test]
    fn parts_survive_the_journey() {
        let film = film(RIGHT, 9, |x, y| f64::from(x) / 3.0 + f64::from(y));
        let mut aovs = AovBuffers::new(RIGHT, &[Aov::Depth, Aov::Albedo, Aov::PrimitiveId]);
        for (_, layer) in &mut aovs.layers {
            match layer {
                AovLayer::Scalar(values) => values[1] = -7.5,
                AovLayer::Vector(values) => values[2] = [0.25, 0.5, 1.0],
                AovLayer::Integer(values) => values[3] = 77,
            }
        }
        let with_layers = encode_part(&film, Some(&aovs));
        assert_eq!(merge(RIGHT, &[with_layers]).unwrap(), (film.clone(), Some(aovs)));
        assert_eq!(merge(RIGHT, &[encode_part(&film, None)]).unwrap(), (film, None));
    }

    #[test]
    fn damage_is_noticed() {
        let mut bytes = encode_part(&film(LEFT, 1, |_, _| 1.0), None);
        assert_eq!(wrong(LEFT, &[bytes[..10].to_vec()]), "bad part file: shorter than its checksum");
        bytes[40] ^= 1;
        assert_eq!(wrong(LEFT, std::slice::from_ref(&bytes)), "bad part file: the checksum does not match");
        // A correct checksum over a lying header.
        let mut body = bytes[..bytes.len() - HASH_BYTES].to_vec();
        body[16..20].copy_from_slice(&u32::MAX.to_le_bytes());
        let hash = blake3::hash(&body);
        body.extend_from_slice(hash.as_bytes());
        assert!(wrong(LEFT, &[body]).contains("missing"));
    }

    #[test]
    fn tiles_and_passes_merge_into_the_unsplit_film() {
        let value = |x: u32, y: u32| f64::from((x * 31 + y * 17) as f32 * 0.123);
        let parts = [(RIGHT, 8), (LEFT, 4), (LEFT, 4)].map(|(region, n)| encode_part(&film(region, n, value), None));
        let (merged, _) = merge(WHOLE, &parts).unwrap();
        assert_eq!(merged.samples, 8);
        let v = value(3, 0);
        assert_eq!(merged.sum[3], [v, 2.0 * v, 0.1]);
        let v = value(2, 0);
        assert_eq!(merged.sum[2], [2.0 * v, 4.0 * v, 0.2]);
    }

    #[test]
    fn holes_and_strangers_are_refused() {
        let part = |region, aovs: &[Aov]| {
            let layers = AovBuffers::new(region, aovs);
            encode_part(&film(region, 4, |_, _| 1.0), (!aovs.is_empty()).then_some(&layers))
        };
        assert_eq!(wrong(WHOLE, &[part(LEFT, &[])]), "bad part file: pixel (3, 0) has 0 samples, the first pixel 4");
        assert!(wrong(WHOLE, &[part(Region { x: 6, ..LEFT }, &[])]).contains("within"));
        for other in [&[Aov::Albedo][..], &[]] {
            assert!(wrong(WHOLE, &[part(LEFT, &[Aov::Depth]), part(RIGHT, other)]).contains("different layers"));
        }
    }

    #[test]
    fn aov_tiles_merge() {
        let parts = [(LEFT, 1.0), (RIGHT, 2.0)].map(|(region, depth)| {
            let mut aovs = AovBuffers::new(region, &[Aov::Depth]);
            if let AovLayer::Scalar(values) = &mut aovs.layers[0].1 {
                values.fill(depth);
            }
            encode_part(&film(region, 1, |_, _| 0.0), Some(&aovs))
        });
        let (_, aovs) = merge(WHOLE, &parts).unwrap();
        let row = [1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0];
        assert_eq!(aovs.unwrap().layers[0].1, AovLayer::Scalar(row.repeat(4)));
    }
}
