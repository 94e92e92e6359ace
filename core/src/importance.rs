//! What is brought up to date before the rest, and in which steps.

use crate::focus::Focus;
use crate::job::Budget;

/// What comes first. Nothing in particular by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Importance {
    /// What somebody looks at.
    pub focus: Option<Focus>,
    /// In which steps; without, all that is looked at is computed together.
    pub tiles: Option<Tiles>,
}

impl From<Focus> for Importance {
    fn from(focus: Focus) -> Importance {
        Importance { focus: Some(focus), tiles: None }
    }
}

/// How what comes first is cut up (Ulschmid et al. 2024, on light maps).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tiles {
    /// Elements per tile, about: tiles are halves of halves of the region, and never divide what is interpolated
    /// together. They are larger where there would be more than 256 of them.
    pub size: u32,
    /// Samples per element of a tile, the tile quality.
    pub samples: u32,
    /// One by one, or all together.
    pub mode: TileMode,
}

impl Default for Tiles {
    fn default() -> Tiles {
        Tiles { size: 256, samples: 64, mode: TileMode::Continuous }
    }
}

/// In which order the samples of tiles are taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TileMode {
    /// All tiles together, in rounds of growing size; then the whole map, until the budget ends.
    Global,
    /// One tile after the other, each to tile quality; then the rest of the map to the same, and no further.
    Incremental,
    /// One tile after the other, each to tile quality; then the whole map until the budget ends.
    Continuous,
}

impl Importance {
    /// The tiles that are computed one by one.
    pub(crate) fn one_by_one(&self) -> Option<&Tiles> {
        self.tiles.as_ref().filter(|tiles| tiles.mode != TileMode::Global)
    }

    /// Whether work ends at tile quality.
    pub(crate) fn ends_at_tile_quality(&self) -> bool {
        self.tiles.is_some_and(|tiles| tiles.mode == TileMode::Incremental)
    }

    /// Samples per element of what comes first.
    pub(crate) fn samples(&self) -> u32 {
        self.tiles.unwrap_or_default().samples
    }

    /// When the whole ends.
    pub(crate) fn budget(&self, budget: &Budget) -> Budget {
        let most = if self.ends_at_tile_quality() { self.samples() } else { u32::MAX };
        Budget { samples_per_element: budget.samples_per_element.min(most), ..*budget }
    }
}
