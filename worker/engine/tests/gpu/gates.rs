//! Line Spaces on the GPU: no answer changes with what is proven, and both devices are told the same.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use glam::{Affine3A, Quat, Vec3};
use lightshaft_engine::accel::line_space::{
    BinaryBuilder, CastPattern, ClassLayout, GateCounters, LineSpace, LineSpaceParams, Payload,
};
use lightshaft_engine::accel::{BuildParams, MeshStructure, Placement, SceneAccel};
use lightshaft_engine::device::gpu::{Batch, HostStructure, Kernel, MeshView, PlacementView, Tracer};
use lightshaft_engine::scene::Mesh;
use lightshaft_engine::trace::{Counters, Ray};

use crate::common::{AcceptAll, Random, ball, build, soup};
use crate::context;

fn payloads() -> Vec<LineSpaceParams> {
    let classes = |n, layout| LineSpaceParams { n, payload: Payload::Classes { layout, resolution: 64 } };
    let with = |n, payload| LineSpaceParams { n, payload };
    vec![
        classes(16, ClassLayout::Tree),
        classes(4, ClassLayout::Tree),
        classes(7, ClassLayout::Table),
        with(6, Payload::Binary { builder: BinaryBuilder::Masking }),
        with(5, Payload::Binary { builder: BinaryBuilder::Casting(CastPattern::Nine) }),
        with(4, Payload::Candidates { pattern: CastPattern::Centre }),
        with(5, Payload::Coverage { bits: 3, rays: 8 }),
    ]
}

/// Meshes placed in the world, and rays through them from all sides and from within.
struct Setting {
    meshes: Vec<Mesh>,
    structures: Vec<Arc<MeshStructure>>,
    positions: Vec<Vec<[f32; 3]>>,
    placements: Vec<Placement>,
    rays: Vec<Ray>,
}

impl Setting {
    fn new(meshes: Vec<Mesh>, placements: Vec<Placement>) -> Self {
        let structures: Vec<_> = meshes.iter().map(|mesh| Arc::new(build(mesh, BuildParams::default()))).collect();
        let positions = meshes.iter().map(|mesh| mesh.positions.iter().map(|p| p.to_array()).collect()).collect();
        let bounds = SceneAccel::build(structures.clone(), &placements).top().bounds();
        let mut random = Random(83);
        let rays = (0..20_000)
            .map(|i| {
                let target = bounds.center() + bounds.extent() * (random.point() - 0.5);
                let away = random.direction() * bounds.extent().length() * if i % 4 == 0 { 0.3 } else { 2.0 };
                let ray = Ray::new(target + away, -away);
                if i % 5 == 0 { Ray { t_max: 1.0, ..ray } } else { ray }
            })
            .collect();
        Self { meshes, structures, positions, placements, rays }
    }

    fn one_ball() -> Self {
        let turn = Quat::from_axis_angle(Vec3::new(0.2, 0.9, -0.3).normalize(), 0.8);
        let transform =
            Affine3A::from_scale_rotation_translation(Vec3::new(1.0, 1.4, -0.8), turn, Vec3::new(3.0, 1.0, -2.0));
        Self::new(vec![ball(24, Vec3::ZERO, 1.0)], vec![Placement { mesh: 0, transform, filtered: false }])
    }

    fn many() -> Self {
        let mut random = Random(84);
        let placements = (0..60)
            .map(|i| {
                let turn = Quat::from_axis_angle(random.direction(), 6.0 * random.unit());
                let scale = 0.4 + random.point();
                let transform = Affine3A::from_scale_rotation_translation(scale, turn, 6.0 * random.point());
                Placement { mesh: i % 2, transform, filtered: i % 7 == 0 }
            })
            .collect();
        Self::new(vec![ball(20, Vec3::ZERO, 1.0), soup(400, 0.2, 85)], placements)
    }

    fn plain(&self) -> SceneAccel {
        SceneAccel::build(self.structures.clone(), &self.placements)
    }

    fn gated(&self, params: &LineSpaceParams) -> SceneAccel {
        let space = |(mesh, structure): (&Mesh, &Arc<MeshStructure>)| {
            let never = AtomicBool::new(false);
            Some(Arc::new(LineSpace::build(mesh, structure, params, u64::MAX, &never).expect("builds")))
        };
        let spaces = self.meshes.iter().zip(&self.structures).map(space).collect();
        self.plain().with_line_spaces(spaces).expect("one each")
    }

