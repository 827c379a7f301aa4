// Hit filter of scenes without alpha: every hit counts.

fn accept(filtered: bool, hit: Hit) -> bool {
    return true;
}
