//! Child processes, each of which is ended when its [`Process`] is dropped.

use std::io::{BufRead, BufReader, Read, Result};
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};
use std::thread::JoinHandle;

/// A running child process. Dropping it sends SIGTERM and waits for its end. If this process is killed,
/// the child gets a SIGTERM too (Linux only).
pub(crate) struct Process {
    child: Child,
    stderr: Option<JoinHandle<String>>,
}

/// A child's exit status and error output.
pub(crate) struct Ended {
    pub status: ExitStatus,
    pub stderr: String,
}

impl Process {
    /// Starts a command. Its stdout is piped to this process; its stderr is collected.
    pub fn start(command: &mut Command, stdin: Stdio) -> Result<Self> {
        end_with_parent(command);
        let mut child =
            command.stdin(stdin).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn()?;
        let stderr = child.stderr.take().map(|mut pipe| {
            std::thread::spawn(move || {
                let mut bytes = Vec::new();
                // What can't be read any more can't be reported either.
                let _ = pipe.read_to_end(&mut bytes);
                String::from_utf8_lossy(&bytes).into_owned()
            })
        });
        Ok(Self { child, stderr })
    }

    /// The child's standard input, if it was piped and not taken before.
    pub fn take_stdin(&mut self) -> Option<ChildStdin> {
        self.child.stdin.take()
    }

    /// Waits until the child has ended.
    pub fn wait(mut self) -> Result<Ended> {
        let status = self.child.wait()?;
        let stderr = self.stderr.take().and_then(|t| t.join().ok()).unwrap_or_default();
        Ok(Ended { status, stderr })
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if matches!(self.child.try_wait(), Ok(None)) {
            if let Ok(pid) = i32::try_from(self.child.id()) {
                // SAFETY: the child has not been waited for, so its id is still its own.
                unsafe { libc::kill(pid, libc::SIGTERM) };
            }
            // It ended or can't be reached; in neither case is there anything left to do.
            let _ = self.child.wait();
        }
    }
}

/// Runs a command to its end, with nothing on stdin; calls `on_line` with every line of its stdout.
pub(crate) fn run(command: &mut Command, mut on_line: impl FnMut(&str)) -> Result<Ended> {
    let mut process = Process::start(command, Stdio::null())?;
    if let Some(stdout) = process.child.stdout.take() {
        let mut reader = BufReader::new(stdout);
        let mut line = Vec::new();
        while reader.read_until(b'\n', &mut line)? > 0 {
            on_line(String::from_utf8_lossy(&line).trim_end());
            line.clear();
        }
    }
    process.wait()
}

/// Lets the kernel end the child when the thread that starts it ends. In all uses, this thread waits for the child.
#[cfg(target_os = "linux")]
fn end_with_parent(command: &mut Command) {
    use std::os::unix::process::CommandExt;
    // SAFETY: between fork and exec only async-signal-safe functions may run; prctl is one.
    unsafe {
        command.pre_exec(|| match libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGTERM) {
            0 => Ok(()),
            _ => Err(std::io::Error::last_os_error()),
        });
    }
}

#[cfg(not(target_os = "linux"))]
fn end_with_parent(_: &mut Command) {}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::{Duration, Instant};

    #[test]
    fn lines_status_and_stderr_come_back() {
        let mut lines = Vec::new();
        let ended = run(
            Command::new("sh").args(["-c", "echo one; echo two; echo wrong >&2; exit 3"]),
            |line| lines.push(line.to_owned()),
        )
        .unwrap();
        assert_eq!(lines, ["one", "two"]);
        assert_eq!((ended.status.code(), ended.stderr.as_str()), (Some(3), "wrong\n"));
    }

    #[test]
    fn a_dropped_child_is_ended() {
        let start = Instant::now();
        drop(Process::start(Command::new("sleep").arg("60"), Stdio::null()).unwrap());
        assert!(start.elapsed() < Duration::from_secs(10));
    }
}
