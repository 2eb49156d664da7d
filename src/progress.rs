//! Progress with time left, on a terminal; nothing elsewhere.

use indicatif::{ProgressBar, ProgressStyle};

/// Where long work reports to: standard error, and only if that is a terminal.
#[derive(Clone, Copy, Debug)]
pub struct Reporter {
    quiet: bool,
}

/// One piece of long work; its bar vanishes when it is dropped.
pub struct Task(ProgressBar);

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

    /// One sentence for the user.
    pub fn note(&self, sentence: &str) {
        if !self.quiet {
            eprintln!("{sentence}");
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
}

impl Drop for Task {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}
