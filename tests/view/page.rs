//! The page in a real Chromium: what a user does with mouse and keys, and what is shown then.

use crate::chromium::{Chromium, Tab};
use crate::common::{succeed, text};
use crate::filmed::{TRUE_S, capture, copy};
use crate::served::Served;
use serde_json::{Value, json};

const DESK: (u32, u32) = (1280, 800);
const PHONE: (u32, u32) = (390, 844);
const SHIFT: u32 = 8;
const CTRL: u32 = 2;

const AT_REST: &str = "document.getElementById('status')?.textContent.includes('at rest')";

/// Opens the page, and waits for a picture of the chosen quality.
fn open<'a>(browser: &'a mut Chromium, served: &Served, size: (u32, u32), link: &str) -> Tab<'a> {
    let mut tab = browser.tab(size, "light");
    tab.open(&format!("{}#{link}", served.address));
    tab.until("document.readyState === 'complete'");
    tab.until(AT_REST);
    tab
}

/// What the link keeps, once the page is at rest.
fn link(tab: &mut Tab, name: &str) -> Option<String> {
    // The link is brought up to date when nothing has changed for a while.
    std::thread::sleep(std::time::Duration::from_millis(600));
    tab.until(AT_REST);
    let value = tab.value(&format!("new URLSearchParams(location.hash.slice(1)).get({name:?})"));
    value.as_str().map(str::to_owned)
}

fn number(tab: &mut Tab, name: &str) -> f64 {
    link(tab, name).unwrap_or_else(|| panic!("the link says no {name}")).parse().unwrap()
}

/// The picture of a pane, as its pixels' bytes added up by channel.
fn sums(tab: &mut Tab, pane: &str) -> Value {
    tab.value(&format!(
        "(() => {{ const c = document.querySelector('#{pane} canvas'); \
         const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data; \
         const s = [0, 0, 0]; d.forEach((v, k) => {{ if (k % 4 < 3) s[k % 4] += v * (1 + k % 977); }}); return s; }})()"
    ))
}

/// The left and upper edge of an element, its width and its height, pixels.
fn edges(tab: &mut Tab, selector: &str) -> [f64; 4] {
    let edges = tab.value(&format!(
        "(() => {{ const b = document.querySelector({selector:?}).getBoundingClientRect(); \
         return [b.x, b.y, b.width, b.height]; }})()"
    ));
    serde_json::from_value(edges).unwrap()
}

/// Nothing went wrong, in the page's own words or the browser's.
fn is_well(tab: &mut Tab) {
    assert_eq!(
        tab.value("[...document.querySelectorAll('.problem')].filter((p) => !p.hidden).length"),
        0
    );
    assert_eq!(tab.errors, Vec::<String>::new());
}

#[test]
fn drag_wheel_and_map_move_the_viewpoint() {
    let served = Served::start(capture());
    let mut browser = Chromium::start();
    let mut tab = open(&mut browser, &served, DESK, "x=0&y=0&z=0&t=0.08");
    let before = sums(&mut tab, "pane-a");
    tab.drag([600.0, 400.0], [500.0, 450.0], 0);
    assert!(number(&mut tab, "x") > 0.01 && number(&mut tab, "y") > 0.005);
    assert_ne!(sums(&mut tab, "pane-a"), before);
    let x = number(&mut tab, "x");
    tab.drag([600.0, 400.0], [600.0, 340.0], SHIFT);
    assert!(number(&mut tab, "z") > 0.005 && (number(&mut tab, "x") - x).abs() < 1e-6);
    tab.drag([600.0, 400.0], [560.0, 400.0], CTRL);
    assert!(number(&mut tab, "yaw") > 0.5);
    tab.wheel([600.0, 400.0], -300.0);
    assert!(number(&mut tab, "zoom") > 1.2);
    tab.key("Home", 0);
    assert_eq!((number(&mut tab, "x"), link(&mut tab, "zoom")), (0.0, None));
    let map = tab.value("(() => { const b = document.getElementById('map').getBoundingClientRect(); return [b.x, b.y, b.width, b.height]; })()");
    let map: Vec<f64> = serde_json::from_value(map).unwrap();
    let at = |x: f64, y: f64| [map[0] + x * map[2], map[1] + y * map[3]];
    tab.drag(at(0.5, 0.2), at(0.65, 0.25), 0);
    assert!(number(&mut tab, "x") > 0.01 && number(&mut tab, "y") > 0.01);
    is_well(&mut tab);
}

