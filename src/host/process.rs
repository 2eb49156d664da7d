//! Child processes. Each child has its own process group. When its [`Process`] is dropped, or when a signal ends the
//! program, the group is ended: by SIGTERM, and after a grace period by SIGKILL.

use super::machine::lock;
use std::collections::BTreeSet;
use std::io::{BufRead, BufReader, Read, Result};
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};
use std::sync::Mutex;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Maximum time between SIGTERM and SIGKILL when a process group is ended. If all children end earlier, SIGKILL follows
/// at once.
const GRACE: Duration = Duration::from_secs(if cfg!(test) { 1 } else { 5 });

/// Process ids of the running children. They are also the ids of the children's process groups.
static RUNNING: Mutex<BTreeSet<i32>> = Mutex::new(BTreeSet::new());

/// A running child process. Dropping this value ends the child's process group, and waits until the child has ended. On
/// Linux, the child also receives SIGTERM if this process is killed.
pub(crate) struct Process {
    child: Child,
    id: i32,
    stderr: Option<JoinHandle<String>>,
}

/// Exit status and error output of a child process that has ended.
pub(crate) struct Ended {
    pub status: ExitStatus,
    pub stderr: String,
}

impl Process {
    /// Starts a command in a new process group. Its stdout is piped to this process. Its stderr is collected.
    pub fn start(command: &mut Command, stdin: Stdio) -> Result<Self> {
        end_with_parent(command);
        command.process_group(0).stdin(stdin).stdout(Stdio::piped()).stderr(Stdio::piped());
        // The mutex is locked until the child is in the list, so that a signal handler knows every running child.
        let mut running = lock(&RUNNING);
        let mut child = command.spawn()?;
        let id = child.id().cast_signed();
        running.insert(id);
        drop(running);
        let stderr = child.stderr.take().map(|mut pipe| {
            std::thread::spawn(move || {
                let mut bytes = Vec::new();
                // An error means that no more output can be read.
                let _ = pipe.read_to_end(&mut bytes);
                String::from_utf8_lossy(&bytes).into_owned()
            })
        });
        Ok(Self { child, id, stderr })
    }

    /// Takes the pipe to the child's standard input. `None` if the standard input is not piped, or if the pipe was
    /// already taken.
    pub fn take_stdin(&mut self) -> Option<ChildStdin> {
        self.child.stdin.take()
    }

    /// Waits until the child has ended. Returns its exit status and its stderr.
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
            // If waiting fails, the child is gone, and nothing remains to be done.
            let _ = self.child.wait();
        }
        lock(&RUNNING).remove(&self.id);
    }
}

/// Ends all children of this process, and prevents new children from starting. The caller must end this process
/// afterwards.
pub(super) fn end_all() {
    let running = lock(&RUNNING);
    end_groups(running.iter().copied());
    std::mem::forget(running);
}

/// Ends process groups. Sends SIGTERM, waits until the children have ended, but no longer than [`GRACE`], and then
/// sends SIGKILL to end the rest of each group. `ids` are the ids of children for which this process hasn't waited yet.
fn end_groups(ids: impl IntoIterator<Item = i32> + Clone) {
    let signal = |id: i32, signal| {
        // SAFETY: the arguments are plain numbers. A group that doesn't exist is an error without effect.
        unsafe { libc::kill(-id, signal) };
    };
    ids.clone().into_iter().for_each(|id| signal(id, libc::SIGTERM));
    let start = Instant::now();
    while ids.clone().into_iter().any(is_running) && start.elapsed() < GRACE {
        std::thread::sleep(Duration::from_millis(10));
    }
    ids.into_iter().for_each(|id| signal(id, libc::SIGKILL));
}

/// Returns whether a child of this process is running. The child's exit status remains available to `wait`.
fn is_running(id: i32) -> bool {
    let flags = libc::WEXITED | libc::WNOHANG | libc::WNOWAIT;
    // SAFETY: the structure is valid when all of its bytes are 0, and the call fills it in.
    unsafe {
        let mut state: libc::siginfo_t = std::mem::zeroed();
        libc::waitid(libc::P_PID, id.cast_unsigned(), &mut state, flags) == 0 && state.si_pid() == 0
    }
}

/// Runs a command to its end, with an empty stdin. Calls `on_line` with every line of the command's stdout. Returns the
/// exit status and the stderr.
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

/// Makes the kernel send SIGTERM to the child when the thread that started the child ends. This signal never ends a
/// child too early, because every caller waits for the child on the thread that started it.
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
        // The child is gone, or is a zombie that its new parent hasn't waited for yet.
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
