//! Line Spaces built on the device, bit for bit those that the CPU builds.
//!
//! WGSL leaves divisions and fused products to the driver, and has no double precision, so a device cannot repeat the
//! CPU's arithmetic. It need not: the kernels bound what rounding can do, answer what it cannot change (nearly all), and name the rest,
//! which the CPU's own builder decides (floating-point filters: Shewchuk 1997, "Adaptive precision floating-point
//! arithmetic and fast robust geometric predicates"). So both devices share one cache key.
//!
//! - Casting: the product's walk, with primitive tests that give bounds ([`cast`]).
//! - Classes: the surface as voxels, then a level of shafts after the other, whose sections are compared in whole
//!   numbers ([`classes`]).
//! - Masking: the surface as voxels, then the union of the atlas' masks ([`mask`]).
//!
//! Clipping and coverage are the CPU's: the oracle needs no second form, and coverage has a pattern of its own for each shaft.

mod cast;
mod classes;
mod mask;
mod voxels;

use std::cell::Cell;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use glam::Affine3A;

use super::context::Context;
use super::pace::Pace;
use super::structure::{GpuStructure, HostStructure, MeshView, PlacementView};
use crate::accel::line_space::{BinaryBuilder, LineSpace, LineSpaceParams, Payload, ShaftGrid, Shafts};
use crate::accel::{BuildError, MeshStructure, Placement, SceneAccel};
use crate::device::DeviceError;
use crate::scene::Mesh;

/// Times that a build is tried again on a fresh device.
const MAX_RETRIES: u32 = 2;
/// Fewest threads of a submit: those of a workgroup.
const LEAST: u32 = super::tracer::WORKGROUP;
/// Most threads of a submit, as [`Pace`] has it.
const MOST: u64 = 1 << 20;
/// Lengths of boxes whose products neither overflow nor vanish in single precision.
const LENGTHS: std::ops::RangeInclusive<f32> = 6e-8..=1e9;

/// Builds Line Spaces on one adapter. Opens it anew when it is lost.
pub struct LineSpaceBuilder {
    context: Mutex<Arc<Context>>,
    atlas: mask::KeptAtlas,
}

/// A Line Space, and how it was made.
#[derive(Debug)]
pub struct BuiltLineSpace {
    pub space: LineSpace,
    pub on_gpu: bool,
    /// What the device left to the CPU: shafts, and pairs of a cell and a triangle.
    pub left_to_cpu: u64,
    /// The most seconds that the device was held at a stretch, once its kernels were compiled.
    pub longest_submit_s: f64,
    /// Why the device did not do it though it might have.
    pub warning: Option<String>,
}

impl LineSpaceBuilder {
    pub fn new(context: Arc<Context>) -> Self {
        Self { context: Mutex::new(context), atlas: mask::KeptAtlas::default() }
    }

    /// As [`LineSpace::build`], with the same outcome. The CPU does it where the device has no kernel for it, or fails.
    ///
    /// # Errors
    /// As those of [`LineSpace::build`]; looks at `cancel` between submits.
    pub fn build(
        &self,
        mesh: &Mesh,
        structure: &Arc<MeshStructure>,
        params: &LineSpaceParams,
        budget_bytes: u64,
        cancel: &AtomicBool,
    ) -> Result<BuiltLineSpace, BuildError> {
        let grid = params.grid_within(structure, budget_bytes)?;
        let mut warning = None;
        if let Some(grid) = grid.filter(|_| can_build(mesh, structure, params)) {
            let built = self.with_retries(|context| {
                let job = Job::new(context, mesh, structure, &grid, cancel);
                let shafts = self.shafts(&job, params)?;
                Ok((shafts, job.left_to_cpu.get(), job.longest_submit_s.get()))
            });
            match built {
                Ok((shafts, left_to_cpu, longest_submit_s)) => {
                    let space = LineSpace::new(mesh, params, Some((grid, shafts)));
                    return Ok(BuiltLineSpace { space, on_gpu: true, left_to_cpu, longest_submit_s, warning });
                }
                Err(DeviceError::Cancelled) => return Err(BuildError::Cancelled),
                Err(error) => warning = Some(format!("a line space was built on the CPU instead: {error}")),
            }
        }
        let space = LineSpace::build(mesh, structure, params, budget_bytes, cancel)?;
        Ok(BuiltLineSpace { space, on_gpu: false, left_to_cpu: 0, longest_submit_s: 0.0, warning })
    }

