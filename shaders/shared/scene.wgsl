// The packed scene: mirrors of pack/layout.rs (a test compares the layouts) and where its arrays are bound.

struct PackedMesh {
    position_offset: u32,
    triangle_offset: u32,
    triangle_count: u32,
    sphere_offset: u32,
    sphere_count: u32,
    slot_offset: u32,
    normal_offset: u32,
    tangent_offset: u32,
    uv0_offset: u32,
    uv1_offset: u32,
    color_offset: u32,
    _pad: u32,
}

const INSTANCE_MIRRORED = 2u;
const INSTANCE_SIMILARITY = 4u;

struct PackedInstance {
    object_to_world: array<vec4<f32>, 3>,
    world_to_object: array<vec4<f32>, 3>,
    mesh: u32,
    material_base: u32,
    emitter_base: u32,
    flags: u32,
}

const MATERIAL_ALPHA_MASK = 1u;
const MATERIAL_ALPHA_BLEND = 2u;
const MATERIAL_UNLIT = 8u;
const MATERIAL_SPECULAR_GLOSSINESS = 16u;

struct PackedMaterial {
    base_color: vec4<f32>,
    emissive: vec3<f32>,
    metallic: f32,
    dielectric_f0: vec3<f32>,
    roughness: f32,
    normal_scale: f32,
    alpha_cutoff: f32,
    flags: u32,
    base_color_texture: u32,
    metallic_roughness_texture: u32,
    normal_texture: u32,
    emissive_texture: u32,
    _pad: u32,
}

const WRAP_MIRRORED = 1u;
const WRAP_CLAMP = 2u;
const TEXTURE_WRAP_V_SHIFT = 2u;
const TEXTURE_NEAREST = 16u;
const TEXTURE_SRGB = 32u;
const TEXTURE_UV1 = 64u;

struct PackedTexture {
    transform: array<f32, 6>,
    texel_offset: u32,
    width: u32,
    height: u32,
    flags: u32,
    _pad: array<u32, 2>,
}

const LIGHT_DIRECTIONAL = 1u;
const LIGHT_SPOT = 2u;
const LIGHT_TRIANGLE = 3u;
const LIGHT_ENVIRONMENT = 5u;

struct PackedLight {
    position: vec3<f32>,
    kind: u32,
    direction: vec3<f32>,
    range: f32,
    intensity: vec3<f32>,
    selection: f32,
    spot_scale: f32,
    spot_offset: f32,
    instance: u32,
    primitive: u32,
}

struct PackedEnvironment {
    radiance: vec3<f32>,
    width: u32,
    height: u32,
    rotation_cos: f32,
    rotation_sin: f32,
    light: u32,
}

struct PackedCamera {
    position: vec3<f32>,
    orthographic: u32,
    forward: vec3<f32>,
    width: u32,
    right: vec3<f32>,
    height: u32,
    up: vec3<f32>,
    _pad: u32,
}

// What does not change between dispatches. Offsets of structs are in elements of `tables`, the others in words of the
// pool that holds the array.
struct SceneInfo {
    camera: PackedCamera,
    environment: PackedEnvironment,
    meshes: u32,
    instances: u32,
    materials: u32,
    textures: u32,
    lights: u32,
    positions: u32,
    triangles: u32,
    slots: u32,
    spheres: u32,
    attributes: u32,
    instance_materials: u32,
    light_cdf: u32,
    light_count: u32,
    emitter_lights: u32,
    ggx_albedo: u32,
    srgb: u32,
    sobol: u32,
    environment_texels: u32,
    environment_cdf: u32,
    _pad: u32,
}

// One dispatch's part of the work: slots 0 .. pixels * samples are the samples of some of the region's pixels.
struct Wave {
    region_x: u32,
    region_y: u32,
    region_width: u32,
    // Turn of the first pixel in the region's order (`path_sample`).
    first_pixel: u32,
    pixels: u32,
    first_sample: u32,
    samples: u32,
    seed: u32,
    // Number of the vertex that rays lead to.
    bounce: u32,
    max_bounces: u32,
    // Alpha ray numbers of closest-hit and of shadow rays; NONE: blended surfaces stand where alpha is a half or more.
    closest_number: u32,
    shadow_number: u32,
    // Ambient occlusion: rays per sample, number of this one, and their reach.
    ao_samples: u32,
    ao_index: u32,
    ao_distance: f32,
    // Bits of infinity: WGSL has no literal for it.
    infinity: u32,
    // Samples of these pixels that are in the sums already.
    accumulated: u32,
    // Always 0, which compilers cannot know.
    zero: u32,
    // Slots that the buffers between the stages have room for.
    capacity: u32,
    // Number of the queue with the active paths, 0 or 1.
    active_queue: u32,
    // The order of pixels: `PixelOrder`.
    run: u32,
    runs: u32,
    run_step: u32,
    _pad: u32,
}

// All arrays of structs, one after the other: adapters bind few storage buffers at once.
@group(1) @binding(0) var<storage, read> tables: array<vec4<u32>>;
// Geometry and lists of numbers, then texels and the environment map.
//!pool words
//!pool texels
@group(3) @binding(0) var<uniform> scene: SceneInfo;
@group(3) @binding(1) var<uniform> wave: Wave;

fn float_at(i: u32) -> f32 {
    return bitcast<f32>(words_at(i));
}

fn table_floats(i: u32) -> vec4<f32> {
    return bitcast<vec4<f32>>(tables[i]);
}

fn mesh_at(number: u32) -> PackedMesh {
    let i = scene.meshes + 3u * number;
    let a = tables[i];
    let b = tables[i + 1u];
    let c = tables[i + 2u];
    return PackedMesh(a.x, a.y, a.z, a.w, b.x, b.y, b.z, b.w, c.x, c.y, c.z, c.w);
}

fn instance_at(number: u32) -> PackedInstance {
    let i = scene.instances + 7u * number;
    let ids = tables[i + 6u];
    return PackedInstance(
        array<vec4<f32>, 3>(table_floats(i), table_floats(i + 1u), table_floats(i + 2u)),
        array<vec4<f32>, 3>(table_floats(i + 3u), table_floats(i + 4u), table_floats(i + 5u)),
        ids.x, ids.y, ids.z, ids.w,
    );
}

fn material_at(number: u32) -> PackedMaterial {
    let i = scene.materials + 5u * number;
    let b = table_floats(i + 1u);
    let c = table_floats(i + 2u);
    let d = tables[i + 3u];
    let e = tables[i + 4u];
    return PackedMaterial(
        table_floats(i), b.xyz, b.w, c.xyz, c.w, bitcast<f32>(d.x), bitcast<f32>(d.y), d.z, d.w, e.x, e.y, e.z, e.w,
    );
}

fn texture_at(number: u32) -> PackedTexture {
    let i = scene.textures + 3u * number;
    let a = table_floats(i);
    let b = tables[i + 1u];
    let c = tables[i + 2u];
    let transform = array<f32, 6>(a.x, a.y, a.z, a.w, bitcast<f32>(b.x), bitcast<f32>(b.y));
    return PackedTexture(transform, b.z, b.w, c.x, c.y, array<u32, 2>(c.z, c.w));
}

fn light_at(number: u32) -> PackedLight {
    let i = scene.lights + 4u * number;
    let a = tables[i];
    let b = table_floats(i + 1u);
    let c = table_floats(i + 2u);
    let d = tables[i + 3u];
    return PackedLight(
        bitcast<vec3<f32>>(a.xyz), a.w, b.xyz, b.w, c.xyz, c.w, bitcast<f32>(d.x), bitcast<f32>(d.y), d.z, d.w,
    );
}
