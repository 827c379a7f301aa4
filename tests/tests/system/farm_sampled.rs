//! Sampled pictures in the farm: other seeds are the same picture, another material or lamp is not.

use lightshaft_tests::glb::Gltf;
use lightshaft_tests::service::generate;
use serde_json::{Value, json};

use crate::farm::Farm;

/// Few and heavy-tailed samples: paths that find small lamps by chance.
const SUITE: &str = r#"
    name = "sampled"
    [scenes.demo]
    generate = "demo"
    [[case]]
    name = "path"
    scene = "demo"
    device = "cpu"
    repeat = 6
    settings = { width = 32, height = 24, spp = 8, outputs = ["exr"] }
    image = { z_test = { significance = 0.01 } }
    time = "off"
    [[case]]
    name = "finer"
    scene = "demo"
    device = "cpu"
    repeat = 8
    settings = { width = 64, height = 48, spp = 32, outputs = ["exr"] }
    image = { z_test = { significance = 0.01 } }
    time = "off"
"#;
const OTHER_SEEDS: usize = 20;

/// A run of which no repetition has a seed of another run's.
async fn begin(farm: &Farm, label: &str, number: usize, more: Value) -> String {
    let mut body = json!({ "cases": ["path"], "overrides": { "seed": 1000 * (number + 1) } });
    body.as_object_mut().expect("an object").extend(more.as_object().expect("an object").clone());
    farm.begin_at("/v1/farm/runs", label, &body).await
}

#[tokio::test]
async fn other_seeds_pass_and_another_material_or_lamp_does_not() {
    let farm = Farm::start(SUITE).await;
    let base = farm.run("base", json!({})).await;
    let path = format!("/v1/farm/runs/{}/approve", base["id"].as_str().expect("an id"));
    assert_eq!(farm.service.post(&path, &json!({ "who": "Ada", "why": "the first" })).await.status, 200);

    let mut runs = Vec::new();
    for i in 0..OTHER_SEEDS {
        runs.push(begin(&farm, &format!("seed {i}"), i, json!({})).await);
    }
    let mut alarms = Vec::new();
    for run in &runs {
        let run = farm.finished(run).await;
        let image = &run["cases"][0]["image"];
        assert_eq!(image["z_test"]["pixels"], 768, "{run:#}");
        alarms.extend((image["verdict"] != "within_tolerance").then(|| image.clone()));
    }
    // Renders are the same on every machine, so this is no matter of luck.
    assert!(alarms.is_empty(), "of {OTHER_SEEDS}: {alarms:#?}");

    let demo = Gltf::from_glb(&generate(&["demo"]));
    let material = |name: &str| {
        let materials = demo.document["materials"].as_array().expect("materials");
        materials.iter().position(|one| one["name"] == name).expect("the demo has it")
    };
    let roughness = format!("/materials/{}/pbrMetallicRoughness/roughnessFactor", material("chrome"));
    let strength =
        format!("/materials/{}/extensions/KHR_materials_emissive_strength/emissiveStrength", material("window"));
    // A sixth more light shows in means of many pixels, however few the samples; what mirrors see needs more of them.
    let changes = [("a brighter window", "path", strength, 14.0), ("brushed chrome", "finer", roughness, 0.6)];
    for (number, (what, case, pointer, value)) in changes.into_iter().enumerate() {
        let scene = farm.service.scene(demo.clone().with(&pointer, json!(value)).glb()).await;
        let more = json!({ "scenes": { "demo": scene }, "cases": [case] });
        let run = farm.finished(&begin(&farm, what, OTHER_SEEDS + number, more).await).await;
        let image = &run["cases"][0]["image"];
        assert_eq!((&run["ok"], &image["verdict"]), (&json!(false), &json!("changed")), "{what}: {run:#}");
        let reason = image["reason"].as_str().expect("a reason");
        assert!(reason.starts_with("more than noise explains differ"), "{what}: {reason}");
        println!("{what}: {reason}");
    }
}
