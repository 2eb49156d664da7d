//! Results of earlier work, in memory and on disk, within bounds.

use serde::Serialize;
use std::any::Any;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// BLAKE3 hash of a stage's name and its serialized inputs.
type Key = [u8; blake3::OUT_LEN];

/// A memory of results that several threads share, bounded in bytes: the results used last are cached.
///
/// A key is derived by serializing a stage's inputs. A result must depend on nothing else, so that the memo
/// changes how long work takes and never what comes out of it. Inputs that are the same for the life of the memo
/// (the capture, its clocks) need not be among them.
///
/// Threads that ask for one result at once may all compute it, with equal results. They don't wait for each other:
/// the thread that computes may run, and wait for, the one that would have to wait.
pub struct Memo {
    max_bytes: usize,
    entries: Mutex<Entries>,
}

#[derive(Default)]
struct Entries {
    by_key: HashMap<Key, Entry>,
    bytes: usize,
    /// Number of uses so far, which orders the entries by their last use.
    uses: u64,
}

struct Entry {
    stage: &'static str,
    value: Arc<dyn Any + Send + Sync>,
    bytes: usize,
    last_use: u64,
}

impl Memo {
    /// An empty memo for at most `max_bytes` of results. The result inserted last is cached whatever its size.
    pub fn new(max_bytes: usize) -> Self {
        Self { max_bytes, entries: Mutex::default() }
    }

    /// The bound, bytes.
    pub fn max_bytes(&self) -> usize {
        self.max_bytes
    }

    /// The size of all cached results, bytes.
    pub fn bytes(&self) -> usize {
        self.lock().bytes
    }

    /// The result of a stage for these inputs, if it is cached.
    pub fn get<T: Any + Send + Sync>(
        &self,
        stage: &'static str,
        inputs: &impl Serialize,
    ) -> Option<Arc<T>> {
        let mut entries = self.lock();
        entries.uses += 1;
        let now = entries.uses;
        let entry = entries.by_key.get_mut(&key(stage, inputs))?;
        entry.last_use = now;
        entry.value.clone().downcast().ok()
    }

    /// Caches a result of this size in bytes, and drops those used longest ago until the bound holds.
    pub fn insert<T: Any + Send + Sync>(
        &self,
        stage: &'static str,
        inputs: &impl Serialize,
        value: Arc<T>,
        bytes: usize,
    ) {
        let key = key(stage, inputs);
        let mut entries = self.lock();
        entries.uses += 1;
        let entry = Entry { stage, value, bytes, last_use: entries.uses };
        entries.bytes += bytes;
        if let Some(replaced) = entries.by_key.insert(key, entry) {
            entries.bytes -= replaced.bytes;
        }
        while entries.bytes > self.max_bytes && entries.by_key.len() > 1 {
            let oldest = entries.by_key.iter().min_by_key(|(_, entry)| entry.last_use);
            let Some(key) = oldest.map(|(key, _)| *key) else { break };
            if let Some(dropped) = entries.by_key.remove(&key) {
                entries.bytes -= dropped.bytes;
            }
        }
    }

    /// The cached result of a stage for these inputs, else a new one. `bytes` gives its size.
    pub fn get_or<T: Any + Send + Sync, E>(
        &self,
        stage: &'static str,
        inputs: &impl Serialize,
        bytes: impl FnOnce(&T) -> usize,
        compute: impl FnOnce() -> Result<T, E>,
    ) -> Result<Arc<T>, E> {
        if let Some(value) = self.get(stage, inputs) {
            return Ok(value);
        }
        let value = Arc::new(compute()?);
        let bytes = bytes(&value);
        self.insert(stage, inputs, value.clone(), bytes);
        Ok(value)
    }

    /// Drops the results of the stages that pass.
    pub fn forget(&self, passes: impl Fn(&str) -> bool) {
        let mut entries = self.lock();
        entries.by_key.retain(|_, entry| !passes(entry.stage));
        entries.bytes = entries.by_key.values().map(|entry| entry.bytes).sum();
    }

    fn lock(&self) -> MutexGuard<'_, Entries> {
        // No operation panics half-way, so that a poisoned lock still guards whole entries.
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn key(stage: &str, inputs: &impl Serialize) -> Key {
    let mut hasher = blake3::Hasher::new();
    // Neither fails: the hasher takes all bytes, and inputs are plain data.
    let written = serde_json::to_writer(&mut hasher, &(stage, inputs));
    debug_assert!(written.is_ok());
    hasher.finalize().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn insert(memo: &Memo, key: u32, bytes: usize) {
        memo.insert("stage", &key, Arc::new(key), bytes);
    }

    fn cached(memo: &Memo, key: u32) -> bool {
        memo.get::<u32>("stage", &key).is_some_and(|value| *value == key)
    }

    #[test]
    fn the_result_used_longest_ago_is_dropped_first() {
        let memo = Memo::new(3);
        (0..3).for_each(|key| insert(&memo, key, 1));
        assert!(cached(&memo, 0));
        insert(&memo, 3, 1);
        assert_eq!([0, 1, 2, 3].map(|k| cached(&memo, k)), [true, false, true, true]);
        assert_eq!(memo.bytes(), 3);
    }

    #[test]
    fn the_last_result_is_cached_however_large() {
        let memo = Memo::new(3);
        insert(&memo, 1, 2);
        insert(&memo, 2, 100);
        assert_eq!([1, 2].map(|k| cached(&memo, k)), [false, true]);
        insert(&memo, 1, 2);
        assert_eq!((cached(&memo, 2), memo.bytes()), (false, 2));
    }

    #[test]
    fn a_replaced_result_has_no_size() {
        let memo = Memo::new(10);
        insert(&memo, 1, 4);
        insert(&memo, 1, 5);
        assert_eq!((cached(&memo, 1), memo.bytes()), (true, 5));
    }

    #[test]
    fn a_forgotten_stage_is_computed_again() {
        let memo = Memo::new(10);
        let computed = |stage| {
            let mut is_computed = false;
            let compute = || -> Result<u32, ()> {
                is_computed = true;
                Ok(7)
            };
            assert_eq!(memo.get_or(stage, &0.1, |_| 1, compute), Ok(Arc::new(7)));
            is_computed
        };
        assert!(computed("a") && computed("b") && !computed("a"));
        memo.forget(|stage| stage == "a");
        assert_eq!(memo.bytes(), 1);
        assert!(computed("a") && !computed("b"));
    }

    #[test]
    fn every_input_and_every_bit_of_a_time_tells_keys_apart() {
        let next = f64::from_bits(0.1_f64.to_bits() + 1);
        assert_ne!(key("a", &(1, 0.1)), key("a", &(1, next)));
        assert_ne!(key("a", &(1, 0.1)), key("b", &(1, 0.1)));
        assert_eq!(key("a", &(1, 0.1)), key("a", &(1, 0.1)));
    }
}
