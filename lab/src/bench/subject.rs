//! What a bench works on: a scene, its edit file, and the loop over the cases.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use rebake_core::scene::Scene;
use rebake_core::{World, WorldOptions};

use super::report::Setup;
use super::{Case, EditFile, Options, PreparedCase, Watcher};

/// A scene and edits of it.
#[derive(Clone, Copy, Debug)]
pub struct Subject<'a> {
    /// Of the scene, for people.
    pub name: &'a str,
    /// Before all edits.
    pub scene: &'a Scene,
    /// The cases.
    pub file: &'a EditFile,
    /// Where paths in the edit file begin.
    pub folder: &'a Path,
}

impl Subject<'_> {
    /// What all cases have in common, on the current rayon pool.
    pub(super) fn setup(&self, options: &Options, watcher: &mut dyn Watcher) -> Result<Setup> {
        watcher.step("", "elements of the scene");
        let of_scene = WorldOptions { spacing: options.spacing, ..WorldOptions::default() };
        let world = World::new(self.scene.clone(), &of_scene)?;
        Ok(Setup {
            scene: self.name.to_owned(),
            elements: world.element_count(),
            threads: rayon::current_num_threads(),
            spacing: world.spacing(),
            mode: options.mode,
            seeds: options.seeds,
        })
    }

    /// Prepares the cases that `options` names and `is_wanted`, one after the other, for `work`. All have one spacing,
    /// whatever they take out of the scene first.
    pub(super) fn each_case(
        &self,
        (options, spacing): (&Options, f32),
        is_wanted: impl Fn(&Case) -> bool,
        watcher: &mut dyn Watcher,
        mut work: impl FnMut(&PreparedCase, &mut dyn Watcher) -> Result<()>,
    ) -> Result<()> {
        let is_named = |case: &Case| options.filter.as_ref().is_none_or(|part| case.name.contains(part));
        let is_run = |case: &Case| is_named(case) && is_wanted(case);
        ensure!(self.file.cases.iter().any(is_run), "cases: none is of the name and kind to run");
        let stated = options.mode;
        let world_options = WorldOptions { spacing: Some(spacing), stated, ..WorldOptions::default() };
        for (k, case) in self.file.cases.iter().enumerate().filter(|(_, case)| is_run(case)) {
            watcher.step(&case.name, "edit");
            let prepared = case.prepare(self.scene, self.folder, &world_options);
            work(&prepared.with_context(|| format!("cases[{k}] ({:?})", case.name))?, watcher)?;
        }
        Ok(())
    }
}
