//! The form that submits a job: with the keyboard alone, with mistakes, with a map of the sky, and from an earlier job.

use lightshaft_tests::Service;
use lightshaft_tests::browser::{Browser, keys};
use lightshaft_tests::glb::Gltf;
use serde_json::{Value, json};

use super::{decoded, says};

/// Presses Tab until the element of this id, or else one that says this text, has the focus. Every stop on the way must
/// show that it has it.
async fn tab_to(browser: &Browser, wanted: &str) {
    let focus = "const e = document.activeElement, box = e.closest('.button.file, .segments label') ?? e;
        const shown = [box, ...box.children].some((s) => getComputedStyle(s).outlineStyle !== 'none');
        return [e.id, e.innerText?.trim() ?? '', shown, e.outerHTML.slice(0, 200)]";
    for _ in 0..60 {
        browser.press(&[keys::TAB]).await;
        let at = browser.script(focus).await;
        assert_eq!(at[2], true, "the focus cannot be seen on {}", at[3]);
        if at[0] == wanted || at[1] == wanted {
            return;
        }
    }
    panic!("the Tab key does not lead to {wanted:?}");
}

async fn overwrite(browser: &Browser, text: &str) {
    browser.press(&[keys::CONTROL, "a"]).await;
    browser.press(&[text]).await;
}

/// Puts a value into the field of a JSON pointer, as typing would.
async fn fill(browser: &Browser, pointer: &str, value: &str) {
    let script =
        "const control = document.querySelector(`.field:not([hidden])[data-pointer=\"${arguments[0]}\"] [data-value]`);
        const input = control.matches('fieldset') ? control.querySelector('input') : control;
        input.value = arguments[1]; input.dispatchEvent(new Event('input', {bubbles: true}))";
    browser.script_with(script, json!([pointer, value])).await;
}

/// What is said beside the field of a pointer.
fn error_at(pointer: &str, text: &str) -> String {
    says(&format!(".field[data-pointer=\"{pointer}\"]:not([hidden]) .field-error"), text)
}

async fn job_of_page(browser: &Browser, service: &Service) -> Value {
    let path = "const p = location.pathname; return /^\\/jobs\\/(?!new)/.test(p) && p.split('/').pop()";
    let id = browser.until("the job's page", path).await;
    service.job(id.as_str().unwrap()).await
}

#[tokio::test]
async fn a_job_is_submitted_and_watched_without_a_mouse() {
    let service = Service::start();
    service.generated(&["cornell-box"]).await;
    let browser = Browser::open().await;
    browser.go(service.url()).await;
    tab_to(&browser, "Skip to content").await;
    browser.press(&[keys::ENTER]).await;
    assert_eq!(browser.script("return document.activeElement.id").await, "main");
    tab_to(&browser, "New job").await;
    browser.press(&[keys::ENTER]).await;
    browser.until("the form", "return !!document.querySelector('#new-job')").await;
    for (field, value) in [("f-settings-width", "48"), ("f-settings-height", "36"), ("f-settings-spp", "2")] {
        tab_to(&browser, field).await;
        overwrite(&browser, value).await;
    }
    browser.until("that all is well", &says("#verdict", "Ready to submit.")).await;
    tab_to(&browser, "Submit").await;
    browser.press(&[keys::SPACE]).await;
    browser.until("the final picture", &decoded("#picture[src*=\"image.png\"]")).await;
    let settings = job_of_page(&browser, &service).await["settings"].clone();
    assert_eq!([&settings["width"], &settings["height"], &settings["spp"]], [48, 36, 2]);
    // The zoom of the picture, too: from "Fit" down to 4 times.
    browser.script("document.querySelector('[name=zoom]:checked').focus()").await;
    browser.press(&[keys::DOWN, keys::DOWN, keys::DOWN]).await;
    assert_eq!(browser.script("return document.querySelector('#picture').getBoundingClientRect().width").await, 192);
}

#[tokio::test]
async fn mistakes_are_said_beside_their_fields_while_one_types() {
    let service = Service::start_with(&["--workers", "0"]);
    service.scene(Gltf::triangle().glb()).await;
    let browser = Browser::open().await;
    browser.go(&format!("{}/jobs/new", service.url())).await;
    browser.until("that all is well", &says("#verdict", "Ready to submit.")).await;

    fill(&browser, "/settings/spp", "0").await;
    browser.until("the limits", &error_at("/settings/spp", "1")).await;
    fill(&browser, "/settings/width", "99999").await;
    browser.until("the limits", &error_at("/settings/width", "16384")).await;
    fill(&browser, "/labels", "suite nightly").await;
    browser.until("the form of a label", &error_at("/labels", "must be key=value")).await;
    fill(&browser, "/labels", "lightshaft.own=1").await;
    browser.until("whose such labels are", &error_at("/labels", "the service's own")).await;
    fill(&browser, "/settings/camera", "@perspective").await;
    fill(&browser, "/settings/camera/position", "").await;
    browser.until("what is missing", &error_at("/settings/camera/position", "must be three numbers")).await;
    let invalid = "return [...document.querySelectorAll('[aria-invalid=true]')].map((e) => e.id)";
    let expected = ["f-settings-width", "f-settings-spp", "f-settings-camera-position", "labels"];
    assert_eq!(browser.script(invalid).await, json!(expected));

    // Submitting leads to the first mistake, and makes nothing.
    browser.click("#new-job [type=submit]").await;
    browser.until("the first mistake", "return document.activeElement.id === 'f-settings-width'").await;
    assert_eq!(service.get("/v1/jobs?automatic=false").await.json()["items"], json!([]));

    for (pointer, value) in [
        ("/settings/width", "64"),
        ("/settings/spp", "1"),
        ("/settings/camera/position", "3"),
        ("/labels", "suite=nightly"),
    ] {
        fill(&browser, pointer, value).await;
    }
    browser.until("that all is well", &says("#verdict", "Ready to submit.")).await;
    assert_eq!(browser.script(invalid).await, json!([]));
    browser.click("#new-job [type=submit]").await;
    let job = job_of_page(&browser, &service).await;
    assert_eq!(job["labels"], json!({"suite": "nightly"}));
    assert_eq!(job["settings"]["camera"]["position"], json!([3.0, 1.0, 4.0]));
}

