//! Child processes, each with a process group of its own. A group is ended when its [`Process`] is dropped, or when a
//! signal ends the program: by SIGTERM, and after a grace period by SIGKILL.

use super::machine::lock;
use std::collections::BTreeSet;
use std::io::{BufRead, BufReader, Read, Result};
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};
use std::sync::Mutex;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Time that a child has to end after SIGTERM.
const GRACE: Duration = Duration::from_secs(if cfg!(test) { 1 } else { 5 });

/// The children that run, whose ids are those of their groups.
static RUNNING: Mutex<BTreeSet<i32>> = Mutex::new(BTreeSet::new());

/// A running child process. Dropping it ends its group, and waits for its end. If this process is killed,
/// the child gets a SIGTERM too (Linux only).
pub(crate) struct Process {
    child: Child,
    id: i32,
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
        command.process_group(0).stdin(stdin).stdout(Stdio::piped()).stderr(Stdio::piped());
        // Under the mutex, so that a signal finds either no child or one that is listed.
        let mut running = lock(&RUNNING);
        let mut child = command.spawn()?;
        let id = child.id().cast_signed();
        running.insert(id);
        drop(running);
        let stderr = child.stderr.take().map(|mut pipe| {
            std::thread::spawn(move || {
                let mut bytes = Vec::new();
                // What can't be read any more can't be reported either.
                let _ = pipe.read_to_end(&mut bytes);
                String::from_utf8_lossy(&bytes).into_owned()
            })
        });
        Ok(Self { child, id, stderr })
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
            end_groups([self.id]);
            // It ended or can't be reached; in neither case is there anything left to do.
            let _ = self.child.wait();
        }
        lock(&RUNNING).remove(&self.id);
    }
}

/// Ends all children of this process. No child starts afterwards: the caller ends the process.
pub(super) fn end_all() {
    let running = lock(&RUNNING);
    end_groups(running.iter().copied());
    std::mem::forget(running);
}

/// Ends the groups of children that haven't been waited for: by SIGTERM, then by SIGKILL.
fn end_groups(ids: impl IntoIterator<Item = i32> + Clone) {
    let signal = |id: i32, signal| {
        // SAFETY: plain numbers; a group that is gone is an error without effect.
        unsafe { libc::kill(-id, signal) };
    };
    ids.clone().into_iter().for_each(|id| signal(id, libc::SIGTERM));
    let start = Instant::now();
    while ids.clone().into_iter().any(is_running) && start.elapsed() < GRACE {
        std::thread::sleep(Duration::from_millis(10));
    }
    ids.into_iter().for_each(|id| signal(id, libc::SIGKILL));
}

/// Whether a child of this process runs. Its exit status stays for the one who waits for it.
fn is_running(id: i32) -> bool {
    let flags = libc::WEXITED | libc::WNOHANG | libc::WNOWAIT;
    // SAFETY: zeros are a valid value, which the call fills in.
    unsafe {
        let mut state: libc::siginfo_t = std::mem::zeroed();
        libc::waitid(libc::P_PID, id.cast_unsigned(), &mut state, flags) == 0 && state.si_pid() == 0
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

    #[test]
    fn a_child_that_ignores_sigterm_is_killed_with_its_own_children() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("id");
        let script = "trap '' TERM; sleep 60 & echo $! > id; wait; sleep 60";
        let mut command = Command::new("sh");
        command.args(["-c", script]).current_dir(&folder);
        let process = Process::start(&mut command, Stdio::null()).unwrap();
        let id = || std::fs::read_to_string(&file).ok().filter(|text| text.ends_with('\n'));
        let grandchild = std::iter::repeat_with(id).flatten().next().unwrap();
        let start = Instant::now();
        drop(process);
        assert!(start.elapsed() < Duration::from_secs(10));
        // It is gone, or waits for its new parent to take notice.
        let lives = || {
            let state = std::fs::read_to_string(format!("/proc/{}/stat", grandchild.trim()));
            state.is_ok_and(|state| !state.contains(") Z "))
        };
        while lives() {
            assert!(start.elapsed() < Duration::from_secs(10), "the grandchild lives on");
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}
