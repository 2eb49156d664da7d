//! What the program asks of the machine: files written whole, child processes, signals, time, bounded
//! caches.

mod cache;
mod interrupt;
mod obstacle;
pub(crate) mod process;
mod stopwatch;
pub(crate) mod temporary;
mod write;

pub use cache::BoundedCache;
pub use interrupt::remove_unfinished_on_signals;
pub use obstacle::obstacle;
pub use stopwatch::{Elapsed, Stopwatch, process_cpu_s};
pub use write::{try_folder, write_atomically, write_json};
