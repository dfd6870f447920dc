//! A headless Chromium, driven by its debugging protocol over pipes: messages in JSON, a zero byte after each.

use std::env;
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use serde_json::{Value, json};
use tempfile::TempDir;
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};
use tokio::process::{Child, ChildStdin, ChildStdout, Command};
use tokio::time::{interval, timeout};

/// Must be 1 to pass over the tests that need a browser.
const SKIP: &str = "FURROW_TESTS_SKIP_BROWSER";
/// Where screenshots go, if anywhere.
const SCREENSHOTS: &str = "FURROW_SCREENSHOTS";
/// Names under which it is installed.
const PROGRAMS: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "chrome"];
/// The browser reads from file 3 and writes to file 4; its own output is not looked at.
const LAUNCH: &str = "exec \"$@\" 3<&0 4>&1 </dev/null >/dev/null 2>&1";
const SEEN_WITHIN: Duration = Duration::from_secs(90);
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// A browser with one page. It is killed when dropped.
pub(crate) struct Browser {
    questions: ChildStdin,
    answers: BufReader<ChildStdout>,
    session: String,
    calls: u64,
    /// What the page's console complained about.
    pub(crate) complaints: Vec<String>,
    _process: Child,
    _profile: TempDir,
}

impl Browser {
    /// Starts it; none if the user wants to do without.
    pub(crate) async fn start() -> Option<Self> {
        if env::var_os(SKIP).is_some_and(|skip| skip == "1") {
            eprintln!("skipped: {SKIP}=1");
            return None;
        }
        let profile = tempfile::tempdir().unwrap();
        let mut process = launch(profile.path());
        let questions = process.stdin.take().expect("it is piped");
        let answers = BufReader::new(process.stdout.take().expect("it is piped"));
        let (session, complaints) = (String::new(), Vec::new());
        let mut browser =
            Self { questions, answers, session, calls: 0, complaints, _process: process, _profile: profile };
        browser.open_page().await;
        Some(browser)
    }

    async fn open_page(&mut self) {
        let target = self.call("Target.createTarget", json!({"url": "about:blank"})).await["targetId"].clone();
        let attached = self.call("Target.attachToTarget", json!({"targetId": target, "flatten": true})).await;
        attached["sessionId"].as_str().unwrap().clone_into(&mut self.session);
        for domain in ["Page", "Runtime", "Log"] {
            self.call(&format!("{domain}.enable"), json!({})).await;
        }
        self.call("Emulation.setScrollbarsHidden", json!({"hidden": true})).await;
    }

    /// Asks the browser, or the page where there is one; the answer's result.
    pub(crate) async fn call(&mut self, method: &str, params: Value) -> Value {
        self.calls += 1;
        let mut question = json!({"id": self.calls, "method": method, "params": params});
        if !self.session.is_empty() {
            question["sessionId"] = json!(self.session);
        }
        self.questions.write_all(format!("{question}\0").as_bytes()).await.unwrap();
        let answered = timeout(SEEN_WITHIN, self.answer(self.calls)).await;
        let answer = answered.unwrap_or_else(|_| panic!("{method} is not answered"));
        assert!(answer.get("error").is_none(), "{method}: {answer}");
        answer["result"].clone()
    }

    async fn answer(&mut self, call: u64) -> Value {
        loop {
            let mut message = Vec::new();
            self.answers.read_until(0, &mut message).await.unwrap();
            assert_eq!(message.pop(), Some(0), "the browser ended");
            let said: Value = serde_json::from_slice(&message).unwrap();
            if said["id"] == call {
                return said;
            }
            self.complaints.extend(complaint(&said));
        }
    }

    /// The value of a JavaScript expression; promises are waited for.
    pub(crate) async fn value(&mut self, expression: &str) -> Value {
        let params = json!({"expression": expression, "awaitPromise": true, "returnByValue": true});
        let answer = self.call("Runtime.evaluate", params).await;
        assert!(answer.get("exceptionDetails").is_none(), "{expression}: {answer}");
        answer["result"]["value"].clone()
    }

