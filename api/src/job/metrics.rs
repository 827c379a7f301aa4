//! What a job cost, as its workers measured it.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Measured by the worker; summed over a job's tasks.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Metrics {
    /// From when the first task could run, most often the submission, until a worker leased it; null without a service.
    #[serde(default)]
    pub queue_s: Option<f64>,
    /// From the same moment until its first tile began to be rendered; without a service, from the start.
    #[serde(default)]
    pub first_tile_s: Option<f64>,
    /// Fetching and decoding the scene.
    pub scene_s: f64,
    /// Getting every structure: built, loaded or fetched.
    pub build_s: f64,
    /// Packing and uploading to the device.
    pub prepare_s: f64,
    pub render_s: f64,
    /// Encoding and uploading pictures.
    pub output_s: f64,
    pub total_s: f64,
    pub rays: RayCounts,
    /// Rays of all kinds over `render_s`.
    pub mrays_per_s: f64,
    pub structure_bytes: u64,
    /// Nodes of all structures: of BVHs those of the binary trees, of grids one.
    #[serde(default)]
    pub structure_nodes: u64,
    pub line_space_bytes: u64,
    /// What Line Spaces were asked and answered; null in a job without.
    #[serde(default)]
    pub line_space: Option<LineSpaceUse>,
    /// On a GPU, the longest that it was held at a stretch, once its kernels were compiled; 0 on a CPU.
    #[serde(default)]
    pub longest_submit_s: f64,
    /// Highest resident memory of the worker process.
    pub peak_bytes: u64,
    pub device: String,
    pub device_kind: String,
    pub spp: u32,
    pub cache: Vec<CacheReport>,
    /// Engine, driver and shader versions.
    pub versions: BTreeMap<String, String>,
    pub warnings: Vec<String>,
}

impl Metrics {
    /// Adds another task of the same job: times and rays add up, but the first task says when the job began; sizes and
    /// samples are those of the largest, since tasks share the same structures and a merge reports the samples of the
    /// whole picture. Reports of one structure from one source become one, whose seconds add up.
    pub fn add(&mut self, other: &Self) {
        self.queue_s = earliest(self.queue_s, other.queue_s);
        self.first_tile_s = earliest(self.first_tile_s, other.first_tile_s);
        self.scene_s += other.scene_s;
        self.build_s += other.build_s;
        self.prepare_s += other.prepare_s;
        self.render_s += other.render_s;
        self.output_s += other.output_s;
        self.total_s += other.total_s;
        self.rays.primary += other.rays.primary;
        self.rays.shadow += other.rays.shadow;
        self.rays.ao += other.rays.ao;
        self.rays.indirect += other.rays.indirect;
        self.mrays_per_s = if self.render_s > 0.0 { self.rays.total() as f64 / self.render_s / 1e6 } else { 0.0 };
        self.structure_bytes = self.structure_bytes.max(other.structure_bytes);
        self.structure_nodes = self.structure_nodes.max(other.structure_nodes);
        self.line_space_bytes = self.line_space_bytes.max(other.line_space_bytes);
        self.line_space = match (self.line_space, other.line_space) {
            (Some(a), Some(b)) => Some(a.joined(b)),
            (a, b) => a.or(b),
        };
        self.longest_submit_s = self.longest_submit_s.max(other.longest_submit_s);
        self.peak_bytes = self.peak_bytes.max(other.peak_bytes);
        join_distinct(&mut self.device, &other.device);
        join_distinct(&mut self.device_kind, &other.device_kind);
        self.spp = self.spp.max(other.spp);
        self.cache.extend(other.cache.iter().cloned());
        join_reports(&mut self.cache);
        for (name, version) in &other.versions {
            self.versions.entry(name.clone()).or_insert_with(|| version.clone());
        }
        for warning in &other.warnings {
            if !self.warnings.contains(warning) {
                self.warnings.push(warning.clone());
            }
        }
    }
}

/// Of a job with Line Spaces. One ray may ask those of several meshes, and counts each time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct LineSpaceUse {
    /// Meshes that have one.
    pub meshes: u64,
    /// Of those, the ones that are asked: where it pays.
    pub asked: u64,
    /// Rays that asked: the sum of those below.
    pub rays: u64,
    /// That start in the mesh's box: the structure was walked.
    pub starts_inside: u64,
    /// Whose line passes the mesh's box by.
    pub beside: u64,
    /// Whose shaft is empty: the mesh was skipped.
    pub empty: u64,
    /// Whose shaft is blocked throughout; an occlusion ray that crosses the whole box was answered.
    pub opaque: u64,
    /// Of whose shaft nothing is certain: the structure was walked.
    pub mixed: u64,
    /// Of all those, the ones that policy `approximate_occlusion` answered without proof.
    pub approximated: u64,
    /// That start too far away for single precision: the structure was walked.
    pub too_far: u64,
    /// Nodes of an N-tree whose shaft was looked up, by all rays.
    #[serde(default)]
    pub node_look_ups: u64,
    /// Of those, the ones that were passed by with all below them.
    #[serde(default)]
    pub skipped_nodes: u64,
}

impl LineSpaceUse {
    /// Rays that need not look at the mesh, of those that asked.
    pub fn answered_percent(&self) -> f64 {
        if self.rays == 0 { 0.0 } else { 100.0 * (self.beside + self.empty + self.opaque) as f64 / self.rays as f64 }
    }

