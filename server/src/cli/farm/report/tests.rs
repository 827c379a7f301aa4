use std::collections::BTreeMap;

use lightshaft_api::farm::Run;
use serde_json::{Value, json};

use super::html::{Pictures, data_uri};
use super::{html, junit, markdown};
use crate::cli::farm::words::{self, Standing};

const PAGE: &str = "http://farm.example/farm/runs/r1";

fn case(name: &str, verdict: &str, ok: Value, with: Value) -> Value {
    let mut case = json!({
        "name": name, "state": "finished", "ok": ok, "scene": "s", "settings": {}, "repeat": 3,
        "tolerance": "identical", "time_tolerance": { "max_ratio": 1.1 }, "device_class": "cpu: AVX2", "worker": "w",
        "image": {
            "verdict": verdict, "reason": null, "pixels": "p", "source": "exr", "accepted": "q", "figures": null,
            "z_test": null, "unsteady": false,
        },
        "time": {
            "verdict": "same", "reason": "within 10 %", "metric": "render_s", "samples_s": [1.0, 1.1, 0.9],
            "spread": { "samples": 3, "lower_quartile_s": 0.95, "median_s": 1.0, "upper_quartile_s": 1.05 },
            "baseline": { "samples": 9, "lower_quartile_s": 0.9, "median_s": 0.95, "upper_quartile_s": 1.0 },
            "ratio": { "value": 1.05, "low": 0.98, "high": 1.1, "p": 0.4 }, "limit": 1.1, "noise_floor": 0.03,
            "confirmation": { "state": "not_needed", "reason": null, "a_s": [], "b_s": [], "ratio": null },
        },
        "decision": null, "versions": {}, "jobs": [],
        "artifacts": [{ "name": "image.png", "media_type": "image/png", "bytes": 1, "hash": "h", "href": "/x" }],
    });
    if let (Value::Object(case), Value::Object(with)) = (&mut case, with) {
        case.extend(with);
    }
    case
}

/// One case of every kind; the names try to be markup.
fn run() -> Run {
    let figures = json!({
        "rmse": 0.02, "rel_mse": 0.1, "mae": 0.01, "psnr": 30.0, "ssim": 0.9, "flip_mean": 0.1134, "flip_p99": 0.8,
        "max_difference": 0.5, "max_at": [3, 4], "differing_pixels": 1234, "pixels": 4096,
    });
    let changed = json!({ "image": {
        "verdict": "changed", "reason": "mean FLIP is 0.1134, and may be 0.01", "pixels": "p", "source": "exr",
        "accepted": "q", "figures": figures, "z_test": null, "unsteady": false,
    }});
    let mut slower = case("slow", "identical", json!(false), json!({}));
    slower["time"]["verdict"] = json!("slower");
    slower["time"]["ratio"] = json!({ "value": 1.31, "low": 1.25, "high": 1.38, "p": 0.0001 });
    slower["time"]["confirmation"]["state"] = json!("confirmed");
    let decision = |kind: &str| {
        json!({ "decision": {
            "id": "d", "kind": kind, "who": "Ada", "why": "as intended", "at": "2026-11-23T00:00:00Z", "baseline": "main",
            "suite": "generated", "case": "x", "device_class": "c", "run": "r1", "label": "l", "pixels": "p",
        }})
    };
    let open = json!({ "state": "rendering", "image": null, "time": null, "artifacts": [] });
    let run = json!({
        "id": "r1", "kind": "check", "suite": "s1", "suite_name": "generated", "label": "3f2a91c", "baseline": "main",
        "labels": { "driver": "560 & <script>" }, "state": "finished", "ok": false,
        "counts": {
            "cases": 7, "finished": 6, "ok": 2, "undecided": 3, "rejected": 1, "identical": 3, "within_tolerance": 0,
            "changed": 2, "missing": 0, "failed": 1, "faster": 0, "same": 4, "slower": 1, "too_noisy_to_say": 0,
        },
        "created_at": "2026-11-23T01:02:03Z", "finished_at": null, "scenes": {}, "overrides": {}, "priority": 0,
        "cases": [
            case("fine", "identical", json!(true), json!({})),
            case("</td><script>alert(1)</script>|`x`", "changed", json!(false), changed),
            slower,
            case("crashed", "failed", json!(false), json!({ "time": null, "artifacts": [] })),
            case("new look", "changed", json!(true), decision("approved")),
            case("ugly", "identical", json!(false), decision("rejected")),
            case("late", "identical", json!(null), open),
        ],
    });
    serde_json::from_value(run).unwrap()
}

