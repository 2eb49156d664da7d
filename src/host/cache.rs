//! Bounded caches in memory, which drop the least recently used values first.

use super::machine::lock;
use serde::Serialize;
use std::any::Any;
use std::collections::HashMap;
use std::hash::Hash;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

/// A cache that threads can share, with a bound on the total cost of its values. If the bound is exceeded, the least
/// recently used values are dropped. The last inserted value is always kept, even if its cost alone exceeds the bound.
///
/// Equal keys must have equal values. The bound then affects how long a computation takes, but never its result.
pub struct BoundedCache<K, V> {
    max_cost: AtomicUsize,
    entries: Mutex<CacheEntries<K, V>>,
}

struct CacheEntries<K, V> {
    by_key: HashMap<K, CacheEntry<V>>,
    cost: usize,
    /// Number of calls of `get` and `insert` so far. It serves as a logical clock for the order of uses.
    clock: u64,
}

struct CacheEntry<V> {
    value: V,
    cost: usize,
    last_use: u64,
}

impl<K: Hash + Eq + Clone, V: Clone> BoundedCache<K, V> {
    /// Creates an empty cache. `max_cost` bounds the sum of the costs that are given to [`Self::insert`].
    pub fn new(max_cost: usize) -> Self {
        let entries = CacheEntries { by_key: HashMap::new(), cost: 0, clock: 0 };
        Self { max_cost: AtomicUsize::new(max_cost), entries: Mutex::new(entries) }
    }

    /// Returns the bound on the sum of the costs.
    pub fn max_cost(&self) -> usize {
        self.max_cost.load(Ordering::Relaxed)
    }

    /// Raises the bound on the sum of the costs, unless it is larger already.
    pub fn raise_bound(&self, max_cost: usize) {
        self.max_cost.fetch_max(max_cost, Ordering::Relaxed);
    }

    /// Returns the value of a key, and makes it the most recently used. `None` if the key isn't cached.
    pub fn get(&self, key: &K) -> Option<V> {
        let mut entries = lock(&self.entries);
        entries.clock += 1;
        let now = entries.clock;
        let entry = entries.by_key.get_mut(key)?;
        entry.last_use = now;
        Some(entry.value.clone())
    }

    /// Inserts a value. Then drops the least recently used values until the total cost is within the bound.
    pub fn insert(&self, key: K, value: V, cost: usize) {
        let mut entries = lock(&self.entries);
        entries.clock += 1;
        let last_use = entries.clock;
        entries.cost += cost;
        if let Some(replaced) = entries.by_key.insert(key, CacheEntry { value, cost, last_use }) {
            entries.cost -= replaced.cost;
        }
        while entries.cost > self.max_cost() && entries.by_key.len() > 1 {
            let oldest = entries.by_key.iter().min_by_key(|(_, e)| e.last_use);
            let Some(key) = oldest.map(|(key, _)| key.clone()) else { break };
            if let Some(dropped) = entries.by_key.remove(&key) {
                entries.cost -= dropped.cost;
            }
        }
    }

    /// Drops the values whose keys don't satisfy `passes`.
    pub fn retain(&self, passes: impl Fn(&K) -> bool) {
        let mut entries = lock(&self.entries);
        entries.by_key.retain(|key, _| passes(key));
        entries.cost = entries.by_key.values().map(|entry| entry.cost).sum();
    }

    /// Returns the sum of the costs of all cached values.
    pub fn cost(&self) -> usize {
        lock(&self.entries).cost
    }
}

/// A cache in memory for the results of pipeline stages. The cost of a result is its size in bytes.
///
/// The key of a result is a hash of the stage's name and its serialized inputs. Inputs that are constant while the memo
/// exists, such as the capture, may be left out of the key.
///
/// If several threads request the same missing result at once, each thread computes it, and their results are equal. No
/// thread waits for the result of another thread, because this could deadlock: while a thread computes a result in a
/// parallel loop, rayon may run another task on this thread, and this task could wait for the same result.
pub struct Memo(BoundedCache<MemoKey, Arc<dyn Any + Send + Sync>>);