#[test]
fn time_is_scrubbed_played_and_stopped() {
    let served = Served::start(capture());
    let mut browser = Chromium::start();
    let mut tab = open(&mut browser, &served, DESK, "t=0.05");
    let before = sums(&mut tab, "pane-a");
    tab.value("(() => { const t = document.getElementById('time'); t.value = 0.1; t.dispatchEvent(new Event('input')); })()");
    assert!((number(&mut tab, "t") - 0.1).abs() < 1e-6);
    assert_ne!(sums(&mut tab, "pane-a"), before);
    assert!(
        tab.value("document.getElementById('clock').textContent")
            .as_str()
            .unwrap()
            .contains("frame 3.00")
    );
    tab.key(".", 0);
    assert!((number(&mut tab, "t") - 4.0 / 30.0).abs() < 1e-9, "the next frame");
    tab.key(",", 0);
    assert!((number(&mut tab, "t") - 0.1).abs() < 1e-9, "and back");
    tab.key(" ", 0);
    tab.until("document.getElementById('play').getAttribute('aria-pressed') === 'true'");
    tab.until("/frames\\/s/.test(document.getElementById('status').textContent) && Math.abs(document.getElementById('time').value - 0.1) > 0.003");
    tab.click("#play");
    tab.until("document.getElementById('play').getAttribute('aria-pressed') === 'false'");
    let stood = number(&mut tab, "t");
    tab.click("#orbit");
    tab.until("Math.abs(document.getElementById('x').value) > 0.02");
    tab.key("t", 0);
    assert_eq!(number(&mut tab, "t"), stood, "time stood still");
    is_well(&mut tab);
}

#[test]
fn methods_stand_beside_each_other() {
    let served = Served::start(capture());
    let mut browser = Chromium::start();
    let mut tab = open(&mut browser, &served, DESK, "x=0.02&y=0&z=0&t=0.09");
    tab.key("c", 0);
    tab.until("!document.getElementById('divide').hidden");
    assert_eq!(link(&mut tab, "beside").as_deref(), Some("lfr"));
    assert_ne!(sums(&mut tab, "pane-a"), sums(&mut tab, "pane-b"));
    let [x, y, width, height] = edges(&mut tab, "#picture");
    let y = y + height / 2.0;
    tab.drag([x + width / 2.0, y], [x + 0.7 * width, y], 0);
    assert!(number(&mut tab, "split") > 65.0, "the border was dragged");
    assert!(number(&mut tab, "x") == 0.02, "and the viewpoint was not");
    // The truth is at its places: the page goes to the nearest.
    tab.key("3", 0);
    assert_eq!(link(&mut tab, "at").as_deref(), Some("t1"));
    assert!((number(&mut tab, "t") - TRUE_S).abs() < 1e-9);
    tab.key("4", 0);
    assert_eq!(link(&mut tab, "show").as_deref(), Some("sources"));
    tab.until("document.querySelector('#map .camera').style.fill.startsWith('rgb')");
    is_well(&mut tab);
    tab.key("3", 0);
    tab.key("w", 0);
    tab.until("document.querySelector('#pane-a .problem').innerText.includes('truth at some places and times only')");
    tab.click("#pane-a .problem button");
    tab.until("document.querySelector('#pane-a .problem').hidden");
    assert_eq!(link(&mut tab, "at").as_deref(), Some("t1"));
}

