//! A real browser: headless Chromium, driven by chromedriver over plain WebDriver (W3C) HTTP.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::process;

/// Keys that have no character, as WebDriver writes them (section 17.4.2 of its specification).
pub mod keys {
    pub const TAB: &str = "\u{e004}";
    pub const ENTER: &str = "\u{e007}";
    pub const SPACE: &str = "\u{e00d}";
    pub const DOWN: &str = "\u{e015}";
    pub const SHIFT: &str = "\u{e008}";
    pub const CONTROL: &str = "\u{e009}";
}

pub struct Browser {
    driver: Child,
    session: String,
    http: reqwest::Client,
}

impl Browser {
    /// Starts chromedriver on a free port and opens a window.
    ///
    /// # Panics
    /// When chromedriver or Chromium is missing (`make test` installs both).
    pub async fn open() -> Self {
        let mut driver = Command::new("chromedriver")
            .arg("--port=0")
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("chromedriver (Debian package chromium-driver) is installed");
        let lines = BufReader::new(driver.stdout.take().expect("its output is piped")).lines();
        let port: u16 = lines
            .map_while(Result::ok)
            .find_map(|line| line.rsplit_once("started successfully on port ")?.1.trim_end_matches('.').parse().ok())
            .expect("chromedriver says its port");
        // From here on a panic ends the driver too.
        let mut browser = Self { driver, session: String::new(), http: reqwest::Client::new() };
        // Without a GPU, WebGL is drawn in software; pages of our own are to be trusted with that.
        let chrome = json!({"args": ["--headless=new", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader",
            "--disable-dev-shm-usage", "--window-size=1280,1600"]});
        let wanted = json!({"capabilities": {"alwaysMatch": {"browserName": "chrome", "goog:chromeOptions": chrome,
            "goog:loggingPrefs": {"browser": "ALL"}}}});
        let base = format!("http://127.0.0.1:{port}/session");
        let request = browser.http.post(&base).json(&wanted);
        let reply: Value = request.send().await.expect("chromedriver answers").json().await.expect("JSON");
        let id = reply["value"]["sessionId"].as_str().unwrap_or_else(|| panic!("a session: {reply}"));
        browser.session = format!("{base}/{id}");
        browser
    }

    pub async fn go(&self, url: &str) {
        self.post("url", json!({"url": url})).await;
    }

    /// Evaluates JavaScript (`return ...`) in the page. A promise is awaited.
    pub async fn script(&self, script: &str) -> Value {
        self.script_with(script, json!([])).await
    }

    /// As [`Browser::script`], with `arguments`.
    pub async fn script_with(&self, script: &str, arguments: Value) -> Value {
        self.post("execute/sync", json!({"script": script, "args": arguments})).await
    }

