//! Wall-clock and processor time.

use serde::{Deserialize, Serialize};
use std::time::Instant;

/// What some work took.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Elapsed {
    pub wall_s: f64,
    /// Of the processor, over all threads: other work on the machine adds little to it.
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

/// Seconds of processor time that this process has used, over all its threads.
pub fn process_cpu_s() -> f64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the structure is there to be written to.
    let result = unsafe { libc::clock_gettime(libc::CLOCK_PROCESS_CPUTIME_ID, &mut time) };
    if result == 0 { time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64 } else { 0.0 }
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
