//! Every stage in every variant is valid WGSL, and the shaders' structs lie in memory as Rust's do.

use wgpu::naga;

use super::context::{Context, whole};
use super::pace::PixelOrder;
use super::pool::PoolLayout;
use super::scene::{SceneInfo, Wave};
use super::shader::{STAGES, Variant, compose, compose_text};
use super::tracer::{GpuHit, GpuPath, GpuRay};
use crate::device::Region;
use crate::integrate::aov::FirstHit;
use crate::pack::{
    PackedCamera, PackedEnvironment, PackedInstance, PackedLight, PackedMaterial, PackedMesh, PackedTexture,
};

fn pools(chunks: u32) -> Vec<PoolLayout> {
    let pool = |name, element, group, binding| PoolLayout { name, element, group, binding, chunks, shift: 10 };
    vec![
        pool("nodes", "vec4<u32>", 0, 0),
        pool("prims", "vec4<u32>", 0, 4),
        pool("words", "u32", 1, 1),
        pool("texels", "u32", 1, 5),
    ]
}

fn module(
    stage: &'static str,
    chunks: u32,
    any_hit: bool,
    replacements: &[(&'static str, &'static str)],
) -> naga::Module {
    let flag = |name, value: bool| (name, value.to_string());
    let constants = vec![
        ("STACK_SIZE", "16u".to_owned()),
        flag("ANY_HIT", any_hit),
        flag("SPHERES", true),
        flag("FILTERED", true),
        flag("COUNTING", true),
        flag("GATED", true),
        flag("APPROXIMATE", true),
        flag("FLAT", true),
        flag("ALONE", false),
    ];
    let source = compose(stage, &Variant { constants, pools: &pools(chunks), replacements });
    let module = naga::front::wgsl::parse_str(&source.wgsl)
        .unwrap_or_else(|e| panic!("{stage}: {}", e.emit_to_string_with_path(&source.wgsl, stage)));
    naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty())
        .validate(&module)
        .unwrap_or_else(|e| panic!("{stage}: {}", e.emit_to_string_with_path(&source.wgsl, stage)));
    module
}

/// Builds walk one mesh's BVH alone, and filter nothing.
fn is_build(stage: &str) -> bool {
    stage.starts_with("build_")
}

#[test]
fn every_stage_is_valid_in_every_variant() {
    for (stage, _) in STAGES {
        for chunks in [1, 2, 4] {
            for any_hit in [false, true] {
                module(stage, chunks, any_hit, &[]);
                if is_build(stage) {
                    continue;
                }
                module(stage, chunks, any_hit, &[("accept_all", "accept_alpha")]);
                module(stage, chunks, any_hit, &[("traverse", "traverse_baseline")]);
                module(stage, chunks, any_hit, &[("traverse", "traverse_cells")]);
            }
        }
    }
}

/// Storage bindings that a stage declares when every pool fits one.
#[test]
fn no_stage_binds_more_than_the_stated_minimum() {
    for (stage, _) in STAGES {
        for replacements in [&[][..], &[("accept_all", "accept_alpha")]] {
            if is_build(stage) && !replacements.is_empty() {
                continue;
            }
            let module = module(stage, 1, false, replacements);
            let storage = module
                .global_variables
                .iter()
                .filter(|(_, variable)| matches!(variable.space, naga::AddressSpace::Storage { .. }))
                .count();
            assert!(storage <= super::REQUIRED_STORAGE_BUFFERS as usize, "{stage} binds {storage}");
        }
    }
}

#[track_caller]
fn assert_struct(module: &naga::Module, name: &str, size: usize, offsets: &[(&str, usize)]) {
    let found = module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some(name));
    let Some((_, naga::Type { inner: naga::TypeInner::Struct { members, span }, .. })) = found else {
        panic!("no struct {name}");
    };
    assert_eq!(*span as usize, size, "size of {name}");
    let actual: Vec<_> = members.iter().map(|m| (m.name.as_deref().unwrap_or(""), m.offset as usize)).collect();
    let actual: Vec<_> = actual.into_iter().filter(|(member, _)| !member.starts_with("_pad")).collect();
    assert_eq!(actual, offsets, "members of {name}");
}

macro_rules! assert_layout {
    ($module:expr, $name:literal, $rust:ty, $($field:ident),+) => {
        assert_struct($module, $name, size_of::<$rust>(), &[$((stringify!($field), std::mem::offset_of!($rust, $field))),+])
    };
}