    /// Repeats a script until it returns something but null and false.
    ///
    /// # Panics
    /// With the page's text when a minute passes without.
    pub async fn until(&self, what: &str, script: &str) -> Value {
        let start = Instant::now();
        loop {
            let value = self.script(script).await;
            if !matches!(value, Value::Null | Value::Bool(false)) {
                return value;
            }
            if start.elapsed() > Duration::from_secs(60) {
                let text = self.script("return document.body.innerText").await;
                panic!("the page does not show {what}:\n{}", text.as_str().unwrap_or_default());
            }
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    }

    /// Types into the first element of a CSS selector; into a file field, a path.
    pub async fn type_into(&self, selector: &str, text: &str) {
        let element = self.element(selector).await;
        self.post(&format!("element/{element}/value"), json!({"text": text})).await;
    }

    /// Clicks on the first element of a CSS selector.
    pub async fn click(&self, selector: &str) {
        let element = self.element(selector).await;
        self.post(&format!("element/{element}/click"), json!({})).await;
    }

    /// Clicks on the first button or link within `selector` that says `text`, and nothing else.
    ///
    /// # Panics
    /// When there is none.
    pub async fn click_on(&self, selector: &str, text: &str) {
        let find =
            "return [...document.querySelectorAll(arguments[0])].flatMap((e) => [...e.querySelectorAll('a,button')])
            .find((e) => e.innerText.trim().replace(/\\s+/g, ' ') === arguments[1]) ?? null";
        let found = self.script_with(find, json!([selector, text])).await;
        let element = id_of(&found).unwrap_or_else(|| panic!("{text:?} within {selector}: {found}"));
        self.post(&format!("element/{element}/click"), json!({})).await;
    }

    /// Presses and releases keys one after another, wherever the focus is. A modifier of [`keys`] is held for the rest.
    pub async fn press(&self, pressed: &[&str]) {
        let (held, struck): (Vec<&str>, Vec<&str>) =
            pressed.iter().partition(|&&key| key == keys::SHIFT || key == keys::CONTROL);
        let action = |kind: &str, key: &str| json!({"type": kind, "value": key});
        let mut actions: Vec<Value> = held.iter().map(|key| action("keyDown", key)).collect();
        for text in struck {
            for character in text.chars() {
                let key = character.to_string();
                actions.extend([action("keyDown", &key), action("keyUp", &key)]);
            }
        }
        actions.extend(held.iter().rev().map(|key| action("keyUp", key)));
        self.post("actions", json!({"actions": [{"type": "key", "id": "keyboard", "actions": actions}]})).await;
    }

    /// A command of the browser's own protocol (Chrome DevTools), for what WebDriver has no words for.
    pub async fn devtools(&self, command: &str, parameters: Value) -> Value {
        self.post("goog/cdp/execute", json!({"cmd": command, "params": parameters})).await
    }

    /// Drags files or folders of this machine over the first element of a selector and lets them go there.
    pub async fn drop_on(&self, selector: &str, paths: &[&Path]) {
        let middle = "const r = document.querySelector(arguments[0]).getBoundingClientRect();
            return [r.x + r.width / 2, r.y + r.height / 2]";
        let middle = self.script_with(middle, json!([selector])).await;
        let data = json!({"items": [], "files": paths, "dragOperationsMask": 1});
        for kind in ["dragEnter", "dragOver", "drop"] {
            let event = json!({"type": kind, "x": middle[0], "y": middle[1], "data": data});
            self.devtools("Input.dispatchDragEvent", event).await;
        }
    }

    /// What an open question of the page (`confirm`) says; it is answered with yes.
    pub async fn accept(&self) -> String {
        let text = self.get("alert/text").await;
        self.post("alert/accept", json!({})).await;
        text.as_str().unwrap_or_default().to_owned()
    }

    /// Messages of the console at level SEVERE since the last call: script errors and loads that failed.
    pub async fn errors(&self) -> Vec<String> {
        let entries = self.post("se/log", json!({"type": "browser"})).await;
        let severe = entries.as_array().into_iter().flatten().filter(|entry| entry["level"] == "SEVERE");
        severe.map(|entry| entry["message"].as_str().unwrap_or_default().to_owned()).collect()
    }

    async fn element(&self, selector: &str) -> String {
        let found = self.post("element", json!({"using": "css selector", "value": selector})).await;
        id_of(&found).unwrap_or_else(|| panic!("{selector}: {found}"))
    }

    async fn get(&self, command: &str) -> Value {
        read(command, self.http.get(format!("{}/{command}", self.session))).await
    }

    async fn post(&self, command: &str, body: Value) -> Value {
        read(command, self.http.post(format!("{}/{command}", self.session)).json(&body)).await
    }
}

/// The id of a found element: the one value of an object whose key is a constant of the specification.
fn id_of(element: &Value) -> Option<String> {
    Some(element.as_object()?.values().next()?.as_str()?.to_owned())
}

async fn read(command: &str, request: reqwest::RequestBuilder) -> Value {
    let response = request.send().await.expect("chromedriver answers");
    let is_good = response.status().is_success();
    let mut reply: Value = response.json().await.expect("JSON");
    assert!(is_good, "{command}: {}", reply["value"]["message"]);
    reply["value"].take()
}

impl Drop for Browser {
    fn drop(&mut self) {
        process::kill_tree(self.driver.id());
        let _ = self.driver.wait();
    }
}
