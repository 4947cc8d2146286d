//! The page in a real browser, Chromium, by the protocol of its developer tools.

use std::{
    io::{BufRead as _, BufReader},
    net::TcpStream,
    path::Path,
    process::{Child, Command, Stdio},
    sync::mpsc,
    time::{Duration, Instant},
};

use base64::{Engine as _, engine::general_purpose::STANDARD};
use serde_json::{Value, json};
use singletrack_hil::{Failure, Outcome, bench::Bench, ensure, rig::Need, viewer::Viewer, wait};
use tempfile::TempDir;
use tungstenite::{Message, WebSocket};

use crate::{
    Scenario,
    viewers::{ROUNDS, compare, lateness},
};

pub(crate) const SCENARIOS: &[Scenario] = &[
    Scenario::new(
        "the_page_shows_a_drive_at_a_desk_and_on_a_telephone_in_a_browser",
        shows_a_drive,
    )
    .needing(&[Need::Browser])
    .alone(),
    Scenario::new(
        "the_page_outlives_the_daemon_and_finds_the_next_one_in_a_browser",
        survives_the_daemon,
    )
    .needing(&[Need::Browser])
    .alone(),
    Scenario::new(
        "twenty_people_with_slow_lines_do_not_affect_driving_in_chromium",
        with_slow_people,
    )
    .needing(&[Need::Browser])
    .alone(),
];

/// People at a time, each with a tab.
const PEOPLE: usize = 20;

/// The line of a slow tab: bytes of the page in a second, less than the server has for it, and
/// delay, in ms.
const SLOW_BYTES_S: u32 = 1_000;
const SLOW_DELAY_MS: u32 = 400;

/// The largest time from the command to open a page to what is expected of it.
const PATIENCE: Duration = Duration::from_secs(15);

/// The largest time for the browser to start.
const START: Duration = Duration::from_secs(40);

/// Name, width and height in CSS pixels, and colour scheme.
const SCREENS: [(&str, u32, u32, &str); 4] = [
    ("desk-light", 1280, 800, "light"),
    ("desk-dark", 1280, 800, "dark"),
    ("telephone-light", 390, 844, "light"),
    ("telephone-dark", 390, 844, "dark"),
];

/// The words of the region that screen readers read aloud.
const STATUS: &str = "document.querySelector('[role=status]').innerText";

/// The smallest share of painted pixels among those of any canvas.
const PAINTED: &str = "Math.min(...[...document.querySelectorAll('canvas')].map((canvas) => {
  const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
  return data.filter((value, index) => index % 4 === 3 && value > 0).length / (data.length / 4);
}))";

fn shows_a_drive(bench: &mut Bench) -> Outcome {
    bench.start_daemon()?;
    bench.wait_until_ready()?;
    let page = Viewer::start("page", bench)?;
    let origin = format!("http://{}", page.address());
    let mut browser = Browser::start()?;

    // Before the drive: a browser that starts takes the processors.
    let mut tab = browser.open(&origin)?;
    tab.wait_for(STATUS, "ready")?;
    bench.arm_and_drive()?;
    for (index, screen) in SCREENS.into_iter().enumerate() {
        tab.resize(screen)?;
        tab.wait_for(STATUS, "driving")?;
        tab.wait_for(
            "document.getElementById('link').innerText",
            "daemon connected",
        )?;
        tab.wait_for("document.getElementById('drive-time').innerText", " s")?;
        tab.wait_for("document.getElementById('error').innerText", " mm")?;
        // Long enough for a trail, and for a picture in the new colours.
        bench.keep_driving(Duration::from_secs(2))?;
        let painted = tab.evaluate(PAINTED)?.as_f64().unwrap_or_default();
        ensure!(
            painted > 0.003,
            "{}: a canvas is empty: {painted}",
            screen.0
        );
        let wide = tab.evaluate("document.documentElement.scrollWidth - innerWidth")?;
        ensure!(
            wide.as_i64().is_some_and(|wide| wide <= 0),
            "{}: it is wider than the screen by {wide}",
            screen.0
        );
        tab.screenshot(screen.0)?;
        if index == 0 {
            tab.press_first_button()?;
            tab.wait_for(
                "document.activeElement.getAttribute('aria-pressed')",
                "true",
            )?;
        }
    }

    // A stop is said with what to do, and the end of the daemon too.
    tab.resize(SCREENS[0])?;
    bench.client()?.stop()?.accepted()?;
    tab.wait_for(STATUS, "fault")?;
    tab.wait_for(STATUS, "emergency-stop")?;
    tab.wait_for(STATUS, "reset the board")?;
    tab.screenshot("fault")?;
    tab.is_clean(&origin)?;
    bench.daemon()?.terminate(Duration::from_secs(6))?;
    tab.wait_for(STATUS, "no connection")?;
    tab.screenshot("no-connection")
}

