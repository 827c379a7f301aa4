//! Which cells of a lattice the surface meets: `shaders/build_voxels.wgsl`.

use bytemuck::{Pod, Zeroable};
use glam::Vec3;
use rayon::prelude::*;

use super::super::context::whole;
use super::super::shader::{Variant, compose};
use super::{Job, Waves};
use crate::accel::line_space::parts::{Rasterizer, Voxels, rim_edges};
use crate::accel::overlap::{CellRange, Lattice};
use crate::device::DeviceError;

/// Bytes of a piece: nine floats.
const PIECE_BYTES: u64 = 36;
/// Primitives that are cut into pieces at a time.
const BATCH: usize = 1 << 16;
/// Pairs of a cell and a piece that a submit may leave to the CPU; with more, the CPU looks at all its pieces.
const PAIRS: usize = 1 << 16;
/// By how many cells they may grow, lest every piece have too many.
const MOST_GROWTH: f64 = 2.0;

/// As in the shader.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct VoxelJob {
    origin: [f32; 3],
    slack: f32,
    scale: [f32; 3],
    resolution: u32,
    growth: [f32; 3],
    count: u32,
    edges: u32,
    _pad: [u32; 3],
}

/// Both grids of the layered build.
pub(super) fn of_surface_and_rim(job: &Job<'_>, resolution: u32) -> Result<Voxels, DeviceError> {
    let mesh = job.mesh;
    let rasterizer = Rasterizer::new(&job.structure.bvh2().bounds(), job.grid, resolution);
    let mut surface = Marker::new(job, rasterizer.lattice, false)?;
    for first in (0..mesh.triangles.len()).step_by(BATCH) {
        let batch = &mesh.triangles[first..(first + BATCH).min(mesh.triangles.len())];
        surface.mark(&pieces(&rasterizer, batch.len(), |i| batch[i].map(|vertex| mesh.positions[vertex as usize])))?;
    }
    for sphere in &mesh.spheres {
        surface.mark_sphere(sphere.center, sphere.radius);
    }
    let surface = surface.finish()?;

    let edges = rim_edges(mesh);
    job.check()?;
    let mut rim = Marker::new(job, rasterizer.lattice, true)?;
    for batch in edges.chunks(BATCH) {
        rim.mark(&pieces(&rasterizer, batch.len(), |i| [batch[i][0], batch[i][1], batch[i][1]]))?;
    }
    Ok(Voxels::from_words(resolution, &surface, &rim.finish()?))
}

fn pieces(rasterizer: &Rasterizer, count: usize, corners: impl Fn(usize) -> [Vec3; 3] + Sync) -> Vec<[Vec3; 3]> {
    let of = |i| {
        let mut pieces = Vec::new();
        rasterizer.pieces(corners(i), &mut |piece| pieces.push(piece));
        pieces
    };
    (0..count).into_par_iter().with_min_len(1024).flat_map_iter(of).collect()
}

/// Marks cells piece by piece.
pub(super) struct Marker<'a> {
    job: &'a Job<'a>,
    waves: Waves<'a>,
    lattice: Lattice,
    of_all: VoxelJob,
    pipeline: wgpu::ComputePipeline,
    group: wgpu::BindGroup,
    control: wgpu::Buffer,
    corners: wgpu::Buffer,
    cells: wgpu::Buffer,
    unsure: wgpu::Buffer,
    /// Cells that the CPU marks.
    own: Vec<u32>,
}