    /// Of two tasks of one job, or two passes of one task.
    pub fn joined(self, other: Self) -> Self {
        Self {
            meshes: self.meshes.max(other.meshes),
            asked: self.asked.max(other.asked),
            rays: self.rays + other.rays,
            starts_inside: self.starts_inside + other.starts_inside,
            beside: self.beside + other.beside,
            empty: self.empty + other.empty,
            opaque: self.opaque + other.opaque,
            mixed: self.mixed + other.mixed,
            approximated: self.approximated + other.approximated,
            too_far: self.too_far + other.too_far,
            node_look_ups: self.node_look_ups + other.node_look_ups,
            skipped_nodes: self.skipped_nodes + other.skipped_nodes,
        }
    }
}

fn join_reports(reports: &mut Vec<CacheReport>) {
    fn key(report: &CacheReport) -> (&str, &str, CacheSource, Option<BuiltOn>) {
        (&report.mesh, &report.structure, report.source, report.built_on)
    }
    reports.sort_by(|a, b| key(a).cmp(&key(b)));
    reports.dedup_by(|next, kept| {
        let is_same = key(next) == key(kept);
        if is_same {
            kept.seconds += next.seconds;
            kept.bytes = kept.bytes.max(next.bytes);
        }
        is_same
    });
}

fn earliest(a: Option<f64>, b: Option<f64>) -> Option<f64> {
    a.into_iter().chain(b).min_by(f64::total_cmp)
}

/// Appends the items of `other` to a list separated by semicolons (names of devices hold commas), each only once.
fn join_distinct(list: &mut String, other: &str) {
    for item in other.split("; ").filter(|item| !item.is_empty()) {
        if list.split("; ").any(|known| known == item) {
            continue;
        }
        if !list.is_empty() {
            list.push_str("; ");
        }
        list.push_str(item);
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct RayCounts {
    pub primary: u64,
    pub shadow: u64,
    pub ao: u64,
    pub indirect: u64,
}

impl RayCounts {
    pub fn total(&self) -> u64 {
        self.primary + self.shadow + self.ao + self.indirect
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum CacheSource {
    Built,
    Memory,
    Disk,
    Fetched,
}

impl CacheSource {
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Built => "built",
            Self::Memory => "memory",
            Self::Disk => "disk",
            Self::Fetched => "fetched",
        }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CacheReport {
    /// Hash of the mesh; of a structure over all instances, a hash over their meshes and transforms.
    pub mesh: String,
    /// Structure kind and parameters.
    pub structure: String,
    pub source: CacheSource,
    /// What built it; null where it was not built for this job. Both devices build the same, bit for bit.
    pub built_on: Option<BuiltOn>,
    pub seconds: f64,
    pub bytes: u64,
}

/// The kind of device that built something.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum BuiltOn {
    Cpu,
    Gpu,
}

impl BuiltOn {
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Cpu => "cpu",
            Self::Gpu => "gpu",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_many_tasks_took_from_the_same_place_is_told_once() {
        let report = |mesh: &str, source, seconds| CacheReport {
            mesh: mesh.to_owned(),
            structure: "bvh".to_owned(),
            source,
            built_on: (source == CacheSource::Built).then_some(BuiltOn::Cpu),
            seconds,
            bytes: 100,
        };
        let task = |reports: &[CacheReport]| Metrics { cache: reports.to_vec(), ..Metrics::default() };
        let mut sum = task(&[report("b", CacheSource::Built, 2.0), report("a", CacheSource::Built, 1.0)]);
        for _ in 0..100 {
            sum.add(&task(&[report("a", CacheSource::Memory, 0.5), report("b", CacheSource::Memory, 0.5)]));
        }
        let expected = [
            report("a", CacheSource::Built, 1.0),
            report("a", CacheSource::Memory, 50.0),
            report("b", CacheSource::Built, 2.0),
            report("b", CacheSource::Memory, 50.0),
        ];
        assert_eq!(sum.cache, expected);
    }

    #[test]
    fn metrics_of_two_tasks_add_up() {
        let mut sum = Metrics {
            queue_s: Some(0.5),
            render_s: 1.0,
            rays: RayCounts { primary: 1_000_000, ..RayCounts::default() },
            structure_bytes: 10,
            device: "AVX2, 2 threads".into(),
            spp: 4,
            warnings: vec!["w".into()],
            ..Metrics::default()
        };
        let other = Metrics {
            queue_s: Some(0.2),
            first_tile_s: Some(0.3),
            render_s: 3.0,
            rays: RayCounts { shadow: 7_000_000, ..RayCounts::default() },
            structure_bytes: 30,
            device: "GPU".into(),
            spp: 8,
            warnings: vec!["w".into()],
            ..Metrics::default()
        };
        sum.add(&other);
        assert_eq!(sum.mrays_per_s, 2.0);
        assert_eq!((sum.queue_s, sum.first_tile_s), (Some(0.2), Some(0.3)), "those of the first task");
        assert_eq!((sum.structure_bytes, sum.spp), (30, 8));
        assert_eq!(sum.device, "AVX2, 2 threads; GPU");
        assert_eq!(sum.warnings, ["w"]);
        sum.add(&other);
        sum.add(&sum.clone());
        assert_eq!(sum.device, "AVX2, 2 threads; GPU");
    }
}
