//! Progress with time left, on a terminal; one JSON line a step for a program that asks for them; nothing elsewhere.

use crate::text::printable;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde_json::json;
use std::io::Write;
use std::time::Duration;

/// Where long work reports to: standard error, and only if that is a terminal; or, in lines, standard output.
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

/// One piece of long work; its bar vanishes when it is dropped.
pub struct Task {
    bar: ProgressBar,
    in_lines: bool,
}

/// How often a phase shows that it is alive.
const TICK: Duration = Duration::from_millis(200);

impl Reporter {
    pub fn new(quiet: bool) -> Self {
        Self { to: if quiet { Listener::Nobody } else { Listener::Terminal } }
    }

    /// Reports nothing.
    pub fn silent() -> Self {
        Self { to: Listener::Nobody }
    }

    /// Steps that can be counted, as lines `{"done", "total", "what"}` on standard output.
    pub fn lines() -> Self {
        Self { to: Listener::Lines }
    }

    pub fn is_quiet(&self) -> bool {
        self.to == Listener::Nobody
    }

    /// Starts a bar of `total` steps.
    pub fn task(&self, label: &str, total: usize) -> Task {
        let bar = match self.to {
            Listener::Nobody => ProgressBar::hidden(),
            Listener::Lines => {
                ProgressBar::with_draw_target(Some(total as u64), ProgressDrawTarget::hidden())
            }
            Listener::Terminal => {
                let style =
                    ProgressStyle::with_template("{msg:28} {bar:30} {pos}/{len}  {eta} left")
                        .expect("the template is a constant")
                        .progress_chars("━╸ ");
                ProgressBar::new(total as u64).with_style(style)
            }
        };
        let task =
            Task { bar: bar.with_message(label.to_owned()), in_lines: self.to == Listener::Lines };
        task.say();
        task
    }

    /// Starts work whose steps can't be counted: its time so far is shown.
    pub fn phase(&self, label: &str) -> Task {
        if self.to != Listener::Terminal {
            return Task { bar: ProgressBar::hidden(), in_lines: false };
        }
        let style = ProgressStyle::with_template("{spinner} {msg}  {elapsed}")
            .expect("the template is a constant");
        let bar = ProgressBar::new_spinner().with_style(style).with_message(label.to_owned());
        bar.enable_steady_tick(TICK);
        Task { bar, in_lines: false }
    }

    /// One sentence for the user.
    pub fn note(&self, sentence: &str) {
        if self.to == Listener::Terminal {
            // A note that nobody can read is none.
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

    /// Says that `done` steps were there before, which tells nothing about the time left.
    pub fn resume_at(&self, done: usize) {
        self.bar.set_position(done as u64);
        self.bar.reset_eta();
    }

    /// Replaces the label.
    pub fn describe(&self, label: &str) {
        self.bar.set_message(label.to_owned());
    }

    /// How far it is, as a line. A line that nobody can read is none.
    fn say(&self) {
        if self.in_lines {
            let (done, total) = (self.bar.position(), self.bar.length().unwrap_or(0));
            let said = json!({ "done": done, "total": total, "what": self.bar.message() });
            let _ = writeln!(std::io::stdout(), "{said}");
        }
    }

    /// Takes it off the terminal before its end.
    pub fn hide(&self) {
        self.bar.finish_and_clear();
    }
}

impl Drop for Task {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