fn survives_the_daemon(bench: &mut Bench) -> Outcome {
    const LINK: &str = "document.getElementById('link').innerText";
    let page = Viewer::start("page", bench)?;
    let mut browser = Browser::start()?;
    let mut tab = browser.open(&format!("http://{}", page.address()))?;
    for _ in 0..2 {
        tab.wait_for(STATUS, "no connection")?;
        tab.wait_for(STATUS, "there is no daemon")?;
        bench.start_daemon()?;
        tab.wait_for(LINK, "daemon connected")?;
        bench.daemon()?.terminate(Duration::from_secs(6))?;
    }
    tab.wait_for(STATUS, "there is no daemon")?;
    drop(page);
    tab.wait_for(STATUS, "check that singletrack page runs")
}

fn with_slow_people(bench: &mut Bench) -> Outcome {
    bench.start_daemon()?;
    bench.wait_until_ready()?;
    let page = Viewer::start("page", bench)?;
    let origin = format!("http://{}", page.address());
    let (mut alone, mut watched) = (Vec::new(), Vec::new());
    // Before the drive: a browser that starts takes the processors.
    let mut browser = Browser::start()?;
    let mut tabs = Vec::new();
    for _ in 0..PEOPLE {
        let mut tab = browser.open(&origin)?;
        tab.wait_for(STATUS, "ready")?;
        tab.slow_down()?;
        tabs.push(tab);
    }
    bench.arm_and_drive()?;
    for _ in 0..ROUNDS {
        lateness(bench, &mut watched)?;
    }
    for tab in &mut tabs {
        tab.wait_for(STATUS, "driving")?;
    }
    drop((tabs, browser));
    for _ in 0..ROUNDS {
        lateness(bench, &mut alone)?;
    }
    compare(bench, alone, watched)
}

/// A browser, which ends with this value.
struct Browser {
    process: Child,
    address: String,
    /// Its profile.
    _folder: TempDir,
}

