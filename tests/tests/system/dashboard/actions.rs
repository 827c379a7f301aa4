//! The buttons: what they do to jobs, workers and scenes, and what the page says afterwards.

use lightshaft_tests::Service;
use lightshaft_tests::browser::Browser;
use lightshaft_tests::glb::Gltf;
use reqwest::Method;
use serde_json::json;

use super::{decoded, says};

#[tokio::test]
async fn a_waiting_job_is_paused_resumed_moved_up_cancelled_and_retried() {
    let service = Service::start_with(&["--workers", "0"]);
    let scene = service.scene(Gltf::triangle().glb()).await;
    let id = service.submit(&scene, json!({})).await;
    let browser = Browser::open().await;
    browser.go(&format!("{}/jobs/{id}", service.url())).await;
    browser.until("why it waits", &says("#waiting", "There is no worker.")).await;

    browser.click_on("#actions", "Pause").await;
    browser.until("the pause", &says("#state", "paused")).await;
    browser.until("why it waits", &says("#waiting", "The job is paused.")).await;
    browser.click_on("#actions", "Resume").await;
    browser
        .until("the end of the pause", "return !document.querySelector('#state').innerText.includes('paused')")
        .await;

    browser.script("document.querySelector('#priority').value = ''").await;
    browser.type_into("#priority", "7").await;
    browser.click_on("#progress", "Change").await;
    browser.until("the change", &says("#announcer", "The priority is changed.")).await;
    assert_eq!(service.job(&id).await["priority"], 7);
    // A number out of range does not leave the page.
    browser.script("document.querySelector('#priority').value = ''").await;
    browser.type_into("#priority", "700").await;
    browser.click_on("#progress", "Change").await;
    assert_eq!(browser.script("return document.querySelector('#priority').matches(':invalid')").await, true);
    assert_eq!(service.job(&id).await["priority"], 7);

    browser.click_on("#actions", "Cancel").await;
    browser.until("the end", &says("#state", "cancelled")).await;
    browser.until("it is said aloud", &says("#announcer", "cancelled")).await;
    browser.click_on("#actions", "Retry").await;
    browser.until("a new beginning", &says("#state", "queued")).await;
    assert_eq!(service.job(&id).await["state"], "queued");
    assert_eq!(browser.errors().await, Vec::<String>::new());
}

#[tokio::test]
async fn a_running_job_shows_its_picture_and_a_cancelled_one_keeps_its_log() {
    let service = Service::start();
    let scene = service.generated(&["cornell-box"]).await;
    let endless = json!({"width": 160, "height": 120, "spp": 1 << 20, "time_limit_s": 100, "device": "cpu"});
    let id = service.submit(&scene, endless).await;
    let browser = Browser::open().await;
    browser.go(&format!("{}/jobs/{id}", service.url())).await;
    browser.until("a picture so far", &decoded("#picture[src*=\"preview.png\"]")).await;
    let first = browser.script("return document.querySelector('#picture').src").await;
    let moves = format!("return document.querySelector('#picture').src !== {first}");
    browser.until("the next picture", &moves).await;
    browser.until("lines of the log", &says("#log", "scene:")).await;

    browser.click_on("#actions", "Cancel").await;
    browser.until("the end", &says("#state", "cancelled")).await;
    browser.until("the log, still there", &says("#log", "scene:")).await;
    browser.go(&format!("{}/jobs/{id}", service.url())).await;
    browser.until("the log of the cancelled job", &says("#log", "scene:")).await;
    browser.until("the attempt", &says("#tasks", "cancelled")).await;
    // A preview ends with its job, so that one which was just asked for may be gone.
    let errors = browser.errors().await;
    assert!(errors.iter().all(|error| error.contains("preview.png")), "{errors:?}");
}

#[tokio::test]
async fn a_worker_is_drained_called_back_and_forgotten() {
    let service = Service::start();
    let lost = json!({"name": "lost", "version": "0.1.0", "devices": [{"kind": "cpu", "name": "one thread"}]});
    let lost = service.post("/v1/workers", &lost).await.json()["id"].as_str().expect("an id").to_owned();
    let browser = Browser::open().await;
    browser.go(&format!("{}/workers", service.url())).await;
    browser.until("the worker of the service", &says("#present", "local-1")).await;

    browser.click_on("#present", "Drain local-1").await;
    assert!(browser.accept().await.contains("takes no more"), "the question");
    browser.until("the state", &says("#present", "draining")).await;
    let drained = async || service.get("/v1/workers").await.json()["items"].to_string().contains("\"draining\":true");
    assert!(drained().await);
    browser.click_on("#present", "Take tasks again on local-1").await;
    browser.until("the state", "return !document.querySelector('#present').innerText.includes('draining')").await;
    assert!(!drained().await);

    // A worker that has left is gone, and may be forgotten; one that fell silent is after a minute and a half.
    service.send(service.request(Method::POST, &format!("/v1/workers/{lost}/part"))).await;
    browser.until("what is gone", &says("#present summary", "1 gone")).await;
    browser.click("#present summary").await;
    browser.click_on("#present details", "Forget lost").await;
    browser.until("nothing of it", "return !document.querySelector('#present details')").await;
    assert!(!service.get("/v1/workers").await.text().contains("lost"));
    assert_eq!(browser.errors().await, Vec::<String>::new());
}

#[tokio::test]
async fn a_scene_is_deleted_after_a_question_and_a_refusal_is_explained() {
    let service = Service::start_with(&["--workers", "0"]);
    let scene = service.scene(Gltf::triangle().glb()).await;
    let job = service.submit(&scene, json!({})).await;
    let browser = Browser::open().await;
    let delete = async || {
        browser.go(&format!("{}/scenes/{scene}", service.url())).await;
        browser.click_on("main", "Delete").await;
        assert!(browser.accept().await.starts_with("Delete the scene"));
    };
    delete().await;
    browser.until("why not", "return document.querySelector('#alerts').innerText.length > 10").await;
    assert_eq!(service.get(&format!("/v1/scenes/{scene}")).await.status, 200, "a job still needs it");

    service.send(service.request(Method::POST, &format!("/v1/jobs/{job}/cancel"))).await;
    delete().await;
    browser.until("the list", "return location.pathname === '/scenes'").await;
    browser.until("that it is empty", &says("#scene-list", "No scenes yet.")).await;
    service.get(&format!("/v1/scenes/{scene}")).await.problem(404);
}
