//! What a benchmark is asked to measure: scenes by `NAME` or `NAME=SPACING` (m), all of them where none is named, and
//! `scenes=FOLDER` for where their files are.

use std::path::PathBuf;

/// The command line.
pub(crate) struct Asked(Vec<String>);

impl Asked {
    pub(crate) fn new() -> Asked {
        Asked(std::env::args().skip(1).filter(|argument| !argument.starts_with("--")).collect())
    }

    /// What is behind `name=`.
    pub(crate) fn value(&self, name: &str) -> Option<&str> {
        self.0.iter().find_map(|argument| argument.strip_prefix(name)?.strip_prefix('='))
    }

    /// Where files of scenes are.
    pub(crate) fn folder(&self) -> PathBuf {
        let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/scenes");
        PathBuf::from(self.value("scenes").unwrap_or(beside))
    }

    /// The scenes of `spacings` that are wanted, with the spacing of each.
    pub(crate) fn scenes(&self, spacings: &[(&'static str, f32)]) -> Vec<(&'static str, f32)> {
        let is_named = |name: &str| self.0.iter().any(|argument| argument == name) || self.value(name).is_some();
        let all = !spacings.iter().any(|(name, _)| is_named(name));
        let wanted = spacings.iter().filter(|(name, _)| all || is_named(name));
        wanted
            .map(|&(name, spacing)| (name, self.value(name).and_then(|v| v.parse().ok()).unwrap_or(spacing)))
            .collect()
    }
}
