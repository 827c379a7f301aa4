// Twin of integrate/lights.rs.

struct LightSample {
    direction: vec3<f32>,
    distance: f32,
    radiance: vec3<f32>,
    pdf: f32,
    is_delta: bool,
}

fn no_light() -> LightSample {
    return LightSample(vec3<f32>(0.0, 1.0, 0.0), 0.0, vec3<f32>(0.0), 0.0, true);
}

fn sample_light(position: vec3<f32>, normal: vec3<f32>, choice: u32, u: f32, v: f32) -> LightSample {
    if scene.light_count == 0u {
        return no_light();
    }
    let number = select_light(choice);
    let light = light_at(number);
    if light.kind == LIGHT_ENVIRONMENT {
        let direction = sample_environment(normal, u, v);
        return LightSample(
            direction,
            infinity(),
            environment_radiance(direction),
            light.selection * environment_pdf(normal, direction),
            false,
        );
    }
    if light.instance == NONE {
        return sample_punctual(light, position);
    }
    if light.kind == LIGHT_TRIANGLE {
        return sample_triangle(light, position, u, v);
    }
    return sample_sphere(light, position, u, v);
}

fn select_light(choice: u32) -> u32 {
    var low = 0u;
    var high = scene.light_count - 1u;
    while low < high {
        let middle = (low + high) / 2u;
        if words_at(scene.light_cdf + middle) >= choice {
            high = middle;
        } else {
            low = middle + 1u;
        }
    }
    return low;
}

fn sample_punctual(light: PackedLight, position: vec3<f32>) -> LightSample {
    if light.kind == LIGHT_DIRECTIONAL {
        return LightSample(-light.direction, infinity(), light.intensity, light.selection, true);
    }
    let to_light = light.position - position;
    let distance2 = dot(to_light, to_light);
    if distance2 <= 0.0 {
        return no_light();
    }
    let distance = sqrt(distance2);
    let direction = to_light * (1.0 / distance);
    var attenuation = 1.0 / distance2;
    if bitcast<u32>(light.range) < INFINITY_BITS {
        let r = distance / light.range;
        let r2 = r * r;
        attenuation *= clamp(1.0 - r2 * r2, 0.0, 1.0);
    }
    if light.kind == LIGHT_SPOT {
        let cosine = -dot(direction, light.direction);
        let cone = clamp(cosine * light.spot_scale + light.spot_offset, 0.0, 1.0);
        attenuation *= cone * cone;
    }
    return LightSample(direction, distance, light.intensity * attenuation, light.selection, true);
}

fn triangle_cross(instance: u32, primitive: u32) -> vec3<f32> {
    let mesh = instance_at(instance).mesh;
    let triangle = triangle_vertices(mesh, primitive);
    let a = corner(mesh, triangle.x);
    let e1 = transform_vector(instance_at(instance).object_to_world, corner(mesh, triangle.y) - a);
    let e2 = transform_vector(instance_at(instance).object_to_world, corner(mesh, triangle.z) - a);
    return cross(e1, e2);
}

// A sample of an emitter's point, seen from `position`.
fn sample_point(point: SurfacePoint, position: vec3<f32>, pdf: f32) -> LightSample {
    // The shadow ray ends on the near side of the light.
    let to_light = point.position - position;
    let reach = offset_origin(point.position, point.error, point.geometric_normal, -to_light) - position;
    return LightSample(
        normalize_or(reach, vec3<f32>(0.0, 1.0, 0.0)),
        sqrt(dot(reach, reach)),
        emission(point.material, point) * opacity(point),
        pdf,
        false,
    );
}

fn sample_triangle(light: PackedLight, position: vec3<f32>, u: f32, v: f32) -> LightSample {
    let b = uniform_triangle(u, v);
    let point = triangle_point(light.instance, light.primitive, b.x, b.y);
    let to_light = point.position - position;
    let distance2 = dot(to_light, to_light);
    let projected = 0.5 * abs(dot(triangle_cross(light.instance, light.primitive), to_light));
    if distance2 <= 0.0 || projected <= 0.0 {
        return no_light();
    }
    return sample_point(point, position, light.selection * distance2 * sqrt(distance2) / projected);
}

fn opacity(point: SurfacePoint) -> f32 {
    let flags = material_at(point.material).flags;
    if (flags & (MATERIAL_ALPHA_MASK | MATERIAL_ALPHA_BLEND)) == 0u {
        return 1.0;
    }
    let alpha = base_color(point.material, point).w;
    if (flags & MATERIAL_ALPHA_MASK) == 0u {
        return clamp(alpha, 0.0, 1.0);
    }
    return select(0.0, 1.0, alpha >= material_at(point.material).alpha_cutoff);
}

