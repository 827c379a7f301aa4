// Twin of integrate/math.rs: the same operations in the same order.

const PI = 3.14159265358979;
const TWO_PI = 2.0 * PI;
const INV_PI = 0.318309886183791;
const LOCAL_ERROR = 1.0 / 1048576.0;
const WORLD_ERROR = 1.0 / 4194304.0;
const INFINITY_BITS = 0x7f800000u;

fn infinity() -> f32 {
    return bitcast<f32>(wave.infinity);
}

fn luminance(c: vec3<f32>) -> f32 {
    return 0.2126 * c.x + 0.7152 * c.y + 0.0722 * c.z;
}

fn transform_point(rows: array<vec4<f32>, 3>, p: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(
        rows[0].x * p.x + rows[0].y * p.y + rows[0].z * p.z + rows[0].w,
        rows[1].x * p.x + rows[1].y * p.y + rows[1].z * p.z + rows[1].w,
        rows[2].x * p.x + rows[2].y * p.y + rows[2].z * p.z + rows[2].w,
    );
}

fn transform_vector(rows: array<vec4<f32>, 3>, v: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(
        rows[0].x * v.x + rows[0].y * v.y + rows[0].z * v.z,
        rows[1].x * v.x + rows[1].y * v.y + rows[1].z * v.z,
        rows[2].x * v.x + rows[2].y * v.y + rows[2].z * v.z,
    );
}

fn transform_normal(inverse_rows: array<vec4<f32>, 3>, n: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(
        inverse_rows[0].x * n.x + inverse_rows[1].x * n.y + inverse_rows[2].x * n.z,
        inverse_rows[0].y * n.x + inverse_rows[1].y * n.y + inverse_rows[2].y * n.z,
        inverse_rows[0].z * n.x + inverse_rows[1].z * n.y + inverse_rows[2].z * n.z,
    );
}

fn surface_error(rows: array<vec4<f32>, 3>, extent: vec3<f32>, position: vec3<f32>) -> f32 {
    let r0 = abs(rows[0]);
    let r1 = abs(rows[1]);
    let r2 = abs(rows[2]);
    let x = r0.x * extent.x + r0.y * extent.y + r0.z * extent.z;
    let y = r1.x * extent.x + r1.y * extent.y + r1.z * extent.z;
    let z = r2.x * extent.x + r2.y * extent.y + r2.z * extent.z;
    let world = max(max(r0.w + abs(position.x), r1.w + abs(position.y)), r2.w + abs(position.z));
    return max(max(x, y), z) * LOCAL_ERROR + world * WORLD_ERROR;
}

fn normalize_or(v: vec3<f32>, fallback: vec3<f32>) -> vec3<f32> {
    let length = sqrt(dot(v, v));
    if length > 0.0 && (bitcast<u32>(length) < INFINITY_BITS) {
        return v * (1.0 / length);
    }
    return fallback;
}

struct Basis {
    tangent: vec3<f32>,
    bitangent: vec3<f32>,
}

fn basis(n: vec3<f32>) -> Basis {
    let sign = select(-1.0, 1.0, n.z >= 0.0);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    return Basis(
        vec3<f32>(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x),
        vec3<f32>(b, sign + n.y * n.y * a, -n.y),
    );
}

fn to_local(frame: Basis, normal: vec3<f32>, v: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(dot(v, frame.tangent), dot(v, frame.bitangent), dot(v, normal));
}

fn to_world(frame: Basis, normal: vec3<f32>, v: vec3<f32>) -> vec3<f32> {
    return frame.tangent * v.x + frame.bitangent * v.y + normal * v.z;
}

fn offset_origin(position: vec3<f32>, error: f32, normal: vec3<f32>, direction: vec3<f32>) -> vec3<f32> {
    if dot(direction, normal) >= 0.0 {
        return position + normal * error;
    }
    return position - normal * error;
}

fn power_heuristic(a: f32, b: f32) -> f32 {
    if a <= 0.0 {
        return 0.0;
    }
    if b <= a {
        let r = b / a;
        return 1.0 / (1.0 + r * r);
    }
    let r = a / b;
    return (r * r) / (1.0 + r * r);
}

fn cosine_hemisphere(u: f32, v: f32) -> vec3<f32> {
    let r = sqrt(u);
    return vec3<f32>(r * unit_circle(TWO_PI * v), sqrt(max(1.0 - u, 0.0)));
}

fn uniform_sphere(u: f32, v: f32) -> vec3<f32> {
    let z = 1.0 - 2.0 * u;
    let r = sqrt(max(1.0 - z * z, 0.0));
    return vec3<f32>(r * unit_circle(TWO_PI * v), z);
}

fn uniform_triangle(u: f32, v: f32) -> vec2<f32> {
    let s = sqrt(u);
    return vec2<f32>(s * (1.0 - v), s * v);
}

// Compares bits: compilers may assume that floats are finite.
fn is_finite(v: vec3<f32>) -> bool {
    let bits = bitcast<vec3<u32>>(v) & vec3<u32>(0x7fffffffu);
    return max(bits.x, max(bits.y, bits.z)) < INFINITY_BITS;
}

// atan2 to some units in the last place (Moshier's Cephes, atanf); built-ins may be off by 1e-4.
fn precise_atan2(y: f32, x: f32) -> f32 {
    let ay = abs(y);
    let ax = abs(x);
    let large = max(ax, ay);
    let t = min(ax, ay) / max(large, 1e-37);
    // t is in 0..1; above tan(pi/8) turned by pi/4.
    let turned = t > 0.41421357;
    let r = select(t, (t - 1.0) / (t + 1.0), turned);
    let z = r * r;
    var a = (((8.05374449538e-2 * z - 1.38776856032e-1) * z + 1.99777106478e-1) * z - 3.33329491539e-1) * z * r + r;
    a = select(a, a + 0.785398163397448, turned);
    a = select(a, 1.5707963267949 - a, ay > ax);
    a = select(a, PI - a, x < 0.0);
    return select(a, -a, y < 0.0);
}

// Cosine and sine of an angle in -2 pi to 2 pi to some units in the last place (Cephes, cosf and sinf); built-ins may be
// off by 2^-11, and a point on a sphere would lie far from its surface.
fn unit_circle(angle: f32) -> vec2<f32> {
    let quarters = round(angle * (2.0 * INV_PI));
    // A quarter in three parts, so that products with the first two are exact.
    let x = ((angle - quarters * 1.5703125) - quarters * 4.837512969970703125e-4) - quarters * 7.54978995489188216e-8;
    let z = x * x;
    let c = ((2.443315711809948e-5 * z - 1.388731625493765e-3) * z + 4.166664568298827e-2) * z * z - 0.5 * z + 1.0;
    let s = ((-1.9515295891e-4 * z + 8.3321608736e-3) * z - 1.6666654611e-1) * z * x + x;
    let turn = bitcast<u32>(i32(quarters));
    let quarter = select(vec2<f32>(c, s), vec2<f32>(-s, c), (turn & 1u) != 0u);
    return select(quarter, -quarter, (turn & 2u) != 0u);
}

fn precise_acos(x: f32) -> f32 {
    return precise_atan2(sqrt(max((1.0 - x) * (1.0 + x), 0.0)), x);
}
