//! Shows on real models that Lightshaft works, as Markdown tables: uploads every scene of a folder, renders those that
//! have a reference picture on each device, and compares the pictures with the references and with each other.
//!
//! ```text
//! cargo run --release -p lightshaft-tests --bin verify_references -- --scenes DIR --references DIR [--out DIR]
//! ```
//!
//! The references' folder holds `settings.json`, a list of `{name, file, width, height, spp, camera, settings}`, and
//! `<name>.exr`. With `--out`, each picture is left there as the EXR of the job and as a PNG strip: reference, ours, FLIP
//! heat map. `regions` are the lowest and the highest mean ratio of the picture's 8 x 6 parts: noise averages out there,
//! and a fault that the whole picture's mean hides does not.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::Parser;
use lightshaft_compare::{Image, heat_map};
use lightshaft_tests::{Reply, Service, glb, picture};
use serde::Deserialize;
use serde_json::{Map, Value, json};

#[derive(Parser)]
struct Arguments {
    /// Folder of .glb and .gltf files, searched to every depth.
    #[arg(long)]
    scenes: PathBuf,
    /// Folder of `settings.json` and the reference pictures.
    #[arg(long)]
    references: Option<PathBuf>,
    /// Devices to render on.
    #[arg(long, value_delimiter = ',', default_value = "cpu,gpu")]
    devices: Vec<String>,
    /// Only references with these names.
    #[arg(long, value_delimiter = ',')]
    only: Vec<String>,
    /// Replaces the samples per pixel of `settings.json`.
    #[arg(long)]
    spp: Option<u32>,
    /// Where to leave pictures.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Do not upload the scenes that have no reference.
    #[arg(long)]
    skip_uploads: bool,
}

/// Parts of a picture that are compared by their means.
const REGIONS: (usize, usize) = (8, 6);

#[derive(Deserialize)]
struct Reference {
    name: String,
    file: PathBuf,
    width: u32,
    height: u32,
    spp: u32,
    camera: Value,
    settings: Map<String, Value>,
}

#[tokio::main]
async fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let service = Service::start();
    if !arguments.skip_uploads {
        upload_all(&service, &arguments.scenes).await?;
    }
    if let Some(references) = &arguments.references {
        compare_all(&service, &arguments, references).await?;
    }
    Ok(())
}

