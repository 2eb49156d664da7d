//! Progress with time left, on a terminal; nothing elsewhere.

use crate::text::printable;
use indicatif::{ProgressBar, ProgressStyle};
use std::io::Write;
use std::time::Duration;

/// Where long work reports to: standard error, and only if that is a terminal.
#[derive(Clone, Copy, Debug)]
pub struct Reporter {
    quiet: bool,
}

/// One piece of long work; its bar vanishes when it is dropped.
pub struct Task(ProgressBar);

/// How often a phase shows that it is alive.
const TICK: Duration = Duration::from_millis(200);

impl Reporter {
    pub fn new(quiet: bool) -> Self {
        Self { quiet }
    }

    /// Reports nothing.
    pub fn silent() -> Self {
        Self { quiet: true }
    }

    pub fn is_quiet(&self) -> bool {
        self.quiet
    }

    /// Starts a bar of `total` steps.
    pub fn task(&self, label: &str, total: usize) -> Task {
        if self.quiet {
            return Task(ProgressBar::hidden());
        }
        let style = ProgressStyle::with_template("{msg:28} {bar:30} {pos}/{len}  {eta} left")
            .expect("the template is a constant")
            .progress_chars("━╸ ");
        Task(ProgressBar::new(total as u64).with_style(style).with_message(label.to_owned()))
    }

    /// Starts work whose steps can't be counted: its time so far is shown.
    pub fn phase(&self, label: &str) -> Task {
        if self.quiet {
            return Task(ProgressBar::hidden());
        }
        let style = ProgressStyle::with_template("{spinner} {msg}  {elapsed}")
            .expect("the template is a constant");
        let bar = ProgressBar::new_spinner().with_style(style).with_message(label.to_owned());
        bar.enable_steady_tick(TICK);
        Task(bar)
    }

    /// One sentence for the user.
    pub fn note(&self, sentence: &str) {
        if !self.quiet {
            // A note that nobody can read is none.
            let _ = writeln!(std::io::stderr(), "{}", printable(sentence));
        }
    }
}

impl Task {
    pub fn advance(&self, steps: usize) {
        self.0.inc(steps as u64);
    }

    pub fn set(&self, done: usize) {
        self.0.set_position(done as u64);
    }

    /// Says that `done` steps were there before, which tells nothing about the time left.
    pub fn resume_at(&self, done: usize) {
        self.0.set_position(done as u64);
        self.0.reset_eta();
    }

    /// Replaces the label.
    pub fn describe(&self, label: &str) {
        self.0.set_message(label.to_owned());
    }

    /// Takes it off the terminal before its end.
    pub fn hide(&self) {
        self.0.finish_and_clear();
    }
}

impl Drop for Task {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}