#[test]
fn shader_structs_lie_in_memory_as_rusts_do() {
    let shade = module("shade_path", 1, false, &[]);
    assert_layout!(
        &shade,
        "PackedMesh",
        PackedMesh,
        position_offset,
        triangle_offset,
        triangle_count,
        sphere_offset,
        sphere_count,
        slot_offset,
        normal_offset,
        tangent_offset,
        uv0_offset,
        uv1_offset,
        color_offset
    );
    assert_layout!(
        &shade,
        "PackedInstance",
        PackedInstance,
        object_to_world,
        world_to_object,
        mesh,
        material_base,
        emitter_base,
        flags
    );
    assert_layout!(
        &shade,
        "PackedMaterial",
        PackedMaterial,
        base_color,
        emissive,
        metallic,
        dielectric_f0,
        roughness,
        normal_scale,
        alpha_cutoff,
        flags,
        base_color_texture,
        metallic_roughness_texture,
        normal_texture,
        emissive_texture
    );
    assert_layout!(&shade, "PackedTexture", PackedTexture, transform, texel_offset, width, height, flags);
    assert_layout!(
        &shade,
        "PackedLight",
        PackedLight,
        position,
        kind,
        direction,
        range,
        intensity,
        selection,
        spot_scale,
        spot_offset,
        instance,
        primitive
    );
    assert_layout!(
        &shade,
        "PackedEnvironment",
        PackedEnvironment,
        radiance,
        width,
        height,
        rotation_cos,
        rotation_sin,
        light
    );
    assert_layout!(&shade, "PackedCamera", PackedCamera, position, orthographic, forward, width, right, height, up);
    assert_layout!(
        &shade,
        "SceneInfo",
        SceneInfo,
        camera,
        environment,
        meshes,
        instances,
        materials,
        textures,
        lights,
        positions,
        triangles,
        slots,
        spheres,
        attributes,
        instance_materials,
        light_cdf,
        light_count,
        emitter_lights,
        ggx_albedo,
        srgb,
        sobol,
        environment_texels,
        environment_cdf
    );
    assert_layout!(
        &shade,
        "Wave",
        Wave,
        region_x,
        region_y,
        region_width,
        first_pixel,
        pixels,
        first_sample,
        samples,
        seed,
        bounce,
        max_bounces,
        closest_number,
        shadow_number,
        ao_samples,
        ao_index,
        ao_distance,
        infinity,
        accumulated,
        zero,
        capacity,
        active_queue,
        run,
        runs,
        run_step
    );
    assert_layout!(&shade, "Ray", GpuRay, origin, t_min, direction, t_max);
    assert_layout!(&shade, "Hit", GpuHit, t, u, v, instance, primitive);
    assert_layout!(&shade, "Path", GpuPath, state, radiance, contribution);
    let first_hit = module("first_hit", 1, false, &[]);
    assert_layout!(
        &first_hit,
        "FirstHit",
        FirstHit,
        position,
        depth,
        geometric_normal,
        instance,
        shading_normal,
        primitive,
        albedo,
        material,
        box_tests,
        primitive_tests
    );
}

/// The accessors of `scene.wgsl` take the tables' structs apart by hand: each must give back what Rust put in.
#[test]
fn structs_are_read_from_the_tables_as_rust_wrote_them() {
    let context = Context::open(None).expect("tests need an adapter (mesa-vulkan-drivers has one)");
    const COUNT: usize = 3;
    let accessors: [(&str, &str, usize); 5] = [
        ("PackedMesh", "mesh_at", size_of::<PackedMesh>()),
        ("PackedInstance", "instance_at", size_of::<PackedInstance>()),
        ("PackedMaterial", "material_at", size_of::<PackedMaterial>()),
        ("PackedTexture", "texture_at", size_of::<PackedTexture>()),
        ("PackedLight", "light_at", size_of::<PackedLight>()),
    ];
    for (name, accessor, bytes) in accessors {
        let text = format!(
            "//!include rays\n//!include scene\n\
             @group(2) @binding(0) var<storage, read_write> found: array<{name}>;\n\
             @compute @workgroup_size({COUNT})\n\
             fn main(@builtin(global_invocation_id) id: vec3<u32>) {{ found[id.x] = {accessor}(id.x); }}\n"
        );
        let source = compose_text("table test", &text, &Variant { pools: &pools(1), ..Variant::default() });
        // Distinct words that are ordinary floats too; one element stands in front of the structs.
        let written: Vec<u32> = (0..(COUNT * bytes / 4) as u32).map(|i| 0x3f80_0000 + i).collect();
        let table = context.upload("tables", bytemuck::cast_slice(&[&[0; 4], &written[..]].concat())).expect("fits");
        let found = context.upload("found", &vec![0; COUNT * bytes]).expect("fits");
        let info = SceneInfo { meshes: 1, instances: 1, materials: 1, textures: 1, lights: 1, ..SceneInfo::default() };
        let info = context.uniform("scene info", bytemuck::bytes_of(&info)).expect("fits");
        let entry = wgpu::BindGroupEntry { binding: 0, resource: table.as_entire_binding() };
        let (table_layout, tables) = context.bind_storage("tables", &[entry], true);
        let (found_layout, founds) = context.bind_buffers("found", &[whole(&found)]);
        let (info_layout, infos) = context.bind_uniforms("info", &[whole(&info)]);
        let pipeline = context.pipeline(&source, &[None, Some(&table_layout), Some(&found_layout), Some(&info_layout)]);
        let mut encoder = context.encoder();
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(1, &tables, &[]);
        pass.set_bind_group(2, &founds, &[]);
        pass.set_bind_group(3, &infos, &[]);
        pass.dispatch_workgroups(1, 1, 1);
        drop(pass);
        context.submit(encoder).expect("runs");
        let read: Vec<u32> = context.read(&found, written.len()).expect("reads");
        assert_eq!(read, written, "{accessor}");
    }
}

