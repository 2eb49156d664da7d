//! What the program asks of the machine: files written whole, child processes, time, bounded caches.

mod cache;
pub(crate) mod process;
mod stopwatch;
mod write;

pub use cache::BoundedCache;
pub use stopwatch::{Elapsed, Stopwatch, process_cpu_s};
pub use write::{write_atomically, write_json};
