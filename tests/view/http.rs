//! Requests as they should be, and as they should not.

use crate::common::{assert_refused, stderr, stlfr, succeed, text};
use crate::filmed::{TRUE_S, capture, copy};
use crate::served::{PATIENCE, Response, Served};
use std::io::{ErrorKind, Read, Write};
use std::os::unix::process::ExitStatusExt;
use std::time::{Duration, Instant};
use stlfr::method::Method as _;
use stlfr::options::ProxyMethod;

const PICTURE: &str = "picture?w=160&h=120&t=0.08&x=0.01";

#[test]
fn the_page_and_pictures_come_with_every_header() {
    let served = Served::start(capture());
    for (name, media_type) in [
        ("", "text/html"),
        ("main.js", "text/javascript"),
        ("style.css", "text/css"),
        ("scene.json", "application/json"),
        (PICTURE, "image/png"),
        (&format!("{PICTURE}&level=quick"), "image/png"),
        (&format!("view.json?{}", PICTURE.split_once('?').unwrap().1), "application/json"),
        ("picture?w=1", "text/plain"),
    ] {
        let response = served.get(name);
        assert_eq!(response.status == 200, media_type != "text/plain", "{name}: {response:?}");
        assert!(response.header("content-type").unwrap().starts_with(media_type), "{name}");
        let policy = response.header("content-security-policy").unwrap();
        assert!(policy.starts_with("default-src 'none'") && !policy.contains("unsafe"), "{policy}");
        assert_eq!(response.header("cache-control"), Some("no-store"));
        assert_eq!(response.header("x-content-type-options"), Some("nosniff"));
        assert_eq!(response.header("referrer-policy"), Some("no-referrer"));
        assert_eq!(response.header("access-control-allow-origin"), None);
    }
}

#[test]
fn who_has_no_token_or_another_host_or_origin_finds_nothing() {
    let served = Served::start(capture());
    let (token, port, host) = (&served.token, served.port, served.host());
    let page = format!("/{token}/");
    let status = |method: &str, path: &str, headers: &[&str]| {
        let response = served.request(method, path, headers);
        assert!(response.status != 200, "{method} {path} {headers:?}");
        assert!(
            !response.headers.contains(token.as_str()) && !response.text().contains(token.as_str())
        );
        response.status
    };
    let other = token.chars().rev().collect::<String>();
    for path in [
        "/",
        "/scene.json",
        &format!("/{other}/"),
        &format!("/{}/", &token[1..]),
        &format!("/{token}"),
    ] {
        assert_eq!(status("GET", path, &[&host]), 404, "{path}");
    }
    for wrong in
        ["Host: evil.example", "Host: 127.0.0.1", "Host: 127.0.0.1:1", "Host: 0.0.0.0", "X: y"]
    {
        assert_eq!(status("GET", &page, &[wrong]), 421, "{wrong}");
    }
    assert_eq!(status("GET", &page, &[&host, "Host: evil.example"]), 400);
    let absolute = format!("http://evil.example/{token}/");
    assert_ne!(status("GET", &absolute, &["Host: evil.example"]), 200);
    for wrong in
        ["http://evil.example", "null", &format!("https://127.0.0.1:{port}"), "http://127.0.0.1:1"]
    {
        assert_eq!(status("GET", &page, &[&host, &format!("Origin: {wrong}")]), 403, "{wrong}");
    }
    let scene = format!("/{token}/scene.json");
    for site in ["cross-site", "same-site"] {
        assert_eq!(status("GET", &scene, &[&host, &format!("Sec-Fetch-Site: {site}")]), 403);
    }
    let own = format!("Origin: http://127.0.0.1:{port}");
    assert_eq!(
        served.request("GET", &scene, &[&host, &own, "Sec-Fetch-Site: same-origin"]).status,
        200
    );
    let (name, origin) =
        (format!("Host: localhost:{port}"), format!("Origin: http://localhost:{port}"));
    assert_eq!(served.request("GET", &scene, &[&name, &origin]).status, 200);
    // A link to the page from elsewhere is one that the user followed.
    assert_eq!(served.request("GET", &page, &[&host, "Sec-Fetch-Site: cross-site"]).status, 200);
}

