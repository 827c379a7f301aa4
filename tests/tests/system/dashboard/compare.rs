//! The page that compares pictures.

use lightshaft_tests::Service;
use lightshaft_tests::browser::{Browser, keys};
use serde_json::{Value, json};

use super::says;

/// Two finished jobs of one scene with other noise, both with layers.
async fn two_jobs(service: &Service) -> [String; 2] {
    let scene = service.generated(&["cornell-box"]).await;
    let render = async |seed: u32| {
        let settings = json!({"width": 64, "height": 48, "spp": 2, "seed": seed, "integrator": "path", "device": "cpu",
            "outputs": ["png", "exr"], "aovs": ["depth", "shading_normal", "primitive_id", "box_tests"]});
        service.render(&scene, settings).await["id"].as_str().unwrap().to_owned()
    };
    [render(1).await, render(2).await]
}

/// Opens the page for both and waits for pictures and figures.
async fn open(browser: &Browser, service: &Service, [a, b]: &[String; 2], rest: &str) {
    browser.go(&format!("{}/compare?p={a}&p={b}{rest}", service.url())).await;
    settled(browser).await;
}

async fn settled(browser: &Browser) {
    let is_settled = "const root = document.querySelector('[data-compare]');
        return 'ready' in root.dataset && root.querySelector('[data-busy]').hidden
            && root.querySelector('[data-figures]').innerText.includes('RMSE')";
    browser.until("pictures and figures", is_settled).await;
    // What was loaded is drawn with the next frame, and the address follows a little later.
    browser.script("return new Promise((done) => setTimeout(done, 300))").await;
}

/// Pressed where the pictures are.
async fn press(browser: &Browser, pressed: &[&str]) {
    browser.script("document.querySelector('.stage').focus()").await;
    browser.press(pressed).await;
    settled(browser).await;
}

async fn search(browser: &Browser) -> String {
    browser.script("return location.search").await.as_str().unwrap().to_owned()
}

/// Colours of the canvas at pixels of the picture, which lies 1:1 in the middle of the first pane of two.
async fn shown(browser: &Browser, places: &[[u32; 2]]) -> Vec<[i64; 3]> {
    let script = "const canvas = document.querySelector('.stage canvas');
        const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext('2d');
        copy.drawImage(canvas, 0, 0);
        const left = Math.floor(canvas.width / 2) - 1;
        return arguments[0].map(([x, y]) => [...copy.getImageData(
            Math.round(left / 2 - 32) + x, Math.round((canvas.height - 1) / 2 - 24) + y, 1, 1).data].slice(0, 3))";
    let colors = browser.script_with(script, json!([places])).await;
    serde_json::from_value(colors).unwrap()
}

#[tokio::test]
async fn jobs_are_chosen_from_the_list_and_compared() {
    let service = Service::start();
    let jobs = two_jobs(&service).await;
    let browser = Browser::open().await;
    browser.go(&format!("{}/jobs", service.url())).await;
    for job in &jobs {
        browser.click(&format!("[name=p][value='{job}']")).await;
    }
    browser.click_on("main", "Compare selected").await;
    browser.until("the page", "return location.pathname === '/compare'").await;
    settled(&browser).await;
    let figures = browser.script("return document.querySelector('[data-figures]').innerText").await;
    assert!(figures.as_str().unwrap().contains("of 3072"), "{figures}");

    browser.click("[data-remove]").await;
    browser.until("one picture left", &says("main", "One picture is chosen")).await;
    browser.type_into("#add-picture input:not([type])", &format!("{}/image.png", jobs[0])).await;
    browser.click_on("#add-picture", "Add").await;
    settled(&browser).await;
    assert!(search(&browser).await.contains("image.png"));
    assert_eq!(browser.errors().await, Vec::<String>::new());
}

#[tokio::test]
async fn a_picture_is_shown_as_the_engine_maps_its_tones() {
    let service = Service::start();
    let jobs = two_jobs(&service).await;
    let browser = Browser::open().await;
    open(&browser, &service, &jobs, "&z=1&c=32,24").await;
    assert_eq!(
        browser.script("return document.querySelector('[data-fallback]').hidden").await,
        true,
        "WebGL2 is there"
    );
    let png = service.get(&format!("/v1/jobs/{}/artifacts/image.png", jobs[0])).await;
    let png = image::load_from_memory(&png.body).unwrap().into_rgb8();
    let places: Vec<[u32; 2]> = (4..44).step_by(5).flat_map(|y| (4..60).step_by(7).map(move |x| [x, y])).collect();
    let mut is_lit = 0;
    for (place, color) in places.iter().zip(shown(&browser, &places).await) {
        let expected = png.get_pixel(place[0], place[1]).0;
        is_lit += u32::from(expected[0] > 60);
        // Half floats have 11 bits.
        let apart = (0..3).map(|i| (color[i] - i64::from(expected[i])).abs()).max().unwrap();
        assert!(apart <= 1, "{place:?}: {color:?} but the engine wrote {expected:?}");
    }
    assert!(is_lit > 10, "the picture is not black");
}

