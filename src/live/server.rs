//! The HTTP server: accepts connections, and answers the requests.

use super::answer::{Reply, failed, picture, respond};
use super::guard::{Guard, NOT_FOUND};
use super::scene::scene;
use super::{LiveError, PictureRequest, Queue, RigFrame, Studio, workers};
use crate::camera::CameraFormat;
use hyper::Request;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use std::convert::Infallible;
use std::io;
use std::net::{Ipv4Addr, TcpListener};
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpStream;
use tokio::sync::Semaphore;
use tokio_io_timeout::TimeoutStream;

/// Maximum number of open connections. A browser opens six.
const MAX_CONNECTIONS: usize = 48;
/// Maximum time until the headers of a request have arrived. It also limits how long a connection may be idle.
const HEADER_TIMEOUT: Duration = Duration::from_secs(10);
/// Maximum time for which sending a response may stall because the browser doesn't read it.
const WRITE_TIMEOUT: Duration = Duration::from_secs(20);
/// Maximum size of a request's address and headers, bytes.
const MAX_REQUEST_BYTES: usize = 16 << 10;
/// Maximum number of headers of a request.
const MAX_HEADERS: usize = 64;
/// Pause before the next attempt, after accepting a connection has failed.
const RETRY: Duration = Duration::from_millis(50);

const HTML: &str = "text/html; charset=utf-8";
const CSS: &str = "text/css; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const JSON: &str = "application/json";

/// Files of the page: name in the address, media type, contents.
const PAGE: [(&str, &str, &str); 11] = [
    ("", HTML, include_str!("page/index.html")),
    ("style.css", CSS, include_str!("page/style.css")),
    ("icon.svg", "image/svg+xml", include_str!("page/icon.svg")),
    ("main.js", SCRIPT, include_str!("page/main.js")),
    ("state.js", SCRIPT, include_str!("page/state.js")),
    ("stream.js", SCRIPT, include_str!("page/stream.js")),
    ("stage.js", SCRIPT, include_str!("page/stage.js")),
    ("legend.js", SCRIPT, include_str!("page/legend.js")),
    ("plan.js", SCRIPT, include_str!("page/plan.js")),
    ("map.js", SCRIPT, include_str!("page/map.js")),
    ("save.js", SCRIPT, include_str!("page/save.js")),
];

/// A server of interactive views. It has bound its port, but answers no requests until [`Self::serve`] is called.
pub struct Server {
    listener: TcpListener,
    guard: Guard,
}

/// State of the server that all connections share.
struct ServedSite {
    guard: Guard,
    queue: Arc<Queue>,
    scene: String,
    rig: Arc<RigFrame>,
}

impl Server {
    /// Binds a port of this machine. If `port` is 0, the system chooses a free port.
    ///
    /// # Errors
    /// If another program uses the port, or if the system's random generator fails.
    pub fn bind(port: u16) -> io::Result<Self> {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port))?;
        let guard = Guard::new(listener.local_addr()?.port())?;
        Ok(Self { listener, guard })
    }

    /// Returns the page's address, including the secret token.
    pub fn address(&self) -> String {
        self.guard.address()
    }

    /// Serves pictures of a light field until the process ends.
    ///
    /// # Errors
    /// If a thread can't be started, or if the port fails.
    pub fn serve(self, studio: &Studio) -> io::Result<()> {
        let queue = Arc::new(Queue::default());
        let site = ServedSite {
            guard: self.guard,
            queue: queue.clone(),
            scene: scene(studio).to_string(),
            rig: studio.rig.clone(),
        };
        self.listener.set_nonblocking(true)?;
        std::thread::scope(|scope| {
            let served = workers::start(scope, studio, &queue).and_then(|()| {
                let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
                runtime.block_on(accept(self.listener, Arc::new(site)))
            });
            queue.close();
            served
        })
    }
}

/// Accepts connections. A connection beyond [`MAX_CONNECTIONS`] is closed at once.
async fn accept(listener: TcpListener, site: Arc<ServedSite>) -> io::Result<()> {
    let listener = tokio::net::TcpListener::from_std(listener)?;
    let free = Arc::new(Semaphore::new(MAX_CONNECTIONS));
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            // Either the browser has disconnected already, or too many files are open at the moment.
            tokio::time::sleep(RETRY).await;
            continue;
        };
        if let Ok(place) = free.clone().try_acquire_owned() {
            let site = site.clone();
            tokio::spawn(async move {
                converse(stream, site).await;
                drop(place);
            });
        }
    }
}

/// Answers the requests of one connection until it ends.
async fn converse(stream: TcpStream, site: Arc<ServedSite>) {
    // Without this setting, the last part of a picture may be delayed until the browser acknowledges the earlier parts.
    let _ = stream.set_nodelay(true);
    let mut stream = TimeoutStream::new(stream);
    stream.set_write_timeout(Some(WRITE_TIMEOUT));
    let service = service_fn(move |request| {
        let site = site.clone();
        async move {
            let reply = reply(&site, request).await;
            Ok::<Reply, Infallible>(reply.unwrap_or_else(|error| failed(&error)))
        }
    });
    let served = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEADER_TIMEOUT)
        .max_buf_size(MAX_REQUEST_BYTES)
        .max_headers(MAX_HEADERS)
        .serve_connection(TokioIo::new(Box::pin(stream)), service)
        .await;
    // Errors need no handling, since the browser opens another connection.
    drop(served);
}

async fn reply(site: &ServedSite, request: Request<Incoming>) -> Result<Reply, LiveError> {
    let (parts, _) = request.into_parts();
    let query = parts.uri.query().unwrap_or_default();
    match site.guard.admit(&parts)? {
        "picture" => {
            let answer = site.queue.submit(PictureRequest::parse(query)?)?;
            // If the browser disconnects, this future is dropped, and the job counts as no longer wanted.
            Ok(picture(answer.await.unwrap_or(Err(LiveError::Superseded))?))
        }
        // The camera of a picture, in the format that `stlfr render --camera` reads.
        "view.json" => {
            let camera = site.rig.camera(&PictureRequest::parse(query)?)?;
            let text = serde_json::to_string_pretty(&CameraFormat::from(&camera));
            Ok(respond(JSON, text.map_err(|_| LiveError::Panicked)? + "\n"))
        }
        "scene.json" => Ok(respond(JSON, site.scene.clone())),
        name => {
            let file = PAGE.iter().find(|(file, ..)| *file == name);
            let (_, media_type, content) = file.ok_or(NOT_FOUND)?;
            Ok(respond(media_type, *content))
        }
    }
}
