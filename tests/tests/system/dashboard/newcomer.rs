//! The first five minutes: upload, submit, watch, see the picture.

use lightshaft_tests::Service;
use lightshaft_tests::browser::Browser;
use lightshaft_tests::service::generate;

use super::decoded;

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

    browser.click_on("main", "Render this").await;
    browser.until("the form", "return !!document.querySelector('#new-job')").await;
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
