// Twin of integrate/surface.rs.

const MIN_VIEW_COSINE = 0.01;
const MIN_MIRROR_COSINE = 0.01;
const MIN_MIRROR_SHARE = 0.9;

struct SurfacePoint {
    position: vec3<f32>,
    error: f32,
    geometric_normal: vec3<f32>,
    smooth_normal: vec3<f32>,
    tangent: vec3<f32>,
    bitangent_sign: f32,
    uv0: vec2<f32>,
    uv1: vec2<f32>,
    color: vec4<f32>,
    material: u32,
}

struct Surface {
    position: vec3<f32>,
    error: f32,
    geometric_normal: vec3<f32>,
    normal: vec3<f32>,
    base_color: vec3<f32>,
    metallic: f32,
    roughness: f32,
    dielectric_f0: vec3<f32>,
    emission: vec3<f32>,
    material: u32,
    flags: u32,
}

fn material_index(instance: u32, primitive: u32) -> u32 {
    let slot = words_at(scene.slots + mesh_at(instance_at(instance).mesh).slot_offset + primitive);
    return words_at(scene.instance_materials + instance_at(instance).material_base + slot);
}

fn float3_at(i: u32) -> vec3<f32> {
    return vec3<f32>(float_at(i), float_at(i + 1u), float_at(i + 2u));
}

fn attribute3(offset: u32, vertex: u32) -> vec3<f32> {
    return float3_at(scene.attributes + offset + 3u * vertex);
}

fn attribute2(offset: u32, triangle: vec3<u32>, b: vec3<f32>) -> vec2<f32> {
    if offset == NONE {
        return vec2<f32>(0.0);
    }
    let base = scene.attributes + offset;
    let i = base + 2u * triangle.x;
    let j = base + 2u * triangle.y;
    let k = base + 2u * triangle.z;
    return b.x * vec2<f32>(float_at(i), float_at(i + 1u)) + b.y * vec2<f32>(float_at(j), float_at(j + 1u))
        + b.z * vec2<f32>(float_at(k), float_at(k + 1u));
}

fn float4_at(i: u32) -> vec4<f32> {
    return vec4<f32>(float_at(i), float_at(i + 1u), float_at(i + 2u), float_at(i + 3u));
}

fn attribute4(offset: u32, triangle: vec3<u32>, b: vec3<f32>) -> vec4<f32> {
    let base = scene.attributes + offset;
    return b.x * float4_at(base + 4u * triangle.x) + b.y * float4_at(base + 4u * triangle.y)
        + b.z * float4_at(base + 4u * triangle.z);
}

fn triangle_vertices(mesh: u32, primitive: u32) -> vec3<u32> {
    let i = scene.triangles + 3u * (mesh_at(mesh).triangle_offset + primitive);
    return vec3<u32>(words_at(i), words_at(i + 1u), words_at(i + 2u));
}

fn corner(mesh: u32, vertex: u32) -> vec3<f32> {
    return float3_at(scene.positions + 3u * (mesh_at(mesh).position_offset + vertex));
}

fn triangle_point(instance: u32, primitive: u32, u: f32, v: f32) -> SurfacePoint {
    let inst = instance_at(instance);
    let mesh = mesh_at(inst.mesh);
    let triangle = triangle_vertices(inst.mesh, primitive);
    let p0 = corner(inst.mesh, triangle.x);
    let p1 = corner(inst.mesh, triangle.y);
    let p2 = corner(inst.mesh, triangle.z);
    let b = vec3<f32>(1.0 - u - v, u, v);
    let p = p0 * b.x + p1 * b.y + p2 * b.z;
    var point: SurfacePoint;
    point.position = transform_point(inst.object_to_world, p);
    point.error = surface_error(inst.object_to_world, max(max(abs(p0), abs(p1)), abs(p2)), point.position);
    let face = cross(p1 - p0, p2 - p0);
    point.geometric_normal = normalize_or(transform_normal(inst.world_to_object, face), vec3<f32>(0.0, 1.0, 0.0));

    point.smooth_normal = point.geometric_normal;
    if mesh.normal_offset != NONE {
        let n = attribute3(mesh.normal_offset, triangle.x) * b.x + attribute3(mesh.normal_offset, triangle.y) * b.y
            + attribute3(mesh.normal_offset, triangle.z) * b.z;
        point.smooth_normal = normalize_or(transform_normal(inst.world_to_object, n), point.geometric_normal);
    }
    if mesh.tangent_offset != NONE {
        let t = attribute4(mesh.tangent_offset, triangle, b);
        point.tangent = transform_vector(inst.object_to_world, t.xyz);
        let mirrored = (inst.flags & INSTANCE_MIRRORED) != 0u;
        point.bitangent_sign = select(1.0, -1.0, (t.w < 0.0) != mirrored);
    }
    point.color = vec4<f32>(1.0);
    if mesh.color_offset != NONE {
        point.color = attribute4(mesh.color_offset, triangle, b);
    }
    point.uv0 = attribute2(mesh.uv0_offset, triangle, b);
    point.uv1 = attribute2(mesh.uv1_offset, triangle, b);
    point.material = material_index(instance, primitive);
    return point;
}

// Centre and radius of a sphere, object space.
fn sphere_of(mesh: u32, primitive: u32) -> vec4<f32> {
    return float4_at(scene.spheres + 4u * (mesh_at(mesh).sphere_offset + primitive - mesh_at(mesh).triangle_count));
}

