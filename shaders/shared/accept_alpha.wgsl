// Hit filter of scenes with alpha mask or blend; twin of integrate/alpha.rs.

//!include shading

var<private> filter_seed: u32;

fn begin_filter(slot: u32) {
    let ray_number = select(wave.closest_number, wave.shadow_number, ANY_HIT);
    if ray_number == NONE {
        filter_seed = NONE;
    } else {
        let sample = path_sample(slot);
        filter_seed = alpha_seed(sample.seed, sample.index, ray_number);
    }
}

fn accept(filtered: bool, ray: Ray, hit: Hit) -> bool {
    if !filtered {
        return true;
    }
    let material = material_index(hit.instance, hit.primitive);
    let flags = material_at(material).flags;
    if (flags & (MATERIAL_ALPHA_MASK | MATERIAL_ALPHA_BLEND)) == 0u {
        return true;
    }
    let alpha = base_color(material, hit_point(ray, hit)).w;
    if (flags & MATERIAL_ALPHA_MASK) != 0u {
        return alpha >= material_at(material).alpha_cutoff;
    }
    if filter_seed == NONE {
        return alpha >= 0.5;
    }
    var key = hash_combine(hash_combine(filter_seed, hit.instance), hit.primitive);
    if hit.primitive >= mesh_at(instance_at(hit.instance).mesh).triangle_count {
        // A ray meets a sphere twice, and each wall decides for itself.
        let n = sphere_direction(hit.instance, hit.primitive, ray, hit.t);
        let ahead = transform_vector(instance_at(hit.instance).world_to_object, ray.direction);
        key = hash_combine(key, select(0u, 1u, dot(n, ahead) > 0.0));
    }
    return unit_float(key) < alpha;
}
