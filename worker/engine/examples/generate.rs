//! Writes generated scenes: `cargo run --release --example generate -- FOLDER [KIND…]`, all kinds when none is named.

use std::path::PathBuf;
use std::time::Instant;

use lightshaft_engine::scene::{KINDS, Params, generate};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = PathBuf::from(arguments.next().ok_or("which folder?")?);
    let asked: Vec<String> = arguments.collect();
    for kind in KINDS.iter().filter(|kind| asked.is_empty() || asked.iter().any(|name| name == kind.name)) {
        let start = Instant::now();
        let file = generate(kind.name, &Params::default())?;
        println!("{}: {} bytes in {:.2} s", kind.name, file.len(), start.elapsed().as_secs_f64());
        std::fs::write(folder.join(format!("{}.glb", kind.name)), file)?;
    }
    Ok(())
}
