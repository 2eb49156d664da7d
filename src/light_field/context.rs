//! Progress and cancellation of rendering.

use super::RenderError;

/// Progress callback of rendering, which can also stop the rendering.
#[derive(Clone, Copy)]
pub struct Context<'a> {
    proceed: &'a (dyn Fn(usize, usize) -> bool + Sync),
    done: usize,
    total: usize,
}

impl<'a> Context<'a> {
    /// Creates a context with the callback `proceed(done, total)`. It is called before every step with two numbers: the
    /// finished instants, and all instants to be rendered (more than 1 for a motion trail). If the callback returns
    /// false, rendering ends with [`RenderError::Stopped`]. The callback may be called from several threads.
    pub fn new(proceed: &'a (dyn Fn(usize, usize) -> bool + Sync)) -> Self {
        Self { proceed, done: 0, total: 1 }
    }

    /// Creates a context that reports no progress and never stops rendering.
    pub fn unattended() -> Self {
        Self::new(&|_, _| true)
    }

    /// Returns the context for the next instant, after `done` of `total` instants are finished.
    pub(super) fn at(self, done: usize, total: usize) -> Self {
        Self { done, total, ..self }
    }

    /// Calls the progress callback, and checks whether rendering may continue.
    ///
    /// # Errors
    /// [`RenderError::Stopped`] if the callback stops rendering.
    pub fn check(&self) -> Result<(), RenderError> {
        if (self.proceed)(self.done, self.total) { Ok(()) } else { Err(RenderError::Stopped) }
    }
}
