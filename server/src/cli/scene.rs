//! `lightshaft scene …`

use std::path::{Path, PathBuf};

use clap::Parser;
use clap::builder::{PossibleValue, PossibleValuesParser};
use lightshaft_api::client::{Client, ScenePart, Upload};
use lightshaft_api::scene::{Scene, SceneSummary};
use lightshaft_engine::scene::{self as engine, KINDS, Limits, Params, Source};
use lightshaft_server::app::import::summary;
use percent_encoding::percent_decode_str;
use serde_json::{Value, json};

use super::error::{CliError, Result};
use super::{Global, block_on, output};

#[derive(Debug, clap::Subcommand)]
pub(crate) enum Command {
    /// Upload a .glb, a .zip, or a .gltf with the files that it names.
    Upload {
        file: PathBuf,
        /// What the service shows it as. [default: the file's name]
        #[arg(long)]
        name: Option<String>,
    },
    /// List the scenes of the service.
    List {
        /// At most so many.
        #[arg(long, default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..))]
        limit: u32,
    },
    /// Show one scene.
    Show { scene: String },
    /// Write one of the built-in scenes as .glb.
    Generate(GenerateArgs),
    /// Import a file here and say what is in it, or what is wrong with it.
    Validate { file: PathBuf },
    /// Delete a scene of the service.
    Delete { scene: String },
}

#[derive(Debug, clap::Args)]
pub(crate) struct GenerateArgs {
    /// What to make.
    #[arg(value_parser = PossibleValuesParser::new(KINDS.iter().map(|kind| PossibleValue::new(kind.name).help(kind.help))))]
    kind: String,
    /// File to write. [default: KIND.glb]
    #[arg(short, long, value_name = "FILE.glb")]
    output: Option<PathBuf>,
    /// Another seed, another scene of the same kind.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Triangles, roughly; for the kinds that come in several sizes.
    #[arg(long)]
    triangles: Option<u32>,
    /// Objects; for the kinds that place many.
    #[arg(long)]
    count: Option<u32>,
}

pub(crate) fn run(command: Command, global: &Global) -> Result<()> {
    match command {
        Command::Generate(args) => generate(&args, global),
        Command::Validate { file } => validate(&file, global),
        Command::Upload { file, name } => block_on(async {
            let (scene, created) = upload(&global.client()?, &file, name.as_deref()).await?;
            if !created && !global.json {
                eprintln!("the service has this scene already");
            }
            print_scene(&scene, global)
        }),
        Command::List { limit } => block_on(list(global, limit)),
        Command::Show { scene } => block_on(async { print_scene(&global.client()?.scene(&scene).await?, global) }),
        Command::Delete { scene } => block_on(async {
            global.client()?.delete_scene(&scene).await?;
            if global.json { output::print_json(&json!({ "deleted": scene })) } else { Ok(()) }
        }),
    }
}

/// Uploads what the file is: a .gltf goes with the files that it names. The flag says whether the scene is new.
pub(super) async fn upload(client: &Client, file: &Path, name: Option<&str>) -> Result<(Scene, bool)> {
    let stem = file.file_stem().map(|stem| stem.to_string_lossy().into_owned());
    let is_gltf = file.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("gltf"));
    let upload = if is_gltf { Upload::Files(gltf_files(file)?) } else { Upload::file(file).await? };
    Ok(client.upload_scene(upload, name.or(stem.as_deref())).await?)
}

/// The .gltf itself and every file below its folder that it names.
fn gltf_files(file: &Path) -> Result<Vec<ScenePart>> {
    let named = |error: &dyn std::fmt::Display| CliError::usage(format!("{}: {error}", file.display()));
    let text = std::fs::read(file).map_err(|error| named(&error))?;
    let document: Value =
        serde_json::from_slice(&text).map_err(|error| named(&format!("not a glTF document: {error}")))?;
    let name = file.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let folder = file.parent().unwrap_or(Path::new(""));
    let mut parts = vec![ScenePart { path: name, file: file.to_owned() }];
    for path in referenced_paths(&document) {
        let on_disk = folder.join(&path);
        let known = parts.iter().any(|part| part.path == path);
        // One that is missing is the service's to report, in the same words as for every other upload.
        if !known && on_disk.is_file() {
            parts.push(ScenePart { path, file: on_disk });
        }
    }
    Ok(parts)
}

/// Relative paths of the buffers and images of a glTF document; data URIs need no file.
fn referenced_paths(document: &Value) -> Vec<String> {
    ["buffers", "images"]
        .iter()
        .filter_map(|key| document[key].as_array())
        .flatten()
        .filter_map(|entry| entry["uri"].as_str())
        .filter(|uri| !uri.get(..5).is_some_and(|scheme| scheme.eq_ignore_ascii_case("data:")))
        .map(|uri| percent_decode_str(uri).decode_utf8_lossy().replace('\\', "/"))
        .map(|path| path.trim_start_matches("./").to_owned())
        // A path that leaves the folder is refused by the service; nothing outside is read for it.
        .filter(|path| !path.starts_with('/') && !path.split('/').any(|part| part == ".."))
        .collect()
}

