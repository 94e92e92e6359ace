//! A scene made ready for transport: surfaces, elements, trees, emitters. Immutable; an edit makes the next one
//! ([`World::apply`]) and shares with it all that did not change.

mod apart;
mod apply;
mod arriving;
mod build;
mod buried;
mod by_light;
mod check;
mod choice;
mod coarse;
mod counted;
mod delivered;
mod emitters;
mod finish;
mod hide;
mod info;
mod lamplit;
mod lights;
mod motion;
mod objects;
mod openings;
mod options;
mod paint;
mod probe;
mod restore;
mod same;
#[cfg(test)]
mod sharing;
mod shown;
mod sight;
mod sized;
mod tint;
mod transition;
mod trees;
mod validity;

pub use info::{LightInfo, ObjectInfo};
pub use options::{Spread, Stated, WorldError, WorldOptions};
pub use transition::Transition;
pub use trees::Trees;

pub use arriving::{arriving, visible_light};
pub(crate) use arriving::{arriving_in_space, arriving_on_side};
pub(crate) use choice::WEIGHED;
pub(crate) use coarse::Coarse;
pub use emitters::{Emitter, LightSample};
pub(crate) use emitters::{Emitters, Shape, sky};
pub(crate) use sight::{Hidden, over_bulge};
pub use validity::Validity;

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use glam::Vec3;
use rayon::prelude::*;

use crate::atlas::{Atlas, AtlasError, AtlasOptions, Item};
use crate::chunks::Chunks;
use crate::scene::Scene;
use crate::space::{Density, Layout, Placement, Sizing, Space};
use crate::surface::{Facets, SeeThrough, Surface};

/// One object, subdivided and placed.
#[derive(Debug)]
pub struct Placed {
    /// Never used again within a scene's life.
    pub key: u32,
    /// The triangles of the file, in scene space.
    pub surface: Arc<Surface>,
    /// Its triangles that let light through, where there are any.
    pub(crate) see_through: Option<Arc<SeeThrough>>,
    /// Per material, where its emission varies: what shines. Empty where none does.
    pub(crate) facets: Vec<Option<Arc<Facets>>>,
    /// How its elements are laid out.
    pub(crate) layout: Arc<Layout>,
    /// Subset for smooth light, over the front's elements.
    pub(crate) coarse: Arc<Coarse>,
    /// Slots.
    pub placement: Placement,
    /// The back has elements of its own.
    pub with_back: bool,
    /// Distance of its farthest element from the zero of scene space, m.
    pub reach: f32,
}

impl Placed {
    /// The slots of its front, and of its back where that has elements.
    pub(crate) fn sides(&self) -> impl Iterator<Item = Range<u32>> {
        let (first, count) = (self.placement.elements.start, self.layout.len() as u32);
        let side = move |k: u32| first + k * count..first + (k + 1) * count;
        (0..if self.with_back { 2 } else { 1 }).map(side)
    }

    /// Bytes of its surface and of what is laid out on it, albedos by place aside.
    fn memory_bytes(&self) -> usize {
        let see_through = self.see_through.as_ref().map_or(0, |see_through| see_through.memory_bytes());
        let facets: usize = self.facets.iter().flatten().map(|facets| facets.memory_bytes()).sum();
        self.surface.memory_bytes() + self.layout.memory_bytes() + self.coarse.memory_bytes() + see_through + facets
    }
}

/// How far what is computed lies apart, metres.
#[derive(Clone, Debug)]
pub(crate) struct Resolution {
    /// Elements.
    pub density: Density,
    /// What smooth light is measured by: the spacing, or that of a scene of this size by default where it is finer.
    pub smooth: f32,
    /// Where the scene's file has its elements closer together or farther apart than that.
    pub sizing: Option<Arc<Sizing>>,
}

