//! Accessors: typed views of buffers (glTF 2.0, 3.6.2), read into plain vectors.
//!
//! Reads are by byte, so that neither alignment nor interleaving matters. [`check`](super::check) has proved that every
//! accessor lies within its view; [`Accessors::new`] that every buffer is as long as it says.

use std::borrow::Cow;

use super::document::{Accessor, Document};
use crate::scene::error::{ImportError, Result};
use crate::scene::limits::Limits;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ComponentType {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl ComponentType {
    pub(super) fn from_gl(value: u32) -> Option<Self> {
        Some(match value {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            _ => return None,
        })
    }

    pub(super) fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    pub(super) fn is_index(self) -> bool {
        matches!(self, Self::U8 | Self::U16 | Self::U32)
    }

    /// One component as a float; normalised integers as in glTF 2.0, 3.6.2.2.
    fn decode(self, bytes: &[u8], normalized: bool) -> f32 {
        let scale = |value: f32, most: f32| if normalized { (value / most).max(-1.0) } else { value };
        match self {
            Self::I8 => scale(f32::from(bytes[0] as i8), 127.0),
            Self::U8 => scale(f32::from(bytes[0]), 255.0),
            Self::I16 => scale(f32::from(i16::from_le_bytes([bytes[0], bytes[1]])), 32767.0),
            Self::U16 => scale(f32::from(u16::from_le_bytes([bytes[0], bytes[1]])), 65535.0),
            Self::U32 => scale(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]) as f32, u32::MAX as f32),
            Self::F32 => f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
        }
    }

    fn decode_index(self, bytes: &[u8]) -> u32 {
        match self {
            Self::U8 => u32::from(bytes[0]),
            Self::U16 => u32::from(u16::from_le_bytes([bytes[0], bytes[1]])),
            _ => u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]),
        }
    }
}

/// Columns and rows of an element; vectors have one column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shape {
    columns: usize,
    rows: usize,
}

impl Shape {
    pub(super) fn from_name(name: &str) -> Option<Self> {
        let (columns, rows) = match name {
            "SCALAR" => (1, 1),
            "VEC2" => (1, 2),
            "VEC3" => (1, 3),
            "VEC4" => (1, 4),
            "MAT2" => (2, 2),
            "MAT3" => (3, 3),
            "MAT4" => (4, 4),
            _ => return None,
        };
        Some(Self { columns, rows })
    }

    fn components(self) -> usize {
        self.columns * self.rows
    }

    /// Columns of a matrix start at multiples of four bytes (glTF 2.0, 3.6.2.4).
    fn column_bytes(self, component: ComponentType) -> usize {
        let bytes = self.rows * component.bytes();
        if self.columns > 1 { bytes.next_multiple_of(4) } else { bytes }
    }

    pub(super) fn bytes(self, component: ComponentType) -> usize {
        self.columns * self.column_bytes(component)
    }
}

/// All accessors of a checked document, with the buffers that they view.
pub(super) struct Accessors<'a> {
    document: &'a Document,
    buffers: Vec<Cow<'a, [u8]>>,
}

/// An accessor, resolved.
struct Elements<'a> {
    /// `None`: all zeros (an accessor without a buffer view).
    bytes: Option<&'a [u8]>,
    stride: usize,
    count: usize,
    component: ComponentType,
    shape: Shape,
    normalized: bool,
    /// Element numbers, strictly increasing, and the bytes that replace them.
    sparse: Option<(Vec<u32>, &'a [u8])>,
}

impl<'a> Accessors<'a> {
    /// # Errors
    /// Malformed: a buffer shorter than its `byteLength`.
    pub(super) fn new(document: &'a Document, buffers: Vec<Cow<'a, [u8]>>) -> Result<Self> {
        for (index, (declared, buffer)) in document.buffers.iter().zip(&buffers).enumerate() {
            if (buffer.len() as u64) < declared.byte_length {
                return Err(ImportError::malformed(
                    format!("buffers/{index}/byteLength"),
                    format!("{} bytes are declared but the buffer holds {}", declared.byte_length, buffer.len()),
                ));
            }
        }
        Ok(Self { document, buffers })
    }

