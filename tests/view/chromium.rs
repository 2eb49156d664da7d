//! A real Chromium without a window, driven over the two pipes of its DevTools protocol: each message is JSON that
//! ends with a 0.

#![allow(dead_code)] // the tests and the benchmark each use some of it

use serde_json::{Value, json};
use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// How long the browser may take for anything, on a machine that does much else.
const PATIENCE: Duration = Duration::from_secs(60);
/// The browser reads from this descriptor, and writes to the next.
const FIRST_PIPE: i32 = 3;
/// Above the descriptors that the browser's pipes get.
const ABOVE_PIPES: i32 = 10;

/// The browser; it ends with the test.
pub struct Chromium {
    child: Child,
    to: File,
    messages: Receiver<Value>,
    next_id: u64,
    /// What it reads and writes.
    pub folder: TempDir,
}

/// A tab.
pub struct Tab<'a> {
    browser: &'a mut Chromium,
    session: String,
    context: String,
    /// Errors of its scripts, and what its console says.
    pub errors: Vec<String>,
    /// The addresses that it asked for.
    pub requests: Vec<String>,
}

fn pipe() -> [OwnedFd; 2] {
    let mut ends = [0; 2];
    // SAFETY: the array has room for both ends, which are nobody else's.
    unsafe {
        assert_eq!(libc::pipe(ends.as_mut_ptr()), 0, "{}", std::io::Error::last_os_error());
        ends.map(|end| {
            let high = libc::fcntl(end, libc::F_DUPFD_CLOEXEC, ABOVE_PIPES);
            libc::close(end);
            assert!(high >= ABOVE_PIPES, "{}", std::io::Error::last_os_error());
            OwnedFd::from_raw_fd(high)
        })
    }
}

impl Chromium {
    /// Starts it.
    ///
    /// # Panics
    /// If it isn't installed, with the line that installs it.
    pub fn start() -> Self {
        Self::start_with(&["--disable-gpu"])
    }

    /// Starts it with WebGL, drawn by software.
    pub fn start_drawing() -> Self {
        Self::start_with(&["--use-angle=swiftshader", "--enable-unsafe-swiftshader"])
    }