impl<'a> Marker<'a> {
    /// `lattice` is a cube of cells; `edges`: all pieces will be flat.
    pub(super) fn new(job: &'a Job<'a>, lattice: Lattice, edges: bool) -> Result<Self, DeviceError> {
        let context = job.context;
        let resolution = lattice.dims[0];
        let growth = lattice.growth / lattice.cell;
        if growth.max_element() > MOST_GROWTH {
            return Err(DeviceError::Other("its box is so far from the origin that voxels blur".into()));
        }
        let of_all = VoxelJob {
            origin: lattice.origin.to_array(),
            // A corner is moved by 2^-22 of its place, tests by less than the rest.
            slack: 5e-7 * resolution as f32 + 2e-5,
            scale: (1.0 / lattice.cell).as_vec3().to_array(),
            resolution,
            growth: growth.as_vec3().to_array(),
            edges: edges.into(),
            ..VoxelJob::zeroed()
        };
        let words = (resolution as usize).pow(3).div_ceil(32);
        let control = context.upload("voxel job", bytemuck::bytes_of(&of_all))?;
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST;
        let corners = context.buffer("corners", PIECE_BYTES * job.most_threads(PIECE_BYTES), usage)?;
        let cells = context.upload("cells", bytemuck::cast_slice(&vec![0_u32; words]))?;
        let unsure = context.upload("unsure cells", bytemuck::cast_slice(&vec![0_u32; 1 + 2 * PAIRS]))?;
        let (layout, group) = context.bind_buffers("voxels", &[&control, &corners, &cells, &unsure].map(whole));
        let pipeline =
            context.pipeline(&compose("build_voxels", &Variant::default()), &[None, None, Some(&layout), None]);
        let (waves, own) = (Waves::new(job, PIECE_BYTES), vec![0; words]);
        Ok(Self { job, waves, lattice, of_all, pipeline, group, control, corners, cells, unsure, own })
    }

    /// Marks the cells of some pieces.
    pub(super) fn mark(&mut self, pieces: &[[Vec3; 3]]) -> Result<(), DeviceError> {
        let Self { job, waves, lattice, of_all, pipeline, group, control, corners, unsure, own, .. } = self;
        let context = job.context;
        let finite: Vec<[Vec3; 3]> =
            pieces.iter().filter(|piece| piece.iter().all(|corner| corner.is_finite())).copied().collect();
        waves.run(finite.len(), |first, count| {
            let pieces = &finite[first..first + count];
            let floats: Vec<f32> = pieces.iter().flatten().flat_map(|corner| corner.to_array()).collect();
            let of_wave = VoxelJob { count: count as u32, ..*of_all };
            context.write(control, 0, bytemuck::bytes_of(&of_wave))?;
            context.write(corners, 0, bytemuck::cast_slice(&floats))?;
            context.write(unsure, 0, bytemuck::bytes_of(&0_u32))?;
            let seconds = job.dispatch(pipeline, &[(2, group)], count as u32)?;
            let listed = context.read::<u32>(unsure, 1)?[0] as usize;
            if listed > PAIRS {
                job.leave_to_cpu(count);
                pieces.iter().for_each(|&piece| mark_cells(lattice, piece, lattice.all(), own));
            } else if listed > 0 {
                job.leave_to_cpu(listed);
                let pairs = context.read_at::<[u32; 2]>(unsure, 4, listed)?;
                for [cell, piece] in pairs {
                    mark_cells(lattice, pieces[piece as usize], only(lattice, cell), own);
                }
            }
            Ok(seconds)
        })
    }

    /// Marks the cells of a sphere, by the CPU: there are few.
    pub(super) fn mark_sphere(&mut self, center: Vec3, radius: f32) {
        let Self { lattice, own, .. } = self;
        lattice.sphere_cells(center, radius, lattice.all(), |cell| set(lattice, own, cell));
    }

    /// A bit for each cell, x running fastest.
    pub(super) fn finish(self) -> Result<Vec<u32>, DeviceError> {
        let mut cells: Vec<u32> = self.job.context.read(&self.cells, self.own.len())?;
        cells.iter_mut().zip(&self.own).for_each(|(word, own)| *word |= own);
        Ok(cells)
    }
}

fn mark_cells(lattice: &Lattice, piece: [Vec3; 3], within: CellRange, marks: &mut [u32]) {
    lattice.triangle_cells(piece, within, |cell| set(lattice, marks, cell));
}

fn set(lattice: &Lattice, marks: &mut [u32], [x, y, z]: [u32; 3]) {
    let [nx, ny, _] = lattice.dims;
    let cell = (z * ny + y) * nx + x;
    marks[cell as usize / 32] |= 1 << (cell % 32);
}

fn only(lattice: &Lattice, cell: u32) -> CellRange {
    let [nx, ny, _] = lattice.dims;
    let place = [cell % nx, cell / nx % ny, cell / (nx * ny)];
    CellRange { first: place, last: place }
}
