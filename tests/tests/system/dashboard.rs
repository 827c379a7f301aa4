//! The dashboard in a real browser: upload, submit, watch, see the picture, on every page without an error.

use lightshaft_tests::Service;
use lightshaft_tests::browser::Browser;
use lightshaft_tests::glb::Gltf;
use lightshaft_tests::service::generate;
use serde_json::json;

/// True once the first picture in `selector` has been decoded and has pixels.
fn decoded(selector: &str) -> String {
    format!("const i = document.querySelector('{selector}'); return !!i && i.complete && i.naturalWidth > 0")
}

#[tokio::test]
async fn a_newcomer_uploads_a_file_submits_the_form_and_sees_the_picture() {
    let service = Service::start();
    let browser = Browser::open().await;
    let file = service.scratch("cornell.glb");
    std::fs::write(&file, generate(&["cornell-box"])).unwrap();

    browser.go(&format!("{}/scenes", service.url())).await;
    browser.type_into("#files", file.to_str().unwrap()).await;
    browser.until("the scene's own page", "return /^\\/scenes\\/.+/.test(location.pathname)").await;
    browser.until("its thumbnail", &decoded("main img")).await;

    let scene = browser.script("return location.pathname.split('/').pop()").await;
    browser.go(&format!("{}/jobs/new?scene={}", service.url(), scene.as_str().unwrap())).await;
    let fill = "for (const [name, value] of Object.entries({width: 64, height: 48, spp: 2})) {
        const input = document.querySelector(`[data-pointer=\"/settings/${name}\"] input`);
        input.value = value; input.dispatchEvent(new Event('input', {bubbles: true}));
        input.dispatchEvent(new Event('change', {bubbles: true})); } return true";
    browser.script(fill).await;
    browser.click("#new-job button[type=submit]").await;
    browser.until("the job's page", "return /^\\/jobs\\/(?!new)/.test(location.pathname)").await;
    browser.until("the final picture", &decoded("#picture[src*=\"image.png\"]")).await;
    let width = browser.script("return document.querySelector('#picture').naturalWidth").await;
    assert_eq!(width, 64, "the form's settings were used");
    let text = browser.until("what was measured", "return document.querySelector('#metrics').innerText").await;
    assert!(text.as_str().unwrap().contains("MRays/s"), "{text}");
    assert_eq!(browser.errors().await, Vec::<String>::new());
}

#[tokio::test]
async fn a_wrong_file_is_explained_on_the_page() {
    let service = Service::start_with(&["--workers", "0"]);
    let browser = Browser::open().await;
    let file = service.scratch("cycle.glb");
    let cycle = Gltf::triangle().with("/nodes/0", json!({"mesh": 0, "children": [0]}));
    std::fs::write(&file, cycle.glb()).unwrap();
    browser.go(&format!("{}/scenes", service.url())).await;
    browser.type_into("#files", file.to_str().unwrap()).await;
    let says = "const s = document.querySelector('#upload-status').innerText; return s.includes('nodes/0') && s";
    browser.until("the place of the error", says).await;
}

#[tokio::test]
async fn every_page_opens_without_errors() {
    let service = Service::start();
    let scene = service.generated(&["cornell-box"]).await;
    let job = service.render(&scene, json!({"width": 32, "height": 24, "spp": 1})).await;
    let id = job["id"].as_str().unwrap();
    let mesh = job["metrics"]["cache"][0]["mesh"].as_str().unwrap();
    let browser = Browser::open().await;
    let pages = ["/", "/jobs", "/jobs/new", "/scenes", "/workers", "/docs"].map(str::to_owned);
    let pages = [&pages[..], &[format!("/jobs/{id}"), format!("/scenes/{scene}"), format!("/meshes/{mesh}")]].concat();
    for page in pages {
        browser.go(&format!("{}{page}", service.url())).await;
        let title = browser.until("a heading", "return document.querySelector('h1')?.innerText").await;
        assert!(!title.as_str().unwrap().is_empty(), "{page}");
        let facts = "return [document.documentElement.lang, document.querySelectorAll('main').length,
            [...document.images].filter(i => !i.hasAttribute('alt')).length,
            [...document.querySelectorAll('input:not([type=hidden]),select,textarea')].filter(i => !i.labels?.length && !i.ariaLabel).length,
            document.documentElement.scrollWidth <= innerWidth]";
        let facts = browser.script(facts).await;
        assert_eq!(
            facts,
            json!(["en", 1, 0, 0, true]),
            "language, main, pictures without alt, fields without label, no sideways scroll: {page}"
        );
        assert_eq!(browser.errors().await, Vec::<String>::new(), "{page}");
    }
    browser.go(&format!("{}/jobs/nope", service.url())).await;
    let text = browser.script("return document.body.innerText").await;
    assert!(text.as_str().unwrap().contains("there is no job"), "{text}");
}