    fn start_with(arguments: &[&str]) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let [[its_input, to], [from, its_output]] = [pipe(), pipe()];
        let given = [its_input.as_raw_fd(), its_output.as_raw_fd()];
        let mut command = Command::new("chromium");
        command
            .args(["--headless=new", "--remote-debugging-pipe", "--no-first-run"])
            .args(arguments)
            // Tests may run as root in a container, where there is neither a sandbox nor much shared memory. What is
            // opened is the page alone.
            .args(["--no-sandbox", "--disable-dev-shm-usage", "--disable-background-networking"])
            .arg(format!("--user-data-dir={}", folder.path().join("profile").display()))
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        // SAFETY: dup2 is async-signal-safe, and the descriptors are open until the fork.
        unsafe {
            command.pre_exec(move || {
                for (to, from) in (FIRST_PIPE..).zip(given) {
                    if libc::dup2(from, to) < 0 {
                        return Err(std::io::Error::last_os_error());
                    }
                }
                Ok(())
            });
        }
        let child = command.spawn().unwrap_or_else(|error| {
            panic!("Chromium is missing ({error}): install it with apt-get install -y chromium")
        });
        let (sender, messages) = channel();
        let mut reader = BufReader::new(File::from(from));
        std::thread::spawn(move || {
            let mut message = Vec::new();
            while reader.read_until(0, &mut message).is_ok_and(|n| n > 0) {
                message.pop();
                let Ok(value) = serde_json::from_slice(&message) else { return };
                if sender.send(value).is_err() {
                    return;
                }
                message.clear();
            }
        });
        Self { child, to: File::from(to), messages, next_id: 0, folder }
    }

    fn call(&mut self, method: &str, params: &Value, tab: Option<&str>) -> (Value, Vec<Value>) {
        self.next_id += 1;
        let id = self.next_id;
        let mut message = json!({"id": id, "method": method, "params": params});
        if let Some(session) = tab {
            message["sessionId"] = json!(session);
        }
        let mut bytes = message.to_string().into_bytes();
        bytes.push(0);
        self.to.write_all(&bytes).expect("the browser reads");
        let mut events = Vec::new();
        loop {
            let message = self.messages.recv_timeout(PATIENCE);
            let message =
                message.unwrap_or_else(|e| panic!("{method}: the browser is silent ({e})"));
            if message["id"] == json!(id) {
                assert!(message["error"].is_null(), "{method}: {}", message["error"]);
                return (message["result"].clone(), events);
            }
            events.push(message);
        }
    }

    /// A tab with cookies and storage of its own, of this size; `scheme` is `light` or `dark`.
    pub fn tab(&mut self, (width, height): (u32, u32), scheme: &str) -> Tab<'_> {
        let (context, _) = self.call("Target.createBrowserContext", &json!({}), None);
        let context = context["browserContextId"].as_str().expect("a context").to_owned();
        let wanted = json!({"url": "about:blank", "browserContextId": context});
        let (target, _) = self.call("Target.createTarget", &wanted, None);
        let wanted = json!({"targetId": target["targetId"], "flatten": true});
        let (session, _) = self.call("Target.attachToTarget", &wanted, None);
        let session = session["sessionId"].as_str().expect("a session").to_owned();
        let downloads = json!({"behavior": "allow", "browserContextId": context,
            "downloadPath": self.folder.path().join("downloads")});
        self.call("Browser.setDownloadBehavior", &downloads, None);
        let mut tab =
            Tab { browser: self, session, context, errors: Vec::new(), requests: Vec::new() };
        for domain in ["Page.enable", "Runtime.enable", "Log.enable", "Network.enable"] {
            tab.call(domain, json!({}));
        }
        let size =
            json!({"width": width, "height": height, "deviceScaleFactor": 1, "mobile": false});
        tab.call("Emulation.setDeviceMetricsOverride", size);
        let feature = json!({"features": [{"name": "prefers-color-scheme", "value": scheme}]});
        tab.call("Emulation.setEmulatedMedia", feature);
        tab
    }
}