// World-space centre and radius.
fn world_sphere(instance: u32, primitive: u32) -> vec4<f32> {
    let rows = instance_at(instance).object_to_world;
    let sphere = sphere_of(instance_at(instance).mesh, primitive);
    let axis = transform_vector(rows, vec3<f32>(sphere.w, 0.0, 0.0));
    return vec4<f32>(transform_point(rows, sphere.xyz), sqrt(dot(axis, axis)));
}

fn sample_sphere(light: PackedLight, position: vec3<f32>, u: f32, v: f32) -> LightSample {
    var n = uniform_sphere(u, v);
    let cone = sphere_cone(light.instance, light.primitive, position);
    if cone > 0.0 {
        let sphere = world_sphere(light.instance, light.primitive);
        let to_center = sphere.xyz - position;
        let distance = sqrt(dot(to_center, to_center));
        let axis = to_center * (1.0 / distance);
        // 1 - cos of the angle off the axis; then the angle at the sphere's centre.
        let lost = u * cone;
        let sine2 = lost * (2.0 - lost);
        let along = distance * (1.0 - lost) - sqrt(max(sphere.w * sphere.w - distance * distance * sine2, 0.0));
        let across = sqrt(max(sine2, 0.0)) * unit_circle(TWO_PI * v);
        let direction = to_world(basis(axis), axis, vec3<f32>(across, 1.0 - lost));
        let outward = position + direction * along - sphere.xyz;
        n = normalize_or(transform_vector(instance_at(light.instance).world_to_object, outward), n);
    }
    let point = sphere_point(light.instance, light.primitive, n);
    let density = sphere_pdf(light.instance, light.primitive, position, point.position, n);
    return sample_point(point, position, light.selection * density);
}

fn sphere_cone(instance: u32, primitive: u32, position: vec3<f32>) -> f32 {
    if (instance_at(instance).flags & INSTANCE_SIMILARITY) == 0u {
        return 0.0;
    }
    let sphere = world_sphere(instance, primitive);
    let to_center = sphere.xyz - position;
    let sine2 = sphere.w * sphere.w / dot(to_center, to_center);
    if !(sine2 < 0.9999) {
        return 0.0;
    }
    // 1 - cos without cancellation for small spheres.
    return sine2 / (1.0 + sqrt(1.0 - sine2));
}

fn sphere_pdf(instance: u32, primitive: u32, position: vec3<f32>, to: vec3<f32>, n: vec3<f32>) -> f32 {
    let cone = sphere_cone(instance, primitive, position);
    if cone > 0.0 {
        return 1.0 / (TWO_PI * cone);
    }
    let radius = sphere_of(instance_at(instance).mesh, primitive).w;
    // Area element of the image of the unit sphere: cofactor(M) n, whose direction is the normal.
    let m = instance_at(instance).object_to_world;
    let x = vec3<f32>(m[0].x, m[1].x, m[2].x);
    let y = vec3<f32>(m[0].y, m[1].y, m[2].y);
    let z = vec3<f32>(m[0].z, m[1].z, m[2].z);
    let element = cross(y, z) * n.x + cross(z, x) * n.y + cross(x, y) * n.z;
    let to_light = to - position;
    let distance2 = dot(to_light, to_light);
    let projected = abs(dot(element, to_light)) * radius * radius * 4.0 * PI;
    if projected <= 0.0 {
        return 0.0;
    }
    return distance2 * sqrt(distance2) / projected;
}

fn emitter_pdf(
    instance: u32, primitive: u32, position: vec3<f32>, to: vec3<f32>, geometric_normal: vec3<f32>,
) -> f32 {
    let emitter_base = instance_at(instance).emitter_base;
    if emitter_base == NONE {
        return 0.0;
    }
    let number = words_at(scene.emitter_lights + emitter_base + primitive);
    if number == NONE {
        return 0.0;
    }
    let selection = light_at(number).selection;
    if primitive < mesh_at(instance_at(instance).mesh).triangle_count {
        let to_light = to - position;
        let distance2 = dot(to_light, to_light);
        let projected = 0.5 * abs(dot(triangle_cross(instance, primitive), to_light));
        if projected <= 0.0 {
            return 0.0;
        }
        return selection * distance2 * sqrt(distance2) / projected;
    }
    // The object-space normal back from the world's: transpose(M) N, the inverse of the inverse transpose.
    let n = transform_normal(instance_at(instance).object_to_world, geometric_normal);
    return selection * sphere_pdf(instance, primitive, position, to, normalize_or(n, vec3<f32>(0.0, 1.0, 0.0)));
}
