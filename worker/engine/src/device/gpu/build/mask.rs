//! Masking: `shaders/build_voxels.wgsl`, then `shaders/build_mask.wgsl`.

use std::sync::{Arc, Mutex, PoisonError};

use glam::Vec3;

use super::super::context::{Context, whole};
use super::super::shader::{Variant, compose};
use super::voxels::Marker;
use super::{Job, of_cpu};
use crate::accel::line_space::parts::{DILATION, lattice, symmetric_count};
use crate::accel::line_space::{AtlasParams, BinaryShafts, BitSet, MaskAtlas};
use crate::device::DeviceError;

/// Primitives of a batch.
const BATCH: usize = 1 << 16;

/// The atlas that was last on a device: the next mesh mostly has the same N.
#[derive(Default)]
pub(super) struct KeptAtlas(Mutex<Option<Atlas>>);

#[derive(Clone)]
struct Atlas {
    context: Arc<Context>,
    n: u32,
    masks: wgpu::Buffer,
}

impl KeptAtlas {
    fn get(&self, job: &Job<'_>) -> Result<wgpu::Buffer, DeviceError> {
        let n = job.grid.n();
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner).take();
        kept = kept.filter(|atlas| atlas.n == n && Arc::ptr_eq(&atlas.context, job.context));
        let atlas = match kept {
            Some(atlas) => atlas,
            None => {
                job.context.check_binding("the atlas of masks", MaskAtlas::bytes_needed(n))?;
                let made = MaskAtlas::get(&AtlasParams { cells: n, width: 1, growth: DILATION }, job.cancel)
                    .map_err(of_cpu)?;
                let masks = job.context.upload("atlas of masks", bytemuck::cast_slice(made.masks()))?;
                Atlas { context: Arc::clone(job.context), n, masks }
            }
        };
        let masks = atlas.masks.clone();
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(atlas);
        Ok(masks)
    }
}

/// The symmetric shafts that meet a cell with surface.
pub(super) fn marks(job: &Job<'_>, atlas: &KeptAtlas) -> Result<BinaryShafts, DeviceError> {
    let (context, n) = (job.context, job.grid.n());
    let filled = filled_cells(job)?;
    job.check()?;
    let masks = atlas.get(job)?;
    let words = symmetric_count(n).div_ceil(32) as u32;
    let listed: Vec<u32> = [words, filled.len() as u32].into_iter().chain(filled).collect();
    let listed = context.upload("filled cells", bytemuck::cast_slice(&listed))?;
    let storage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC;
    let marks = context.buffer("marks", 4 * u64::from(words), storage)?;
    let (layout, group) = context.bind_buffers("masks", &[&listed, &masks, &marks].map(whole));
    let pipeline = context.pipeline(&compose("build_mask", &Variant::default()), &[None, None, Some(&layout), None]);
    job.dispatch(&pipeline, &[(2, &group)], words)?;
    let bits = BitSet::from_words(symmetric_count(n), context.read(&marks, words as usize)?);
    Ok(BinaryShafts::new(n, bits.map_err(DeviceError::Other)?))
}

/// The cells with surface of N on each axis.
fn filled_cells(job: &Job<'_>) -> Result<Vec<u32>, DeviceError> {
    let (mesh, n) = (job.mesh, job.grid.n());
    let bvh2 = job.structure.bvh2();
    let mut marker = Marker::new(job, lattice(&bvh2.bounds(), job.grid, n), false)?;
    for batch in bvh2.primitives.chunks(BATCH) {
        let mut triangles: Vec<[Vec3; 3]> = Vec::with_capacity(batch.len());
        for &primitive in batch {
            match mesh.triangles.get(primitive as usize) {
                Some(triangle) => triangles.push(triangle.map(|vertex| mesh.positions[vertex as usize])),
                None => {
                    let sphere = &mesh.spheres[primitive as usize - mesh.triangles.len()];
                    marker.mark_sphere(sphere.center, sphere.radius);
                }
            }
        }
        marker.mark(&triangles)?;
    }
    let cells = marker.finish()?;
    Ok((0..n.pow(3)).filter(|cell| cells[*cell as usize / 32] >> (cell % 32) & 1 == 1).collect())
}
