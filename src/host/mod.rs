//! What the program asks of the machine: files read within bounds and written whole, child processes,
//! signals, time, memory, caches in memory and on disk.

mod allocator;
mod cache;
mod disk_cache;
mod file_hashes;
mod interrupt;
mod memo;
mod obstacle;
pub(crate) mod process;
mod read;
mod stopwatch;
pub(crate) mod temporary;
mod workers;
mod write;

pub use allocator::{bound_arenas, reuse_freed_memory};
pub use cache::BoundedCache;
pub use disk_cache::{CacheKind, CacheUse, DiskCache};
pub(crate) use file_hashes::file_hashes;
pub use interrupt::remove_unfinished_on_signals;
pub use memo::Memo;
pub use obstacle::obstacle;
pub(crate) use obstacle::remove_special;
pub(crate) use read::hash_file;
pub use read::{open_bounded, open_file, read_bytes, read_text};
pub use stopwatch::{Elapsed, Stopwatch, process_cpu_s};
pub use workers::on_workers;
pub use write::{try_folder, write_atomically, write_json};
