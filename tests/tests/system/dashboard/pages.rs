//! Every page: whole, usable by everybody, without an error, and from this host alone.

use lightshaft_tests::browser::Browser;
use lightshaft_tests::glb::Gltf;
use lightshaft_tests::{Service, audit};
use reqwest::Method;
use serde_json::json;

/// Pages of a service on which a little of everything has happened.
async fn pages(service: &Service) -> Vec<String> {
    let scene = service.generated(&["cornell-box"]).await;
    let small = json!({"width": 32, "height": 24, "spp": 1});
    let done = service.render(&scene, small.clone()).await;
    let layers = json!({"width": 32, "height": 24, "spp": 1, "outputs": ["exr"], "aovs": ["depth"]});
    let other = service.render(&scene, layers).await["id"].as_str().unwrap().to_owned();
    let mesh = done["metrics"]["cache"][0]["mesh"].as_str().unwrap();
    let waiting = service.submit(&scene, json!({"device": "gpu", "adapter": "of another world"})).await;
    let cancelled = service.submit(&scene, json!({"device": "gpu", "adapter": "of another world"})).await;
    service.send(service.request(Method::POST, &format!("/v1/jobs/{cancelled}/cancel"))).await;
    let done = done["id"].as_str().unwrap();
    let pages = ["/", "/jobs", "/jobs?state=failed&q=nothing", "/jobs/new", "/scenes", "/workers", "/docs"];
    let mut pages = pages.map(str::to_owned).to_vec();
    pages.push(format!("/jobs/new?from={done}"));
    pages.extend([done, &waiting, &cancelled].map(|job| format!("/jobs/{job}")));
    pages.extend(["/compare".to_owned(), format!("/compare?p={done}"), format!("/compare?p={done}&p={other}&px=9,9")]);
    pages.push(format!("/compare?p={other}&p={other}&mode=difference&layer=depth"));
    pages.extend([format!("/scenes/{scene}"), format!("/meshes/{mesh}")]);
    pages
}

/// Opens a page and says everything that is wrong with it.
async fn complaints(browser: &Browser, service: &Service, page: &str) -> Vec<String> {
    browser.go(&format!("{}{page}", service.url())).await;
    browser.until("a heading", "return document.querySelector('h1')?.innerText").await;
    let is_still = "const root = document.querySelector('[data-compare]'); return !root || 'ready' in root.dataset";
    browser.until("all of it", is_still).await;
    let mut found = audit::complaints(browser).await;
    found.extend(browser.errors().await);
    let strangers = browser.requests().await.into_iter().filter(|url| !is_own(url, service));
    found.extend(strangers.map(|url| format!("asks for {url}")));
    found.into_iter().map(|complaint| format!("{page}: {complaint}")).collect()
}

fn is_own(url: &str, service: &Service) -> bool {
    url.starts_with(service.url()) || url.starts_with("data:") || url.starts_with("blob:")
}

#[tokio::test]
async fn every_page_is_for_everybody_on_every_screen() {
    let service = Service::start();
    let browser = Browser::open().await;
    let pages = pages(&service).await;
    let mut found = Vec::new();
    for (width, scheme) in [(1280, "light"), (390, "dark")] {
        browser.look(width, scheme).await;
        for page in &pages {
            let complaints = complaints(&browser, &service, page).await;
            found.extend(complaints.into_iter().map(|complaint| format!("{scheme}, {width} px, {complaint}")));
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[tokio::test]
async fn an_empty_service_shows_how_to_begin() {
    let service = Service::start_with(&["--workers", "0"]);
    let browser = Browser::open().await;
    for page in ["/", "/jobs", "/jobs/new", "/scenes", "/workers", "/compare"] {
        let found = complaints(&browser, &service, page).await;
        assert!(found.is_empty(), "{}", found.join("\n"));
    }
    browser.go(service.url()).await;
    let text = browser.script("return document.body.innerText").await;
    let text = text.as_str().unwrap();
    assert!(text.contains(&format!("curl -F file=@scene.glb {}/v1/scenes", service.url())), "{text}");
    assert!(text.contains(&format!("lightshaft worker --server {}", service.url())), "{text}");
}

#[tokio::test]
async fn what_is_not_there_is_said_on_a_page() {
    let service = Service::start_with(&["--workers", "0"]);
    let browser = Browser::open().await;
    for (page, text) in [
        ("/nowhere", "Nothing lives at /nowhere."),
        ("/jobs/nope", "there is no job"),
        ("/scenes/nope", "there is no scene"),
        ("/meshes/nope", "there is no mesh"),
        ("/compare?p=nope", "there is no job"),
        ("/jobs/new?from=nope", "there is no job"),
        ("/jobs?state=dreaming", "must be queued, running, succeeded, failed or cancelled"),
    ] {
        let complaints = complaints(&browser, &service, page).await;
        // The one error of the console is that of the page itself.
        let others: Vec<&String> =
            complaints.iter().filter(|c| !c.contains("the server responded with a status of 4")).collect();
        assert!(others.is_empty(), "{others:?}");
        let shown = browser.script("return document.body.innerText").await;
        assert!(shown.as_str().unwrap().contains(text), "{page}: {shown}");
    }
    browser.click_on("main", "To the overview").await;
    browser.until("the overview", "return location.pathname === '/'").await;
}

#[tokio::test]
async fn the_page_of_a_mesh_names_its_structures_and_who_holds_them() {
    let service = Service::start();
    let scene = service.generated(&["cornell-box"]).await;
    let job = service.render(&scene, json!({"width": 32, "height": 24, "spp": 1})).await;
    let browser = Browser::open().await;
    browser.go(&format!("{}/jobs/{}", service.url(), job["id"].as_str().unwrap())).await;
    let mesh = browser.script("return document.querySelector('#metrics tbody a').innerText").await;
    browser.click("#metrics tbody a").await;
    browser.until("the mesh's page", "return location.pathname.startsWith('/meshes/')").await;
    let row = "return document.querySelector('tbody tr')?.innerText";
    let row = browser.until("a structure", row).await;
    let row = row.as_str().unwrap();
    assert!(row.contains("quality=medium") && row.contains("local-1"), "{row}");
    let title = browser.script("return document.querySelector('h1').innerText").await;
    assert_eq!(title, mesh);
}

#[tokio::test]
async fn a_long_table_of_jobs_paints_quickly_and_pages_through_all() {
    let service = Service::start_with(&["--workers", "0"]);
    let scene = service.scene(Gltf::triangle().glb()).await;
    for number in 0..120 {
        let label = json!({"number": number.to_string()});
        let reply = service.post("/v1/jobs", &json!({"scene": scene, "labels": label})).await;
        assert_eq!(reply.status, 201, "{reply:?}");
    }
    let browser = Browser::open().await;
    browser.go(&format!("{}/jobs", service.url())).await;
    let rows = "return document.querySelectorAll('tbody tr').length";
    assert_eq!(browser.script(rows).await, 50);
    let paint = "return performance.getEntriesByName('first-contentful-paint')[0]?.startTime";
    let paint_ms = browser.until("the first paint", paint).await.as_f64().unwrap();
    assert!(paint_ms < 2000.0, "an unoptimised build on a busy machine paints within 2 s, not {paint_ms} ms");
    for expected in [50, 20] {
        browser.click_on(".pages", "Older jobs").await;
        browser.until("the next page", &format!("return document.querySelectorAll('tbody tr').length === {expected} && location.search.includes('cursor')")).await;
    }
    let last = browser.script("return [...document.querySelectorAll('tbody tr')].at(-1).innerText").await;
    assert!(last.as_str().unwrap().contains("number=0"), "{last}");
}
