//! Results as tables: Markdown and terminal for people, CSV and JSON for scripts.

use lightshaft_api::benchmark::{BenchmarkResults, Column, Comparison, Row, SceneResults};

use crate::executor::{Artifact, TaskError};

/// Names of what every benchmark leaves.
pub const RESULTS_JSON: &str = "results.json";
pub const RESULTS_CSV: &str = "results.csv";
pub const RESULTS_MARKDOWN: &str = "results.md";

/// A figure that is not there.
/// What stands for a figure that there is not.
pub const NONE: &str = "–";

/// The results in all forms.
pub(super) fn artifacts(results: &BenchmarkResults) -> Result<Vec<Artifact>, TaskError> {
    let json = serde_json::to_vec_pretty(results)
        .map_err(|error| TaskError::worker(format!("the results could not be written as JSON: {error}")))?;
    let text = |name: &'static str, media_type, bytes| Artifact { name: name.into(), media_type, bytes };
    Ok(vec![
        text(RESULTS_JSON, "application/json", json),
        text(RESULTS_CSV, "text/csv", csv(results).into_bytes()),
        text(RESULTS_MARKDOWN, "text/markdown", markdown(results).into_bytes()),
    ])
}

/// One table: headings, and a row of cells for each configuration.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// Scene and effect.
    pub title: String,
    /// What was measured, and how it was lit.
    pub notes: Vec<String>,
    pub headings: Vec<&'static str>,
    pub rows: Vec<Vec<String>>,
}

/// A table for each comparison, with the columns that the results ask for.
pub fn tables(results: &BenchmarkResults) -> Vec<Table> {
    let of_scene = |scene: &SceneResults| -> Vec<Table> {
        scene.comparisons.iter().map(|comparison| table(&results.columns, scene, comparison)).collect()
    };
    results.scenes.iter().flat_map(of_scene).collect()
}

fn table(columns: &[Column], scene: &SceneResults, comparison: &Comparison) -> Table {
    let stand_in = if scene.stand_in { " (stand-in)" } else { "" };
    let size = match (scene.triangles, scene.spheres) {
        (triangles, 0) => format!("{triangles} triangles"),
        (0, spheres) => format!("{spheres} spheres"),
        (triangles, spheres) => format!("{triangles} triangles and {spheres} spheres"),
    };
    let mut notes = vec![
        format!("{}{stand_in}: {size} in {} meshes, {} instances", scene.measured, scene.meshes, scene.instances),
        comparison.note.clone(),
    ];
    if !comparison.views.is_empty() {
        notes.push(format!("views: {}", comparison.views.join(", ")));
    }
    let reasons = comparison.rows.iter().filter_map(|row| {
        let why = row.unavailable.as_ref()?;
        Some(format!("{}: not available: {why}", row.configuration))
    });
    notes.extend(reasons);
    let headings = std::iter::once("configuration").chain(columns.iter().map(|&column| heading(column))).collect();
    let cells = |row: &Row| {
        let reference = if comparison.reference.as_ref() == Some(&row.configuration) { " (reference)" } else { "" };
        let mut cells = vec![format!("{}{reference}", row.configuration)];
        cells.extend(columns.iter().map(|&column| cell(column, row)));
        if row.unavailable.is_some() && cells.len() > 1 {
            cells[1] = "not available".into();
        }
        cells
    };
    Table {
        title: format!("{}{stand_in}: {}", scene.name, comparison.title),
        notes,
        headings,
        rows: comparison.rows.iter().map(cells).collect(),
    }
}