/// Immutable snapshot of a scene with its elements and trees: a list of parts, which an edit replaces where they
/// change. Cheap to clone.
#[derive(Clone, Debug)]
pub struct World {
    /// What was loaded and edited.
    pub scene: Arc<Scene>,
    /// Limits for edits, and what maps state the error of.
    pub(crate) options: WorldOptions,
    /// How far elements lie apart.
    pub(crate) resolution: Resolution,
    /// Each object's surface and elements, in the order of `scene.objects`.
    pub(crate) placed: Vec<Arc<Placed>>,
    /// Elements, and the way from triangles to them.
    pub(crate) space: Space,
    /// What rays meet.
    pub(crate) trees: Trees,
    /// Where light comes from.
    pub(crate) emitters: Arc<Emitters>,
    /// Which elements have values of their own.
    pub(crate) validity: Arc<Validity>,
    /// Which representatives elements do not see, by key of the object.
    pub(crate) sight: BTreeMap<u32, Arc<Hidden>>,
    /// Places of objects on pages of texels, where there are any.
    pub(crate) atlas: Option<Arc<Atlas>>,
    /// The key of the next object; keys are never used again.
    pub(crate) next_key: u32,
}

impl World {
    /// Subdivides a scene and builds its trees on the current rayon pool.
    pub fn new(scene: Scene, options: &WorldOptions) -> Result<World, WorldError> {
        build::build(scene, options)
    }

    /// How far neighbouring elements lie apart.
    pub fn density(&self) -> Density {
        self.resolution.density
    }

    /// Largest distance between neighbouring elements, metres; on objects that are too large for it, more.
    pub fn spacing(&self) -> f32 {
        self.resolution.density.spacing
    }

    /// How its elements are spread over what its file holds.
    pub fn spread(&self) -> Spread {
        self.options.spread
    }

    /// This world with other limits, for edits from here on. What is there stays and may be edited: they are never less
    /// than what it takes.
    pub fn with_limits(self, max_elements: usize, max_triangles: usize) -> World {
        let max_elements = max_elements.max(self.element_count());
        let max_triangles = max_triangles.max(self.triangle_count());
        World { options: WorldOptions { max_elements, max_triangles, ..self.options }, ..self }
    }

    /// Where its objects lie in an atlas, where it was made with one ([`WorldOptions::atlas`]).
    pub fn atlas(&self) -> Option<&Arc<Atlas>> {
        self.atlas.as_ref()
    }

    /// An atlas of its objects. Those that are in `earlier` and have not changed in size stay where they are there;
    /// without it, or where it has another density, all of them are laid out.
    ///
    /// # Errors
    /// [`AtlasError`]
    pub fn new_atlas(&self, earlier: Option<&Atlas>, options: AtlasOptions) -> Result<Atlas, AtlasError> {
        let empty = Atlas::new(options, self.spacing())?;
        let earlier = earlier.filter(|earlier| earlier.texels_per_metre() == empty.texels_per_metre());
        earlier.unwrap_or(&empty).next(self.atlas_items())
    }