#[test]
fn no_path_leads_out_of_the_page() {
    let served = Served::start(capture());
    let token = &served.token;
    for path in [
        "../capture.json",
        "capture.json",
        "cam0/0000.png",
        "truth/truth.json",
        "..%2fcapture.json",
        "%2e%2e/capture.json",
        "./style.css",
        "//style.css",
        "style.css/",
        "/etc/passwd",
        "..\\capture.json",
        "page/../../../Cargo.toml",
        "main.js%00",
        "picture/../scene.json",
    ] {
        let response = served.request("GET", &format!("/{token}/{path}"), &[&served.host()]);
        assert_eq!(response.status, 404, "{path}: {response:?}");
    }
    let beyond = served.request("GET", &format!("/../{token}/"), &[&served.host()]);
    assert_eq!(beyond.status, 404);
}

#[test]
fn what_is_no_get_or_too_large_is_refused() {
    let served = Served::start(capture());
    let (page, host) = (format!("/{}/", served.token), served.host());
    for method in ["POST", "PUT", "DELETE", "OPTIONS", "HEAD", "PATCH", "BREW"] {
        assert_eq!(served.request(method, &page, &[&host]).status, 405, "{method}");
    }
    assert_eq!(served.request("GET", &page, &[&host, "Content-Length: 5"]).status, 413);
    assert_eq!(served.request("GET", &page, &[&host, "Transfer-Encoding: chunked"]).status, 413);
    let long = format!("{page}picture?viewer={}", "a".repeat(2000));
    assert_eq!(served.request("GET", &long, &[&host]).status, 414);
    let large = format!("X: {}", "a".repeat(100_000));
    assert_eq!(served.request("GET", &page, &[&host, &large]).status, 431);
    let many: Vec<String> = (0..200).map(|k| format!("X-{k}: 1")).collect();
    let mut many: Vec<&str> = many.iter().map(String::as_str).collect();
    many.push(&host);
    assert_eq!(served.request("GET", &page, &many).status, 431);
    for bytes in [
        &b"\0\0\0\0"[..],
        b"GET\r\n\r\n",
        b"\x16\x03\x01\x02\0",
        b"GET / HTTP/9.9\r\n\r\n",
        b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
    ] {
        let answer = served.raw(bytes);
        assert!(!answer.starts_with(b"HTTP/1.1 200"), "{bytes:?}");
    }
    assert_eq!(served.get("").status, 200, "the server goes on");
}

#[test]
fn pictures_out_of_bounds_are_refused_in_a_sentence() {
    let served = Served::start(capture());
    for (query, status, words) in [
        ("w=160&h=120&t=99", 422, "no camera has frames around 99 s"),
        ("w=160&h=120&t=0.08&x=50", 400, "too far from the cameras"),
        ("w=161&h=120&t=0.08", 400, "size: is 161×120"),
        ("w=0&h=120", 400, "size: is 0×120"),
        ("w=160&h=120&zoom=0", 400, "zoom: is 0"),
        ("w=160&h=120&t=nan", 400, "t: must be a number"),
        ("w=160&h=120&at=c9", 400, "there is no such camera"),
        ("w=160&h=120&at=t9", 400, "there is no such image of the truth"),
        ("w=160&h=120&method=truth&t=0.08", 400, "there is truth at its places only"),
        ("w=160&h=120&method=truth&t=0.09&at=t0", 400, "is of 0.0800 s, not of 0.0900 s"),
        ("w=160&h=120&method=best", 400, "method: must be one of"),
    ] {
        let response = served.get(&format!("picture?{query}"));
        let message = response.text();
        assert_eq!(response.status, status, "{query}: {message}");
        assert!(message.contains(words) && message.lines().count() == 1, "{query}: {message}");
    }
}

