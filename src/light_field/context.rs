//! Progress and cancellation of rendering.

use super::RenderError;

/// What rendering is asked to tell, and whether it may go on.
#[derive(Clone, Copy)]
pub struct Context<'a> {
    proceed: &'a (dyn Fn(usize, usize) -> bool + Sync),
    done: usize,
    total: usize,
}

impl<'a> Context<'a> {
    /// Calls `proceed(done, total)` before every step, with the number of finished instants and of all; rendering
    /// ends with [`RenderError::Stopped`] where it returns false. Calls may come from several threads.
    pub fn new(proceed: &'a (dyn Fn(usize, usize) -> bool + Sync)) -> Self {
        Self { proceed, done: 0, total: 1 }
    }

    /// Tells nobody, and is never stopped.
    pub fn unattended() -> Self {
        Self::new(&|_, _| true)
    }

    /// The context of instant `done` of `total`.
    pub(super) fn at(self, done: usize, total: usize) -> Self {
        Self { done, total, ..self }
    }

    /// # Errors
    /// [`RenderError::Stopped`] if rendering may not go on.
    pub fn check(&self) -> Result<(), RenderError> {
        if (self.proceed)(self.done, self.total) { Ok(()) } else { Err(RenderError::Stopped) }
    }
}