impl Drop for Chromium {
    fn drop(&mut self) {
        // It may have ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Tab<'_> {
    pub fn call(&mut self, method: &str, params: Value) -> Value {
        let (result, events) = self.browser.call(method, &params, Some(&self.session));
        self.note(&events);
        result
    }

    fn note(&mut self, events: &[Value]) {
        for event in events.iter().filter(|e| e["sessionId"] == json!(self.session)) {
            match event["method"].as_str() {
                Some("Runtime.exceptionThrown") => self.errors.push(event["params"].to_string()),
                Some("Network.requestWillBeSent") => {
                    let address = event["params"]["request"]["url"].as_str();
                    self.requests.extend(address.map(str::to_owned));
                }
                Some("Log.entryAdded") if event["params"]["entry"]["level"] == "error" => {
                    self.errors.push(event["params"].to_string());
                }
                _ => {}
            }
        }
    }

    pub fn open(&mut self, address: &str) {
        self.call("Page.navigate", json!({"url": address}));
    }

    /// The value of an expression of JavaScript, awaited if it is a promise.
    pub fn value(&mut self, expression: &str) -> Value {
        let wanted = json!({"expression": expression, "awaitPromise": true, "returnByValue": true,
            "userGesture": true});
        let result = self.call("Runtime.evaluate", wanted);
        assert!(result["exceptionDetails"].is_null(), "{expression}: {result}");
        result["result"]["value"].clone()
    }

    /// Waits until an expression is true.
    #[track_caller]
    pub fn until(&mut self, expression: &str) {
        let start = Instant::now();
        while self.value(&format!("Boolean({expression})")) != json!(true) {
            let status = self.value("document.body?.innerText.slice(0, 600)");
            assert!(start.elapsed() < PATIENCE, "never: {expression}; the page says {status}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// A mouse from one place to another, its left button pressed, in steps. `keys`: 8 for Shift, 2 for Ctrl.
    pub fn drag(&mut self, from: [f64; 2], to: [f64; 2], keys: u32) {
        const STEPS: u32 = 8;
        let mut mouse = |kind: &str, [x, y]: [f64; 2], buttons: u32| {
            let event = json!({"type": kind, "x": x, "y": y, "button": "left", "buttons": buttons,
                "clickCount": 1, "modifiers": keys});
            self.call("Input.dispatchMouseEvent", event);
        };
        mouse("mousePressed", from, 1);
        for step in 1..=STEPS {
            let share = f64::from(step) / f64::from(STEPS);
            mouse("mouseMoved", [0, 1].map(|k| from[k] + (to[k] - from[k]) * share), 1);
        }
        mouse("mouseReleased", to, 0);
    }

    /// The wheel's turn, down if positive.
    pub fn wheel(&mut self, [x, y]: [f64; 2], down_px: f64) {
        let event = json!({"type": "mouseWheel", "x": x, "y": y, "deltaX": 0, "deltaY": down_px});
        self.call("Input.dispatchMouseEvent", event);
    }

    /// The middle of an element, and a click there.
    pub fn click(&mut self, selector: &str) {
        let middle = self.value(&format!(
            "(() => {{ const b = document.querySelector({selector:?}).getBoundingClientRect(); \
             return [b.x + b.width / 2, b.y + b.height / 2]; }})()"
        ));
        let at = [0, 1].map(|k| middle[k].as_f64().expect("a number"));
        self.drag(at, at, 0);
    }

    /// A key, pressed and released: a name such as `ArrowLeft`, or a character.
    pub fn key(&mut self, key: &str, keys: u32) {
        let code = match key {
            "Tab" => 9,
            "Enter" => 13,
            "Escape" => 27,
            "End" => 35,
            "Home" => 36,
            "ArrowLeft" => 37,
            "ArrowUp" => 38,
            "ArrowRight" => 39,
            "ArrowDown" => 40,
            _ => 0,
        };
        let text = match key {
            "Enter" => "\r",
            _ if key.len() == 1 => key,
            _ => "",
        };
        let down = if text.is_empty() { "rawKeyDown" } else { "keyDown" };
        for kind in [down, "keyUp"] {
            let mut event = json!({"type": kind, "key": key, "modifiers": keys,
                "windowsVirtualKeyCode": code});
            if kind == "keyDown" {
                event["text"] = json!(text);
            }
            if key == " " {
                event["code"] = json!("Space");
                event["windowsVirtualKeyCode"] = json!(32);
            }
            self.call("Input.dispatchKeyEvent", event);
        }
    }

    /// A file that the page gave to be saved, whose name ends so; waits for it.
    pub fn saved(&mut self, ending: &str) -> Vec<u8> {
        let folder = self.browser.folder.path().join("downloads");
        let start = Instant::now();
        loop {
            let mut files = std::fs::read_dir(&folder).into_iter().flatten().flatten();
            // Chromium holds the name by an empty file until the whole one is renamed to it.
            let is_whole = |f: &std::fs::DirEntry| f.metadata().is_ok_and(|m| m.len() > 0);
            if let Some(file) =
                files.find(|f| f.file_name().to_string_lossy().ends_with(ending) && is_whole(f))
            {
                let bytes = std::fs::read(file.path()).expect("a file");
                std::fs::remove_file(file.path()).expect("a file");
                return bytes;
            }
            assert!(start.elapsed() < PATIENCE, "nothing was saved that ends with {ending}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// A picture of the page, PNG.
    pub fn screenshot(&mut self) -> Vec<u8> {
        use base64::Engine;
        let result = self.call("Page.captureScreenshot", json!({"format": "png"}));
        let text = result["data"].as_str().expect("a picture");
        base64::engine::general_purpose::STANDARD.decode(text).expect("base64")
    }
}

impl Drop for Tab<'_> {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            let gone = json!({"browserContextId": self.context});
            self.browser.call("Target.disposeBrowserContext", &gone, None);
        }
    }
}