/// Saves a picture, and has the program render it by these options; whether they are the same, byte by byte.
fn is_saved_as_rendered(served: &Served, query: &str, options: &[&str]) -> bool {
    let folder = tempfile::tempdir().unwrap();
    let (view, image) = (folder.path().join("view.json"), folder.path().join("view.png"));
    std::fs::write(&view, served.get(&format!("view.json?{query}")).body).unwrap();
    let time = query.split('&').find_map(|p| p.strip_prefix("t=")).unwrap();
    let place = ["--camera", text(&view), "--time", time, "-o", text(&image)];
    succeed(&[&["render", text(capture())], options, &place].concat());
    let saved = served.get(&format!("picture?{query}&level=saved"));
    assert_eq!(saved.status, 200, "{query}: {}", saved.text());
    saved.body == std::fs::read(&image).unwrap()
}

const PLACES: [&str; 2] =
    ["w=160&h=120&t=0.08&x=0.02&y=0.01", "w=120&h=100&t=0.05&x=-0.03&zoom=1.5&yaw=2&pitch=-1"];

/// What a picture shows is what the library renders.
#[test]
fn what_is_saved_is_what_render_writes() {
    let options = ["--preset", "balanced"];
    let nearest = [&options[..], &["--sync", "nearest"]].concat();
    let served = Served::start_with(capture(), &options);
    for query in PLACES {
        assert!(is_saved_as_rendered(&served, query, &options), "{query}");
        let traditional = format!("{query}&method=lfr");
        assert!(is_saved_as_rendered(&served, &traditional, &nearest), "{query}");
    }
}