    fn on_gpu(&self, accel: &SceneAccel) -> HostStructure {
        let view = |i: usize| MeshView {
            structure: &self.structures[i],
            positions: &self.positions[i],
            triangles: &self.meshes[i].triangles,
            spheres: &[],
        };
        let views: Vec<_> = (0..self.meshes.len()).map(view).collect();
        let placed: Vec<_> =
            self.placements.iter().map(|p| PlacementView::new(p.mesh, p.transform, p.filtered)).collect();
        HostStructure::wide(accel, &views, &placed)
    }

    /// What the CPU is told, and which rays it takes to be blocked.
    fn occlusion_on_cpu(&self, accel: &SceneAccel) -> (Vec<bool>, GateCounters) {
        let mut counters = Counters::default();
        let blocked = self.rays.iter().map(|ray| accel.occluded(ray, &AcceptAll, &mut counters)).collect();
        (blocked, counters.gates)
    }
}

fn occlusion(tracer: &Tracer<'_>, rays: &[Ray]) -> (Vec<bool>, GateCounters) {
    let batch: Batch = tracer.prepare(rays, true).expect("fits");
    tracer.run(&batch).expect("traces");
    (tracer.occlusion(&batch).expect("reads"), tracer.gate_counters(&batch).expect("reads"))
}

#[test]
fn proven_answers_are_those_without() {
    let context = context();
    let setting = Setting::many();
    let plain = setting.on_gpu(&setting.plain());
    let plain = Tracer::new(&context, &plain, Kernel::Product).expect("fits");
    let (closest, (blocked, asked)) = (plain.closest(&setting.rays).expect("traces"), occlusion(&plain, &setting.rays));
    assert_eq!(asked, GateCounters::default());
    for params in payloads() {
        let gated = setting.on_gpu(&setting.gated(&params));
        let gated = Tracer::new(&context, &gated, Kernel::Product).expect("fits");
        assert!(gated.closest(&setting.rays).expect("traces") == closest, "{params:?}");
        let (answers, told) = occlusion(&gated, &setting.rays);
        assert!(answers == blocked, "{params:?}");
        assert_eq!(told.look_ups() > 0, params.is_conservative(), "{params:?}: {told:?}");
    }
}

/// Of one instance, so that the order in which instances are met decides nothing.
#[test]
fn both_devices_are_told_the_same() {
    let context = context();
    let setting = Setting::one_ball();
    for approximate in [false, true] {
        for params in payloads() {
            let gated = setting.gated(&params);
            let gated = if approximate { gated.approximating_occlusion() } else { gated };
            let (on_cpu, told_on_cpu) = setting.occlusion_on_cpu(&gated);
            let host = setting.on_gpu(&gated);
            let tracer = Tracer::new(&context, &host, Kernel::Product).expect("fits");
            let (on_gpu, told_on_gpu) = occlusion(&tracer, &setting.rays);
            let differing = on_cpu.iter().zip(&on_gpu).filter(|(a, b)| a != b).count();
            // The devices round rays into the mesh's space differently: a ray may fall into the next shaft.
            assert!(differing * 1000 <= setting.rays.len(), "{params:?}: {differing} answers differ");
            let close = |a: u64, b: u64| a.abs_diff(b) <= 10 + a.max(b) / 100;
            // The top level's boxes are coarser on the GPU: more rays that pass a mesh by ask.
            let of = |told: GateCounters| {
                let [_, full_opaque, full_mixed] = told.full_chord;
                let [_, inside_opaque, inside_mixed] = told.ends_inside;
                [full_opaque, full_mixed, inside_opaque, inside_mixed, told.starts_inside]
            };
            let (cpu, gpu) = (of(told_on_cpu), of(told_on_gpu));
            assert!(cpu.iter().zip(gpu).all(|(&a, b)| close(a, b)), "{params:?}: {told_on_cpu:?}, {told_on_gpu:?}");
            let asked_nothing = !params.is_conservative() && !approximate;
            assert_eq!(told_on_gpu.look_ups() == 0, asked_nothing, "{params:?}: {told_on_gpu:?}");
            assert_eq!(told_on_gpu.approximated > 0, approximate, "{params:?}: {told_on_gpu:?}");
        }
    }
}
