//! The server as a child process, and requests byte by byte.

#![allow(dead_code)] // the tests and the benchmark each use some of it

use crate::common::{interruptible, stlfr, text};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

/// How long a test waits for what must come.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// `stlfr view` of a capture. It ends with the test.
pub struct Served {
    child: Child,
    pub address: String,
    pub port: u16,
    pub token: String,
}

/// A response.
#[derive(Debug)]
pub struct Response {
    pub status: u16,
    pub headers: String,
    pub body: Vec<u8>,
}

impl Served {
    /// Starts it, and waits for its address.
    pub fn start(capture: &Path) -> Self {
        Self::start_with(capture, &[])
    }

    /// The same with more words of a command line.
    pub fn start_with(capture: &Path, more: &[&str]) -> Self {
        let mut command = stlfr();
        command.args(["-q", "view", text(capture), "--no-open"]).args(more).stdout(Stdio::piped());
        let mut child = interruptible(&mut command).spawn().expect("the program starts");
        let mut address = String::new();
        let stdout = child.stdout.take().expect("it was piped");
        BufReader::new(stdout).read_line(&mut address).expect("it prints an address");
        let address = address.trim().to_owned();
        let rest = address.strip_prefix("http://127.0.0.1:").expect("an address of this machine");
        let (port, token) = rest.split_once('/').expect("a port, and a token");
        let token = token.trim_end_matches('/').to_owned();
        let port = port.parse().expect("a port");
        Self { child, address, port, token }
    }

    pub fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(("127.0.0.1", self.port)).expect("the server listens");
        stream.set_read_timeout(Some(PATIENCE)).expect("sockets have timeouts");
        stream
    }

    /// Sends bytes as they are; what comes back until the server closes the connection.
    pub fn raw(&self, request: &[u8]) -> Vec<u8> {
        let mut stream = self.connect();
        // The server may have answered and closed before all of it was sent.
        let _ = stream.write_all(request);
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        answer
    }

    /// A request with these header lines besides `Connection`.
    pub fn request(&self, method: &str, path: &str, headers: &[&str]) -> Response {
        let mut lines = vec![format!("{method} {path} HTTP/1.1"), "Connection: close".into()];
        lines.extend(headers.iter().map(|h| (*h).to_owned()));
        let answer = self.raw(format!("{}\r\n\r\n", lines.join("\r\n")).as_bytes());
        Response::parse(&answer)
    }

    pub fn host(&self) -> String {
        format!("Host: 127.0.0.1:{}", self.port)
    }

    /// What is at an address behind the token.
    pub fn get(&self, name: &str) -> Response {
        self.request("GET", &format!("/{}/{name}", self.token), &[&self.host()])
    }

    pub fn is_running(&mut self) -> bool {
        self.child.try_wait().expect("it can be waited for").is_none()
    }

    pub fn process(&self) -> u32 {
        self.child.id()
    }

    /// Ctrl+C; how it ended.
    pub fn interrupt(mut self) -> std::process::ExitStatus {
        let process = i32::try_from(self.child.id()).expect("process ids are small");
        // SAFETY: the child has not been waited for, so its id is its own.
        unsafe { libc::kill(process, libc::SIGINT) };
        let started = Instant::now();
        while self.is_running() {
            assert!(started.elapsed() < PATIENCE, "it goes on");
            std::thread::sleep(Duration::from_millis(5));
        }
        self.child.wait().expect("it can be waited for")
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        // It may have ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Response {
    fn parse(bytes: &[u8]) -> Self {
        let end = bytes.windows(4).position(|w| w == b"\r\n\r\n");
        let end =
            end.unwrap_or_else(|| panic!("no response: {:?}", String::from_utf8_lossy(bytes)));
        let headers = String::from_utf8_lossy(&bytes[..end]).into_owned();
        let status = headers.split(' ').nth(1).and_then(|s| s.parse().ok()).expect("a status");
        Self { status, headers, body: bytes[end + 4..].to_vec() }
    }

    pub fn text(&self) -> String {
        String::from_utf8_lossy(&self.body).into_owned()
    }

    /// A header's value.
    pub fn header(&self, name: &str) -> Option<&str> {
        let lines = self.headers.lines().skip(1).filter_map(|line| line.split_once(':'));
        lines.into_iter().find(|(n, _)| n.eq_ignore_ascii_case(name)).map(|(_, v)| v.trim())
    }
}