pub fn heading(column: Column) -> &'static str {
    match column {
        Column::InitS => "init s",
        Column::Nodes => "nodes",
        Column::StructureMb => "structure MB",
        Column::LineSpaces => "# LS",
        Column::LineSpaceMb => "LS MB",
        Column::SizeMb => "size MB",
        Column::Fps => "FPS",
        Column::MraysPerS => "MRays/s",
        Column::Ratio => "ratio [95 %]",
        Column::Rmse => "RMSE",
        Column::Flip => "FLIP",
        Column::BoxTests => "boxes/ray",
        Column::TriangleTests => "triangles/ray",
        Column::LookUps => "look-ups/ray",
        Column::PaperInitS => "paper: init s",
        Column::PaperNodes => "paper: nodes",
        Column::PaperLineSpaces => "paper: # LS",
        Column::PaperLineSpaceMb => "paper: LS MB",
        Column::PaperSizeMb => "paper: size MB",
        Column::PaperFps => "paper: FPS",
        Column::PaperMraysPerS => "paper: MRays/s",
        Column::PaperRatio => "paper: ratio",
        Column::PaperRmse => "paper: RMSE",
    }
}

pub fn cell(column: Column, row: &Row) -> String {
    let (built, timed, picture) = (row.built.as_ref(), row.timed.as_ref(), row.picture.as_ref());
    let paper = row.paper.unwrap_or_default();
    let megabytes = |bytes: u64| bytes as f64 / 1e6;
    let text = match column {
        Column::Ratio => timed.and_then(|t| t.ratio).map(|r| format!("{:.2} [{:.2}, {:.2}]", r.value, r.low, r.high)),
        Column::Nodes => built.map(|b| b.structure_nodes.to_string()),
        Column::LineSpaces => built.map(|b| b.line_spaces.to_string()),
        Column::PaperNodes => paper.nodes.map(|n| format!("{n:.0}")),
        Column::PaperLineSpaces => paper.line_spaces.map(|n| format!("{n:.0}")),
        Column::InitS => built.map(|b| figure(b.init_s)),
        Column::StructureMb => built.map(|b| figure(megabytes(b.structure_bytes))),
        Column::LineSpaceMb => built.map(|b| figure(megabytes(b.line_space_bytes))),
        Column::SizeMb => built.map(|b| figure(megabytes(b.structure_bytes + b.line_space_bytes))),
        Column::Fps => timed.map(|t| figure(t.frames_per_s.median)),
        Column::MraysPerS => timed.map(|t| figure(t.mrays_per_s.median)),
        Column::Rmse => picture.map(|p| error(p.rmse)),
        Column::Flip => picture.map(|p| error(p.flip)),
        Column::BoxTests => timed.map(|t| figure(t.per_ray.box_tests)),
        Column::TriangleTests => timed.map(|t| figure(t.per_ray.triangle_tests)),
        Column::LookUps => timed.map(|t| figure(t.per_ray.look_ups)),
        Column::PaperInitS => paper.init_s.map(figure),
        Column::PaperLineSpaceMb => paper.line_space_mb.map(figure),
        Column::PaperSizeMb => paper.size_mb.map(figure),
        Column::PaperFps => paper.fps.map(figure),
        Column::PaperMraysPerS => paper.mrays_per_s.map(figure),
        Column::PaperRatio => paper.ratio.map(|ratio| format!("{ratio:.2}")),
        Column::PaperRmse => paper.rmse.map(error),
    };
    text.unwrap_or_else(|| NONE.to_owned())
}

/// Three digits that count.
fn figure(value: f64) -> String {
    match value.abs() {
        large if large >= 100.0 => format!("{value:.0}"),
        middle if middle >= 10.0 => format!("{value:.1}"),
        small if small >= 0.1 || small == 0.0 => format!("{value:.2}"),
        _ => format!("{value:.4}"),
    }
}

/// Nothing but zero is written as 0.
fn error(value: f64) -> String {
    if value == 0.0 { "0".into() } else { format!("{value:.4}") }
}

