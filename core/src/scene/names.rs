//! Unique names from names that need not be.

use std::collections::{BTreeMap, BTreeSet};

/// Longest name that is kept, in characters.
const MAX_CHARS: usize = 200;

/// Names given out so far.
#[derive(Debug, Default)]
pub(crate) struct UniqueNames {
    taken: BTreeSet<String>,
    /// Per wanted name: the last number tried, so that many equal names do not cost the square of their number.
    last: BTreeMap<String, u32>,
}

impl UniqueNames {
    /// Takes `wanted`, or where it is taken `wanted-2`, `wanted-3`, ….
    pub(crate) fn claim(&mut self, wanted: &str) -> String {
        self.claim_with(wanted, '-')
    }

    /// Takes `wanted`, or where it is taken `wanted` with `separator` and the first free number from 2 on.
    pub(crate) fn claim_with(&mut self, wanted: &str, separator: char) -> String {
        let mut name: String = wanted.chars().take(MAX_CHARS).collect();
        if self.taken.contains(&name) {
            let last = self.last.entry(name.clone()).or_insert(1);
            let base = name;
            loop {
                *last = last.saturating_add(1);
                name = format!("{base}{separator}{last}");
                if !self.taken.contains(&name) {
                    break;
                }
            }
        }
        self.taken.insert(name.clone());
        name
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_whatever_is_asked_for() {
        let mut names = UniqueNames::default();
        let wanted = ["a", "a-2", "a", "a", "a-2", "b", "a"];
        let given: Vec<String> = wanted.iter().map(|name| names.claim(name)).collect();
        assert_eq!(given, ["a", "a-2", "a-3", "a-4", "a-2-2", "b", "a-5"]);
    }
}
