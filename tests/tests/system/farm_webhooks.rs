//! Webhooks of the regression farm: no crash of the service loses a message.

use std::net::{Ipv4Addr, SocketAddr};

use lightshaft_tests::Service;
use lightshaft_tests::glb::Gltf;
use lightshaft_tests::receiver::Receiver;
use reqwest::Method;
use serde_json::{Value, json};

const SUITE: &str = r#"
    name = "tiny"
    [scenes.triangle]
    file = "triangle.glb"
    [[case]]
    name = "plain"
    scene = "triangle"
    device = "cpu"
    time = "off"
    settings = { width = 16, height = 16, spp = 1, outputs = ["png"] }
"#;

fn anywhere() -> SocketAddr {
    (Ipv4Addr::LOCALHOST, 0).into()
}

#[tokio::test]
async fn a_message_survives_a_kill_and_is_delivered_when_somebody_listens() {
    let mut service = Service::start_with(&["--no-thumbnails", "--webhook-allow-private"]);
    let scene = service.scene(Gltf::triangle().glb()).await;
    let request = service.request(Method::POST, "/v1/farm/suites").header("content-type", "application/toml");
    let suite = service.send(request.body(SUITE)).await.json();
    // Nobody listens yet: the port is only kept free.
    let address = std::net::TcpListener::bind(anywhere()).and_then(|listener| listener.local_addr()).expect("a port");
    let webhook = json!({
        "url": format!("http://{address}/hook"), "secret": "correct horse battery staple", "events": ["run.finished"],
    });
    let made = service.post("/v1/farm/webhooks", &webhook).await;
    assert_eq!(made.status, 201, "{}", made.text());
    let webhook = format!("/v1/farm/webhooks/{}", made.json()["id"].as_str().expect("an id"));
    let run = json!({ "suite": suite["id"], "label": "one", "scenes": { "triangle": scene } });
    let run = service.post("/v1/farm/runs", &run).await.json();

    let failing = service
        .until("an attempt that fails", async || {
            let found = service.get(&webhook).await.json();
            found["error"].is_string().then_some(found)
        })
        .await;
    assert_eq!(failing["waiting"], 1, "{failing:#}");
    service.kill_and_restart();
    let receiver = Receiver::start(address);
    let told = service.until("the message", async || receiver.told().first().cloned()).await;
    let message: Value = serde_json::from_slice(&told.body).expect("JSON");
    assert_eq!((&message["type"], &message["data"]["id"]), (&json!("run.finished"), &run["id"]), "{message:#}");
    assert!(told.header("webhook-signature").starts_with("v1,") && !told.header("webhook-timestamp").is_empty());

    let deliveries = service
        .until("the delivery to be noted", async || {
            let found = service.get(&format!("{webhook}/deliveries")).await.json();
            (found["items"][0]["state"] == "delivered").then_some(found)
        })
        .await;
    let delivery = &deliveries["items"][0];
    assert_eq!(delivery["id"].as_str(), Some(told.header("webhook-id")));
    let attempts = delivery["attempts"].as_array().expect("attempts");
    assert!(attempts.len() >= 2 && attempts.last().is_some_and(|last| last["status"] == 204), "{deliveries:#}");
    assert_eq!(receiver.told().len(), 1, "and no more");
}
