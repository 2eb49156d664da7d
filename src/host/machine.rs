//! Functions of the machine on which the program runs: worker threads, locks, clocks, and settings of glibc's
//! allocator.

use serde::{Deserialize, Serialize};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Runs `work` on a thread of rayon's pool, and returns its result.
///
/// On any other thread, each parallel loop in `work` would wake a pool thread before the calling thread sleeps. If no
/// core is free, both threads would then share a core for milliseconds.
pub fn on_workers<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    rayon::scope(|_| work())
}

/// Locks a mutex, even if a thread has panicked while it held the lock. The value in the mutex must therefore be
/// consistent at any time.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Wall-clock time and processor time that a computation took.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Elapsed {
    /// Wall-clock time, seconds.
    pub wall_s: f64,
    /// Processor time of all threads of this process, seconds. Other programs on the machine hardly affect it.
    pub cpu_s: f64,
}

/// Measures wall-clock time and processor time since its start.
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

/// Returns the size of the machine's memory, bytes. `None` if the system doesn't report it.
pub fn memory_bytes() -> Option<usize> {
    // SAFETY: the calls only read constants of the system.
    let [pages, page_bytes] =
        [libc::_SC_PHYS_PAGES, libc::_SC_PAGESIZE].map(|name| unsafe { libc::sysconf(name) });
    let [pages, page_bytes] = [usize::try_from(pages).ok()?, usize::try_from(page_bytes).ok()?];
    pages.checked_mul(page_bytes)
}

/// Returns the processor time that all threads of this process have used so far, seconds. 0 if the system doesn't
/// report it.
pub fn process_cpu_s() -> f64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `time` is a valid structure that the call fills in.
    let result = unsafe { libc::clock_gettime(libc::CLOCK_PROCESS_CPUTIME_ID, &mut time) };
    if result == 0 { time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64 } else { 0.0 }
}

/// Makes glibc's allocator keep freed memory, so that later allocations, such as of the next image, reuse it.
/// Otherwise, freed memory is returned to the kernel, which clears it before it can be used again. For the main
/// function of programs, not for libraries. Has no effect without glibc.
pub fn reuse_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        // Only blocks of at least 32 MiB get memory mappings of their own, which are returned to the kernel when they
        // are freed.
        set_allocator(libc::M_MMAP_THRESHOLD, 32 << 20);
        // The main arena keeps at most 128 MiB of free memory.
        set_allocator(libc::M_TRIM_THRESHOLD, 128 << 20);
    }
}

/// Limits glibc's allocator to two arenas (pools of memory for groups of threads). Each arena keeps the memory that its
/// threads have freed, so that many arenas take much memory in a server. Has no effect without glibc.
pub fn bound_arenas() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    set_allocator(libc::M_ARENA_MAX, 2);
}

#[cfg(all(target_os = "linux", target_env = "gnu"))]
fn set_allocator(parameter: i32, value: i32) {
    // SAFETY: the call sets a parameter of the allocator. It neither allocates nor frees memory.
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
