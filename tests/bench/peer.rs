//! OpenCV as a peer, in a process of its own; `klt_peer.py` documents its commands.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

/// A running peer process, which ends when this is dropped.
pub struct Peer {
    child: Child,
    commands: Option<ChildStdin>,
    answers: BufReader<ChildStdout>,
}

/// The time that a command took, milliseconds.
#[derive(Clone, Copy)]
pub struct Spent {
    pub processor_ms: f64,
    pub wall_ms: f64,
}

impl Peer {
    /// Starts the peer in the project's Python environment, which `stlfr setup` makes.
    ///
    /// # Panics
    /// If the environment is missing.
    pub fn start() -> Self {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let mut child = Command::new(root.join(".venv/bin/python"))
            .arg(root.join("tests/bench/klt_peer.py"))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .expect("the environment is set up (stlfr setup)");
        let commands = child.stdin.take();
        let answers = BufReader::new(child.stdout.take().expect("it is piped"));
        Self { child, commands, answers }
    }

    /// Sends a command and waits for its answer.
    ///
    /// # Panics
    /// If the peer fails.
    pub fn ask(&mut self, command: &str) -> Spent {
        let stdin = self.commands.as_mut().expect("it is open until the end");
        writeln!(stdin, "{command}").expect("the peer listens");
        let mut line = String::new();
        self.answers.read_line(&mut line).expect("the peer answers");
        let mut numbers = line.split_whitespace().map(|n| n.parse().expect("milliseconds"));
        let mut next = || numbers.next().unwrap_or_else(|| panic!("{command}: {line}"));
        Spent { processor_ms: next(), wall_ms: next() }
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        // At the end of its input it ends.
        self.commands = None;
        let _ = self.child.wait();
    }
}
