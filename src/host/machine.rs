//! The machine: its worker threads, locks, its clocks, and glibc's allocator.

use serde::{Deserialize, Serialize};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Runs `work` on one of rayon's threads.
///
/// On any other thread, each parallel loop in `work` would wake a thread of rayon's before the calling thread sleeps.
/// If no core is free, the scheduler lets two threads share one for milliseconds.
pub fn on_workers<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    rayon::scope(|_| work())
}

/// Locks a mutex, even if a thread panicked while it held the lock. The value must be consistent at any time.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Time that a computation took.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Elapsed {
    pub wall_s: f64,
    /// Processor time of all threads of this process: other programs on the machine add little to it.
    pub cpu_s: f64,
}

/// Measures the time since it was started.
pub struct Stopwatch {
    wall: Instant,
    cpu_s: f64,
}

impl Stopwatch {
    pub fn start() -> Self {
        Self { wall: Instant::now(), cpu_s: process_cpu_s() }
    }

    pub fn elapsed(&self) -> Elapsed {
        Elapsed { wall_s: self.wall.elapsed().as_secs_f64(), cpu_s: process_cpu_s() - self.cpu_s }
    }
}

/// Processor time that this process has used, over all its threads, seconds.
pub fn process_cpu_s() -> f64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the structure is there to be written to.
    let result = unsafe { libc::clock_gettime(libc::CLOCK_PROCESS_CPUTIME_ID, &mut time) };
    if result == 0 { time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64 } else { 0.0 }
}

/// Keeps freed memory for the next image instead of returning it to the kernel, which would clear it again. For programs;
/// a library leaves the allocator to its process. Does nothing without glibc.
pub fn reuse_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        // Blocks of at least 32 MiB are mapped one by one.
        set_allocator(libc::M_MMAP_THRESHOLD, 32 << 20);
        // The main arena keeps up to 128 MiB of free memory.
        set_allocator(libc::M_TRIM_THRESHOLD, 128 << 20);
    }
}

/// Limits the allocator to two arenas: each keeps what its threads have freed, which adds up in a server. Does nothing
/// without glibc.
pub fn bound_arenas() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    set_allocator(libc::M_ARENA_MAX, 2);
}

#[cfg(all(target_os = "linux", target_env = "gnu"))]
fn set_allocator(parameter: i32, value: i32) {
    // SAFETY: it sets a number of the allocator, which takes effect where memory is next allocated or freed.
    unsafe {
        libc::mallopt(parameter, value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_takes_both_and_sleep_only_one() {
        let watch = Stopwatch::start();
        let mut sum = 0.0_f64;
        while watch.elapsed().cpu_s < 0.01 {
            sum += sum.sin() + 1.0;
        }
        assert!(sum > 0.0 && watch.elapsed().wall_s > 0.0);
        let watch = Stopwatch::start();
        std::thread::sleep(std::time::Duration::from_millis(30));
        assert!(watch.elapsed().wall_s >= 0.03);
    }
}