/// What all tables have in common.
pub fn preamble(results: &BenchmarkResults) -> Vec<String> {
    let mut lines = vec![format!(
        "{} ({}), {}x{} pixels, {} samples per pixel a frame, {} for pictures, {} rounds of at least {} s a time, seed {}",
        results.device,
        results.device_kind,
        results.width,
        results.height,
        results.spp,
        results.picture_spp,
        results.repetitions,
        results.min_sample_s,
        results.seed,
    )];
    if let Some(source) = &results.source {
        lines.push(format!(
            "columns of the paper: {source}; a ratio is the speed over the reference's of the same run, and compares \
             across machines better than times do"
        ));
    }
    lines
}

pub fn markdown(results: &BenchmarkResults) -> String {
    let mut text = format!("# {}\n\n", escape_markdown(&results.title));
    for line in preamble(results) {
        text.push_str(&format!("{}\n\n", escape_markdown(&line)));
    }
    for table in tables(results) {
        text.push_str(&format!("## {}\n\n", escape_markdown(&table.title)));
        for note in &table.notes {
            text.push_str(&format!("- {}\n", escape_markdown(note)));
        }
        text.push_str(&format!("\n| {} |\n", table.headings.join(" | ")));
        text.push_str(&format!("|{}\n", "---|".repeat(table.headings.len())));
        for row in &table.rows {
            let cells: Vec<String> = row.iter().map(|cell| escape_markdown(cell)).collect();
            text.push_str(&format!("| {} |\n", cells.join(" | ")));
        }
        text.push('\n');
    }
    text
}

/// Names come from files and people.
fn escape_markdown(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        if matches!(c, '|' | '<' | '>' | '`' | '*' | '\\') {
            escaped.push('\\');
        }
        escaped.push(if c.is_control() { ' ' } else { c });
    }
    escaped
}

/// Every figure, one line for each configuration.
pub fn csv(results: &BenchmarkResults) -> String {
    let mut text = CSV_HEADINGS.join(",");
    text.push('\n');
    for scene in &results.scenes {
        for comparison in &scene.comparisons {
            for row in &comparison.rows {
                let cells: Vec<String> = csv_cells(scene, comparison, row).iter().map(|cell| quote(cell)).collect();
                text.push_str(&cells.join(","));
                text.push('\n');
            }
        }
    }
    text
}

const CSV_HEADINGS: [&str; 46] = [
    "scene",
    "measured",
    "stand_in",
    "effect",
    "configuration",
    "reference",
    "unavailable",
    "init_s",
    "structure_bytes",
    "structure_nodes",
    "line_space_bytes",
    "line_spaces",
    "mrays_per_s",
    "mrays_per_s_lower_quartile",
    "mrays_per_s_upper_quartile",
    "frames_per_s",
    "frames_per_s_lower_quartile",
    "frames_per_s_upper_quartile",
    "ratio",
    "ratio_low",
    "ratio_high",
    "rmse",
    "flip",
    "differing_pixels",
    "primary_rays",
    "shadow_rays",
    "ao_rays",
    "indirect_rays",
    "box_tests_per_ray",
    "triangle_tests_per_ray",
    "look_ups_per_ray",
    "empty_per_ray",
    "opaque_per_ray",
    "mixed_per_ray",
    "starts_inside_per_ray",
    "approximated_per_ray",
    "samples",
    "paper_fps",
    "paper_mrays_per_s",
    "paper_ratio",
    "paper_size_mb",
    "paper_line_space_mb",
    "paper_line_spaces",
    "paper_nodes",
    "paper_init_s",
    "paper_rmse",
];