fn sphere_point(instance: u32, primitive: u32, n: vec3<f32>) -> SurfacePoint {
    let inst = instance_at(instance);
    let sphere = sphere_of(inst.mesh, primitive);
    var point: SurfacePoint;
    point.position = transform_point(inst.object_to_world, sphere.xyz + n * sphere.w);
    point.error = surface_error(inst.object_to_world, abs(sphere.xyz) + vec3<f32>(sphere.w), point.position);
    point.geometric_normal = normalize_or(transform_normal(inst.world_to_object, n), vec3<f32>(0.0, 1.0, 0.0));
    point.smooth_normal = point.geometric_normal;
    point.uv0 = vec2<f32>(
        0.5 + precise_atan2(n.x, n.z) * (0.5 * INV_PI),
        precise_acos(clamp(n.y, -1.0, 1.0)) * INV_PI,
    );
    point.uv1 = point.uv0;
    let east = normalize_or(vec3<f32>(n.z, 0.0, -n.x), vec3<f32>(1.0, 0.0, 0.0));
    point.tangent = transform_vector(inst.object_to_world, east);
    point.bitangent_sign = select(1.0, -1.0, (inst.flags & INSTANCE_MIRRORED) != 0u);
    point.color = vec4<f32>(1.0);
    point.material = material_index(instance, primitive);
    return point;
}

fn sphere_direction(instance: u32, primitive: u32, ray: Ray, t: f32) -> vec3<f32> {
    let inst = instance_at(instance);
    let m = inst.object_to_world;
    let origin = transform_vector(inst.world_to_object, ray.origin - vec3<f32>(m[0].w, m[1].w, m[2].w));
    let direction = transform_vector(inst.world_to_object, ray.direction);
    return normalize_or(origin + direction * t - sphere_of(inst.mesh, primitive).xyz, vec3<f32>(0.0, 1.0, 0.0));
}

fn hit_point(ray: Ray, hit: Hit) -> SurfacePoint {
    if hit.primitive < mesh_at(instance_at(hit.instance).mesh).triangle_count {
        return triangle_point(hit.instance, hit.primitive, hit.u, hit.v);
    }
    return sphere_point(hit.instance, hit.primitive, sphere_direction(hit.instance, hit.primitive, ray, hit.t));
}

fn base_color(material: u32, point: SurfacePoint) -> vec4<f32> {
    var color = material_at(material).base_color * point.color;
    let number = material_at(material).base_color_texture;
    if number != NONE {
        color *= sample_texture(number, point.uv0, point.uv1);
    }
    return color;
}

fn emission(material: u32, point: SurfacePoint) -> vec3<f32> {
    var e = material_at(material).emissive;
    let number = material_at(material).emissive_texture;
    if number != NONE && any(e != vec3<f32>(0.0)) {
        e *= sample_texture(number, point.uv0, point.uv1).xyz;
    }
    return e;
}

fn mapped_normal(material: u32, point: SurfacePoint) -> vec3<f32> {
    let n = point.smooth_normal;
    let number = material_at(material).normal_texture;
    if number == NONE || point.bitangent_sign == 0.0 {
        return n;
    }
    let along = point.tangent - n * dot(n, point.tangent);
    let tangent = normalize_or(along, basis(n).tangent);
    let bitangent = cross(n, tangent) * point.bitangent_sign;
    let t = sample_texture(number, point.uv0, point.uv1);
    let x = (2.0 * t.x - 1.0) * material_at(material).normal_scale;
    let y = (2.0 * t.y - 1.0) * material_at(material).normal_scale;
    let z = 2.0 * t.z - 1.0;
    return normalize_or(tangent * x + bitangent * y + n * z, n);
}

fn valid_normal(normal: vec3<f32>, geometric_normal: vec3<f32>, to_viewer: vec3<f32>) -> vec3<f32> {
    var n = normal;
    let cosine = dot(n, to_viewer);
    if cosine < MIN_VIEW_COSINE {
        n = normalize_or(n + to_viewer * (MIN_VIEW_COSINE - cosine), geometric_normal);
    }
    let mirrored = n * (2.0 * dot(n, to_viewer)) - to_viewer;
    let height = dot(mirrored, geometric_normal);
    let least = min(MIN_MIRROR_COSINE, MIN_MIRROR_SHARE * dot(geometric_normal, to_viewer));
    if height >= least {
        return n;
    }
    let lifted = normalize_or(mirrored + geometric_normal * (least - height), geometric_normal);
    return normalize_or(lifted + to_viewer, geometric_normal);
}

fn shade_point(point: SurfacePoint, to_viewer: vec3<f32>) -> Surface {
    let material = material_at(point.material);
    let color = base_color(point.material, point);
    var metallic = material.metallic;
    var roughness = material.roughness;
    var dielectric_f0 = material.dielectric_f0;
    if material.metallic_roughness_texture != NONE {
        let t = sample_texture(material.metallic_roughness_texture, point.uv0, point.uv1);
        if (material.flags & MATERIAL_SPECULAR_GLOSSINESS) != 0u {
            dielectric_f0 *= t.xyz;
            roughness = 1.0 - (1.0 - roughness) * t.w;
        } else {
            roughness *= t.y;
            metallic *= t.z;
        }
    }
    let side = select(1.0, -1.0, dot(point.geometric_normal, to_viewer) < 0.0);
    let geometric_normal = point.geometric_normal * side;
    let normal = valid_normal(mapped_normal(point.material, point) * side, geometric_normal, to_viewer);
    return Surface(
        point.position,
        point.error,
        geometric_normal,
        normal,
        clamp(color.xyz, vec3<f32>(0.0), vec3<f32>(1.0)),
        clamp(metallic, 0.0, 1.0),
        clamp(roughness, 0.0, 1.0),
        dielectric_f0,
        emission(point.material, point),
        point.material,
        material.flags,
    );
}
