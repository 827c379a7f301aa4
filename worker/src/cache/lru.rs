//! Least-recently-used values under a byte budget.

use std::borrow::Borrow;
use std::collections::HashMap;
use std::hash::Hash;

/// Evicts the value that was not used for the longest time once the budget is exceeded. Finding it is linear in the
/// number of entries: meant for hundreds of big values, not for millions of small ones.
#[derive(Debug)]
pub struct Lru<K, V> {
    entries: HashMap<K, Entry<V>>,
    budget_bytes: u64,
    used_bytes: u64,
    clock: u64,
}

#[derive(Debug)]
struct Entry<V> {
    value: V,
    bytes: u64,
    used_at: u64,
}

impl<K: Eq + Hash + Clone, V: Clone> Lru<K, V> {
    pub fn new(budget_bytes: u64) -> Self {
        Self { entries: HashMap::new(), budget_bytes, used_bytes: 0, clock: 0 }
    }

    pub fn get<Q>(&mut self, key: &Q) -> Option<V>
    where
        K: Borrow<Q>,
        Q: Eq + Hash + ?Sized,
    {
        self.clock += 1;
        let entry = self.entries.get_mut(key)?;
        entry.used_at = self.clock;
        Some(entry.value.clone())
    }

    /// A value larger than the whole budget is not kept.
    pub fn insert(&mut self, key: K, value: V, bytes: u64) {
        self.remove(&key);
        if bytes > self.budget_bytes {
            return;
        }
        self.clock += 1;
        self.used_bytes += bytes;
        self.entries.insert(key, Entry { value, bytes, used_at: self.clock });
        self.evict();
    }

    /// Counts the values' bytes again, where values grow after they were inserted.
    pub fn weigh(&mut self, bytes: impl Fn(&V) -> u64) {
        for entry in self.entries.values_mut() {
            entry.bytes = bytes(&entry.value);
        }
        self.used_bytes = self.entries.values().map(|entry| entry.bytes).sum();
        self.evict();
    }

    fn evict(&mut self) {
        while self.used_bytes > self.budget_bytes {
            let oldest = self.entries.iter().min_by_key(|(_, entry)| entry.used_at).map(|(key, _)| key.clone());
            match oldest {
                Some(key) => self.remove(&key),
                None => break,
            }
        }
    }

    fn remove(&mut self, key: &K) {
        if let Some(entry) = self.entries.remove(key) {
            self.used_bytes -= entry.bytes;
        }
    }

    pub fn keys(&self) -> impl Iterator<Item = &K> {
        self.entries.keys()
    }

    pub fn used_bytes(&self) -> u64 {
        self.used_bytes
    }

    pub fn budget_bytes(&self) -> u64 {
        self.budget_bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_recently_used_value_goes_first() {
        let mut lru = Lru::new(10);
        lru.insert("a", 1, 4);
        lru.insert("b", 2, 4);
        assert_eq!(lru.get("a"), Some(1));
        lru.insert("c", 3, 4);
        assert_eq!((lru.get("a"), lru.get("b"), lru.get("c")), (Some(1), None, Some(3)));
        assert_eq!(lru.used_bytes(), 8);
    }

    #[test]
    fn values_that_grew_are_counted_as_they_are() {
        let mut lru = Lru::new(10);
        lru.insert("a", 1, 1);
        lru.insert("b", 5, 5);
        lru.weigh(|&value| 2 * value);
        assert_eq!((lru.get("a"), lru.get("b"), lru.used_bytes()), (None, Some(5), 10));
    }

    #[test]
    fn a_replaced_value_is_counted_once_and_a_giant_is_not_kept() {
        let mut lru = Lru::new(10);
        lru.insert("a", 1, 6);
        lru.insert("a", 2, 7);
        assert_eq!((lru.get("a"), lru.used_bytes()), (Some(2), 7));
        lru.insert("giant", 3, 11);
        assert_eq!((lru.get("giant"), lru.get("a")), (None, Some(2)));
    }
}