    fn atlas_items(&self) -> impl Iterator<Item = Item<'_>> {
        let objects = self.scene.objects.iter().zip(&self.placed);
        objects.map(|(object, placed)| Item { object, with_back: placed.with_back })
    }

    /// What light maps state the error of.
    pub fn stated(&self) -> Stated {
        self.options.stated
    }

    /// Length of the light map, holes of removed objects included.
    pub fn slots(&self) -> usize {
        self.space.slots().owners.len()
    }

    /// Slots that hold an element.
    pub fn element_count(&self) -> usize {
        self.placed.iter().map(|p| p.placement.elements.len()).sum()
    }

    /// Triangles between the elements: what the light map of a client is drawn with.
    pub fn triangle_count(&self) -> usize {
        self.placed.iter().map(|p| p.layout.cell_count()).sum()
    }

    /// Sample points per slot, scene space: add [`Scene::origin`] for world space.
    pub fn positions(&self) -> &Chunks<Vec3> {
        &self.space.slots().positions
    }

    /// Unit normals per slot.
    pub fn normals(&self) -> &Chunks<Vec3> {
        &self.space.slots().normals
    }

    /// m² per slot; 0 in holes.
    pub fn areas(&self) -> &Chunks<f32> {
        &self.space.slots().areas
    }

    /// Area-weighted mean over some slots; 0 where they have no area.
    pub fn area_mean(&self, slots: impl IntoIterator<Item = usize>, value: impl Fn(usize) -> f64) -> f64 {
        let (mut sum, mut total) = (0.0, 0.0);
        for slot in slots {
            let area = f64::from(self.areas()[slot]);
            sum += area * value(slot);
            total += area;
        }
        if total > 0.0 { sum / total } else { 0.0 }
    }

    /// Whether an element's value is computed. Inside solids and behind surfaces it is copied from neighbours.
    pub fn is_valid(&self, slot: usize) -> bool {
        self.validity.is_valid(slot)
    }

    /// A scene with a big tree of its own whose small trees make rays slow.
    pub fn needs_rebuild(&self) -> bool {
        !self.trees.small.is_empty()
    }

    /// A fresh big tree over everything. Runs for a second in large scenes: do it in the background.
    pub fn rebuilt_trees(&self) -> Trees {
        build::big_tree(&self.placed, self.trees.generation)
    }

    /// This world with trees of [`World::rebuilt_trees`]; none where the geometry has changed since.
    pub fn with_trees(&self, trees: Trees) -> Option<World> {
        (trees.generation == self.trees.generation).then(|| World { trees, ..self.clone() })
    }

    /// Bytes held by elements, triangles, trees and textures; what is shared with other versions counts here too.
    pub fn memory_bytes(&self) -> usize {
        let albedos = |p: &Placed| -> usize {
            let parts = self.space.parts_of(&p.placement);
            parts.first().and_then(|part| part.albedos.as_ref()).map_or(0, |albedos| size_of_val(&**albedos))
        };
        let objects: usize = self.placed.iter().map(|p| p.memory_bytes() + albedos(p)).sum();
        let sight: usize = self.sight.values().map(|hidden| hidden.memory_bytes()).sum();
        let space = self.space.memory_bytes() + self.validity.memory_bytes() + sight;
        let atlas = self.atlas.as_ref().map_or(0, |atlas| atlas.memory_bytes());
        let sizing = self.resolution.sizing.as_ref().map_or(0, |sizing| sizing.memory_bytes());
        sizing + space + self.trees.memory_bytes() + objects + self.scene.texture_bytes() + atlas
    }

    /// The sides of all objects, in the order of their slots.
    pub(crate) fn sides(&self) -> Vec<(&Placed, Range<usize>)> {
        let of_object = |placed: &'_ Arc<Placed>| {
            let slots = |side: Range<u32>| side.start as usize..side.end as usize;
            placed.sides().map(slots).collect::<Vec<_>>()
        };
        let mut sides: Vec<(&Placed, Range<usize>)> =
            self.placed.iter().flat_map(|placed| of_object(placed).into_iter().map(|side| (&**placed, side))).collect();
        sides.sort_by_key(|(_, side)| side.start);
        sides
    }

    /// Slots whose value is computed, ascending.
    pub(crate) fn computed_slots(&self) -> Vec<u32> {
        let slots = (0..self.slots() as u32).into_par_iter().with_min_len(4096);
        slots.filter(|&slot| self.is_computed(slot as usize)).collect()
    }

    /// Whether a slot has an element whose value is computed.
    #[inline]
    pub(crate) fn is_computed(&self, slot: usize) -> bool {
        self.areas()[slot] > 0.0 && self.validity.is_valid(slot)
    }

    /// Where rays of an element start.
    #[inline]
    pub fn ray_origin(&self, slot: usize) -> (Vec3, Vec3) {
        let n = self.normals()[slot];
        (self.positions()[slot] + n * self.space.slots().offset(slot), n)
    }
}
