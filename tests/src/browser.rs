//! A real browser: headless Chromium, driven by chromedriver over plain WebDriver (W3C) HTTP.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use crate::process;

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
        let http = reqwest::Client::new();
        let chrome = json!({"args": ["--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--window-size=1280,1600"]});
        let wanted = json!({"capabilities": {"alwaysMatch": {"browserName": "chrome", "goog:chromeOptions": chrome,
            "goog:loggingPrefs": {"browser": "ALL"}}}});
        let base = format!("http://127.0.0.1:{port}/session");
        let reply: Value =
            http.post(&base).json(&wanted).send().await.expect("chromedriver answers").json().await.expect("JSON");
        let id = reply["value"]["sessionId"].as_str().unwrap_or_else(|| panic!("a session: {reply}"));
        Self { session: format!("{base}/{id}"), driver, http }
    }

    pub async fn go(&self, url: &str) {
        self.post("url", json!({"url": url})).await;
    }

    /// Evaluates JavaScript (`return ...`) in the page.
    pub async fn script(&self, script: &str) -> Value {
        self.post("execute/sync", json!({"script": script, "args": []})).await
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

    /// Messages of the console at level SEVERE: script errors and loads that failed.
    pub async fn errors(&self) -> Vec<String> {
        let entries = self.post("se/log", json!({"type": "browser"})).await;
        let entries = entries.as_array().cloned().unwrap_or_default();
        let severe = entries.iter().filter(|entry| entry["level"] == "SEVERE");
        severe.map(|entry| entry["message"].as_str().unwrap_or_default().to_owned()).collect()
    }

    async fn element(&self, selector: &str) -> String {
        let found = self.post("element", json!({"using": "css selector", "value": selector})).await;
        let mut ids = found.as_object().into_iter().flat_map(|element| element.values());
        ids.next().and_then(Value::as_str).unwrap_or_else(|| panic!("{selector}: {found}")).to_owned()
    }

    async fn post(&self, command: &str, body: Value) -> Value {
        let url = format!("{}/{command}", self.session);
        let response = self.http.post(url).json(&body).send().await.expect("chromedriver answers");
        let ok = response.status().is_success();
        let mut reply: Value = response.json().await.expect("JSON");
        assert!(ok, "{command} {body}: {}", reply["value"]["message"]);
        reply["value"].take()
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        process::kill_tree(self.driver.id());
        let _ = self.driver.wait();
    }
}
