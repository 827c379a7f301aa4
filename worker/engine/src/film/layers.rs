//! Reads the layers of OpenEXR files: what there is, one layer's pixels, all values of one pixel.
//!
//! The counterpart of [`super::encode_exr`], for files of ours and of others. A file is walked block by block, so that
//! nothing but the wanted layer is ever in memory, and one pixel costs one block. Only the first part of a file is
//! read, at its full resolution.

use std::collections::BTreeMap;
use std::io::Cursor;

use exr::block::UncompressedBlock;
use exr::block::reader::{ChunksReader, Reader};
use exr::meta::header::Header;
use exr::prelude::{Error, Result as ExrResult, SampleType};

use super::AovLayer;

/// The layer of channels without a prefix: `R`, `G`, `B`.
pub const COLOR: &str = "color";

/// What the values of a layer are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LayerKind {
    /// Linear colour: three floats.
    Color,
    /// Positions and normals: three floats.
    Vector,
    /// One float.
    Scalar,
    /// Ids (`u32::MAX` where there is none) and counts: one unsigned integer.
    Integer,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LayerInfo {
    /// [`COLOR`], the channels' prefix, or a lone channel's whole name.
    pub name: String,
    pub kind: LayerKind,
    /// Names of the file's channels, one or three.
    pub channels: Vec<String>,
}

/// Least and greatest finite value of a layer, and how many values are not finite. For integers, `u32::MAX` counts as
/// not finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LayerRange {
    pub minimum: f64,
    pub maximum: f64,
    pub non_finite: u64,
}

impl Default for LayerRange {
    fn default() -> Self {
        Self { minimum: f64::INFINITY, maximum: f64::NEG_INFINITY, non_finite: 0 }
    }
}

impl LayerRange {
    /// `None` when no value is finite.
    pub fn bounds(&self) -> Option<(f64, f64)> {
        (self.minimum <= self.maximum).then_some((self.minimum, self.maximum))
    }

    pub fn add(&mut self, value: f64) {
        if value.is_finite() {
            self.minimum = self.minimum.min(value);
            self.maximum = self.maximum.max(value);
        } else {
            self.non_finite += 1;
        }
    }
}

#[derive(Debug, thiserror::Error)]
pub enum LayersError {
    #[error("the picture has {width} x {height} pixels, more than the {limit} that are read")]
    TooLarge { width: usize, height: usize, limit: u64 },
    #[error("OpenEXR: {0}")]
    Malformed(String),
}

impl From<Error> for LayersError {
    fn from(error: Error) -> Self {
        Self::Malformed(error.to_string())
    }
}

/// Whether bytes begin as an OpenEXR file does.
pub fn is_exr(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0x76, 0x2f, 0x31, 0x01])
}

/// A file whose header has been read and found to be within the limits.
#[derive(Clone, Debug)]
pub struct ExrLayers<'a> {
    bytes: &'a [u8],
    width: usize,
    height: usize,
    layers: Vec<LayerInfo>,
    /// For each channel of the file in its order: the layer and the component that it fills, if any.
    places: Vec<Vec<(usize, usize)>>,
}

