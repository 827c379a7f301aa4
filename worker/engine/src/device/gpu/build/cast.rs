//! Lines cast between patches: `shaders/build_cast.wgsl`.

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

use super::super::context::whole;
use super::super::shader::{Variant, compose};
use super::{Job, Waves, check};
use crate::accel::line_space::parts::{
    Below, Caster, NO_CANDIDATE, directed_count, directed_patches, symmetric_count, symmetric_patches,
};
use crate::accel::line_space::{BinaryShafts, BitSet, CastPattern, Patch, SparseCandidates};
use crate::device::DeviceError;

/// As in the shader: the CPU is to say.
const UNSURE: u32 = NO_CANDIDATE - 1;
/// Shafts that the CPU looks at before it asks for a cancellation.
const CHUNK: usize = 256;

/// As in the shader.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct CastJob {
    first: u32,
    count: u32,
    n: u32,
    lines: u32,
    directed: u32,
}

/// The symmetric shafts of which a line of the pattern is blocked.
pub(super) fn marks(job: &Job<'_>, pattern: CastPattern) -> Result<BinaryShafts, DeviceError> {
    let n = job.grid.n();
    let mut bits = BitSet::new(symmetric_count(n));
    let answers = cast(job, pattern, false)?;
    (0..).zip(answers).filter(|(_, answer)| *answer != NO_CANDIDATE).for_each(|(index, _)| bits.set(index));
    Ok(BinaryShafts::new(n, bits))
}

/// The candidate of each directed shaft.
pub(super) fn candidates(job: &Job<'_>, pattern: CastPattern) -> Result<SparseCandidates, DeviceError> {
    Ok(SparseCandidates::from_dense(job.grid.n(), &cast(job, pattern, true)?))
}

/// What the first line of each shaft that hits something hits (of symmetric shafts only that it does), else
/// [`NO_CANDIDATE`].
fn cast(job: &Job<'_>, pattern: CastPattern, directed: bool) -> Result<Vec<u32>, DeviceError> {
    let context = job.context;
    let n = job.grid.n();
    let points: Vec<[f32; 4]> = (0..6 * n * n)
        .flat_map(|index| pattern.points(job.grid, Patch::from_index(n, index)))
        .map(|point| point.extend(0.0).to_array())
        .collect();
    let lines = points.len() as u32 / (6 * n * n);
    let structure = job.upload_structure()?;
    context.check_bindings(structure.bindings + 3)?;
    let count = if directed { directed_count(n) } else { symmetric_count(n) };
    let storage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC;
    let control = context.upload("cast job", bytemuck::bytes_of(&CastJob::zeroed()))?;
    let points = context.upload("points of patches", bytemuck::cast_slice(&points))?;
    let answered = context.buffer("answers", 4 * count.min(job.most_threads(4)), storage)?;
    let (layout, group) = context.bind_buffers("cast", &[whole(&control), whole(&points), whole(&answered)]);
    let constants = structure.constants(!directed, false);
    let source = compose("build_cast", &Variant { constants, pools: &structure.pools, replacements: &[] });
    let pipeline = context.pipeline(&source, &[Some(&structure.layout), None, Some(&layout)]);

    let mut answers: Vec<u32> = Vec::with_capacity(count as usize);
    Waves::new(job, 4).run(count as usize, |first, count| {
        let of_wave = CastJob { first: first as u32, count: count as u32, n, lines, directed: directed.into() };
        context.write(&control, 0, bytemuck::bytes_of(&of_wave))?;
        let seconds = job.dispatch(&pipeline, &[(0, &structure.group), (2, &group)], count as u32)?;
        answers.extend(context.read::<u32>(&answered, count)?);
        Ok(seconds)
    })?;

    let below = Below::root(job.structure);
    let caster = Caster::new(&below, job.grid);
    let decide = |index: u32| {
        let (start, end) = if directed { directed_patches(n, index) } else { symmetric_patches(n, index) };
        caster.candidate(start, end, pattern).unwrap_or(NO_CANDIDATE)
    };
    let open: Vec<u32> = (0..).zip(&answers).filter(|(_, answer)| **answer == UNSURE).map(|(index, _)| index).collect();
    job.leave_to_cpu(open.len());
    let cancel = job.cancel;
    let decided = open
        .par_chunks(CHUNK)
        .map(|chunk| check(cancel).map(|()| chunk.iter().map(|&index| decide(index)).collect::<Vec<_>>()))
        .collect::<Result<Vec<_>, DeviceError>>()?;
    open.iter().zip(decided.iter().flatten()).for_each(|(&index, &answer)| answers[index as usize] = answer);
    Ok(answers)
}