    fn shafts(&self, job: &Job<'_>, params: &LineSpaceParams) -> Result<Shafts, DeviceError> {
        match params.payload {
            Payload::Binary { builder: BinaryBuilder::Masking } => mask::marks(job, &self.atlas).map(Shafts::Binary),
            Payload::Binary { builder: BinaryBuilder::Casting(pattern) } => {
                cast::marks(job, pattern).map(Shafts::Binary)
            }
            Payload::Candidates { pattern } => cast::candidates(job, pattern).map(Shafts::Candidates),
            Payload::Classes { layout, resolution } => {
                let tree = classes::tree(job, params.n >> params.class_levels(), resolution)?;
                Ok(Shafts::of_classes(layout, tree))
            }
            Payload::Binary { builder: BinaryBuilder::Clipping } | Payload::Coverage { .. } => {
                Err(DeviceError::Other(format!("no kernel builds {}", params.canonical())))
            }
        }
    }

    fn context(&self) -> Arc<Context> {
        Arc::clone(&self.context.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Runs `work`; when the device is lost, again on a new one.
    fn with_retries<T>(&self, work: impl Fn(&Arc<Context>) -> Result<T, DeviceError>) -> Result<T, DeviceError> {
        let mut retries = 0;
        loop {
            let context = self.context();
            let reason = match work(&context) {
                Err(DeviceError::Lost(reason)) if retries < MAX_RETRIES => reason,
                result => return result,
            };
            retries += 1;
            tracing::warn!(reason, retries, "the GPU was lost during a build; opening it again");
            let fresh = Arc::new(context.reopen()?);
            let mut current = self.context.lock().unwrap_or_else(PoisonError::into_inner);
            // Unless another build has done so.
            if Arc::ptr_eq(&current, &context) {
                *current = fresh;
            }
        }
    }
}

impl std::fmt::Debug for LineSpaceBuilder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LineSpaceBuilder").field("on", &self.context().info.name).finish_non_exhaustive()
    }
}

/// Whether there is a kernel for it, whose arithmetic suits the mesh.
fn can_build(mesh: &Mesh, structure: &MeshStructure, params: &LineSpaceParams) -> bool {
    let has_kernel = match params.payload {
        Payload::Binary { builder } => builder != BinaryBuilder::Clipping,
        Payload::Candidates { .. } => true,
        // The CPU compares sections in floating point, which is exact but where thirds of a voxel meet whole ones.
        Payload::Classes { resolution, .. } => {
            params.n.is_power_of_two() || !(params.n * resolution).is_multiple_of(2048)
        }
        Payload::Coverage { .. } => false,
    };
    let bounds = structure.bvh2().bounds();
    let extent = bounds.max - bounds.min;
    let farthest = bounds.min.abs().max(bounds.max.abs()).max_element();
    let fits = LENGTHS.contains(&extent.max_element()) && farthest <= *LENGTHS.end();
    has_kernel && fits && !mesh.triangles.is_empty()
}

/// One attempt at a build.
struct Job<'a> {
    context: &'a Arc<Context>,
    mesh: &'a Mesh,
    structure: &'a Arc<MeshStructure>,
    grid: &'a ShaftGrid,
    cancel: &'a AtomicBool,
    left_to_cpu: Cell<u64>,
    longest_submit_s: Cell<f64>,
}