/// A row's samples of one channel.
enum Samples<'a> {
    Float(&'a [f32]),
    Integer(&'a [u32]),
}

impl<'a> ExrLayers<'a> {
    /// # Errors
    /// When the file is damaged, has more than `max_pixels`, or holds what is not read: deep data, subsampled channels.
    pub fn open(bytes: &'a [u8], max_pixels: u64) -> Result<Self, LayersError> {
        let reader = Reader::read_from_buffered(Cursor::new(bytes), false)?;
        let header = first(reader.headers())?;
        let (width, height) = (header.layer_size.width(), header.layer_size.height());
        let pixels = (width as u64).saturating_mul(height as u64);
        if pixels == 0 || pixels > max_pixels {
            return Err(LayersError::TooLarge { width, height, limit: max_pixels });
        }
        if header.deep {
            return Err(LayersError::Malformed("deep data is not read".to_owned()));
        }
        let channels = &header.channels.list;
        if let Some(channel) = channels.iter().find(|channel| (channel.sampling.x(), channel.sampling.y()) != (1, 1)) {
            return Err(LayersError::Malformed(format!("channel {} is subsampled", channel.name)));
        }
        let named: Vec<(String, SampleType)> =
            channels.iter().map(|channel| (channel.name.to_string(), channel.sample_type)).collect();
        let (layers, places) = group(&named);
        Ok(Self { bytes, width, height, layers, places })
    }

    pub fn width(&self) -> usize {
        self.width
    }

    pub fn height(&self) -> usize {
        self.height
    }

    /// Colour first, the others by name.
    pub fn layers(&self) -> &[LayerInfo] {
        &self.layers
    }

    /// The range of every layer, in their order: one pass over the file.
    pub fn ranges(&self) -> Result<Vec<LayerRange>, LayersError> {
        let mut ranges = vec![LayerRange::default(); self.layers.len()];
        self.walk(&vec![true; self.places.len()], |channel, _, samples| {
            // A channel that fills several components counts once.
            let Some(&(layer, _)) = self.places[channel].first() else { return };
            let range = &mut ranges[layer];
            match samples {
                Samples::Float(values) => values.iter().for_each(|&value| range.add(value.into())),
                Samples::Integer(values) => values.iter().for_each(|&value| range.add(integer_value(value))),
            }
        })?;
        Ok(ranges)
    }

    /// The pixels of a layer, row 0 at the top; `index` is its place in [`Self::layers`].
    pub fn read(&self, index: usize) -> Result<AovLayer, LayersError> {
        let count = self.width * self.height;
        let mut layer = match self.layers[index].kind {
            LayerKind::Color | LayerKind::Vector => AovLayer::Vector(vec![[0.0; 3]; count]),
            LayerKind::Scalar => AovLayer::Scalar(vec![0.0; count]),
            LayerKind::Integer => AovLayer::Integer(vec![0; count]),
        };
        let components: Vec<Vec<usize>> = self
            .places
            .iter()
            .map(|places| places.iter().filter(|place| place.0 == index).map(|place| place.1).collect())
            .collect();
        let wanted: Vec<bool> = components.iter().map(|components| !components.is_empty()).collect();
        self.walk(&wanted, |channel, start, samples| match (&mut layer, samples) {
            (AovLayer::Vector(pixels), Samples::Float(values)) => {
                for &component in &components[channel] {
                    let row = pixels[start..].iter_mut().zip(values);
                    row.for_each(|(pixel, &value)| pixel[component] = value);
                }
            }
            (AovLayer::Scalar(pixels), Samples::Float(values)) => {
                pixels[start..start + values.len()].copy_from_slice(values);
            }
            (AovLayer::Integer(pixels), Samples::Integer(values)) => {
                pixels[start..start + values.len()].copy_from_slice(values);
            }
            // The kind of a layer follows from the types of its channels.
            _ => {}
        })?;
        Ok(layer)
    }

    /// The values of every layer at a pixel of the picture, in the order of [`Self::layers`].
    pub fn pixel(&self, x: usize, y: usize) -> Result<Vec<Vec<f64>>, LayersError> {
        let mut values: Vec<Vec<f64>> = self.layers.iter().map(|layer| vec![0.0; components(layer.kind)]).collect();
        let wanted = vec![true; self.places.len()];
        let reader = Reader::read_from_buffered(Cursor::new(self.bytes), false)?;
        let chunks = reader.filter_chunks(false, |_, _, block| {
            let (left, top) = (block.pixel_position.x(), block.pixel_position.y());
            is_first_level(block.layer, block.level)
                && (left..left + block.pixel_size.width()).contains(&x)
                && (top..top + block.pixel_size.height()).contains(&y)
        })?;
        let place = y * self.width + x;
        chunks.decompress_sequential(false, |meta, block| {
            self.visit(first(&meta.headers)?, &block, &wanted, &mut |channel, start, samples| {
                let value = match samples {
                    Samples::Float(row) => place.checked_sub(start).and_then(|i| row.get(i)).map(|&v| f64::from(v)),
                    Samples::Integer(row) => place.checked_sub(start).and_then(|i| row.get(i)).map(|&v| f64::from(v)),
                };
                for &(layer, component) in &self.places[channel] {
                    if let Some(value) = value {
                        values[layer][component] = value;
                    }
                }
            })
        })?;
        Ok(values)
    }

    /// Calls `visit` with every row of the wanted channels: channel, index of the row's first pixel, samples.
    fn walk(&self, wanted: &[bool], mut visit: impl FnMut(usize, usize, Samples<'_>)) -> Result<(), LayersError> {
        let reader = Reader::read_from_buffered(Cursor::new(self.bytes), false)?;
        let chunks = reader.filter_chunks(false, |_, _, block| is_first_level(block.layer, block.level))?;
        chunks
            .decompress_parallel(false, |meta, block| self.visit(first(&meta.headers)?, &block, wanted, &mut visit))?;
        Ok(())
    }

    fn visit(
        &self,
        header: &Header,
        block: &UncompressedBlock,
        wanted: &[bool],
        visit: &mut impl FnMut(usize, usize, Samples<'_>),
    ) -> ExrResult<()> {
        for line in block.lines(&header.channels) {
            let at = line.location;
            let (x, y) = (at.position.x(), at.position.y());
            if !wanted[at.channel] {
                continue;
            }
            if x + at.sample_count > self.width || y >= self.height {
                return Err(Error::Invalid("block outside of the picture".into()));
            }
            let start = y * self.width + x;
            let bytes = line.value;
            // Blocks hold samples in the machine's byte order.
            match header.channels.list[at.channel].sample_type {
                SampleType::F32 => {
                    let row: Vec<f32> = bytes.as_chunks::<4>().0.iter().map(|&b| f32::from_ne_bytes(b)).collect();
                    visit(at.channel, start, Samples::Float(&row));
                }
                SampleType::F16 => {
                    let halves = bytes.as_chunks::<2>().0.iter();
                    let row: Vec<f32> = halves.map(|&b| half::f16::from_ne_bytes(b).to_f32()).collect();
                    visit(at.channel, start, Samples::Float(&row));
                }
                SampleType::U32 => {
                    let row: Vec<u32> = bytes.as_chunks::<4>().0.iter().map(|&b| u32::from_ne_bytes(b)).collect();
                    visit(at.channel, start, Samples::Integer(&row));
                }
            }
        }
        Ok(())
    }
}

/// An id or count as a number; "none" is infinite.
pub fn integer_value(value: u32) -> f64 {
    if value == u32::MAX { f64::INFINITY } else { f64::from(value) }
}

fn components(kind: LayerKind) -> usize {
    match kind {
        LayerKind::Color | LayerKind::Vector => 3,
        LayerKind::Scalar | LayerKind::Integer => 1,
    }
}

fn first(headers: &[Header]) -> ExrResult<&Header> {
    headers.first().ok_or_else(|| Error::Invalid("a file without a picture".into()))
}

fn is_first_level(part: usize, level: exr::math::Vec2<usize>) -> bool {
    part == 0 && (level.x(), level.y()) == (0, 0)
}

/// For each channel, which layer and component it fills.
type Places = Vec<Vec<(usize, usize)>>;

/// Puts channels together: `R G B` and `X Y Z` of one prefix are a layer of three components, what is left are layers of
/// one. A grey file (`Y` alone) has a colour of three equal components.
fn group(channels: &[(String, SampleType)]) -> (Vec<LayerInfo>, Places) {
    let mut by_prefix: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (index, (name, _)) in channels.iter().enumerate() {
        by_prefix.entry(name.rsplit_once('.').map_or("", |(prefix, _)| prefix)).or_default().push(index);
    }
    let mut layers = Vec::new();
    let mut places: Places = vec![Vec::new(); channels.len()];
    for (prefix, mut members) in by_prefix {
        let suffix = |index: usize| channels[index].0.rsplit('.').next().unwrap_or_default();
        let is_float = |index: usize| channels[index].1 != SampleType::U32;
        for (letters, kind) in [(["R", "G", "B"], LayerKind::Color), (["X", "Y", "Z"], LayerKind::Vector)] {
            let find =
                |letter: &str| members.iter().copied().find(|&i| is_float(i) && suffix(i).eq_ignore_ascii_case(letter));
            let mut found: Vec<usize> = letters.iter().filter_map(|letter| find(letter)).collect();
            if kind == LayerKind::Color && prefix.is_empty() && found.is_empty() {
                found = find("Y").into_iter().collect();
            } else if found.len() != 3 {
                continue;
            }
            if found.is_empty() {
                continue;
            }
            for component in 0..3 {
                places[found[component % found.len()]].push((layers.len(), component));
            }
            members.retain(|index| !found.contains(index));
            let name = if prefix.is_empty() && kind == LayerKind::Color { COLOR } else { prefix };
            let channels = found.iter().map(|&index| channels[index].0.clone()).collect();
            layers.push(LayerInfo { name: name.to_owned(), kind, channels });
        }
        let is_lone = members.len() == 1 && !prefix.is_empty() && !layers.iter().any(|layer| layer.name == prefix);
        for index in members {
            let whole = &channels[index].0;
            let name = if is_lone { prefix.to_owned() } else { whole.clone() };
            let kind = if is_float(index) { LayerKind::Scalar } else { LayerKind::Integer };
            places[index].push((layers.len(), 0));
            layers.push(LayerInfo { name, kind, channels: vec![whole.clone()] });
        }
    }
    (layers, places)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::Region;
    use crate::film::{AovBuffers, encode_exr};
    use crate::settings::Aov;

    /// 5 x 40 pixels: more than the 16 rows of one block.
    fn picture() -> (Vec<[f32; 3]>, AovBuffers, Vec<u8>) {
        let (width, height) = (5, 40);
        let radiance: Vec<[f32; 3]> = (0..width * height).map(|i| [i as f32, 0.5, -1.0]).collect();
        let mut aovs = AovBuffers::new(Region { x: 0, y: 0, width, height }, &Aov::ALL);
        for (_, layer) in &mut aovs.layers {
            match layer {
                AovLayer::Scalar(values) => values[7] = 2.5,
                AovLayer::Vector(values) => values[7] = [1.0, -2.0, 3.5],
                AovLayer::Integer(values) => values[7] = 4_000_000_001,
            }
        }
        let bytes = encode_exr(width, height, &radiance, Some(&aovs), &[]).unwrap();
        (radiance, aovs, bytes)
    }

    #[test]
    fn every_layer_of_ours_comes_back() {
        let (radiance, aovs, bytes) = picture();
        let file = ExrLayers::open(&bytes, 200).unwrap();
        assert_eq!((file.width(), file.height()), (5, 40));
        let names: Vec<&str> = file.layers().iter().map(|layer| layer.name.as_str()).collect();
        assert_eq!(names[0], COLOR);
        assert_eq!(file.read(0).unwrap(), AovLayer::Vector(radiance));
        for (aov, layer) in &aovs.layers {
            let index = names.iter().position(|name| *name == aov.name()).unwrap_or_else(|| panic!("{}", aov.name()));
            assert_eq!(&file.read(index).unwrap(), layer, "{}", aov.name());
        }
        assert_eq!(names.len(), Aov::ALL.len() + 1);
    }

    #[test]
    fn ranges_leave_out_what_is_not_finite() {
        let (_, _, bytes) = picture();
        let file = ExrLayers::open(&bytes, 200).unwrap();
        let ranges = file.ranges().unwrap();
        assert_eq!(ranges[0].bounds(), Some((-1.0, 199.0)));
        let of = |name: &str| ranges[file.layers().iter().position(|layer| layer.name == name).unwrap()];
        assert_eq!((of("depth").bounds(), of("depth").non_finite), (Some((2.5, 2.5)), 199));
        assert_eq!((of("instance_id").maximum, of("instance_id").non_finite), (4_000_000_001.0, 199));
    }

    #[test]
    fn a_pixel_has_the_values_of_all_layers() {
        let (_, _, bytes) = picture();
        let file = ExrLayers::open(&bytes, 200).unwrap();
        let pixel = |x, y, name: &str| {
            let index = file.layers().iter().position(|layer| layer.name == name).unwrap();
            file.pixel(x, y).unwrap()[index].clone()
        };
        assert_eq!(pixel(2, 1, COLOR), [7.0, 0.5, -1.0]);
        assert_eq!(pixel(2, 1, "depth"), [2.5]);
        assert_eq!(pixel(2, 1, "shading_normal"), [1.0, -2.0, 3.5]);
        assert_eq!(pixel(2, 1, "primitive_id"), [4_000_000_001.0]);
        assert_eq!(pixel(4, 39, COLOR), [199.0, 0.5, -1.0]);
    }

    #[test]
    fn channels_of_others_are_grouped_by_prefix() {
        let float = |name: &str| (name.to_owned(), SampleType::F16);
        let named = |names: &[&str]| {
            let channels: Vec<_> = names.iter().map(|name| float(name)).collect();
            let (layers, places) = group(&channels);
            assert!(places.iter().all(|places| !places.is_empty()));
            layers.into_iter().map(|layer| (layer.name, layer.kind)).collect::<Vec<_>>()
        };
        let (color, scalar) = (LayerKind::Color, LayerKind::Scalar);
        assert_eq!(named(&["A", "B", "G", "R"]), [(COLOR.into(), color), ("A".into(), scalar)]);
        assert_eq!(named(&["Y"]), [(COLOR.into(), color)]);
        assert_eq!(named(&["uv.U", "uv.V"]), [("uv.U".into(), scalar), ("uv.V".into(), scalar)]);
        let two = named(&["left.B", "left.G", "left.R", "left.Z"]);
        assert_eq!(two, [("left".into(), color), ("left.Z".into(), scalar)]);
        assert_eq!(named(&["N.X", "N.Y", "N.Z"]), [("N".into(), LayerKind::Vector)]);
    }

    #[test]
    fn damaged_and_oversized_files_are_refused() {
        let (_, _, bytes) = picture();
        let error = ExrLayers::open(&bytes, 199).unwrap_err().to_string();
        assert_eq!(error, "the picture has 5 x 40 pixels, more than the 199 that are read");
        for length in [3, 40, 200] {
            assert!(ExrLayers::open(&bytes[..length], 200).is_err(), "{length}");
        }
        let torn = &bytes[..bytes.len() - 30];
        if let Ok(file) = ExrLayers::open(torn, 200) {
            assert!(file.read(0).is_err() && file.ranges().is_err());
        }
    }
}
