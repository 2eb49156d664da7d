//! Progress and cancellation of rendering.

use super::RenderError;

/// The progress callback of rendering, which can also stop it.
#[derive(Clone, Copy)]
pub struct Context<'a> {
    proceed: &'a (dyn Fn(usize, usize) -> bool + Sync),
    done: usize,
    total: usize,
}

impl<'a> Context<'a> {
    /// A context with the callback `proceed(done, total)`, which is called before every step with the number of
    /// finished instants and of all instants. If it returns false, rendering ends with [`RenderError::Stopped`]. It may
    /// be called from several threads.
    pub fn new(proceed: &'a (dyn Fn(usize, usize) -> bool + Sync)) -> Self {
        Self { proceed, done: 0, total: 1 }
    }

    /// A context without progress reports, which never stops rendering.
    pub fn unattended() -> Self {
        Self::new(&|_, _| true)
    }

    /// The context for the instant after `done` of `total` instants.
    pub(super) fn at(self, done: usize, total: usize) -> Self {
        Self { done, total, ..self }
    }

    /// Reports progress to the callback.
    ///
    /// # Errors
    /// [`RenderError::Stopped`] if the callback stops rendering.
    pub fn check(&self) -> Result<(), RenderError> {
        if (self.proceed)(self.done, self.total) { Ok(()) } else { Err(RenderError::Stopped) }
    }
}
