//! Which versions of a light map led to the one that is published.

use serde::{Deserialize, Serialize};

/// Which versions led to the present one. Those whose light was lost in a crash did not.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Lineage {
    /// Versions below are not known any more.
    oldest: u64,
    /// The versions strictly between each two are lost.
    lost: Vec<(u64, u64)>,
}

impl Lineage {
    /// Crashes that are remembered one by one.
    const REMEMBERED: usize = 256;

    /// Versions below are not known any more.
    pub(crate) fn oldest(&self) -> u64 {
        self.oldest
    }

    /// This, without versions below `oldest`.
    pub(crate) fn since(&self, oldest: u64) -> Lineage {
        Lineage { oldest: oldest.max(self.oldest), lost: self.lost.clone() }
    }

    /// Whether what changed since `version` can be told.
    pub(crate) fn knows(&self, version: u64) -> bool {
        version >= self.oldest && !self.lost.iter().any(|(last, next)| (last + 1..*next).contains(&version))
    }

    /// The light of the versions strictly between `last` and `next` is lost.
    pub(crate) fn lose(&mut self, last: u64, next: u64) {
        self.lost.push((last, next));
        if self.lost.len() > Lineage::REMEMBERED {
            self.oldest = self.lost.remove(0).1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lost_versions_are_not_known() {
        let mut lineage = Lineage::default();
        assert!(lineage.knows(0) && lineage.knows(7));
        lineage.lose(7, 1_000_001);
        assert!(lineage.knows(7) && !lineage.knows(8) && !lineage.knows(1_000_000) && lineage.knows(1_000_001));
        for life in 1..=Lineage::REMEMBERED as u64 {
            lineage.lose(life * 1_000_000 + 5, (life + 1) * 1_000_000 + 1);
        }
        assert!(!lineage.knows(7) && !lineage.knows(8), "too long ago");
        assert!(lineage.knows(1_000_001) && !lineage.knows(1_000_006) && lineage.knows(2_000_001));
    }
}
