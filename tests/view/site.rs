//! A published site: a static web server, and its page's pictures.

use super::chromium::{Chromium, Tab};
use serde_json::json;
use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::sync::{Arc, Mutex};
use stlfr::camera::{Camera, CameraFormat};
use stlfr::raster::{Image, read_image};

/// A static web server; the paths that were asked for.
pub fn serve(folder: &Path) -> (u16, Arc<Mutex<Vec<String>>>) {
    let listener = TcpListener::bind(("127.0.0.1", 0)).unwrap();
    let port = listener.local_addr().unwrap().port();
    let asked = Arc::new(Mutex::new(Vec::new()));
    let (folder, heard) = (folder.to_owned(), asked.clone());
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let (folder, heard) = (folder.clone(), heard.clone());
            std::thread::spawn(move || answer(stream.unwrap(), &folder, &heard));
        }
    });
    (port, asked)
}

fn answer(mut stream: TcpStream, folder: &Path, asked: &Mutex<Vec<String>>) {
    let mut lines = BufReader::new(stream.try_clone().unwrap()).lines();
    let Some(Ok(first)) = lines.next() else { return };
    let path = first.split(' ').nth(1).unwrap_or_default().to_owned();
    asked.lock().unwrap().push(path.clone());
    while lines.next().is_some_and(|line| line.is_ok_and(|line| !line.is_empty())) {}
    let kind = match path.rsplit_once('.') {
        Some((_, "js")) => "text/javascript",
        Some((_, "css")) => "text/css",
        _ => "text/html",
    };
    let (status, body) = match std::fs::read(folder.join(&path[1..])) {
        Ok(body) => ("200 OK", body),
        Err(_) => ("404 Not Found", Vec::new()),
    };
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    );
    // The browser may have gone.
    let _ = stream.write_all(head.as_bytes()).and_then(|()| stream.write_all(&body));
}

const DRAWN: &str = "typeof stlfr !== 'undefined' && stlfr.statistics?.pictures > 0";

/// Opens the page, and waits for its first picture.
pub fn open<'a>(browser: &'a mut Chromium, address: &str, size: (u32, u32)) -> Tab<'a> {
    let mut tab = browser.tab(size, "dark");
    tab.open(address);
    tab.until(DRAWN);
    tab
}

/// The page's picture of a view.
pub fn drawn(tab: &mut Tab, camera: &Camera, time_s: f64) -> Image {
    use base64::Engine;
    let view = json!(CameraFormat::from(camera));
    let address = tab.value(&format!(
        "stlfr.picture({view}, {time_s}).then((canvas) => canvas.toDataURL('image/png'))"
    ));
    let png = address.as_str().unwrap().split_once(',').unwrap().1;
    let png = base64::engine::general_purpose::STANDARD.decode(png).unwrap();
    let file = tempfile::NamedTempFile::with_suffix(".png").unwrap();
    std::fs::write(file.path(), png).unwrap();
    read_image(file.path()).unwrap().0
}
