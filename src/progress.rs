//! Progress reports: a bar with time left on a terminal, or JSON lines for another program.

use crate::text::printable;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde_json::json;
use std::io::Write;
use std::time::Duration;

/// Receives progress: bars on standard error if that is a terminal, or lines on standard output.
#[derive(Clone, Copy, Debug)]
pub struct Reporter {
    to: Listener,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Listener {
    Nobody,
    Terminal,
    Lines,
}

/// A running task; its bar disappears when it is dropped.
pub struct Task {
    bar: ProgressBar,
    in_lines: bool,
}

/// Interval at which the spinner of a phase moves.
const TICK: Duration = Duration::from_millis(200);

impl Reporter {
    pub fn new(quiet: bool) -> Self {
        Self { to: if quiet { Listener::Nobody } else { Listener::Terminal } }
    }

    /// A reporter that prints nothing.
    pub fn silent() -> Self {
        Self { to: Listener::Nobody }
    }

    /// A reporter that prints counted steps as lines `{"done", "total", "what"}` on standard output.
    pub fn lines() -> Self {
        Self { to: Listener::Lines }
    }

    /// Starts a bar of `total` steps.
    pub fn task(&self, label: &str, total: usize) -> Task {
        let template = "{msg:28} {bar:30} {pos}/{len}  {eta} left";
        let bar = self.bar(label, Some(total as u64), template);
        let task = Task { bar, in_lines: self.to == Listener::Lines };
        task.say();
        task
    }

    /// Starts a task without counted steps, which shows its elapsed time.
    pub fn phase(&self, label: &str) -> Task {
        let bar = self.bar(label, None, "{spinner} {msg}  {elapsed}");
        if self.to == Listener::Terminal {
            bar.enable_steady_tick(TICK);
        }
        Task { bar, in_lines: false }
    }

    fn bar(&self, label: &str, total: Option<u64>, template: &str) -> ProgressBar {
        let target = match self.to {
            Listener::Terminal => ProgressDrawTarget::stderr(),
            Listener::Nobody | Listener::Lines => ProgressDrawTarget::hidden(),
        };
        let style = ProgressStyle::with_template(template).expect("the template is a constant");
        let bar = ProgressBar::with_draw_target(total, target).with_message(label.to_owned());
        bar.with_style(style.progress_chars("━╸ "))
    }

    /// Shows one sentence to the user.
    pub fn note(&self, sentence: &str) {
        if self.to == Listener::Terminal {
            // A note is lost if standard error can't be written.
            let _ = writeln!(std::io::stderr(), "{}", printable(sentence));
        }
    }
}

impl Task {
    pub fn advance(&self, steps: usize) {
        self.bar.inc(steps as u64);
        self.say();
    }

    pub fn set(&self, done: usize) {
        self.bar.set_position(done as u64);
        self.say();
    }

    /// Marks `done` steps as done earlier, so that they don't count for the time left.
    pub fn resume_at(&self, done: usize) {
        self.bar.set_position(done as u64);
        self.bar.reset_eta();
    }

    /// Replaces the label of the task.
    pub fn describe(&self, label: &str) {
        self.bar.set_message(label.to_owned());
    }

    /// Prints the progress as a line; errors of standard output are ignored.
    fn say(&self) {
        if self.in_lines {
            let (done, total) = (self.bar.position(), self.bar.length().unwrap_or(0));
            let said = json!({ "done": done, "total": total, "what": self.bar.message() });
            let _ = writeln!(std::io::stdout(), "{said}");
        }
    }

    /// Removes the bar before the task ends.
    pub fn hide(&self) {
        self.bar.finish_and_clear();
    }
}

impl Drop for Task {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
