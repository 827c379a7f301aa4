//! How a job is cut into tasks.

use lightshaft_api::job::TaskWork;
use lightshaft_api::settings::{JobSettings, RenderSettings, Split};

/// The tasks of a job. A benchmark is one: what is compared must run on one worker, and a worker does one task at a time.
pub fn plan(settings: &JobSettings) -> Vec<TaskWork> {
    match settings {
        JobSettings::Render(settings) => plan_render(settings),
        JobSettings::Benchmark(_) => vec![TaskWork::Benchmark],
        JobSettings::Build(_) => vec![TaskWork::Build],
        JobSettings::Compare(_) => vec![TaskWork::Compare],
    }
}

/// One task, or the parts and then the merge that waits for them. Tiles cover every pixel once, passes every sample once.
fn plan_render(settings: &RenderSettings) -> Vec<TaskWork> {
    let mut tasks = match settings.split {
        None | Some(Split::Tiles([1, 1])) => return vec![TaskWork::Frame],
        Some(Split::Tiles([columns, rows])) => tiles(settings.width, settings.height, columns, rows),
        Some(Split::Passes(passes)) => passes_of(settings.spp, passes),
    };
    tasks.push(TaskWork::Merge);
    tasks
}

fn tiles(width: u32, height: u32, columns: u32, rows: u32) -> Vec<TaskWork> {
    let mut tasks = Vec::new();
    for row in 0..rows {
        for column in 0..columns {
            let (x, x_end) = (share(width, column, columns), share(width, column + 1, columns));
            let (y, y_end) = (share(height, row, rows), share(height, row + 1, rows));
            tasks.push(TaskWork::Tile { x, y, width: x_end - x, height: y_end - y });
        }
    }
    tasks
}

fn passes_of(spp: u32, passes: u32) -> Vec<TaskWork> {
    (0..passes)
        .map(|i| {
            let first_sample = share(spp, i, passes);
            TaskWork::Pass { first_sample, samples: share(spp, i + 1, passes) - first_sample }
        })
        .collect()
}

/// Where share `i` of `n` begins.
fn share(total: u32, i: u32, n: u32) -> u32 {
    (u64::from(total) * u64::from(i) / u64::from(n)) as u32
}

#[cfg(test)]
mod tests {
    use lightshaft_api::job::JobKind;
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn an_unsplit_job_is_one_frame() {
        assert_eq!(plan_render(&RenderSettings::default()), [TaskWork::Frame]);
        let single = RenderSettings { split: Some(Split::Tiles([1, 1])), ..RenderSettings::default() };
        assert_eq!(plan_render(&single), [TaskWork::Frame]);
    }

    #[test]
    fn kinds_other_than_renders_are_one_task() {
        let of = |kind| plan(&JobSettings::default_of(kind));
        assert_eq!(of(JobKind::Benchmark), [TaskWork::Benchmark]);
        assert_eq!(of(JobKind::Build), [TaskWork::Build]);
        assert_eq!(of(JobKind::Compare), [TaskWork::Compare]);
        assert_eq!(of(JobKind::Render), [TaskWork::Frame]);
    }

    proptest! {
        #[test]
        fn tiles_cover_every_pixel_once(width in 1u32..200, height in 1u32..200, columns in 1u32..=64, rows in 1u32..=64) {
            prop_assume!(columns <= width && rows <= height && columns * rows > 1);
            let split = Some(Split::Tiles([columns, rows]));
            let tasks = plan_render(&RenderSettings { width, height, split, ..RenderSettings::default() });
            prop_assert_eq!(tasks.last(), Some(&TaskWork::Merge));
            let mut covered = vec![0u32; (width * height) as usize];
            for task in &tasks[..tasks.len() - 1] {
                let TaskWork::Tile { x, y, width: w, height: h } = *task else { panic!("{task:?}") };
                prop_assert!(w > 0 && h > 0);
                for row in y..y + h {
                    for column in x..x + w {
                        covered[(row * width + column) as usize] += 1;
                    }
                }
            }
            prop_assert!(covered.iter().all(|&count| count == 1));
        }

        #[test]
        fn passes_take_every_sample_once(spp in 2u32..5000, passes in 2u32..=256) {
            prop_assume!(passes <= spp);
            let tasks = plan_render(&RenderSettings { spp, split: Some(Split::Passes(passes)), ..RenderSettings::default() });
            let mut next = 0;
            for task in &tasks[..tasks.len() - 1] {
                let TaskWork::Pass { first_sample, samples } = *task else { panic!("{task:?}") };
                prop_assert_eq!(first_sample, next);
                prop_assert!(samples > 0);
                next += samples;
            }
            prop_assert_eq!(next, spp);
        }
    }
}