    /// Goes to `url`.
    pub(crate) async fn go(&mut self, url: &str) {
        self.call("Page.navigate", json!({"url": url})).await;
    }

    /// Waits until a JavaScript expression is true.
    pub(crate) async fn until(&mut self, expression: &str) {
        let mut looks = interval(LOOK_EVERY);
        let search = async {
            let question = format!("(() => {{ try {{ return Boolean({expression}); }} catch {{ return false; }} }})()");
            while self.value(&question).await != true {
                looks.tick().await;
            }
        };
        if timeout(SEEN_WITHIN, search).await.is_err() {
            let shown = self.value("document.querySelector('main').innerText").await;
            panic!(
                "it never came to be that {expression}; the page shows: {shown}; it complains: {:?}",
                self.complaints
            );
        }
    }

    /// Waits until `selector` is there, and clicks on it.
    pub(crate) async fn click(&mut self, selector: &str) {
        self.until(&format!("document.querySelector({})", json!(selector))).await;
        self.value(&format!("document.querySelector({}).click()", json!(selector))).await;
    }

    /// Puts `text` into the field `selector`, as typing does.
    pub(crate) async fn fill(&mut self, selector: &str, text: &str) {
        let set = "(selector, text) => { const field = document.querySelector(selector); field.value = text; \
            for (const kind of ['input', 'change']) field.dispatchEvent(new Event(kind, { bubbles: true })); }";
        self.until(&format!("document.querySelector({})", json!(selector))).await;
        self.value(&format!("({set})({}, {})", json!(selector), json!(text))).await;
    }

    /// Makes the window that wide and high [px].
    pub(crate) async fn resize(&mut self, width: u32, height: u32) {
        let size = json!({"width": width, "height": height, "deviceScaleFactor": 1, "mobile": false});
        self.call("Emulation.setDeviceMetricsOverride", size).await;
    }

    /// Prefers dark pages, or light ones.
    pub(crate) async fn prefer(&mut self, scheme: &str) {
        let features = json!({"features": [{"name": "prefers-color-scheme", "value": scheme}]});
        self.call("Emulation.setEmulatedMedia", features).await;
    }

    /// Keeps a picture of the whole page, where the user wants one.
    pub(crate) async fn picture(&mut self, name: &str) {
        let Some(directory) = env::var_os(SCREENSHOTS).filter(|folder| !folder.is_empty()) else { return };
        let picture = self.call("Page.captureScreenshot", json!({"captureBeyondViewport": true})).await;
        let bytes = BASE64_STANDARD.decode(picture["data"].as_str().unwrap()).unwrap();
        std::fs::write(Path::new(&directory).join(format!("{name}.png")), bytes).unwrap();
    }
}

fn launch(profile: &Path) -> Child {
    let installed = |program: &&str| {
        let folders = env::var_os("PATH").unwrap_or_default();
        env::split_paths(&folders).any(|folder| folder.join(program).is_file())
    };
    let Some(program) = PROGRAMS.into_iter().find(installed) else {
        panic!("this test drives a browser: install chromium, or set {SKIP}=1 to do without it")
    };
    let mut command = Command::new("sh");
    command.args([
        "-c",
        LAUNCH,
        "sh",
        program,
        "--headless",
        "--remote-debugging-pipe",
        "--no-first-run",
        "--disable-gpu",
    ]);
    // Neither a sandbox, which it refuses to make for root, nor much shared memory is there in containers.
    command.args(["--no-sandbox", "--disable-dev-shm-usage"]).arg(format!("--user-data-dir={}", profile.display()));
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null());
    command.kill_on_drop(true).spawn().expect("a shell can be started")
}

/// What the console shows as an error, if the message is one.
fn complaint(said: &Value) -> Option<String> {
    let params = &said["params"];
    match said["method"].as_str()? {
        "Runtime.exceptionThrown" => Some(params["exceptionDetails"].to_string()),
        "Runtime.consoleAPICalled" if params["type"] == "error" => Some(params["args"].to_string()),
        "Log.entryAdded" if params["entry"]["level"] == "error" => Some(params["entry"].to_string()),
        _ => None,
    }
}