#[test]
fn sines_and_cosines_are_those_of_the_cpu() {
    let context = Context::open(None).expect("tests need an adapter (mesa-vulkan-drivers has one)");
    const COUNT: usize = 4096;
    let text = "//!include rays\n//!include scene\n//!include math\n\
         @group(2) @binding(0) var<storage, read_write> values: array<vec2<f32>>;\n\
         @compute @workgroup_size(64)\n\
         fn main(@builtin(global_invocation_id) id: vec3<u32>) { values[id.x] = unit_circle(values[id.x].x); }\n";
    let source = compose_text("circle test", text, &Variant { pools: &pools(1), ..Variant::default() });
    let angles: Vec<[f32; 2]> = (0..COUNT).map(|i| [std::f32::consts::TAU * (i as f32 / 2047.0 - 1.0), 0.0]).collect();
    let values = context.upload("values", bytemuck::cast_slice(&angles)).expect("fits");
    let (layout, group) = context.bind_buffers("values", &[whole(&values)]);
    let pipeline = context.pipeline(&source, &[None, None, Some(&layout)]);
    let mut encoder = context.encoder();
    let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
    pass.set_pipeline(&pipeline);
    pass.set_bind_group(2, &group, &[]);
    pass.dispatch_workgroups(COUNT as u32 / 64, 1, 1);
    drop(pass);
    context.submit(encoder).expect("runs");
    let found: Vec<[f32; 2]> = context.read(&values, COUNT).expect("reads");
    for ([angle, _], [cosine, sine]) in angles.into_iter().zip(found) {
        let (expected_sine, expected_cosine) = f64::from(angle).sin_cos();
        let error = (f64::from(sine) - expected_sine).abs().max((f64::from(cosine) - expected_cosine).abs());
        assert!(error < 2e-7, "{angle}: {cosine}, {sine}");
    }
}

#[test]
fn pixels_take_turns_as_the_host_believes() {
    let context = Context::open(None).expect("tests need an adapter (mesa-vulkan-drivers has one)");
    let region = Region { x: 3, y: 5, width: 67, height: 61 };
    let order = PixelOrder::new(region.pixels() as u32);
    let text = "//!include rays\n//!include scene\n//!include math\n//!include sampler\n\
         @group(2) @binding(0) var<storage, read_write> found: array<vec2<u32>>;\n\
         @compute @workgroup_size(64)\n\
         fn main(@builtin(global_invocation_id) id: vec3<u32>) {\n\
             let sample = path_sample(id.x);\n\
             found[id.x] = vec2<u32>(sample.x, sample.y);\n\
         }\n";
    let source = compose_text("turns test", text, &Variant { pools: &pools(1), ..Variant::default() });
    let wave = Wave { samples: 1, ..Wave::over(region, 0) };
    let count = region.pixels().next_multiple_of(64);
    let found = context.upload("found", &vec![0; 8 * count]).expect("fits");
    let info = context.uniform("scene info", bytemuck::bytes_of(&SceneInfo::default())).expect("fits");
    let wave = context.uniform("wave", bytemuck::bytes_of(&wave)).expect("fits");
    let empty = context.upload("empty", &[0; 16]).expect("fits");
    let entry = |binding| wgpu::BindGroupEntry { binding, resource: empty.as_entire_binding() };
    let (scene_layout, scene) = context.bind_storage("scene", &[entry(0), entry(1), entry(5)], true);
    let (found_layout, founds) = context.bind_buffers("found", &[whole(&found)]);
    let (uniform_layout, uniforms) = context.bind_uniforms("uniforms", &[whole(&info), whole(&wave)]);
    let groups = [None, Some(&scene_layout), Some(&found_layout), Some(&uniform_layout)];
    let pipeline = context.pipeline(&source, &groups);
    let mut encoder = context.encoder();
    let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
    pass.set_pipeline(&pipeline);
    pass.set_bind_group(1, &scene, &[]);
    pass.set_bind_group(2, &founds, &[]);
    pass.set_bind_group(3, &uniforms, &[]);
    pass.dispatch_workgroups((count / 64) as u32, 1, 1);
    drop(pass);
    context.submit(encoder).expect("runs");
    let read: Vec<[u32; 2]> = context.read(&found, region.pixels()).expect("reads");
    for (turn, place) in (0..).zip(read) {
        let pixel = order.pixel(turn);
        assert_eq!(place, [region.x + pixel % region.width, region.y + pixel / region.width], "turn {turn}");
    }
}