/// Key of a cached result: the stage's name, and the BLAKE3 hash of the name and the serialized inputs.
type MemoKey = (&'static str, [u8; blake3::OUT_LEN]);

impl Memo {
    /// Creates an empty memo. All cached results together take at most `max_bytes`.
    pub fn new(max_bytes: usize) -> Self {
        Self(BoundedCache::new(max_bytes))
    }

    /// Returns the maximum size of all cached results together, bytes.
    pub fn max_bytes(&self) -> usize {
        self.0.max_cost()
    }

    /// Raises the maximum size of all cached results together, bytes, unless it is larger already.
    pub fn raise_max_bytes(&self, max_bytes: usize) {
        self.0.raise_bound(max_bytes);
    }

    /// Returns the current size of all cached results together, bytes.
    pub fn bytes(&self) -> usize {
        self.0.cost()
    }

    /// Returns the cached result of a stage for the given inputs. `None` if no result of the type `T` is cached for
    /// them.
    pub fn get<T: Any + Send + Sync>(
        &self,
        stage: &'static str,
        inputs: &impl Serialize,
    ) -> Option<Arc<T>> {
        self.0.get(&memo_key(stage, inputs))?.downcast().ok()
    }

    /// Caches `value`, the result of a stage for the given inputs, and returns it. `bytes` is the size of this result.
    pub fn insert<T: Any + Send + Sync>(
        &self,
        stage: &'static str,
        inputs: &impl Serialize,
        value: Arc<T>,
        bytes: usize,
    ) -> Arc<T> {
        self.0.insert(memo_key(stage, inputs), value.clone(), bytes);
        value
    }

    /// Drops the cached results of all stages whose names satisfy `passes`.
    pub fn forget(&self, passes: impl Fn(&str) -> bool) {
        self.0.retain(|(stage, _)| !passes(stage));
    }
}

fn memo_key(stage: &'static str, inputs: &impl Serialize) -> MemoKey {
    let mut hasher = blake3::Hasher::new();
    // Serialization can't fail: the hasher accepts all bytes, and inputs are plain data.
    let written = serde_json::to_writer(&mut hasher, &(stage, inputs));
    debug_assert!(written.is_ok());
    (stage, hasher.finalize().into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_value_used_longest_ago_is_dropped_first() {
        let cache = BoundedCache::new(3);
        for key in 0..3 {
            cache.insert(key, key, 1);
        }
        assert_eq!(cache.get(&0), Some(0));
        cache.insert(3, 3, 1);
        assert_eq!([0, 1, 2, 3].map(|k| cache.get(&k)), [Some(0), None, Some(2), Some(3)]);
        assert_eq!(cache.cost(), 3);
        cache.raise_bound(4);
        cache.raise_bound(2);
        cache.insert(4, 4, 1);
        assert_eq!((cache.cost(), cache.max_cost(), cache.get(&0)), (4, 4, Some(0)));
    }

    #[test]
    fn the_last_value_is_held_however_large() {
        let cache = BoundedCache::new(3);
        cache.insert("small", 1, 2);
        cache.insert("large", 2, 100);
        assert_eq!((cache.get(&"small"), cache.get(&"large")), (None, Some(2)));
        cache.insert("small", 1, 2);
        assert_eq!((cache.get(&"large"), cache.cost()), (None, 2));
    }

    #[test]
    fn what_does_not_pass_is_dropped_with_its_cost() {
        let cache = BoundedCache::new(10);
        for key in 0..4 {
            cache.insert(key, key, 2);
        }
        cache.retain(|key| key % 2 == 0);
        assert_eq!((cache.get(&1), cache.get(&2), cache.cost()), (None, Some(2), 4));
    }

    #[test]
    fn a_value_that_is_replaced_costs_nothing() {
        let cache = BoundedCache::new(10);
        cache.insert(1, 'a', 4);
        cache.insert(1, 'b', 5);
        assert_eq!((cache.get(&1), cache.cost()), (Some('b'), 5));
    }

    fn insert(memo: &Memo, key: u32, bytes: usize) {
        memo.0.insert(memo_key("stage", &key), Arc::new(key), bytes);
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
    fn the_results_of_a_forgotten_stage_are_dropped() {
        let memo = Memo::new(10);
        for stage in ["a", "b"] {
            assert_eq!(memo.get::<u32>(stage, &0.1), None);
            assert_eq!(memo.insert(stage, &0.1, Arc::new(7), 1), Arc::new(7));
        }
        memo.forget(|stage| stage == "a");
        assert_eq!(memo.bytes(), 1);
        assert_eq!([memo.get("a", &0.1), memo.get("b", &0.1)], [None, Some(Arc::new(7))]);
    }

    #[test]
    fn every_input_and_every_bit_of_a_time_tells_keys_apart() {
        let next = f64::from_bits(0.1_f64.to_bits() + 1);
        assert_ne!(memo_key("a", &(1, 0.1)), memo_key("a", &(1, next)));
        assert_ne!(memo_key("a", &(1, 0.1)), memo_key("b", &(1, 0.1)));
        assert_eq!(memo_key("a", &(1, 0.1)), memo_key("a", &(1, 0.1)));
    }
}