#[test]
fn decisions_go_before_verdicts() {
    let standings: Vec<Standing> = run().cases.iter().map(Standing::of).collect();
    let expected = [
        Standing::Passed,
        Standing::Failed,
        Standing::Failed,
        Standing::Failed,
        Standing::Approved,
        Standing::Rejected,
        Standing::Open,
    ];
    assert_eq!(standings, expected);
    let run = run();
    assert_eq!(words::time(&run.cases[2]), "slower, 1.31 times (1.25 to 1.38), confirmed");
    assert_eq!(words::image(&run.cases[6]), "rendering");
    assert_eq!(words::decision(&run.cases[4]), "approved by Ada: as intended");
}

#[test]
fn junit_counts_what_its_readers_count() {
    let xml = junit::report(&run(), PAGE);
    assert!(xml.contains("tests=\"7\" failures=\"3\" errors=\"1\" skipped=\"1\""), "{xml}");
    assert_eq!(["<failure ", "<error ", "<skipped ", "<testcase "].map(|tag| xml.matches(tag).count()), [3, 1, 1, 7]);
    assert!(xml.contains("value=\"560 &amp; &lt;script&gt;\"") && !xml.contains("<script"), "{xml}");
    assert!(xml.contains("mean FLIP is 0.1134") && xml.contains("1234 of 4096 pixels differ"), "{xml}");
    // Every element that is opened is closed.
    let (opened, closed) = (xml.matches('<').count(), xml.matches("</").count());
    let empty = xml.matches("/>").count();
    assert_eq!(opened - 1, 2 * closed + empty, "{xml}");
}

#[test]
fn markdown_shows_what_needs_a_look_and_escapes_the_rest() {
    let text = markdown::report(&run(), PAGE);
    assert!(text.starts_with("## generated: 2 changed, 1 slower, 1 failed, 1 rejected\n"), "{text}");
    let (look, well) = text.split_once("<details>").unwrap();
    for name in ["slow", "crashed", "ugly", "late"] {
        assert!(look.contains(&format!("| {name} |")), "{name}: {look}");
    }
    assert!(well.contains("| fine |") && well.contains("| new look | approved |"), "{well}");
    assert!(!text.contains("<script") && text.contains("\\|\\`x\\`"), "{text}");
    for row in text.lines().filter(|line| line.starts_with('|')) {
        assert_eq!(row.replace("\\|", "").matches('|').count(), 6, "{row}");
    }
}

#[test]
fn the_page_has_everything_inside() {
    let mut png = Vec::new();
    let wide = image::RgbImage::from_fn(2000, 10, |x, _| image::Rgb([x as u8, 0, 0]));
    wide.write_to(&mut std::io::Cursor::new(&mut png), image::ImageFormat::Png).unwrap();
    let uri = data_uri(&png).unwrap();
    let small = data_uri_bytes(&uri);
    assert_eq!(image::load_from_memory(&small).unwrap().width(), 960);
    let pictures: Pictures = BTreeMap::from([(("fine".to_owned(), "image.png".to_owned()), uri.clone())]);
    let page = html::report(&run(), &pictures, PAGE).unwrap();
    assert!(page.contains(&uri));
    assert!(!page.contains("<script") && page.contains("&#60;script&#62;"), "names are no markup");
    for loads in [" src=\"http", " href=\"/", "url(", "@import"] {
        assert!(!page.contains(loads), "{loads}");
    }
    let first = page.find("slow</h2>").unwrap();
    assert!(first < page.find("fine</h2>").unwrap(), "what needs a look comes first");
    assert_eq!(page.matches("<details open>").count(), 5);
    assert!(
        page.contains("<circle cx=") && page.contains("median 1.00 s; the baseline&#39;s 950.0 ms"),
        "times are drawn"
    );
    assert!(data_uri(b"no picture").is_err());
}

fn data_uri_bytes(uri: &str) -> Vec<u8> {
    use base64::Engine;
    let text = uri.strip_prefix("data:image/png;base64,").unwrap();
    base64::engine::general_purpose::STANDARD.decode(text).unwrap()
}