#[test]
fn a_link_keeps_the_place_and_a_new_window_finds_it() {
    let served = Served::start(capture());
    let mut browser = Chromium::start();
    let place = "x=0.031000&y=0.012000&z=0.020000&yaw=1.500&zoom=1.30000&t=0.0712&show=lfr&beside=st&split=31";
    let shown = {
        let mut tab = open(&mut browser, &served, DESK, place);
        tab.key("l", 0);
        let kept = tab.value("location.hash.slice(1)");
        let sorted = |link: &str| {
            let mut fields: Vec<String> = link.split('&').map(str::to_owned).collect();
            fields.sort();
            fields
        };
        let kept = kept.as_str().unwrap().replace("&pitch=0.000", "");
        assert_eq!(sorted(&kept), sorted(place));
        is_well(&mut tab);
        [sums(&mut tab, "pane-a"), sums(&mut tab, "pane-b")]
    };
    let mut tab = open(&mut browser, &served, DESK, place);
    assert_eq!([sums(&mut tab, "pane-a"), sums(&mut tab, "pane-b")], shown);
    // A link that is wrong is said, and harms nothing.
    tab.open(&format!("{}#x=99&y=a&t=1e9&show=best&split=-5", served.address));
    tab.until("document.querySelector('#pane-a .problem').innerText.includes('too far')");
    tab.key("Home", 0);
    tab.until(
        "document.querySelector('#pane-a .problem').innerText.includes('No camera has frames')",
    );
}

/// A link says no turn and no zoom where they are plain.
#[test]
fn a_link_that_is_followed_takes_back_turn_and_zoom() {
    let served = Served::start(capture());
    let mut browser = Chromium::start();
    let mut tab = open(&mut browser, &served, DESK, "x=0.01&y=0&z=0&yaw=2&zoom=1.5&t=0.08");
    assert_eq!((number(&mut tab, "yaw"), number(&mut tab, "zoom")), (2.0, 1.5));
    tab.value("void (location.hash = 'x=0.02&y=0&z=0')");
    assert_eq!(number(&mut tab, "x"), 0.02);
    assert_eq!((link(&mut tab, "yaw"), link(&mut tab, "zoom")), (None, None));
    assert_eq!(number(&mut tab, "t"), 0.08, "what it doesn't say stays");
    is_well(&mut tab);
}

#[test]
fn what_is_saved_is_the_picture_and_its_camera() {
    let balanced = ["--preset", "balanced"];
    let served = Served::start_with(capture(), &balanced);
    let mut browser = Chromium::start();
    let mut tab = open(&mut browser, &served, DESK, "x=0.021&y=0.01&z=0.01&t=0.0712");
    tab.click("#save");
    tab.until("document.getElementById('command').textContent.includes('--camera view.json --time 0.0712')");
    tab.click("#save-png");
    let picture = tab.saved(".png");
    tab.click("#save");
    tab.click("#save-json");
    let camera = tab.saved("view.json");
    let folder = tempfile::tempdir().unwrap();
    let (view, image) = (folder.path().join("view.json"), folder.path().join("view.png"));
    std::fs::write(&view, camera).unwrap();
    let capture = text(capture());
    let render = ["render", capture, "--camera", text(&view), "--time", "0.0712"];
    succeed(&[&render[..], &balanced, &["-o", text(&image)]].concat());
    assert!(picture == std::fs::read(&image).unwrap());
    is_well(&mut tab);
}

