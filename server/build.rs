//! The migrations are embedded at build time: a new one must build the crate anew.

fn main() {
    println!("cargo:rerun-if-changed=../migrations");
}