/// The shape of a picture that is shown may be that of a prepared instant.
#[test]
fn over_depth_per_pixel_too_what_is_saved_is_what_render_writes() {
    let folder = tempfile::tempdir().unwrap();
    let depth = folder.path().join("depth.json");
    std::fs::write(&depth, r#"{"proxy": {"method": "depth"}}"#).unwrap();
    let options = ["--options", text(&depth)];
    let served = Served::start_with(capture(), &options);
    let query = PLACES[0];
    let traditional = format!("{query}&method=lfr");
    let nearest = [&options[..], &["--sync", "nearest"]].concat();
    // Prepares the instant.
    let shown = served.get(&format!("picture?{traditional}"));
    assert_eq!(shown.header("x-made-by"), Some("nearest, depth"));
    assert!(is_saved_as_rendered(&served, query, &options));
    assert!(is_saved_as_rendered(&served, &traditional, &nearest));
}

#[test]
fn quick_pictures_are_by_scene_flow_once_depth_and_motion_are_there() {
    let copy = copy();
    let options = copy.path().join("flow.json");
    std::fs::write(&options, r#"{"proxy": {"method": "scene-flow"}}"#).unwrap();
    let served = Served::start_with(copy.path(), &["--options", text(&options)]);
    let get = |level: &str| served.get(&format!("picture?{}&level={level}", PLACES[0]));
    let is_by_flow = |picture: &Response| {
        picture.header("x-made-by").unwrap().ends_with(ProxyMethod::SceneFlow.name())
    };
    assert!(!is_by_flow(&get("quick")));
    let [full, quick] = ["full", "quick"].map(get);
    assert!(is_by_flow(&full) && is_by_flow(&quick));
    let [full, quick] =
        [full, quick].map(|p| image::load_from_memory(&p.body).unwrap().into_rgb8().into_raw());
    let differences = full.iter().zip(&quick).map(|(a, b)| f64::from(a.abs_diff(*b)));
    let rms = (differences.map(|d| d * d).sum::<f64>() / full.len() as f64).sqrt();
    assert!(rms > 0.0 && rms < 8.0, "{rms} of 255");
}

#[test]
fn the_truth_is_its_own_picture() {
    let served = Served::start(capture());
    let query = format!("picture?w=160&h=120&method=truth&at=t1&t={TRUE_S}");
    let shown = image::load_from_memory(&served.get(&query).body).unwrap().into_rgb8();
    let truth = image::open(capture().join("truth/t0-between.png")).unwrap().into_rgb8();
    let differences = shown.as_raw().iter().zip(truth.as_raw()).map(|(a, b)| a.abs_diff(*b));
    // Its outermost pixels fade, as every camera's do.
    assert!(differences.filter(|d| *d > 1).count() < 3 * 2 * (160 + 120));
}

#[test]
fn one_who_sends_or_takes_nothing_keeps_nobody_waiting() {
    let served = Served::start(capture());
    let mut silent = served.connect();
    let mut half = served.connect();
    half.write_all(b"GET / HTTP/1.1\r\nHost: ").unwrap();
    let mut greedy = served.connect();
    // More than the system keeps for one who takes nothing.
    for name in [PICTURE; 20].iter().chain(&["main.js"; 600]) {
        let ask = format!("GET /{}/{name} HTTP/1.1\r\n{}\r\n\r\n", served.token, served.host());
        greedy.write_all(ask.as_bytes()).unwrap();
    }
    let start = Instant::now();
    assert_eq!(served.get("scene.json").status, 200);
    assert_eq!(served.get(PICTURE).status, 200);
    assert!(start.elapsed().as_secs() < 10);
    // All are cut, long before a minute has passed.
    let mut rest = Vec::new();
    let _ = half.read_to_end(&mut rest);
    let _ = silent.read_to_end(&mut rest);
    assert!(start.elapsed() < PATIENCE / 2, "{:?}", start.elapsed());
    // Reading would be taking: that it was cut shows when it sends.
    while greedy.write_all(b"G").is_ok() {
        assert!(start.elapsed() < PATIENCE, "one who takes nothing holds a connection");
        std::thread::sleep(Duration::from_millis(200));
    }
    rest.clear();
    let _ = greedy.read_to_end(&mut rest);
    let answered = rest.windows(12).filter(|w| *w == b"HTTP/1.1 200").count();
    assert!((1..620).contains(&answered), "it was cut while it took nothing: {answered}");
}

/// How many connections the server keeps open.
const CONNECTIONS: usize = 48;

#[test]
fn there_are_not_more_connections_than_may_be_open() {
    let served = Served::start(capture());
    let mut open: Vec<_> = (0..CONNECTIONS + 40).map(|_| served.connect()).collect();
    for (k, beyond) in open.iter_mut().enumerate().skip(CONNECTIONS) {
        assert_eq!(beyond.read(&mut [0]).unwrap(), 0, "connection {k} is one too many");
    }
    for (k, within) in open.iter_mut().enumerate().take(CONNECTIONS) {
        within.set_nonblocking(true).unwrap();
        let error = within.read(&mut [0]).expect_err("nothing was asked for");
        assert_eq!(error.kind(), ErrorKind::WouldBlock, "connection {k} is open");
    }
    drop(open);
    let page = format!(
        "GET /{}/ HTTP/1.1\r\n{}\r\nConnection: close\r\n\r\n",
        served.token,
        served.host()
    );
    let start = Instant::now();
    while !served.raw(page.as_bytes()).starts_with(b"HTTP/1.1 200") {
        assert!(start.elapsed() < PATIENCE, "the server answers again");
    }
}

#[test]
fn a_second_server_on_the_port_is_refused() {
    let served = Served::start(capture());
    let port = served.port.to_string();
    let output =
        stlfr().args(["view", text(capture()), "--no-open", "--port", &port]).output().unwrap();
    assert_refused(&output, 2, &format!("another program serves at {port} already"));
    let missing = stlfr().args(["view", "/nowhere", "--no-open"]).output().unwrap();
    assert_refused(&missing, 2, "/nowhere");
}

#[test]
fn ctrl_c_ends_it_as_it_ends_others() {
    let served = Served::start(capture());
    assert_eq!(served.get("").status, 200);
    let ended = served.interrupt();
    assert_eq!((ended.code(), ended.signal()), (None, Some(libc::SIGINT)));
}

#[test]
fn a_capture_deleted_under_it_is_said_and_the_server_goes_on() {
    let copy = copy();
    let mut served = Served::start(copy.path());
    assert_eq!(served.get("picture?w=160&h=120&t=0.02").status, 200);
    std::fs::remove_dir_all(copy.path()).unwrap();
    let response = served.get("picture?w=160&h=120&t=0.13");
    assert_eq!(response.status, 500);
    assert!(response.text().contains("No such file"), "{}", response.text());
    assert_eq!(response.text().lines().count(), 1);
    assert!(served.is_running() && served.get("scene.json").status == 200);
    // What has been decoded is still there.
    assert_eq!(served.get("picture?w=160&h=120&t=0.02&x=0.01").status, 200);
}

#[test]
fn frames_replaced_under_it_are_said_and_no_picture_mixes_two_recordings() {
    let copy = copy();
    let served = Served::start_with(copy.path(), &["--preset", "balanced"]);
    assert_eq!(served.get("picture?w=160&h=120&t=0.02").status, 200);
    for entry in std::fs::read_dir(copy.path()).unwrap().flatten() {
        let frames = std::fs::read_dir(entry.path()).into_iter().flatten().flatten();
        let mut frames: Vec<_> = frames.map(|frame| frame.path()).collect();
        frames.sort();
        // Another recording: every frame but the last shows what the next one showed.
        for pair in frames.windows(2) {
            let other = copy.path().join("other");
            std::fs::copy(&pair[1], &other).unwrap();
            std::fs::rename(&other, &pair[0]).unwrap();
        }
    }
    let response = served.get("picture?w=160&h=120&t=0.13");
    assert_eq!(response.status, 500);
    assert!(response.text().contains("changed while it was being used"), "{}", response.text());
    assert_eq!(response.text().lines().count(), 1);
}

#[test]
fn many_viewers_share_one_light_field() {
    let served = Served::start(capture());
    let all: Vec<u16> = std::thread::scope(|scope| {
        let ask = |k: usize| {
            let served = &served;
            move || served.get(&format!("{PICTURE}&viewer=v{k}&level=quick")).status
        };
        let threads: Vec<_> = (0..8).map(|k| scope.spawn(ask(k))).collect();
        threads.into_iter().map(|t| t.join().unwrap()).collect()
    });
    assert_eq!(all, [200; 8]);
}

/// A viewer that asks anew gets its newest picture; what it asked for before is not waited for.
#[test]
fn a_viewers_newer_request_takes_the_place_of_the_older() {
    let served = Served::start(capture());
    let statuses: Vec<u16> = std::thread::scope(|scope| {
        let get = |query: String| {
            let served = &served;
            move || served.get(&format!("picture?w=160&h=120&{query}")).status
        };
        // One full picture is made at a time, so the viewer's wait in line.
        let others: Vec<_> =
            (0..12).map(|k| scope.spawn(get(format!("t=0.0{}", 20 + 5 * k)))).collect();
        std::thread::sleep(Duration::from_millis(20));
        let ask = |k: usize| {
            std::thread::sleep(Duration::from_millis(20));
            scope.spawn(get(format!("t=0.0{}&viewer=v", 3 + k)))
        };
        let threads: Vec<_> = (0..5).map(ask).collect();
        for other in others {
            assert_eq!(other.join().unwrap(), 200);
        }
        threads.into_iter().map(|t| t.join().unwrap()).collect()
    });
    assert_eq!(statuses[4], 200);
    assert!(statuses.iter().all(|s| [200, 409].contains(s)), "{statuses:?}");
    assert!(statuses.contains(&409), "none was overtaken: {statuses:?}");
}

#[test]
fn without_a_browser_the_address_is_printed_all_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let mut child = stlfr()
        .args(["view", text(capture())])
        .env("PATH", folder.path())
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = [0; 17];
    child.stdout.as_mut().unwrap().read_exact(&mut line).unwrap();
    assert_eq!(&line, b"http://127.0.0.1:");
    std::thread::sleep(Duration::from_millis(300));
    child.kill().unwrap();
    let output = child.wait_with_output().unwrap();
    assert!(stderr(&output).contains("open the address by hand"), "{}", stderr(&output));
}