impl Drop for Browser {
    fn drop(&mut self) {
        // An error means that it has ended already.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

impl Browser {
    fn start() -> Outcome<Self> {
        let folder = tempfile::tempdir().map_err(Failure::system("no folder for the browser"))?;
        // It draws by software: the rig must not wait for it.
        let mut command = Command::new("nice");
        command
            .args([
                "-n",
                "15",
                "chromium",
                "--headless=new",
                "--remote-debugging-port=0",
                "--disable-gpu",
                "--disable-background-networking",
                "--disable-component-update",
                "--no-first-run",
                "--hide-scrollbars",
            ])
            .arg(format!("--user-data-dir={}", folder.path().display()));
        if rustix::process::geteuid().is_root() {
            // It refuses its sandbox to root. The page is our own.
            command.arg("--no-sandbox");
        }
        let mut process = command
            .arg("about:blank")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(Failure::system("can't run chromium"))?;
        let errors = process.stderr.take();
        let mut browser = Self {
            process,
            address: String::new(),
            _folder: folder,
        };
        let errors = errors.ok_or_else(|| Failure::new("chromium has no stderr"))?;
        let (found_in, found) = mpsc::sync_channel(1);
        std::thread::spawn(move || {
            let prefix = "DevTools listening on ";
            // To the end: a full pipe would stop it.
            for line in BufReader::new(errors).lines().map_while(Result::ok) {
                if let Some(address) = line.strip_prefix(prefix) {
                    // `start` waits for it, but not for ever.
                    let _ = found_in.try_send(address.to_owned());
                }
            }
        });
        browser.address = found
            .recv_timeout(START)
            .map_err(|_| Failure::new(format!("chromium does not listen within {START:?}")))?;
        Ok(browser)
    }

    /// Opens a page in a tab of another person.
    fn open(&mut self, url: &str) -> Outcome<Tab> {
        let host = self.address.trim_start_matches("ws://");
        let host = host.split('/').next().unwrap_or_default();
        let stream = TcpStream::connect(host).map_err(Failure::system("no browser"))?;
        stream
            .set_read_timeout(Some(PATIENCE))
            .map_err(Failure::system("no time limit"))?;
        let (socket, _) = tungstenite::client(&self.address, stream)
            .map_err(|error| Failure::new(format!("the browser: {error}")))?;
        let mut tab = Tab {
            socket,
            session: None,
            requests: 0,
            seen: Vec::new(),
        };
        // Of its own: the tabs of one person share six connections to a server.
        let person = tab.call("Target.createBrowserContext", &json!({}))?;
        let made = tab.call(
            "Target.createTarget",
            &json!({"url": "about:blank", "browserContextId": person["browserContextId"]}),
        )?;
        let attached = tab.call(
            "Target.attachToTarget",
            &json!({"targetId": made["targetId"], "flatten": true}),
        )?;
        tab.session = Some(attached["sessionId"].clone());
        tab.resize(SCREENS[0])?;
        for (method, parameters) in [
            ("Runtime.enable", json!({})),
            ("Log.enable", json!({})),
            ("Network.enable", json!({})),
            ("Page.enable", json!({})),
            ("Page.navigate", json!({"url": url})),
        ] {
            tab.call(method, &parameters)?;
        }
        Ok(tab)
    }
}

/// A tab of the browser, and what it has reported.
struct Tab {
    socket: WebSocket<TcpStream>,
    session: Option<Value>,
    requests: u64,
    /// The events of the page.
    seen: Vec<Value>,
}

impl Tab {
    /// Calls a method and returns its result.
    fn call(&mut self, method: &str, parameters: &Value) -> Outcome<Value> {
        let failed = |error: tungstenite::Error| Failure::new(format!("the browser: {error}"));
        self.requests += 1;
        let mut request = json!({"id": self.requests, "method": method, "params": parameters});
        if let Some(session) = &self.session {
            request["sessionId"] = session.clone();
        }
        let request = Message::text(request.to_string());
        self.socket.send(request).map_err(failed)?;
        loop {
            let Message::Text(text) = self.socket.read().map_err(failed)? else {
                continue;
            };
            let message: Value = serde_json::from_str(&text)
                .map_err(|error| Failure::new(format!("the browser: {error}")))?;
            if message["id"] == self.requests {
                ensure!(message["error"].is_null(), "{method}: {}", message["error"]);
                return Ok(message["result"].clone());
            }
            self.seen.push(message);
        }
    }

    /// Gives it this screen.
    fn resize(&mut self, (_, width, height, scheme): (&str, u32, u32, &str)) -> Outcome {
        let metrics = json!({
            "width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600,
        });
        self.call("Emulation.setDeviceMetricsOverride", &metrics)?;
        let media = json!({"features": [{"name": "prefers-color-scheme", "value": scheme}]});
        self.call("Emulation.setEmulatedMedia", &media).map(drop)
    }

    /// Gives it a slow line.
    fn slow_down(&mut self) -> Outcome {
        let line = json!({
            "offline": false, "latency": SLOW_DELAY_MS,
            "downloadThroughput": SLOW_BYTES_S, "uploadThroughput": SLOW_BYTES_S,
        });
        self.call("Network.emulateNetworkConditions", &line)
            .map(drop)
    }

    fn evaluate(&mut self, expression: &str) -> Outcome<Value> {
        let result = self.call(
            "Runtime.evaluate",
            &json!({"expression": expression, "returnByValue": true}),
        )?;
        Ok(result["result"]["value"].clone())
    }

    /// Waits until the value of an expression contains a text, in any case of its letters.
    fn wait_for(&mut self, expression: &str, part: &str) -> Outcome {
        let mut last = Value::Null;
        let begin = Instant::now();
        let found = wait::until(part, PATIENCE, || {
            last = self.evaluate(expression)?;
            let text = last.as_str().unwrap_or_default().to_lowercase();
            std::thread::sleep(Duration::from_millis(20));
            Ok(text.contains(&part.to_lowercase()).then_some(()))
        });
        found.map_err(|failure| {
            let waited = begin.elapsed();
            Failure::new(format!(
                "{failure}; after {waited:.1?} {expression} is {last}"
            ))
        })
    }

    /// Goes to the first button and presses it, by keys alone.
    fn press_first_button(&mut self) -> Outcome {
        for (key, code, text) in [("Tab", 9, ""), ("Enter", 13, "\r")] {
            let key = json!({
                "type": "keyDown", "key": key, "code": key, "text": text,
                "windowsVirtualKeyCode": code,
            });
            self.call("Input.dispatchKeyEvent", &key)?;
        }
        Ok(())
    }

    /// Writes what is seen to the folder of the tests, for people.
    fn screenshot(&mut self, name: &str) -> Outcome {
        let shot = self.call("Page.captureScreenshot", &json!({"format": "png"}))?;
        let png = STANDARD
            .decode(shot["data"].as_str().unwrap_or_default())
            .map_err(|error| Failure::new(format!("the screenshot: {error}")))?;
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
        std::fs::write(folder.join(format!("page-{name}.png")), png)
            .map_err(Failure::system("can't write the screenshot"))
    }

    /// Whether there was no error, and no request to anything but the page.
    fn is_clean(&self, origin: &str) -> Outcome {
        let origin = format!("{origin}/");
        let mut requests = 0;
        for event in &self.seen {
            let parameters = &event["params"];
            match event["method"].as_str().unwrap_or_default() {
                "Network.requestWillBeSent" => {
                    let url = parameters["request"]["url"].as_str().unwrap_or_default();
                    ensure!(url.starts_with(&origin), "a request to {url}");
                    requests += 1;
                }
                "Runtime.exceptionThrown" => {
                    return Err(Failure::new(format!("an error of the page: {parameters}")));
                }
                "Runtime.consoleAPICalled" => {
                    return Err(Failure::new(format!("in the console: {parameters}")));
                }
                // A warning may be about what this test does.
                "Log.entryAdded" if parameters["entry"]["level"] == "error" => {
                    return Err(Failure::new(format!("in the console: {parameters}")));
                }
                _ => {}
            }
        }
        ensure!(requests >= 6, "only {requests} requests were seen");
        Ok(())
    }
}
