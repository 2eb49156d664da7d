//! A cache in memory with a bound: values that were unused for longest are dropped first.

use std::collections::HashMap;
use std::hash::Hash;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// A cache that threads share. It holds the most recently used values whose costs sum to at most a bound, and always the
/// value that was inserted last.
///
/// A value must depend on its key alone, so that the bound changes the time of a computation and never its result.
pub struct BoundedCache<K, V> {
    max_cost: usize,
    entries: Mutex<CacheEntries<K, V>>,
}

struct CacheEntries<K, V> {
    by_key: HashMap<K, CacheEntry<V>>,
    cost: usize,
    /// Number of uses so far.
    clock: u64,
}

struct CacheEntry<V> {
    value: V,
    cost: usize,
    last_use: u64,
}

impl<K: Hash + Eq + Clone, V: Clone> BoundedCache<K, V> {
    /// An empty cache with a bound on the sum of the costs, in the unit of [`Self::insert`].
    pub fn new(max_cost: usize) -> Self {
        let entries = CacheEntries { by_key: HashMap::new(), cost: 0, clock: 0 };
        Self { max_cost, entries: Mutex::new(entries) }
    }

    /// The value of a key, if it is held. It counts as used.
    pub fn get(&self, key: &K) -> Option<V> {
        let mut entries = self.lock();
        entries.clock += 1;
        let now = entries.clock;
        let entry = entries.by_key.get_mut(key)?;
        entry.last_use = now;
        Some(entry.value.clone())
    }

    /// Inserts a value, and drops the values that were unused for longest until the bound holds.
    pub fn insert(&self, key: K, value: V, cost: usize) {
        let mut entries = self.lock();
        entries.clock += 1;
        let last_use = entries.clock;
        entries.cost += cost;
        if let Some(replaced) = entries.by_key.insert(key, CacheEntry { value, cost, last_use }) {
            entries.cost -= replaced.cost;
        }
        while entries.cost > self.max_cost && entries.by_key.len() > 1 {
            let oldest = entries.by_key.iter().min_by_key(|(_, e)| e.last_use);
            let Some(key) = oldest.map(|(key, _)| key.clone()) else { break };
            if let Some(dropped) = entries.by_key.remove(&key) {
                entries.cost -= dropped.cost;
            }
        }
    }

    /// Drops the values whose keys don't pass a test.
    pub fn retain(&self, passes: impl Fn(&K) -> bool) {
        let mut entries = self.lock();
        entries.by_key.retain(|key, _| passes(key));
        entries.cost = entries.by_key.values().map(|entry| entry.cost).sum();
    }

    /// The sum of the costs of all values held.
    pub fn cost(&self) -> usize {
        self.lock().cost
    }

    fn lock(&self) -> MutexGuard<'_, CacheEntries<K, V>> {
        // No operation panics half-way, so that a poisoned lock still guards a whole cache.
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }
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
}