fn csv_cells(scene: &SceneResults, comparison: &Comparison, row: &Row) -> [String; CSV_HEADINGS.len()] {
    fn of<T>(part: Option<&T>, figure: impl Fn(&T) -> String) -> String {
        part.map(figure).unwrap_or_default()
    }
    fn number(value: Option<f64>) -> String {
        value.map(|value| value.to_string()).unwrap_or_default()
    }
    let (built, timed, picture) = (row.built.as_ref(), row.timed.as_ref(), row.picture.as_ref());
    let ratio = timed.and_then(|timed| timed.ratio);
    let paper = row.paper.unwrap_or_default();
    [
        scene.name.clone(),
        scene.measured.clone(),
        scene.stand_in.to_string(),
        comparison.title.clone(),
        row.configuration.clone(),
        comparison.reference.clone().unwrap_or_default(),
        row.unavailable.clone().unwrap_or_default(),
        of(built, |b| b.init_s.to_string()),
        of(built, |b| b.structure_bytes.to_string()),
        of(built, |b| b.structure_nodes.to_string()),
        of(built, |b| b.line_space_bytes.to_string()),
        of(built, |b| b.line_spaces.to_string()),
        of(timed, |t| t.mrays_per_s.median.to_string()),
        of(timed, |t| t.mrays_per_s.lower.to_string()),
        of(timed, |t| t.mrays_per_s.upper.to_string()),
        of(timed, |t| t.frames_per_s.median.to_string()),
        of(timed, |t| t.frames_per_s.lower.to_string()),
        of(timed, |t| t.frames_per_s.upper.to_string()),
        number(ratio.map(|r| r.value)),
        number(ratio.map(|r| r.low)),
        number(ratio.map(|r| r.high)),
        of(picture, |p| p.rmse.to_string()),
        of(picture, |p| p.flip.to_string()),
        of(picture, |p| p.differing_pixels.to_string()),
        of(timed, |t| t.rays.primary.to_string()),
        of(timed, |t| t.rays.shadow.to_string()),
        of(timed, |t| t.rays.ao.to_string()),
        of(timed, |t| t.rays.indirect.to_string()),
        of(timed, |t| t.per_ray.box_tests.to_string()),
        of(timed, |t| t.per_ray.triangle_tests.to_string()),
        of(timed, |t| t.per_ray.look_ups.to_string()),
        of(timed, |t| t.per_ray.empty.to_string()),
        of(timed, |t| t.per_ray.opaque.to_string()),
        of(timed, |t| t.per_ray.mixed.to_string()),
        of(timed, |t| t.per_ray.starts_inside.to_string()),
        of(timed, |t| t.per_ray.approximated.to_string()),
        of(timed, |t| t.samples.len().to_string()),
        number(paper.fps),
        number(paper.mrays_per_s),
        number(paper.ratio),
        number(paper.size_mb),
        number(paper.line_space_mb),
        number(paper.line_spaces),
        number(paper.nodes),
        number(paper.init_s),
        number(paper.rmse),
    ]
}

/// As RFC 4180. A cell that a spreadsheet would take for a formula gets an apostrophe.
fn quote(cell: &str) -> String {
    let is_number = cell.parse::<f64>().is_ok();
    let cell = if !is_number && cell.starts_with(['=', '+', '-', '@']) { format!("'{cell}") } else { cell.to_owned() };
    if cell.contains(['"', ',', '\n', '\r']) { format!("\"{}\"", cell.replace('"', "\"\"")) } else { cell }
}

#[cfg(test)]
mod tests {
    use lightshaft_api::benchmark::{Built, Interval, PaperFigures, PictureDifference, Quartiles, Timed};

    use super::*;

    fn row(name: &str) -> Row {
        Row {
            configuration: name.into(),
            acceleration: serde_json::json!({}),
            unavailable: None,
            built: None,
            timed: None,
            picture: None,
            paper: Some(PaperFigures { fps: Some(9.9), ratio: Some(1.218), ..PaperFigures::default() }),
            warnings: Vec::new(),
        }
    }

