//! Progress reports: on a terminal, a bar with the time left; in a log, a line every half minute; for another program,
//! lines of JSON.

use crate::text::printable;
use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde_json::json;
use std::io::{IsTerminal, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::Duration;

/// Shows the progress of all tasks: as bars on a terminal, or as lines in a log, both on standard error; or as lines of
/// JSON on standard output.
#[derive(Clone, Copy, Debug)]
pub struct Reporter {
    to: Listener,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Listener {
    Nobody,
    Terminal,
    /// Lines of a log on standard error, if standard error isn't a terminal.
    Log,
    Lines,
}

/// A running task, whose progress is shown. Dropping this value removes the task's bar.
pub struct Task {
    bar: ProgressBar,
    in_lines: bool,
    log: Option<Log>,
}

/// Writes a task's progress to a log at regular intervals, until this value is dropped.
struct Log {
    /// Number of the task's steps that an earlier run has done.
    resumed: Arc<AtomicU64>,
    _end: Sender<()>,
}

/// Time between two lines of a progress log.
const LOG_INTERVAL: Duration = Duration::from_secs(30);

/// Time between two frames of the animation for a task without counted steps.
const TICK: Duration = Duration::from_millis(200);

impl Reporter {
    /// Returns a reporter that prints nothing if `quiet` is true. Otherwise, it shows bars if standard error is a
    /// terminal, and lines of a log if it isn't.
    pub fn new(quiet: bool) -> Self {
        Self {
            to: match quiet {
                true => Listener::Nobody,
                false if std::io::stderr().is_terminal() => Listener::Terminal,
                false => Listener::Log,
            },
        }
    }

    /// Returns a reporter that prints nothing.
    pub fn silent() -> Self {
        Self { to: Listener::Nobody }
    }

    /// Returns a reporter for another program. It prints the progress as lines of JSON, `{"done", "total", "what"}`, on
    /// standard output: finished steps, all steps, and the task's label.
    pub fn lines() -> Self {
        Self { to: Listener::Lines }
    }

    /// Starts a task of `total` steps, and shows the number of finished steps and the time left.
    pub fn task(&self, label: &str, total: usize) -> Task {
        let template = "{msg:28} {bar:30} {pos}/{len}  {eta} left";
        let bar = self.bar(label, Some(total as u64), template);
        let task = Task { in_lines: self.to == Listener::Lines, log: self.log(&bar), bar };
        task.say();
        task
    }

    /// Starts a task without counted steps. Its elapsed time is shown.
    pub fn phase(&self, label: &str) -> Task {
        let bar = self.bar(label, None, "{spinner} {msg}  {elapsed}");
        if self.to == Listener::Terminal {
            bar.enable_steady_tick(TICK);
        }
        Task { in_lines: false, log: self.log(&bar), bar }
    }

    fn log(&self, bar: &ProgressBar) -> Option<Log> {
        (self.to == Listener::Log).then(|| {
            follow(bar.clone(), LOG_INTERVAL, |line| {
                // If standard error can't be written, the line is lost.
                let _ = writeln!(std::io::stderr(), "{}", printable(&line));
            })
        })
    }

    fn bar(&self, label: &str, total: Option<u64>, template: &str) -> ProgressBar {
        let target = match self.to {
            Listener::Terminal => ProgressDrawTarget::stderr(),
            _ => ProgressDrawTarget::hidden(),
        };
        let style = ProgressStyle::with_template(template).expect("the template is a constant");
        let bar = ProgressBar::with_draw_target(total, target).with_message(label.to_owned());
        bar.with_style(style.progress_chars("━╸ "))
    }

    /// Shows one sentence to the user on standard error. Reporters that are silent or print JSON don't show it.
    pub fn note(&self, sentence: &str) {
        if matches!(self.to, Listener::Terminal | Listener::Log) {
            // If standard error can't be written, the note is lost.
            let _ = writeln!(std::io::stderr(), "{}", printable(sentence));
        }
    }
}

impl Task {
    /// Adds `steps` to the number of finished steps.
    pub fn advance(&self, steps: usize) {
        self.bar.inc(steps as u64);
        self.say();
    }

    /// Sets the number of finished steps.
    pub fn set(&self, done: usize) {
        self.bar.set_position(done as u64);
        self.say();
    }

    /// Marks `done` steps as done by an earlier run. The estimate of the time left doesn't count these steps.
    pub fn resume_at(&self, done: usize) {
        self.bar.set_position(done as u64);
        self.bar.reset_eta();
        if let Some(log) = &self.log {
            log.resumed.store(done as u64, Relaxed);
        }
    }

    /// Replaces the label of the task.
    pub fn describe(&self, label: &str) {
        self.bar.set_message(label.to_owned());
    }

    /// Prints the progress as a line of JSON, if the reporter prints JSON. Errors of standard output are ignored.
    fn say(&self) {
        if self.in_lines {
            let (done, total) = (self.bar.position(), self.bar.length().unwrap_or(0));
            let said = json!({ "done": done, "total": total, "what": self.bar.message() });
            let _ = writeln!(std::io::stdout(), "{said}");
        }
    }

    /// Removes the task's bar before the task ends.
    pub fn hide(&self) {
        self.bar.finish_and_clear();
    }
}

impl Drop for Task {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// Starts a thread that calls `write` once per `interval`, with the progress of a bar as one line. The thread ends when
/// the bar is finished, or when the returned log is dropped.
fn follow(bar: ProgressBar, interval: Duration, write: impl Fn(String) + Send + 'static) -> Log {
    let (end, ended) = channel();
    let log = Log { resumed: Arc::default(), _end: end };
    let resumed = log.resumed.clone();
    std::thread::spawn(move || {
        let mut estimate = TimeLeft::default();
        while ended.recv_timeout(interval) == Err(RecvTimeoutError::Timeout) && !bar.is_finished() {
            write(state(&bar, resumed.load(Relaxed), &mut estimate));
        }
    });
    log
}

/// Converts a duration to words, rounded to one unit, such as `3 minutes`.
pub fn in_words(seconds: f64) -> String {
    HumanDuration(Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX)).to_string()
}

/// Converts an elapsed time to words, with seconds beside minutes, such as `2:30 minutes`. Successive lines of a log
/// thus differ.
fn elapsed_words(seconds: f64) -> String {
    if seconds < 60.0 {
        return in_words(seconds);
    }
    let whole = seconds as u64;
    format!("{}:{:02} minutes", whole / 60, whole % 60)
}

/// An estimate of the time left, and the progress at which it was made.
#[derive(Clone, Copy, Default)]
struct TimeLeft {
    /// Number of finished steps when the estimate was made.
    done: u64,
    elapsed_s: f64,
    left_s: f64,
}

/// Returns the progress as one line. The time left is extrapolated from the steps of this run, without the first
/// `resumed` steps, which an earlier run has done. A new estimate is made after each finished step. Until the next
/// estimate, the time left counts down from `estimate`.
fn state(bar: &ProgressBar, resumed: u64, estimate: &mut TimeLeft) -> String {
    let (label, done, elapsed_s) = (bar.message(), bar.position(), bar.elapsed().as_secs_f64());
    let Some(total) = bar.length() else {
        return format!("{label}: {} so far", elapsed_words(elapsed_s));
    };
    if done <= resumed {
        return format!("{label}: {done} of {total}");
    }
    if done != estimate.done {
        let left_s = elapsed_s * total.saturating_sub(done) as f64 / (done - resumed) as f64;
        *estimate = TimeLeft { done, elapsed_s, left_s };
    }
    let left_s = (estimate.left_s - (elapsed_s - estimate.elapsed_s)).max(0.0);
    format!("{label}: {done} of {total}, {} left", in_words(left_s))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;

    #[test]
    fn a_log_has_a_line_in_every_interval_until_the_task_ends() {
        let bar = ProgressBar::hidden().with_message("filming");
        bar.set_length(8);
        let (send, lines) = channel();
        let send = Mutex::new(send);
        let log = follow(bar.clone(), Duration::from_millis(5), move |line| {
            let _ = send.lock().unwrap().send(line);
        });
        assert_eq!(lines.recv().unwrap(), "filming: 0 of 8");
        bar.set_position(2);
        assert!(lines.iter().any(|line| line.starts_with("filming: 2 of 8, ")), "{bar:?}");
        drop(log);
        // Dropping the log ends the thread and its sender, so that this loop ends.
        assert!(lines.iter().all(|line| line.starts_with("filming: 2 of 8, ")));
        let now = |seconds| bar.clone().with_elapsed(Duration::from_secs(seconds));
        let first = |bar: &ProgressBar, resumed| state(bar, resumed, &mut TimeLeft::default());
        assert_eq!(first(&now(60), 0), "filming: 2 of 8, 3 minutes left");
        assert_eq!(first(&now(60), 1), "filming: 2 of 8, 6 minutes left");
        assert_eq!(first(&now(60), 2), "filming: 2 of 8");
        let mut estimate = TimeLeft::default();
        let later = [60, 120, 600].map(|seconds| state(&now(seconds), 0, &mut estimate));
        let left = ["3 minutes", "2 minutes", "0 seconds"];
        assert_eq!(later, left.map(|left| format!("filming: 2 of 8, {left} left")));
        let spinner = ProgressBar::new_spinner().with_message("check");
        assert!(first(&spinner, 0).contains("check: 0 seconds so far"));
        let words = [30.0, 60.0, 150.9].map(elapsed_words);
        assert_eq!(words, ["30 seconds", "1:00 minutes", "2:30 minutes"]);
    }
}
