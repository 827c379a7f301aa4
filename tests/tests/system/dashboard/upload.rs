//! Scenes by drag and drop, as files, as folders, and what is said of wrong ones.

use lightshaft_tests::Service;
use lightshaft_tests::browser::Browser;
use lightshaft_tests::glb::Gltf;
use lightshaft_tests::service::generate;
use serde_json::json;

use super::says;

async fn names(service: &Service) -> Vec<String> {
    let scenes = service.get("/v1/scenes").await.json();
    let mut names: Vec<String> =
        scenes["items"].as_array().unwrap().iter().map(|scene| scene["name"].as_str().unwrap().to_owned()).collect();
    names.sort();
    names
}

#[tokio::test]
async fn a_file_dropped_anywhere_on_the_page_becomes_a_scene() {
    let service = Service::start_with(&["--workers", "0"]);
    let browser = Browser::open().await;
    let file = service.scratch("cornell.glb");
    std::fs::write(&file, generate(&["cornell-box"])).unwrap();
    // The second time the same bytes are known, and a drop beside the frame counts, too.
    for target in ["#drop", "h1"] {
        browser.go(&format!("{}/scenes", service.url())).await;
        browser.drop_on(target, &[&file]).await;
        browser.until("the scene's own page", "return /^\\/scenes\\/.+/.test(location.pathname)").await;
        let title = browser.script("return document.querySelector('h1').innerText").await;
        assert_eq!(title, "cornell");
    }
    assert_eq!(names(&service).await, ["cornell"]);
    assert_eq!(browser.errors().await, Vec::<String>::new());
}

#[tokio::test]
async fn a_folder_with_a_gltf_and_its_files_becomes_one_scene() {
    let service = Service::start_with(&["--workers", "0"]);
    let browser = Browser::open().await;
    let folder = service.scratch("model");
    std::fs::create_dir_all(folder.join("parts")).unwrap();
    let gltf = Gltf::triangle().with("/buffers/0", json!({"byteLength": 42, "uri": "parts/geometry.bin"}));
    std::fs::write(folder.join("model.gltf"), gltf.document.to_string()).unwrap();
    std::fs::write(folder.join("parts/geometry.bin"), &gltf.buffer).unwrap();
    browser.go(&format!("{}/scenes", service.url())).await;
    browser.drop_on("#drop", &[&folder]).await;
    browser.until("the scene's own page", "return /^\\/scenes\\/.+/.test(location.pathname)").await;
    assert_eq!(names(&service).await, ["model"]);
}

#[tokio::test]
async fn several_scenes_dropped_together_are_uploaded_one_after_another() {
    let service = Service::start_with(&["--workers", "0"]);
    let browser = Browser::open().await;
    let files = ["cornell-box", "furnace-sphere"].map(|kind| {
        let file = service.scratch(&format!("{kind}.glb"));
        std::fs::write(&file, generate(&[kind])).unwrap();
        file
    });
    browser.go(&format!("{}/scenes", service.url())).await;
    browser.drop_on("#drop", &[&files[0], &files[1]]).await;
    browser.until("both cards", "return document.querySelectorAll('#scene-list .card').length === 2").await;
    assert_eq!(names(&service).await, ["cornell-box", "furnace-sphere"]);
}

#[tokio::test]
async fn a_wrong_file_is_explained_on_the_page() {
    let service = Service::start_with(&["--workers", "0"]);
    let browser = Browser::open().await;
    browser.go(&format!("{}/scenes", service.url())).await;

    let file = service.scratch("cycle.glb");
    let cycle = Gltf::triangle().with("/nodes/0", json!({"mesh": 0, "children": [0]}));
    std::fs::write(&file, cycle.glb()).unwrap();
    browser.drop_on("#drop", &[&file]).await;
    browser.until("the place of the error", &says("#upload-status", "nodes/0")).await;

    let notes = service.scratch("notes.txt");
    std::fs::write(&notes, "no scene").unwrap();
    browser.drop_on("#drop", &[&notes]).await;
    browser.until("what would be right", &says("#upload-status", "There is no scene among these files")).await;
    assert_eq!(names(&service).await, Vec::<String>::new());
}