#[tokio::test]
async fn every_view_is_a_link_and_works_from_the_keyboard() {
    let service = Service::start();
    let jobs = two_jobs(&service).await;
    let browser = Browser::open().await;
    open(&browser, &service, &jobs, "").await;
    press(&browser, &["w"]).await;
    press(&browser, &["+"]).await;
    press(&browser, &["e"]).await;
    press(&browser, &["t"]).await;
    press(&browser, &["]"]).await;
    press(&browser, &[keys::SHIFT, keys::DOWN]).await;
    let view = search(&browser).await;
    for part in ["mode=swipe", "z=", "ev=0.5", "tm=agx", "layer=box_tests", "px=32,25"] {
        assert!(view.contains(part), "no {part} in {view}");
    }
    browser.until("values of the held pixel", &says(".values", "primitive_id")).await;

    // The same link shows the same.
    let fields =
        "return ['layer', 'tm', 'ev'].map((name) => document.querySelector('#compare-bar').elements[name].value)
        .concat(document.querySelector('[data-place]').innerText)";
    let before = browser.script(fields).await;
    browser.go(&format!("{}/compare{view}", service.url())).await;
    settled(&browser).await;
    browser.until("values of the held pixel", &says(".values", "primitive_id")).await;
    assert_eq!(browser.script(fields).await, before);
    assert_eq!(search(&browser).await, view);

    press(&browser, &["["]).await;
    press(&browser, &[keys::SPACE]).await;
    browser.until("which is shown", &says("#announcer", "Picture B")).await;
    press(&browser, &["?"]).await;
    browser.until("the shortcuts", "return document.querySelector('#shortcuts').open").await;
    assert_eq!(browser.errors().await, Vec::<String>::new());
}

#[tokio::test]
async fn differences_and_heat_maps_are_drawn_with_a_scale() {
    let service = Service::start();
    let jobs = two_jobs(&service).await;
    let browser = Browser::open().await;
    open(&browser, &service, &jobs, "&mode=heat").await;
    browser.until("its scale", &says(".scale-bar", "FLIP error")).await;
    let colors = "const canvas = document.querySelector('.stage canvas');
        const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext('2d');
        copy.drawImage(canvas, 0, 0);
        const data = copy.getImageData(0, 0, canvas.width, canvas.height).data;
        const found = new Set();
        for (let i = 0; i < data.length; i += 4 * 97) found.add(data[i] * 65536 + data[i + 1] * 256 + data[i + 2]);
        return found.size";
    let count = async || browser.script(colors).await.as_u64().unwrap();
    assert!(count().await > 20, "the map of noise has many colours");
    // Depth does not depend on the seed but for where in a pixel it is sampled; ids are the same in most places.
    open(&browser, &service, &jobs, "&mode=difference&layer=primitive_id").await;
    let ids = count().await;
    assert!((1..=8).contains(&ids), "ids differ or not: {ids} colours");
    open(&browser, &service, &jobs, "&layer=depth").await;
    browser.until("its scale", &says(".scale-bar", "depth")).await;
    assert_eq!(browser.errors().await, Vec::<String>::new());
}

#[tokio::test]
async fn pictures_are_moved_zoomed_and_marked_by_the_mouse() {
    let service = Service::start();
    let jobs = two_jobs(&service).await;
    let browser = Browser::open().await;
    open(&browser, &service, &jobs, "&mode=flicker").await;
    let event = async |kind: &str, x: f64, y: f64, more: Value| {
        let mut parameters = json!({"type": kind, "x": x, "y": y, "button": "left", "clickCount": 1});
        parameters.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        browser.devtools("Input.dispatchMouseEvent", parameters).await;
    };
    let middle = "const r = document.querySelector('.stage').getBoundingClientRect();
        return [r.x + r.width / 2, r.y + r.height / 2]";
    let middle: [f64; 2] = serde_json::from_value(browser.script(middle).await).unwrap();
    let [x, y] = middle;
    event("mouseWheel", x, y, json!({"deltaX": 0, "deltaY": -240, "button": "none"})).await;
    settled(&browser).await;
    assert!(search(&browser).await.contains("z="), "{}", search(&browser).await);
    let drag = async |shift: bool| {
        let modifiers = if shift { 8 } else { 0 };
        event("mousePressed", x, y, json!({"modifiers": modifiers})).await;
        event("mouseMoved", x + 40.0, y + 30.0, json!({"modifiers": modifiers, "buttons": 1})).await;
        event("mouseMoved", x + 120.0, y + 80.0, json!({"modifiers": modifiers, "buttons": 1})).await;
        event("mouseReleased", x + 120.0, y + 80.0, json!({"modifiers": modifiers})).await;
        settled(&browser).await;
    };
    let center = |search: &str| -> f64 {
        let text = search.split("c=").nth(1).unwrap_or_else(|| panic!("no centre in {search}"));
        text.split(',').next().unwrap().parse().unwrap()
    };
    let before = center(&search(&browser).await);
    drag(false).await;
    assert!(center(&search(&browser).await) < before - 1.0, "what was grabbed went to the right");
    drag(true).await;
    let marked = search(&browser).await;
    assert!(marked.contains("crop="), "{marked}");
    browser.until("the part", &says("[data-crop]", "pixels at")).await;
    assert_eq!(browser.errors().await, Vec::<String>::new());
}

#[tokio::test]
async fn without_webgl_the_png_files_are_shown() {
    let service = Service::start();
    let jobs = two_jobs(&service).await;
    let browser = Browser::open().await;
    open(&browser, &service, &jobs, "&plain=1&z=1&c=32,24").await;
    browser.until("why", &says("[data-fallback]", "need WebGL2")).await;
    let png = service.get(&format!("/v1/jobs/{}/artifacts/image.png", jobs[0])).await;
    let png = image::load_from_memory(&png.body).unwrap().into_rgb8();
    let color = shown(&browser, &[[30, 40]]).await[0];
    let expected = png.get_pixel(30, 40).0.map(i64::from);
    assert_eq!(color, expected);
    press(&browser, &["h"]).await;
    browser.until("its scale", &says(".scale-bar", "FLIP error")).await;
    assert_eq!(browser.errors().await, Vec::<String>::new());
}
