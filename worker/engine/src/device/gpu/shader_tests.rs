//! Every stage in every variant is valid WGSL, and the shaders' structs lie in memory as Rust's do.

use wgpu::naga;

use super::pool::PoolLayout;
use super::scene::{SceneInfo, Wave};
use super::shader::{STAGES, Variant, compose};
use super::tracer::{GpuHit, GpuRay};
use crate::integrate::aov::FirstHit;
use crate::pack::{
    PackedCamera, PackedEnvironment, PackedInstance, PackedLight, PackedMaterial, PackedMesh, PackedTexture,
};

fn pools(chunks: u32) -> Vec<PoolLayout> {
    let pool = |name, element, group, binding| PoolLayout { name, element, group, binding, chunks, shift: 10 };
    vec![
        pool("nodes", "vec4<u32>", 0, 0),
        pool("prims", "vec4<f32>", 0, 4),
        pool("words", "u32", 1, 5),
        pool("texels", "u32", 1, 9),
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
    ];
    let source = compose(stage, &Variant { constants, pools: &pools(chunks), replacements });
    let module = naga::front::wgsl::parse_str(&source.wgsl)
        .unwrap_or_else(|e| panic!("{stage}: {}", e.emit_to_string_with_path(&source.wgsl, stage)));
    naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty())
        .validate(&module)
        .unwrap_or_else(|e| panic!("{stage}: {}", e.emit_to_string_with_path(&source.wgsl, stage)));
    module
}

#[test]
fn every_stage_is_valid_in_every_variant() {
    for (stage, _) in STAGES {
        for chunks in [1, 2, 4] {
            for any_hit in [false, true] {
                module(stage, chunks, any_hit, &[]);
                module(stage, chunks, any_hit, &[("accept_all", "accept_alpha")]);
                module(stage, chunks, any_hit, &[("traverse", "traverse_baseline")]);
            }
        }
    }
}

/// Storage bindings that a stage declares when every pool fits one.
#[test]
fn no_stage_binds_more_than_the_stated_minimum() {
    for (stage, _) in STAGES {
        for replacements in [&[][..], &[("accept_all", "accept_alpha")]] {
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
        zero
    );
    assert_layout!(&shade, "Ray", GpuRay, origin, t_min, direction, t_max);
    assert_layout!(&shade, "Hit", GpuHit, t, u, v, instance, primitive);
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
