//! Work on all cores.

/// Runs `work` on one of rayon's threads.
///
/// Called from another thread, each parallel loop of the work would wake one of rayon's threads, and that one the next,
/// while the caller is still about to sleep: with no core free, the scheduler lets two of them share one for
/// milliseconds.
pub fn on_workers<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    rayon::scope(|_| work())
}
