//! Renders the entries of a settings list with the engine alone, no server and no worker:
//! `cargo run --release --example reference -- SETTINGS.json SCENES_DIR OUT_DIR [--spp N] [--only NAME]`.
//!
//! An entry has `name`, `file` (below SCENES_DIR), `width`, `height`, `spp`, `camera` and the `settings` `integrator`,
//! `max_bounces` and constant `environment`. Writes `NAME.exr` and `NAME.png`, and prints what it took.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use glam::Vec3;
use lightshaft_engine::accel::{BuildParams, MeshStructure, SceneAccel};
use lightshaft_engine::device::cpu::CpuDevice;
use lightshaft_engine::device::{Device, Pass, Region};
use lightshaft_engine::film::{PassFilm, ToneMap, encode_exr, encode_png};
use lightshaft_engine::pack::{pack, placements, with_overlays};
use lightshaft_engine::scene::{Camera, Limits, Projection, import_file};
use lightshaft_engine::settings::{Environment, Integrator, RenderSettings};
use serde::Deserialize;

#[derive(Deserialize)]
struct Entry {
    name: String,
    file: String,
    width: u32,
    height: u32,
    spp: u32,
    camera: View,
    settings: Settings,
}

#[derive(Deserialize)]
struct View {
    position: Vec3,
    target: Vec3,
    up: Vec3,
    fov_y_deg: f32,
}

#[derive(Deserialize)]
struct Settings {
    integrator: String,
    max_bounces: u32,
    environment: f32,
}

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

fn main() -> Result<()> {
    let mut paths = Vec::new();
    let (mut spp, mut only) = (None, None);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--spp" => spp = Some(arguments.next().ok_or("--spp needs a number")?.parse::<u32>()?),
            "--only" => only = Some(arguments.next().ok_or("--only needs a name")?),
            _ => paths.push(argument),
        }
    }
    let [list, scenes, out] = paths.as_slice() else {
        return Err("usage: reference SETTINGS.json SCENES_DIR OUT_DIR [--spp N] [--only NAME]".into());
    };
    let entries: Vec<Entry> = serde_json::from_slice(&std::fs::read(list)?)?;
    std::fs::create_dir_all(out)?;
    for entry in entries.iter().filter(|e| only.as_ref().is_none_or(|name| *name == e.name)) {
        if let Err(error) = render(entry, Path::new(scenes), Path::new(out), spp.unwrap_or(entry.spp)) {
            println!("{}: {error}", entry.name);
        }
    }
    Ok(())
}

fn render(entry: &Entry, scenes: &Path, out: &Path, spp: u32) -> Result<()> {
    let started = Instant::now();
    let settings = settings(entry, spp)?;
    let scene = with_overlays(&import_file(&scenes.join(&entry.file), &Limits::default())?, &settings);
    for warning in &scene.warnings {
        println!("{}: warning: {warning}", entry.name);
    }
    let import_s = started.elapsed().as_secs_f64();
    let never = AtomicBool::new(false);
    let structures = scene
        .meshes
        .iter()
        .map(|mesh| MeshStructure::build(mesh, &BuildParams::default(), &never).map(Arc::new))
        .collect::<std::result::Result<Vec<_>, _>>()?;
    let accel = Arc::new(SceneAccel::build(structures, &placements(&scene)));
    let build_s = started.elapsed().as_secs_f64() - import_s;
    let packed = Arc::new(pack(&scene, &settings, accel)?);

    let region = Region::full(&settings);
    let mut film = PassFilm::new(region);
    let mut renderer = CpuDevice::new().prepare(packed, &settings)?;
    let pass = Pass { region, first_sample: 0, samples: spp };
    let stats = renderer.render(&pass, &mut film, &|| false)?;
    let mean = film.mean();
    let metadata = [("scene", entry.name.clone()), ("spp", spp.to_string())];
    let (w, h) = (settings.width, settings.height);
    let png = encode_png(w, h, &mean, ToneMap::None, 0.0, &metadata)?;
    std::fs::write(out.join(format!("{}.png", entry.name)), png)?;
    std::fs::write(out.join(format!("{}.exr", entry.name)), encode_exr(w, h, &mean, None, &metadata)?)?;
    println!(
        "{}: import {import_s:.2} s, structures {build_s:.2} s, render {:.2} s, {:.2} Mrays/s",
        entry.name,
        stats.seconds,
        stats.rays.total() as f64 / stats.seconds / 1e6
    );
    Ok(())
}

fn settings(entry: &Entry, spp: u32) -> Result<RenderSettings> {
    let max_bounces = entry.settings.max_bounces;
    let integrator = match entry.settings.integrator.as_str() {
        "path" => Integrator::Path { max_bounces },
        "whitted" => Integrator::Whitted { max_bounces },
        "direct" => Integrator::Direct,
        "aov" => Integrator::Aov,
        other => return Err(format!("unknown integrator {other:?}").into()),
    };
    let forward = (entry.camera.target - entry.camera.position).normalize();
    let right = forward.cross(entry.camera.up).normalize();
    Ok(RenderSettings {
        integrator,
        width: entry.width,
        height: entry.height,
        spp,
        seed: 1,
        camera: Camera {
            name: String::new(),
            position: entry.camera.position,
            forward,
            up: right.cross(forward),
            projection: Projection::Perspective { fov_y_rad: entry.camera.fov_y_deg.to_radians() },
            frame_aspect: None,
        },
        environment: Environment::Constant(Vec3::splat(entry.settings.environment)),
        extra_lights: Vec::new(),
        ground: None,
        aovs: Vec::new(),
    })
}