/// A sky of 4 x 2 pixels, brighter than 1, as Radiance RGBE without compression.
fn sky() -> Vec<u8> {
    let mut file = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n".to_vec();
    file.extend([128, 160, 200, 130].repeat(8));
    file
}

#[tokio::test]
async fn a_map_of_the_sky_is_uploaded_and_lights_the_scene() {
    let service = Service::start();
    let scene = service.scene(Gltf::triangle().glb()).await;
    let (map, notes) = (service.scratch("sky.hdr"), service.scratch("notes.txt"));
    std::fs::write(&map, sky()).unwrap();
    std::fs::write(&notes, "no map").unwrap();
    let browser = Browser::open().await;
    browser.go(&format!("{}/jobs/new?scene={scene}", service.url())).await;
    fill(&browser, "/settings/width", "32").await;
    fill(&browser, "/settings/height", "24").await;

    // Dropped on the form, a wrong file and then the right one.
    browser.drop_on("#new-job h2", &[&notes]).await;
    browser.until("what would be right", &says("#environment-status", "Choose an .hdr or .exr file.")).await;
    browser.drop_on("#new-job h2", &[&map]).await;
    browser.until("the upload", &says("#environment-status", "sky.hdr is uploaded.")).await;
    let hash = browser.script("return document.querySelector('#f-settings-environment-map').value").await;
    assert!(hash.as_str().is_some_and(|hash| hash.len() == 64), "{hash}");
    // Chosen with the button it is the same.
    browser.script("document.querySelector('#f-settings-environment-map').value = ''").await;
    browser.type_into("#environment-file", map.to_str().unwrap()).await;
    let same = format!("return document.querySelector('#f-settings-environment-map').value === {hash}");
    browser.until("the same hash", &same).await;

    browser.until("that all is well", &says("#verdict", "Ready to submit.")).await;
    browser.click("#new-job [type=submit]").await;
    let job = job_of_page(&browser, &service).await;
    assert_eq!(job["settings"]["environment"]["map"], hash);
    service.succeeded(job["id"].as_str().unwrap()).await;
    // While the map is on its way the check says that it is missing, which the browser notes as a failed request.
    let errors = browser.errors().await;
    assert!(errors.iter().all(|error| error.contains("validate_only")), "{errors:?}");
}

#[tokio::test]
async fn a_variation_without_a_change_is_the_same_job_again() {
    let service = Service::start_with(&["--workers", "0"]);
    let scene = service.generated(&["demo"]).await;
    let settings = json!({
        "integrator": "whitted", "width": 321, "height": 123, "spp": 5, "seed": 9, "max_bounces": 6, "device": "gpu",
        "adapter": "llvm", "camera": {"position": [1, 2, 3], "target": [0, 1, 0], "up": [0, 1, 0], "half_height": 2.5},
        "environment": [0.25, 0.5, 1], "ground": {"height": -1, "albedo": [0.5, 0.25, 0.125]},
        "lights": [{"kind": "spot", "position": [1, 2, 3], "direction": [0, -1, 0], "intensity": 50, "outer_cone_deg": 30}],
        "outputs": ["exr"], "aovs": ["depth", "albedo"], "tone_map": "agx", "exposure": -1.5,
        "acceleration": {"quality": "high", "spatial_splits": true}, "split": {"tiles": [3, 2]},
    });
    let order = json!({"scene": scene, "settings": settings, "priority": -3, "max_attempts": 2,
        "labels": {"suite": "nightly", "commit": "1db641f"}});
    let first = service.post("/v1/jobs", &order).await.json();
    let browser = Browser::open().await;
    browser.go(&format!("{}/jobs/{}", service.url(), first["id"].as_str().unwrap())).await;
    browser.click_on("#actions", "Submit a variation").await;
    browser
        .until("that all is well", "return document.querySelector('#verdict')?.innerText.startsWith('Ready to submit')")
        .await;
    browser.click("#new-job [type=submit]").await;
    let second = job_of_page(&browser, &service).await;
    assert_ne!(second["id"], first["id"]);
    for field in ["scene", "settings", "priority", "max_attempts", "labels"] {
        assert_eq!(second[field], first[field], "{field}");
    }
}
