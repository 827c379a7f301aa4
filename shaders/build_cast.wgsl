// BUILD by casting: what the first line of each shaft's pattern that hits something hits (`accel/line_space/cast.rs`), where that is
// certain.
//
// Constants from outside: those of `traverse.wgsl`, of which ANY_HIT says that it does not matter what is hit.

//!include lines
//!include traverse
//!include accept_all

const CAST_NOTHING = 0xffffffffu;
const CAST_UNSURE = 0xfffffffeu;

struct CastJob {
    first: u32,
    count: u32,
    n: u32,
    // Lines of the pattern: each patch has a point for each.
    lines: u32,
    directed: u32,
}

@group(2) @binding(0) var<storage, read_write> jobs: array<CastJob>;
@group(2) @binding(1) var<storage, read_write> points: array<vec4<f32>>;
@group(2) @binding(2) var<storage, read_write> answers: array<u32>;

fn cast_line(origin: vec3<f32>, end: vec3<f32>) -> u32 {
    begin_nearest();
    let hit = trace(Ray(origin, 0.0, end - origin, LINE_END)).hit;
    let is_hit = hit.instance != NONE;
    if ANY_HIT && is_hit {
        return 0u;
    }
    if others_lower <= select(NOWHERE * 0.5, hit.t, is_hit) {
        return CAST_UNSURE;
    }
    return select(CAST_NOTHING, hit.primitive, is_hit);
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let job = jobs[0];
    if id.x >= job.count {
        return;
    }
    let index = job.first + id.x;
    var patches = symmetric_patches(job.n, index);
    if job.directed != 0u {
        patches = directed_patches(job.n, index);
    }
    var answer = CAST_NOTHING;
    for (var line = 0u; line < job.lines; line++) {
        let found = cast_line(points[patches.x * job.lines + line].xyz, points[patches.y * job.lines + line].xyz);
        if found == CAST_UNSURE {
            answer = CAST_UNSURE;
            // A later line may decide that there is something, but not what comes first.
            if !ANY_HIT {
                break;
            }
        } else if found != CAST_NOTHING {
            answer = found;
            break;
        }
    }
    answers[id.x] = answer;
}