    fn results() -> BenchmarkResults {
        let quartiles = |median: f64| Quartiles { lower: 0.9 * median, median, upper: 1.1 * median };
        let measured = Row {
            built: Some(Built {
                init_s: 0.25,
                structure_bytes: 2_000_000,
                line_space_bytes: 500_000,
                ..Built::default()
            }),
            timed: Some(Timed {
                mrays_per_s: quartiles(20.0),
                frames_per_s: quartiles(123.4),
                ratio: Some(Interval { value: 1.25, low: 1.2, high: 1.3 }),
                rays: lightshaft_api::job::RayCounts { primary: 7, ..Default::default() },
                per_ray: Default::default(),
                samples: Vec::new(),
            }),
            picture: Some(PictureDifference {
                rmse: 0.0,
                flip: 0.01234,
                differing_pixels: 3,
                heat_map: "h".into(),
                picture: "p".into(),
            }),
            ..row("a, b")
        };
        let missing = Row { unavailable: Some("n: must be 2 | 16".into()), ..row("LS (9,3)") };
        BenchmarkResults {
            title: "T".into(),
            preset: None,
            source: Some("Keul 2020, table 4.1".into()),
            device: "AVX2, 2 threads".into(),
            device_kind: "cpu".into(),
            driver: String::new(),
            versions: Default::default(),
            width: 64,
            height: 32,
            spp: 1,
            picture_spp: 4,
            seed: 1,
            repetitions: 5,
            min_sample_s: 0.1,
            columns: vec![Column::SizeMb, Column::Fps, Column::Ratio, Column::Rmse, Column::Flip, Column::PaperRatio],
            scenes: vec![SceneResults {
                name: "BUNNY".into(),
                measured: "pile.glb".into(),
                stand_in: true,
                triangles: 12,
                spheres: 0,
                instances: 2,
                meshes: 1,
                comparisons: vec![Comparison {
                    effect: None,
                    title: "soft shadow".into(),
                    note: "one light".into(),
                    reference: Some("r".into()),
                    views: vec!["main".into()],
                    rows: vec![measured, missing],
                }],
            }],
            total_s: 1.0,
        }
    }

    #[test]
    fn a_table_says_what_was_measured_and_what_was_not() {
        let text = markdown(&results());
        let expected = "\
# T

AVX2, 2 threads (cpu), 64x32 pixels, 1 samples per pixel a frame, 4 for pictures, 5 rounds of at least 0.1 s a time, seed 1

columns of the paper: Keul 2020, table 4.1; a ratio is the speed over the reference's of the same run, and compares across \
machines better than times do

## BUNNY (stand-in): soft shadow

- pile.glb (stand-in): 12 triangles in 1 meshes, 2 instances
- one light
- views: main
- LS (9,3): not available: n: must be 2 \\| 16

| configuration | size MB | FPS | ratio [95 %] | RMSE | FLIP | paper: ratio |
|---|---|---|---|---|---|---|
| a, b | 2.50 | 123 | 1.25 [1.20, 1.30] | 0 | 0.0123 | 1.22 |
| LS (9,3) | not available | – | – | – | – | 1.22 |

";
        assert_eq!(text, expected);
    }

    #[test]
    fn csv_has_a_cell_for_every_heading_and_is_safe_in_a_spreadsheet() {
        let text = csv(&results());
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines.len(), 3);
        assert!(
            lines[1].starts_with("BUNNY,pile.glb,true,soft shadow,\"a, b\",r,,0.25,2000000,0,500000,0,20,18,22,123.4,")
        );
        let commas = lines[2].replace("\"LS (9,3)\"", "LS").matches(',').count();
        assert_eq!(commas + 1, CSV_HEADINGS.len(), "{}", lines[2]);
        assert_eq!(quote("=1+1"), "'=1+1");
        assert_eq!(quote("-0.5"), "-0.5");
        assert_eq!(quote("say \"x\""), "\"say \"\"x\"\"\"");
    }

    #[test]
    fn figures_keep_three_digits_and_only_zero_is_zero() {
        assert_eq!([0.0, 0.01234, 0.5, 12.34, 1234.5].map(figure), ["0.00", "0.0123", "0.50", "12.3", "1234"]);
        assert_eq!([0.0, 0.00001].map(error), ["0", "0.0000"]);
    }
}
