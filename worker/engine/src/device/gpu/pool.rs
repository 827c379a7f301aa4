//! Pools: long arrays that may not fit one storage binding.
//!
//! Adapters bind as little as 128 MiB at once (WebGPU's default, and lavapipe's). A pool splits its array over up to
//! [`MAX_CHUNKS`] bindings of a power-of-two length; the accessor that its shader gets picks the binding by the upper
//! bits of the index. A pool that fits one binding, the common case, costs its shader nothing.

use super::context::{Context, amount};
use crate::device::DeviceError;

pub(super) const MAX_CHUNKS: u32 = 4;

/// What a shader has to know of a pool.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct PoolLayout {
    pub name: &'static str,
    /// WGSL type of an element.
    pub element: &'static str,
    pub group: u32,
    /// Binding of the first chunk; the next `MAX_CHUNKS - 1` are reserved for the others.
    pub binding: u32,
    pub chunks: u32,
    /// Elements per chunk: `1 << shift`.
    pub shift: u32,
}

impl PoolLayout {
    /// Declarations of the chunks, and `fn NAME_at(index) -> element`.
    pub(super) fn wgsl(&self) -> String {
        let Self { name, element, group, binding, chunks, shift } = self;
        let mut wgsl = String::new();
        for i in 0..*chunks {
            wgsl.push_str(&format!(
                "@group({group}) @binding({}) var<storage, read> {name}_{i}: array<{element}>;\n",
                binding + i
            ));
        }
        if *chunks == 1 {
            wgsl.push_str(&format!("fn {name}_at(i: u32) -> {element} {{ return {name}_0[i]; }}\n"));
            return wgsl;
        }
        let mask = (1u32 << shift) - 1;
        wgsl.push_str(&format!("fn {name}_at(i: u32) -> {element} {{\n    let k = i & {mask}u;\n"));
        wgsl.push_str(&format!("    switch i >> {shift}u {{\n"));
        for i in 1..*chunks {
            wgsl.push_str(&format!("        case {i}u: {{ return {name}_{i}[k]; }}\n"));
        }
        wgsl.push_str(&format!("        default: {{ return {name}_0[k]; }}\n    }}\n}}\n"));
        wgsl
    }
}

/// An uploaded pool.
pub(super) struct Pool {
    pub layout: PoolLayout,
    pub buffers: Vec<wgpu::Buffer>,
    pub bytes: u64,
}

impl Pool {
    /// Uploads `parts`, one after the other: elements of `stride` bytes (a power of two).
    pub(super) fn upload(
        context: &Context,
        name: &'static str,
        element: &'static str,
        (group, binding): (u32, u32),
        stride: u64,
        parts: &[&[u8]],
    ) -> Result<Self, DeviceError> {
        let shift = (context.binding_limit() / stride).min(1 << 31).ilog2();
        let chunk_bytes = stride << shift;
        let bytes = parts.iter().map(|part| part.len() as u64).sum::<u64>();
        let chunks = bytes.div_ceil(chunk_bytes).max(1);
        if chunks > u64::from(MAX_CHUNKS) {
            return Err(DeviceError::TooLarge(format!(
                "{name}: {}, but `{}` can hold {} ({MAX_CHUNKS} bindings of {})",
                amount(bytes),
                context.info.name,
                amount(chunk_bytes * u64::from(MAX_CHUNKS)),
                amount(chunk_bytes)
            )));
        }
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST;
        let mut buffers = Vec::new();
        for chunk in 0..chunks {
            let size = (bytes - chunk * chunk_bytes).min(chunk_bytes);
            buffers.push(context.buffer(name, size, usage)?);
        }
        let mut at = 0u64;
        for part in parts {
            let mut rest = *part;
            while !rest.is_empty() {
                let (chunk, offset) = (at / chunk_bytes, at % chunk_bytes);
                let length = (rest.len() as u64).min(chunk_bytes - offset) as usize;
                context.write(&buffers[chunk as usize], offset, &rest[..length])?;
                rest = &rest[length..];
                at += length as u64;
            }
        }
        let layout = PoolLayout { name, element, group, binding, chunks: chunks as u32, shift };
        Ok(Self { layout, buffers, bytes })
    }

    /// Bind group entries of the chunks.
    pub(super) fn entries(&self) -> impl Iterator<Item = wgpu::BindGroupEntry<'_>> {
        self.buffers
            .iter()
            .zip(self.layout.binding..)
            .map(|(buffer, binding)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() })
    }
}