async fn upload_all(service: &Service, scenes: &Path) -> Result<()> {
    println!("| scene | status | triangles | instances | warnings, or why it was refused |\n|---|---|---|---|---|");
    for path in models(scenes)? {
        let name = path.strip_prefix(scenes)?.display().to_string();
        let reply = upload(service, &path).await?;
        let body = reply.json();
        if reply.status < 300 {
            let warnings: Vec<&str> =
                body["warnings"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
            let (triangles, instances) = (&body["triangles_total"], &body["instances"]);
            println!("| {name} | {} | {triangles} | {instances} | {} |", reply.status, warnings.join("; "));
        } else {
            let errors = body["errors"].as_array().into_iter().flatten();
            let errors: Vec<String> =
                errors.map(|e| format!("{}: {}", text(&e["pointer"]), text(&e["detail"]))).collect();
            println!("| {name} | {} | | | {} {} |", reply.status, text(&body["detail"]), errors.join("; "));
        }
    }
    println!();
    Ok(())
}

async fn compare_all(service: &Service, arguments: &Arguments, references: &Path) -> Result<()> {
    let settings = fs::read(references.join("settings.json")).context("settings.json of the references")?;
    let list: Vec<Reference> = serde_json::from_slice(&settings)?;
    println!(
        "| scene | device | spp | render s | MRays/s | FLIP mean | FLIP 99 % | relMSE | mean ratio | regions | FLIP to {} |",
        arguments.devices[0]
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    for reference in list.iter().filter(|r| arguments.only.is_empty() || arguments.only.contains(&r.name)) {
        let path = references.join(format!("{}.exr", reference.name));
        let expected = picture::exr(&fs::read(&path).with_context(|| path.display().to_string())?);
        let reply = upload(service, &arguments.scenes.join(&reference.file)).await?;
        if reply.status >= 300 {
            println!("| {} | not uploaded: {} | | | | | | | | | |", reference.name, text(&reply.json()["detail"]));
            continue;
        }
        let scene = reply.json()["id"].as_str().context("a scene's id")?.to_owned();
        let mut first: Option<Image> = None;
        for device in &arguments.devices {
            let job = service.submit(&scene, job_settings(reference, device, arguments.spp)).await;
            let job = ended(service, &job).await;
            if job["state"] != "succeeded" {
                let (state, error) = (text(&job["state"]), text(&job["error"]));
                println!("| {} | {device} | {state}: {error} | | | | | | | | |", reference.name);
                continue;
            }
            let file = service.artifact(&job, "image.exr").await;
            let ours = picture::exr(&file);
            let strip = row(reference, device, &job, &expected, &ours, first.as_ref());
            if let Some(out) = &arguments.out {
                fs::create_dir_all(out)?;
                fs::write(out.join(format!("{}-{device}.exr", reference.name)), &file)?;
                save_strip(&out.join(format!("{}-{device}.png", reference.name)), &expected, &strip)?;
            }
            first.get_or_insert(ours);
        }
    }
    Ok(())
}

/// Waits for a job's end, however long it takes.
async fn ended(service: &Service, id: &str) -> Value {
    loop {
        let job = service.job(id).await;
        if matches!(text(&job["state"]), "succeeded" | "failed" | "cancelled") {
            return job;
        }
        tokio::time::sleep(Duration::from_millis(200)).await;
    }
}

/// Prints one row of the table. Gives the reference, ours and the heat map of their difference.
fn row(
    reference: &Reference,
    device: &str,
    job: &Value,
    expected: &Image,
    ours: &Image,
    first: Option<&Image>,
) -> [Vec<u8>; 3] {
    let comparison = picture::against(expected, ours);
    let report = &comparison.report;
    let to_first =
        first.map_or(String::new(), |first| format!("{:.5}", picture::against(first, ours).report.flip_mean));
    let (darkest, brightest) = region_ratios(expected, ours);
    println!(
        "| {} | {device} | {} | {:.1} | {:.1} | {:.4} | {:.3} | {:.4} | {:.4} | {darkest:.3} to {brightest:.3} | {to_first} |",
        reference.name,
        job["metrics"]["spp"],
        job["metrics"]["render_s"].as_f64().unwrap_or(f64::NAN),
        job["metrics"]["mrays_per_s"].as_f64().unwrap_or(f64::NAN),
        report.flip_mean,
        report.flip_p99,
        report.differences.rel_mse,
        report.differences.mean_ratio.unwrap_or(f64::NAN),
    );
    [expected.to_srgb8(0.0), ours.to_srgb8(0.0), heat_map(&comparison.flip)]
}

/// Lowest and highest ratio of the means of ours and the reference over the parts of the picture that are not black.
fn region_ratios(expected: &Image, ours: &Image) -> (f64, f64) {
    let (columns, rows) = REGIONS;
    let (width, height) = (expected.width(), expected.height());
    let sum = |image: &Image, column: usize, row: usize| -> f64 {
        let xs = column * width / columns..(column + 1) * width / columns;
        let ys = row * height / rows..(row + 1) * height / rows;
        let pixels = ys.flat_map(|y| xs.clone().map(move |x| y * width + x));
        pixels.flat_map(|i| image.pixels()[i]).map(f64::from).sum()
    };
    let dark = 1e-3 * picture::mean(expected) * (3 * width * height) as f64 / (columns * rows) as f64;
    (0..columns * rows)
        .map(|part| (sum(expected, part % columns, part / columns), sum(ours, part % columns, part / columns)))
        .filter(|(expected, _)| *expected > dark)
        .map(|(expected, ours)| ours / expected)
        .fold((f64::INFINITY, 0.0), |(low, high), ratio| (ratio.min(low), ratio.max(high)))
}

fn job_settings(reference: &Reference, device: &str, spp: Option<u32>) -> Value {
    let mut settings = reference.settings.clone();
    let given = json!({"width": reference.width, "height": reference.height, "spp": spp.unwrap_or(reference.spp),
        "camera": reference.camera, "device": device, "outputs": ["png", "exr"]});
    settings.extend(given.as_object().cloned().unwrap_or_default());
    settings.into()
}

/// Uploads a .glb as it is, a .gltf as a zip of all files in its folder.
async fn upload(service: &Service, path: &Path) -> Result<Reply> {
    if path.extension().is_some_and(|extension| extension == "glb") {
        return Ok(service.upload("model/gltf-binary", fs::read(path)?).await);
    }
    let folder = path.parent().context("a file lies in a folder")?;
    let mut files = Vec::new();
    for file in files_below(folder)? {
        let is_other_model = file != path && file.extension().is_some_and(|e| e == "gltf" || e == "glb");
        if !is_other_model {
            let name = file.strip_prefix(folder)?.to_str().context("a UTF-8 name")?.to_owned();
            files.push((name, fs::read(&file)?));
        }
    }
    let files: Vec<(&str, &[u8])> = files.iter().map(|(name, bytes)| (name.as_str(), bytes.as_slice())).collect();
    Ok(service.upload("application/zip", glb::zip(&files)).await)
}

fn models(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut models = files_below(folder)?;
    models.retain(|path| path.extension().is_some_and(|extension| extension == "glb" || extension == "gltf"));
    if models.is_empty() {
        bail!("{} holds no .glb and no .gltf", folder.display());
    }
    Ok(models)
}

fn files_below(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let path = entry?.path();
        if path.is_dir() {
            files.extend(files_below(&path)?);
        } else {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

/// Pictures of one size, side by side.
fn save_strip(path: &Path, size: &Image, pictures: &[Vec<u8>]) -> Result<()> {
    let (width, height) = (size.width(), size.height());
    let rows = (0..height).flat_map(|y| pictures.iter().map(move |picture| &picture[y * width * 3..][..width * 3]));
    let strip: Vec<u8> = rows.flatten().copied().collect();
    image::save_buffer(path, &strip, (width * pictures.len()) as u32, height as u32, image::ExtendedColorType::Rgb8)?;
    Ok(())
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap_or_default()
}