/// All with keys: every control is reached, is seen to be reached, and has a name.
#[test]
fn the_keyboard_suffices() {
    let served = Served::start(capture());
    let mut browser = Chromium::start();
    let mut tab = open(&mut browser, &served, DESK, "x=0&y=0&z=0&t=0.08");
    for (key, axis, way) in
        [("ArrowRight", "x", 1.0), ("ArrowUp", "y", 1.0), ("w", "z", 1.0), ("ArrowLeft", "x", -1.0)]
    {
        let before = number(&mut tab, axis);
        tab.key(key, 0);
        assert!(way * (number(&mut tab, axis) - before) > 1e-4, "{key}");
    }
    tab.key("+", 0);
    assert!(number(&mut tab, "zoom") > 1.05);
    let mut reached = Vec::new();
    for _ in 0..24 {
        tab.key("Tab", 0);
        let focus = tab.value(
            "(() => { const e = document.activeElement, s = getComputedStyle(e); \
             return { id: e.id, name: e.getAttribute('aria-label') ?? e.labels?.[0]?.innerText ?? e.innerText, \
             seen: s.outlineStyle !== 'none' || e.id === 'split' || e.id === 'stage', high: e.getBoundingClientRect().height }; })()",
        );
        let id = focus["id"].as_str().unwrap().to_owned();
        if !id.is_empty() {
            assert!(focus["seen"] == json!(true), "{focus}");
            assert!(!focus["name"].as_str().unwrap().trim().is_empty(), "{focus}");
        }
        reached.push(id);
    }
    for id in [
        "x", "y", "z", "zoom", "at", "play", "orbit", "time", "speed", "left", "right", "link",
        "save", "help",
    ] {
        assert!(reached.iter().any(|r| r == id), "{id} is not reached: {reached:?}");
    }
    tab.key("?", SHIFT);
    tab.until("document.getElementById('keys').open");
    tab.key("Escape", 0);
    tab.until("!document.getElementById('keys').open");
    is_well(&mut tab);
}

#[test]
fn a_phone_shows_all_of_it() {
    let served = Served::start(capture());
    let mut browser = Chromium::start();
    let mut tab = open(&mut browser, &served, PHONE, "t=0.08&show=st&beside=lfr");
    let outside = "[...document.querySelectorAll('button, select, input, .card')].filter((e) => { \
        const b = e.getBoundingClientRect(); \
        return b.width && e.id !== 'split' && (b.left < 0 || b.top < 0 || b.right > innerWidth + 0.5 || b.bottom > innerHeight + 0.5); \
        }).map((e) => e.id)";
    assert_eq!(tab.value("document.documentElement.scrollWidth"), 390);
    assert_eq!(tab.value(outside), json!([]));
    let small = "[...document.querySelectorAll('button, select')].filter((e) => { const b = e.getBoundingClientRect(); \
        return b.width && (b.width < 44 || b.height < 44); }).map((e) => e.id)";
    assert_eq!(tab.value(small), json!([]), "fingers find it");
    tab.click("#map-button");
    tab.until("document.getElementById('place').getBoundingClientRect().width > 100");
    assert_eq!(tab.value(outside), json!([]));
    tab.key("?", 0);
    tab.until("document.getElementById('keys').open");
    assert_eq!(tab.value("document.getElementById('keys').scrollWidth <= innerWidth"), true);
    is_well(&mut tab);
}

#[test]
fn two_windows_look_at_the_same_and_one_comes_back() {
    let served = Served::start(capture());
    let [mut first, mut second] = [(); 2].map(|()| Chromium::start());
    let mut a = open(&mut first, &served, DESK, "x=0.02&y=0&z=0&t=0.08");
    let mut b = open(&mut second, &served, DESK, "x=-0.02&y=0&z=0&t=0.08");
    a.drag([600.0, 400.0], [500.0, 400.0], 0);
    b.drag([600.0, 400.0], [700.0, 400.0], 0);
    assert!(number(&mut a, "x") > 0.02 && number(&mut b, "x") < -0.02);
    is_well(&mut a);
    is_well(&mut b);
    drop(b);
    drop(second);
    let mut third = Chromium::start();
    let mut back = open(&mut third, &served, DESK, "x=-0.02&y=0&z=0&t=0.08");
    is_well(&mut back);
}