    pub(super) fn accessor(&self, index: usize) -> &'a Accessor {
        &self.document.accessors[index]
    }

    /// Elements of an accessor.
    pub(super) fn count(&self, index: usize) -> usize {
        self.document.accessors[index].count as usize
    }

    /// The bytes of a buffer view.
    pub(super) fn view(&self, index: usize) -> &[u8] {
        let view = &self.document.buffer_views[index];
        let start = view.byte_offset as usize;
        &self.buffers[view.buffer][start..start + view.byte_length as usize]
    }

    /// The bytes of a view from `offset` on; none for an accessor of no elements that starts beyond its view.
    fn view_from(&self, index: usize, offset: u64) -> &[u8] {
        self.view(index).get(offset as usize..).unwrap_or_default()
    }

    /// Reads vectors of `N` components as floats: all of them, or those whose numbers `subset` lists.
    ///
    /// # Errors
    /// Malformed, at `at`: another number of components, or sparse indices that do not increase.
    pub(super) fn floats<const N: usize>(
        &self,
        index: usize,
        subset: Option<&[u32]>,
        at: &str,
    ) -> Result<Vec<[f32; N]>> {
        let elements = self.elements(index, at)?;
        if elements.shape.components() != N {
            return Err(ImportError::malformed(
                at,
                format!("accessor {index} has type {}, but {N} components are needed", self.accessor(index).shape),
            ));
        }
        Ok(elements.floats(subset))
    }

    /// Number of components of an element, for attributes that allow several.
    pub(super) fn components(&self, index: usize) -> usize {
        Shape::from_name(&self.accessor(index).shape).map_or(0, Shape::components)
    }

    /// Reads unsigned scalars.
    ///
    /// # Errors
    /// Malformed, at `at`: another type, or sparse indices that do not increase.
    pub(super) fn indices(&self, index: usize, at: &str) -> Result<Vec<u32>> {
        let elements = self.elements(index, at)?;
        if elements.shape.components() != 1 || !elements.component.is_index() {
            let accessor = self.accessor(index);
            return Err(ImportError::malformed(
                at,
                format!(
                    "accessor {index} is {} of component type {}; indices must be SCALAR of 5121, 5123 or 5125",
                    accessor.shape, accessor.component_type
                ),
            ));
        }
        Ok(elements.indices())
    }

    fn elements(&self, index: usize, at: &str) -> Result<Elements<'_>> {
        let accessor = self.accessor(index);
        let wrong = || ImportError::malformed(at, format!("accessor {index} has an unknown type"));
        let component = ComponentType::from_gl(accessor.component_type).ok_or_else(wrong)?;
        let shape = Shape::from_name(&accessor.shape).ok_or_else(wrong)?;
        let element_bytes = shape.bytes(component);
        let mut stride = element_bytes;
        let bytes = accessor.buffer_view.map(|view| {
            stride = self.document.buffer_views[view].byte_stride.map_or(element_bytes, |stride| stride as usize);
            self.view_from(view, accessor.byte_offset)
        });
        let sparse = match &accessor.sparse {
            None => None,
            Some(sparse) => {
                let kind = ComponentType::from_gl(sparse.indices.component_type).ok_or_else(wrong)?;
                let index_bytes = self.view_from(sparse.indices.buffer_view, sparse.indices.byte_offset);
                let numbers: Vec<u32> = index_bytes
                    .chunks_exact(kind.bytes())
                    .take(sparse.count as usize)
                    .map(|bytes| kind.decode_index(bytes))
                    .collect();
                let increasing = numbers.windows(2).all(|pair| pair[0] < pair[1]);
                let inside = numbers.last().is_none_or(|last| u64::from(*last) < accessor.count);
                if !increasing || !inside {
                    return Err(ImportError::malformed(
                        format!("accessors/{index}/sparse/indices"),
                        format!(
                            "indices must increase strictly and stay below the accessor's count of {}",
                            accessor.count
                        ),
                    ));
                }
                Some((numbers, self.view_from(sparse.values.buffer_view, sparse.values.byte_offset)))
            }
        };
        let count = accessor.count as usize;
        Ok(Elements { bytes, stride, count, component, shape, normalized: accessor.normalized, sparse })
    }
}

impl Elements<'_> {
    fn floats<const N: usize>(&self, subset: Option<&[u32]>) -> Vec<[f32; N]> {
        let mut values = match (self.bytes, subset) {
            (None, subset) => vec![[0.0; N]; subset.map_or(self.count, <[u32]>::len)],
            (Some(bytes), None) => (0..self.count).map(|i| self.element(&bytes[i * self.stride..])).collect(),
            (Some(bytes), Some(subset)) => {
                subset.iter().map(|i| self.element(&bytes[*i as usize * self.stride..])).collect()
            }
        };
        let Some((numbers, bytes)) = &self.sparse else { return values };
        let element_bytes = self.shape.bytes(self.component);
        match subset {
            None => {
                for (number, bytes) in numbers.iter().zip(bytes.chunks_exact(element_bytes)) {
                    values[*number as usize] = self.element(bytes);
                }
            }
            Some(subset) => {
                for (value, number) in values.iter_mut().zip(subset) {
                    if let Ok(replaced) = numbers.binary_search(number) {
                        *value = self.element(&bytes[replaced * element_bytes..]);
                    }
                }
            }
        }
        values
    }

    #[inline]
    fn element<const N: usize>(&self, bytes: &[u8]) -> [f32; N] {
        if self.component == ComponentType::F32 {
            return std::array::from_fn(|i| {
                f32::from_le_bytes([bytes[i * 4], bytes[i * 4 + 1], bytes[i * 4 + 2], bytes[i * 4 + 3]])
            });
        }
        let column_bytes = self.shape.column_bytes(self.component);
        std::array::from_fn(|i| {
            let (column, row) = (i / self.shape.rows, i % self.shape.rows);
            self.component.decode(&bytes[column * column_bytes + row * self.component.bytes()..], self.normalized)
        })
    }

    fn indices(&self) -> Vec<u32> {
        let mut values: Vec<u32> = match self.bytes {
            None => vec![0; self.count],
            Some(bytes) => (0..self.count).map(|i| self.component.decode_index(&bytes[i * self.stride..])).collect(),
        };
        if let Some((numbers, bytes)) = &self.sparse {
            for (number, bytes) in numbers.iter().zip(bytes.chunks_exact(self.component.bytes())) {
                values[*number as usize] = self.component.decode_index(bytes);
            }
        }
        values
    }
}

/// An error when an accessor without a buffer view, whose size no buffer bounds, is larger than the geometry may be.
pub(super) fn check_unbacked(document: &Document, limits: &Limits) -> Result<()> {
    for (index, accessor) in document.accessors.iter().enumerate() {
        if accessor.buffer_view.is_none() {
            let bytes = accessor.count.saturating_mul(64);
            Limits::check(format_args!("accessors/{index}/count"), "bytes of geometry", bytes, limits.geometry_bytes)?;
        }
    }
    Ok(())
}