async fn list(global: &Global, limit: u32) -> Result<()> {
    let client = global.client()?;
    let mut scenes: Vec<Scene> = Vec::new();
    let mut cursor = None;
    loop {
        let page = client.scenes(Some((limit - scenes.len() as u32).min(100)), cursor.as_deref()).await?;
        scenes.extend(page.items);
        cursor = page.next_cursor;
        if cursor.is_none() || scenes.len() as u32 >= limit {
            break;
        }
    }
    if global.json {
        return output::print_json(&scenes);
    }
    let mut table = output::Table::new(&["id", "name", "triangles", "instances", "size", "created"]);
    for scene in scenes {
        table.row([
            scene.id,
            scene.name,
            output::count(scene.summary.triangles_instanced),
            output::count(scene.summary.instances),
            output::bytes(scene.bytes),
            format!("{:.0}", scene.created_at),
        ]);
    }
    table.print()
}

/// The bytes of a generated scene, as the words after `scene generate` describe it.
pub(super) fn generated(words: &str) -> Result<Vec<u8>> {
    #[derive(clap::Parser)]
    struct Line {
        #[command(flatten)]
        args: GenerateArgs,
    }
    let words = ["generate"].into_iter().chain(words.split_whitespace());
    let line = Line::try_parse_from(words).map_err(|error| CliError::usage(error.to_string()))?;
    line.args.glb()
}

impl GenerateArgs {
    fn glb(&self) -> Result<Vec<u8>> {
        let params = Params { seed: self.seed, triangles: self.triangles, count: self.count };
        engine::generate(&self.kind, &params).map_err(|error| CliError::usage(error.to_string()))
    }
}

fn generate(args: &GenerateArgs, global: &Global) -> Result<()> {
    let glb = args.glb()?;
    let path = args.output.clone().unwrap_or_else(|| PathBuf::from(format!("{}.glb", args.kind)));
    std::fs::write(&path, &glb).map_err(|error| CliError::usage(format!("{}: {error}", path.display())))?;
    if global.json {
        return output::print_json(&json!({ "kind": args.kind, "file": path, "bytes": glb.len() }));
    }
    output::print(&format!("{} ({})\n", path.display(), output::bytes(glb.len() as u64)))
}

fn validate(file: &Path, global: &Global) -> Result<()> {
    let limits = Limits::default();
    let scene = Source::open(file, &limits)
        .and_then(|source| engine::import(&source, &limits, &|| false))
        .map_err(|error| CliError::no(output::printable(&format!("{}: {error}", file.display()))))?;
    let summary = summary(&scene.summary());
    if global.json {
        return output::print_json(&summary);
    }
    output::print(&describe(&scene.name, &summary))
}

fn print_scene(scene: &Scene, global: &Global) -> Result<()> {
    if global.json {
        return output::print_json(scene);
    }
    output::print(&format!("id          {}\n{}", scene.id, describe(&scene.name, &scene.summary)))
}

fn describe(name: &str, summary: &SceneSummary) -> String {
    use std::fmt::Write;
    let mut text = String::new();
    let mut line = |name: &str, value: String| {
        let _ = writeln!(text, "{name:<12}{}", output::printable(&value));
    };
    line("name", name.to_owned());
    line("meshes", output::count(summary.meshes.len() as u64));
    line("instances", output::count(summary.instances));
    line(
        "triangles",
        format!(
            "{} ({} with instances)",
            output::count(summary.triangles_total),
            output::count(summary.triangles_instanced)
        ),
    );
    if summary.spheres_total > 0 {
        line("spheres", output::count(summary.spheres_total));
    }
    line("materials", summary.materials.len().to_string());
    line("textures", format!("{} ({} pixels)", summary.textures, output::count(summary.texture_pixels)));
    for camera in &summary.cameras {
        line("camera", format!("{} ({})", camera.name, camera.kind));
    }
    for light in &summary.lights {
        line("light", format!("{} ({})", light.name, light.kind));
    }
    if summary.emitters > 0 {
        line("emitters", output::count(summary.emitters));
    }
    if let Some(bounds) = summary.bounds {
        line("bounds", format!("{:?} to {:?}", bounds.min, bounds.max));
    }
    line("memory", format!("about {}", output::bytes(summary.estimated_bytes)));
    for warning in &summary.warnings {
        line("warning", warning.clone());
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gltf_is_uploaded_with_the_files_that_it_names_and_no_others() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
        write("a b.bin", "");
        write("unused.bin", "");
        write(
            "scene.gltf",
            r#"{ "buffers": [{ "uri": "a%20b.bin" }, { "uri": "data:,x" }, { "uri": "missing.bin" }],
                 "images": [{ "uri": "./a%20b.bin" }, { "uri": "../secret.png" }, { "bufferView": 0 }] }"#,
        );
        let parts = gltf_files(&folder.path().join("scene.gltf")).unwrap();
        let paths: Vec<&str> = parts.iter().map(|part| part.path.as_str()).collect();
        assert_eq!(paths, ["scene.gltf", "a b.bin"]);
    }
}
