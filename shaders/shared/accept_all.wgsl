// Hit filter of scenes without alpha: every hit counts.

fn begin_filter(slot: u32) {}

fn accept(filtered: bool, ray: Ray, hit: Hit) -> bool {
    return true;
}