#[test]
fn a_capture_deleted_under_it_is_said_on_the_page() {
    let copy = copy();
    let served = Served::start(copy.path());
    let mut browser = Chromium::start();
    let mut tab = open(&mut browser, &served, DESK, "x=0&y=0&z=0&t=0.05");
    std::fs::remove_dir_all(copy.path()).unwrap();
    tab.value("(() => { const t = document.getElementById('time'); t.value = 0.13; t.dispatchEvent(new Event('input')); })()");
    tab.until("document.querySelector('#pane-a .problem').innerText.includes('No such file')");
    // What was decoded can still be looked at.
    tab.value("(() => { const t = document.getElementById('time'); t.value = 0.05; t.dispatchEvent(new Event('input')); })()");
    tab.until("document.querySelector('#pane-a .problem').hidden");
    drop(served);
    tab.key("ArrowLeft", 0);
    tab.until(
        "document.querySelector('#pane-a .problem').innerText.includes('The server has ended')",
    );
}

/// Nothing of the picture is cut off, nor covered by a part of the page.
#[test]
fn the_picture_is_whole() {
    let served = Served::start(capture());
    for size in [DESK, PHONE, (844, 390)] {
        let mut browser = Chromium::start();
        let mut tab = open(&mut browser, &served, size, "x=0&y=0&z=0&t=0.08");
        let [x, y, width, height] = edges(&mut tab, "#picture");
        assert!((width / height - 160.0 / 120.0).abs() < 0.02, "{width}×{height}");
        assert!(x >= 0.0 && y >= 0.0);
        assert!(x + width <= f64::from(size.0) + 0.5 && y + height <= f64::from(size.1) + 0.5);
        let canvas =
            tab.value("(() => { const c = document.querySelector('#pane-a canvas'); return [c.width, c.height]; })()");
        assert_eq!(canvas, json!([160, 120]));
        for part in ["#head", "#bar", "#place"] {
            let [px, py, pwidth, pheight] = edges(&mut tab, part);
            let is_beside =
                px + pwidth <= x || px >= x + width || py + pheight <= y || py >= y + height;
            assert!(pwidth == 0.0 || is_beside, "{part} at {size:?}");
        }
        tab.key(" ", 0);
        tab.until("/frames\\/s/.test(document.getElementById('status').textContent)");
        assert_eq!(tab.value("document.querySelector('#pane-a canvas').height"), 120, "in motion");
        tab.key(" ", 0);
        tab.until(AT_REST);
        is_well(&mut tab);
    }
}

#[test]
fn cameras_and_depths_have_a_legend_and_what_is_under_the_pointer() {
    let served = Served::start(capture());
    let mut browser = Chromium::start();
    let mut tab = open(&mut browser, &served, DESK, "x=0.01&y=0&z=0&t=0.08&show=sources");
    let weights =
        "[...document.querySelectorAll('#legend output')].map((o) => parseInt(o.textContent) || 0)";
    let sum = format!("Math.abs({weights}.reduce((a, b) => a + b, 0) - 100) < 6");
    tab.until(&sum);
    let colors = tab.value(
        "new Set([...document.querySelectorAll('#legend i')].map((i) => i.style.background)).size",
    );
    assert_eq!(colors, 4);
    let mean = tab.value(weights);
    let [x, y, width, height] = edges(&mut tab, "#picture");
    let mut point = |across: f64, caption: &str| {
        let (x, y) = (x + across * width, y + 0.4 * height);
        tab.call("Input.dispatchMouseEvent", json!({"type": "mouseMoved", "x": x, "y": y}));
        tab.until(&format!(
            "document.querySelector('#legend .caption').textContent.includes({caption:?})"
        ));
        tab.value(weights)
    };
    let left = point(0.02, "under the pointer");
    assert!(point(0.98, "under the pointer") != left && left != mean);
    tab.key("5", 0);
    assert_eq!(link(&mut tab, "show").as_deref(), Some("depth"));
    tab.until("/near: \\d/.test(document.getElementById('legend').innerText)");
    let point = json!({"type": "mouseMoved", "x": x + 0.5 * width, "y": y + 0.45 * height});
    tab.call("Input.dispatchMouseEvent", point);
    tab.until("/\\d m under the pointer/.test(document.getElementById('legend').innerText)");
    let depth_m = tab.value("parseFloat(document.querySelector('#legend .caption').textContent)");
    let depth_m = depth_m.as_f64().unwrap();
    assert!((0.9..4.0).contains(&depth_m), "{depth_m}");
    tab.key("1", 0);
    tab.until("document.getElementById('legend').hidden");
    is_well(&mut tab);
}

