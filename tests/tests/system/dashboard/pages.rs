//! Pages that lead from one to the next. That every page is whole and for everybody is tested in `tests/browser`.

use lightshaft_tests::Service;
use lightshaft_tests::browser::Browser;
use serde_json::json;

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