impl<'a> Job<'a> {
    fn new(
        context: &'a Arc<Context>,
        mesh: &'a Mesh,
        structure: &'a Arc<MeshStructure>,
        grid: &'a ShaftGrid,
        cancel: &'a AtomicBool,
    ) -> Self {
        let (left_to_cpu, longest_submit_s) = (Cell::new(0), Cell::new(0.0));
        Self { context, mesh, structure, grid, cancel, left_to_cpu, longest_submit_s }
    }

    fn check(&self) -> Result<(), DeviceError> {
        check(self.cancel)
    }

    fn leave_to_cpu(&self, count: usize) {
        self.left_to_cpu.set(self.left_to_cpu.get() + count as u64);
    }

    /// The mesh's compressed tree and its primitives, where they are.
    fn upload_structure(&self) -> Result<GpuStructure, DeviceError> {
        let placement = Placement { mesh: 0, transform: Affine3A::IDENTITY, filtered: false };
        let alone = SceneAccel::build(vec![Arc::clone(self.structure)], &[placement]);
        let positions: Vec<[f32; 3]> = self.mesh.positions.iter().map(|position| position.to_array()).collect();
        let spheres: Vec<[f32; 4]> = self.mesh.spheres.iter().map(|s| s.center.extend(s.radius).to_array()).collect();
        let view = MeshView {
            structure: self.structure,
            positions: &positions,
            triangles: &self.mesh.triangles,
            spheres: &spheres,
        };
        let host = HostStructure::wide(&alone, &[view], &[PlacementView::new(0, Affine3A::IDENTITY, false)]);
        GpuStructure::upload(self.context, &host)
    }

    /// A dispatch of a thread for each of `count`.
    fn dispatch(
        &self,
        pipeline: &wgpu::ComputePipeline,
        groups: &[(u32, &wgpu::BindGroup)],
        count: u32,
    ) -> Result<f64, DeviceError> {
        let mut encoder = self.context.encoder();
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(pipeline);
        for (index, group) in groups {
            pass.set_bind_group(*index, *group, &[]);
        }
        pass.dispatch_workgroups(count.div_ceil(super::tracer::WORKGROUP), 1, 1);
        drop(pass);
        self.context.submit(encoder)
    }

    /// Threads that a submit may have whose widest buffer takes so many bytes for each.
    fn most_threads(&self, bytes_each: u64) -> u64 {
        1 << (self.context.binding_limit() / bytes_each).clamp(1, MOST).ilog2()
    }
}

/// Cuts work into submits of tens of milliseconds, and asks between them whether it is still wanted.
struct Waves<'a> {
    job: &'a Job<'a>,
    pace: Pace,
}

impl<'a> Waves<'a> {
    fn new(job: &'a Job<'a>, bytes_each: u64) -> Self {
        Self { job, pace: Pace::new(LEAST, bytes_each, job.context.binding_limit()) }
    }

    /// Runs `wave` on part after part of `count` things, given where a part begins and how long it is. It answers the
    /// seconds of its submit.
    fn run(
        &mut self,
        count: usize,
        mut wave: impl FnMut(usize, usize) -> Result<f64, DeviceError>,
    ) -> Result<(), DeviceError> {
        let mut first = 0;
        while first < count {
            self.job.check()?;
            let length = (self.pace.slots() as usize).min(count - first);
            let seconds = wave(first, length)?;
            let counted = self.pace.record(length as u32, seconds);
            self.job.longest_submit_s.set(self.job.longest_submit_s.get().max(counted));
            first += length;
        }
        self.job.check()
    }
}

fn check(cancel: &AtomicBool) -> Result<(), DeviceError> {
    if cancel.load(Ordering::Relaxed) { Err(DeviceError::Cancelled) } else { Ok(()) }
}

/// An error of the CPU's part.
fn of_cpu(error: BuildError) -> DeviceError {
    match error {
        BuildError::Cancelled => DeviceError::Cancelled,
        BuildError::Unsupported(why) => DeviceError::Other(why),
    }
}