#[test]
fn methods_are_chosen_on_the_page_and_kept_in_the_link() {
    let served = Served::start(capture());
    let mut browser = Chromium::start();
    let mut tab = open(&mut browser, &served, DESK, "x=0.02&y=0&z=0&t=0.09");
    let before = sums(&mut tab, "pane-a");
    tab.value("(() => { const p = document.getElementById('proxy'); p.value = 'plane'; p.dispatchEvent(new Event('change')); })()");
    assert_eq!(link(&mut tab, "proxy").as_deref(), Some("plane"));
    tab.until("document.getElementById('status').textContent.includes('one plane')");
    assert_ne!(sums(&mut tab, "pane-a"), before);
    tab.click("#save");
    tab.until("document.getElementById('command').textContent.includes('--proxy plane')");
    tab.until("/stlfr view .* --at '.*proxy=plane.*'/.test(document.getElementById('return').textContent)");
    is_well(&mut tab);
}

#[test]
fn two_fingers_zoom_and_a_drag_leaves_no_frame() {
    let served = Served::start(capture());
    let mut browser = Chromium::start();
    let mut tab = open(&mut browser, &served, PHONE, "x=0&y=0&z=0&t=0.08");
    tab.call("Emulation.setTouchEmulationEnabled", json!({"enabled": true, "maxTouchPoints": 2}));
    let [x, y, width, height] = edges(&mut tab, "#picture");
    let (x, y) = (x + width / 2.0, y + height / 2.0);
    let mut touch = |kind: &str, apart: f64| {
        let points = json!([{"x": x - apart, "y": y, "id": 0}, {"x": x + apart, "y": y, "id": 1}]);
        let points = if kind == "touchEnd" { json!([]) } else { points };
        tab.call("Input.dispatchTouchEvent", json!({"type": kind, "touchPoints": points}));
    };
    touch("touchStart", 40.0);
    (1..=8).for_each(|k| touch("touchMove", 40.0 + 5.0 * f64::from(k)));
    touch("touchEnd", 0.0);
    let zoom = number(&mut tab, "zoom");
    assert!((1.7..2.3).contains(&zoom), "{zoom}");
    assert_eq!((number(&mut tab, "x"), number(&mut tab, "z")), (0.0, 0.0));
    let framed =
        "getComputedStyle(document.getElementById('picture'), '::after').content !== 'none'";
    tab.key("ArrowRight", 0);
    tab.drag([x, y], [x + 30.0, y], 0);
    assert_eq!(tab.value(framed), false);
    tab.key("ArrowRight", 0);
    assert_eq!(tab.value(framed), true, "keys show where they go");
    is_well(&mut tab);
}

#[test]
fn a_page_at_rest_says_that_the_server_has_ended() {
    let served = Served::start(capture());
    let mut browser = Chromium::start();
    let mut tab = open(&mut browser, &served, DESK, "x=0&y=0&z=0&t=0.05");
    drop(served);
    tab.until(
        "document.querySelector('#pane-a .problem').innerText.includes('The server has ended')",
    );
    tab.until("document.getElementById('status').textContent.includes('no connection')");
    assert_eq!(tab.value(AT_REST), false);
}
