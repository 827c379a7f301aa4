// What a walk found, and what the records of primitives say beside their shape.

//!include rays

struct Trace {
    hit: Hit,
    box_tests: u32,
    primitive_tests: u32,
}

// In the second element of a record of three: what it is, and, of flat structures, whether its hits go through the alpha
// filter; the third one's last word then is its instance.
const PRIMITIVE_SPHERE = 1u;
const PRIMITIVE_FILTERED = 2u;
