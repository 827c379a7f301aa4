//! The regression farm and a disturbed machine: what looks slower because something else slowed it down is rendered again in
//! turns, and not reported.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use lightshaft_tests::process;
use serde_json::{Value, json};

use crate::farm::Farm;

const SUITE: &str = r#"
    name = "disturbed"
    [scenes.demo]
    generate = "demo"
    [[case]]
    name = "path"
    scene = "demo"
    device = "cpu"
    repeat = 5
    settings = { width = 96, height = 72, spp = 8, outputs = ["png"] }
    time = { max_ratio = 1.5 }
"#;
/// One disturbed run is suspected nearly always; what else the machine does could hide it.
const MOST_TRIES: u32 = 5;

/// A worker process that has a fifth of its time, until this is dropped.
struct Disturbed {
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Disturbed {
    fn of(worker: u32) -> Self {
        let ends = Arc::new(AtomicBool::new(false));
        let is_over = Arc::clone(&ends);
        let thread = std::thread::spawn(move || {
            while !is_over.load(Ordering::Relaxed) {
                process::signal(worker, "STOP");
                std::thread::sleep(Duration::from_millis(40));
                process::signal(worker, "CONT");
                std::thread::sleep(Duration::from_millis(10));
            }
        });
        Self { ends, thread: Some(thread) }
    }
}

impl Drop for Disturbed {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// A run of what is unchanged, disturbed until it is suspected of being slower, or ends.
async fn disturbed_run(farm: &Farm, label: &str) -> Value {
    let disturbed = Disturbed::of(farm.service.worker_pid().await);
    let run = farm.begin(label, &json!({})).await;
    farm.service
        .until("a suspicion", async || {
            let run = farm.service.get(&format!("/v1/farm/runs/{run}")).await.json();
            (run["state"] == "finished" || run["cases"][0]["state"] == "confirming").then_some(())
        })
        .await;
    drop(disturbed);
    farm.finished(&run).await
}

#[tokio::test]
async fn a_suspicion_from_disturbed_times_is_refuted_in_turns() {
    let farm = Farm::start(SUITE).await;
    let base = farm.run("base", json!({})).await;
    farm.approve(&base, "the first").await;
    let mut tries = Vec::new();
    for i in 0..MOST_TRIES {
        let run = disturbed_run(&farm, &format!("disturbed {i}")).await;
        let time = run["cases"][0]["time"].clone();
        assert_ne!(time["verdict"], "slower", "nothing has changed: {time:#}");
        let state = &time["confirmation"]["state"];
        if state != "not_needed" {
            assert_eq!(state, "refuted", "{time:#}");
            assert!(time["ratio"]["value"].as_f64().is_some_and(|ratio| ratio > 1.5), "it looked slower: {time:#}");
            let turns = ["a_s", "b_s"].map(|side| time["confirmation"][side].as_array().map(Vec::len));
            assert_eq!(turns, [Some(7), Some(7)], "both sides were rendered again: {time:#}");
            println!("suspected at {}, refuted: {}", time["ratio"]["value"], time["reason"]);
            return;
        }
        tries.push(time);
    }
    panic!("none of {MOST_TRIES} disturbed runs was suspected: {tries:#?}");
}
