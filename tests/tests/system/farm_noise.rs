//! The regression farm and noise alone: nothing has changed, so nothing may be told.

use std::collections::BTreeMap;

use serde_json::json;

use crate::farm::Farm;

/// So small that what the machine does besides is most of what is measured, with tolerances as tight as the farm has them.
const SUITE: &str = r#"
    name = "noise"
    [scenes.demo]
    generate = "demo"
    [[case]]
    name = "path"
    scene = "demo"
    device = "cpu"
    repeat = 3
    settings = { width = 32, height = 24, spp = 4, outputs = ["png"] }
    time = { max_ratio = 1.1 }
"#;
const RUNS: usize = 50;
/// Runs at one time: their jobs take turns on the one worker.
const BATCH: usize = 10;

#[tokio::test]
async fn of_fifty_runs_of_what_is_unchanged_at_most_one_is_called_slower() {
    let farm = Farm::start(SUITE).await;
    let base = farm.run("base", json!({})).await;
    farm.approve(&base, "the first").await;
    let calibration = farm.begin_at("/v1/farm/calibrations", "base", &json!({ "times": 10 })).await;
    farm.finished(&calibration).await;

    let (mut verdicts, mut alarms, mut suspected) = (BTreeMap::new(), Vec::new(), 0);
    for batch in 0..RUNS / BATCH {
        let mut runs = Vec::new();
        for i in 0..BATCH {
            runs.push(farm.begin(&format!("unchanged {batch}.{i}"), &json!({})).await);
        }
        for run in &runs {
            let run = farm.finished(run).await;
            let case = &run["cases"][0];
            assert_eq!(case["image"]["verdict"], "identical", "{run:#}");
            let time = &case["time"];
            let verdict = time["verdict"].as_str().expect("a verdict").to_owned();
            suspected += usize::from(time["confirmation"]["state"] != "not_needed");
            if verdict == "slower" {
                alarms.push(time.clone());
            }
            *verdicts.entry(verdict).or_insert(0) += 1;
        }
    }
    println!("of {RUNS}: {verdicts:?}; {suspected} were suspected and rendered again");
    assert!(alarms.len() <= 1, "{verdicts:?}: {alarms:#?}");
}
