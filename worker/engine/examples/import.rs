//! Imports scenes and prints what is in them and how long it took: `cargo run --release --example import -- FILE…`.

use std::path::Path;
use std::time::Instant;

use lightshaft_engine::scene::{Limits, import_file};

fn main() {
    for file in std::env::args().skip(1) {
        let start = Instant::now();
        let result = import_file(Path::new(&file), &Limits::default());
        let milliseconds = start.elapsed().as_secs_f64() * 1e3;
        match result {
            Ok(scene) => {
                let triangles: usize = scene.meshes.iter().map(|mesh| mesh.triangles.len()).sum();
                println!(
                    "{file}: {milliseconds:.0} ms, {} meshes, {triangles} triangles, {} instances, {} materials, {} images, \
                     {} cameras, {} lights",
                    scene.meshes.len(),
                    scene.instances.len(),
                    scene.materials.len(),
                    scene.images.len(),
                    scene.cameras.len(),
                    scene.lights.len()
                );
                for warning in scene.warnings {
                    println!("    warning: {warning}");
                }
            }
            Err(error) => println!("{file}: {milliseconds:.0} ms, {:?}: {error}", error.kind),
        }
    }
}
