//! The layered build: `shaders/build_classes.wgsl`, a level of shafts after the other.

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

use super::super::context::whole;
use super::super::shader::{Variant, compose};
use super::super::structure::GpuStructure;
use super::{Job, Waves, check, voxels};
use crate::accel::line_space::parts::{Classifier, middle, symmetric_count, symmetric_patches};
use crate::accel::line_space::{Class, ClassTree, Patch};
use crate::device::DeviceError;

/// Shafts that the CPU looks at before it asks for a cancellation.
const CHUNK: usize = 64;

/// As in the shader.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct ClassJob {
    count: u32,
    n: u32,
    finest_n: u32,
    resolution: u32,
    wide: u32,
}

/// The classes of all shafts, beginning with `root_n` patches; the grid's N is `root_n` times a power of two.
pub(super) fn tree(job: &Job<'_>, root_n: u32, resolution: u32) -> Result<ClassTree, DeviceError> {
    let context = job.context;
    let voxels = voxels::of_surface_and_rim(job, resolution)?;
    for occupancy in [&voxels.surface, &voxels.rim] {
        context.check_binding("sums over voxels", size_of_val(occupancy.sums()) as u64)?;
    }
    let kernel = Kernel {
        job,
        structure: job.upload_structure()?,
        classifier: Classifier::new(job.mesh, job.structure, job.grid, &voxels, resolution),
        resolution,
        grid: context.upload("shaft grid", bytemuck::cast_slice(&job.grid.to_words()))?,
        surface: context.upload("sums over the surface", bytemuck::cast_slice(voxels.surface.sums()))?,
        rim: context.upload("sums over the rim", bytemuck::cast_slice(voxels.rim.sums()))?,
    };
    context.check_bindings(kernel.structure.bindings + 6)?;
    let depth = (job.grid.n() / root_n).trailing_zeros();
    let mut shafts: Vec<u32> = (0..symmetric_count(root_n) as u32)
        .map(|index| symmetric_patches(root_n, index))
        .map(|shaft| packed(root_n, shaft))
        .collect();
    let mut levels = Vec::new();
    for level in 0..=depth {
        let n = root_n << level;
        let classes = kernel.classify(n, &shafts)?;
        if level < depth {
            let open = shafts.iter().zip(&classes).filter(|(_, class)| **class == Class::Mixed);
            shafts = open
                .flat_map(|(&shaft, _)| {
                    let (a, b) = unpacked(n, shaft);
                    ClassTree::children(a, b).map(|child| packed(2 * n, child))
                })
                .collect();
        }
        levels.push(classes);
    }
    ClassTree::from_classes(root_n, &levels).map_err(DeviceError::Other)
}

/// The numbers of both patches in a word: there are at most 6,144.
fn packed(n: u32, (a, b): (Patch, Patch)) -> u32 {
    a.index(n) | b.index(n) << 16
}

fn unpacked(n: u32, shaft: u32) -> (Patch, Patch) {
    (Patch::from_index(n, shaft & 0xffff), Patch::from_index(n, shaft >> 16))
}

struct Kernel<'a> {
    job: &'a Job<'a>,
    structure: GpuStructure,
    classifier: Classifier<'a>,
    resolution: u32,
    grid: wgpu::Buffer,
    surface: wgpu::Buffer,
    rim: wgpu::Buffer,
}

impl Kernel<'_> {
    /// The class of each shaft between two patches, of which `n` make an edge of the box.
    fn classify(&self, n: u32, shafts: &[u32]) -> Result<Vec<Class>, DeviceError> {
        let Self { job, structure, .. } = self;
        let context = job.context;
        let points: Vec<[f32; 4]> = (0..6 * n * n)
            .map(|index| middle(job.grid, n, Patch::from_index(n, index)).extend(0.0).to_array())
            .collect();
        let control = context.upload("class job", bytemuck::bytes_of(&ClassJob::zeroed()))?;
        let points = context.upload("middles of patches", bytemuck::cast_slice(&points))?;
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST;
        let asked = context.buffer("shafts", 4 * (shafts.len() as u64).min(job.most_threads(4)), usage)?;
        let buffers = [&control, &self.grid, &points, &asked, &self.surface, &self.rim].map(whole);
        let (layout, group) = context.bind_buffers("classes", &buffers);
        let constants = structure.constants(true, false);
        let source = compose("build_classes", &Variant { constants, pools: &structure.pools, replacements: &[] });
        let pipeline = context.pipeline(&source, &[Some(&structure.layout), None, Some(&layout)]);

        let (finest_n, resolution) = (job.grid.n(), self.resolution);
        let wide = self.classifier.has_triangles_as_wide_as_a_patch(n).into();
        let mut codes: Vec<u32> = Vec::with_capacity(shafts.len());
        Waves::new(job, 4).run(shafts.len(), |first, count| {
            let of_wave = ClassJob { count: count as u32, n, finest_n, resolution, wide };
            context.write(&control, 0, bytemuck::bytes_of(&of_wave))?;
            context.write(&asked, 0, bytemuck::cast_slice(&shafts[first..first + count]))?;
            let seconds = job.dispatch(&pipeline, &[(0, &structure.group), (2, &group)], count as u32)?;
            codes.extend(context.read::<u32>(&asked, count)?);
            Ok(seconds)
        })?;

        job.leave_to_cpu(codes.iter().filter(|code| Class::of_code(**code).is_none()).count());
        let (cancel, classifier) = (job.cancel, &self.classifier);
        let decide = |(&code, &shaft): (&u32, &u32)| {
            Class::of_code(code).unwrap_or_else(|| {
                let (a, b) = unpacked(n, shaft);
                classifier.class(n, a, b)
            })
        };
        let decided = codes
            .par_chunks(CHUNK)
            .zip(shafts.par_chunks(CHUNK))
            .map(|(codes, shafts)| {
                check(cancel)?;
                Ok(codes.iter().zip(shafts).map(decide).collect::<Vec<_>>())
            })
            .collect::<Result<Vec<_>, DeviceError>>()?;
        Ok(decided.concat())
    }
}
