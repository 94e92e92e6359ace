//! Where on pages of texels the surfaces of a scene lie: a rectangle per object, and places in it for its triangles.
//!
//! A rectangle stays where it is as long as its object is there and has its size, whatever else is edited; those of
//! inserted objects are allocated, those of removed objects are freed, pages are added, and nothing is packed anew.
//! Equal scenes that come in equal order give equal atlases. What lies on the texels is not known here.

mod charts;
mod file;
mod pack;
mod pages;
mod raster;
mod shape;
#[cfg(test)]
mod tests;
mod unwrap;

pub use self::pages::{MAX_PAGE_SIDE, Rectangle};
pub use self::unwrap::Coordinates;

pub(crate) use self::raster::{for_rows, nearest};

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use glam::{DVec2, Vec2};
use rayon::prelude::*;

use self::pages::Pages;
use self::shape::Shape;
use self::unwrap::{NoRoom, Unwrap};
use crate::scene::Object;
use crate::surface::FileTriangle;

/// Texels that rectangles of an atlas take at most where nothing else is said.
pub const DEFAULT_MAX_TEXELS: u64 = 1 << 26;

/// How fine an atlas is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AtlasOptions {
    /// Texels per metre of surface; one per spacing of the elements where absent.
    pub texels_per_metre: Option<f32>,
    /// Texels that all rectangles may take together.
    pub max_texels: u64,
}

impl Default for AtlasOptions {
    fn default() -> AtlasOptions {
        AtlasOptions { texels_per_metre: None, max_texels: DEFAULT_MAX_TEXELS }
    }
}

/// Why there is no atlas.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum AtlasError {
    /// The density is no number above 0.
    #[error("texels_per_metre: must be a finite number above 0, not {0}")]
    Density(f32),
    /// All rectangles together are too much.
    #[error("the atlas would take more than {limit} texels at {texels_per_metre} texels per metre: choose fewer")]
    TooLarge {
        /// Texels that are allowed.
        limit: u64,
        /// Density asked for.
        texels_per_metre: f32,
    },
    /// An object falls into more pieces than a page has room for.
    #[error("object {object:?}: its surface falls into more pieces than a page of an atlas has room for")]
    Pieces {
        /// Its name.
        object: String,
    },
}

/// A page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Page {
    /// Texels across.
    pub width: u32,
    /// Texels down.
    pub height: u32,
}

/// An object of the scene an atlas is for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Item<'a> {
    pub object: &'a Object,
    /// Its back has light of its own.
    pub with_back: bool,
}

/// Rectangles of all objects of a scene. Cheap to clone and immutable: an edit makes the next one.
#[derive(Clone, Debug)]
pub struct Atlas {
    texels_per_metre: f32,
    max_texels: u64,
    pages: Pages,
    entries: BTreeMap<String, Arc<Entry>>,
}

/// Where an object lies.
#[derive(Clone, Debug)]
pub struct Entry {
    /// Of its front.
    pub front: Rectangle,
    /// Of its back, where that has light of its own.
    pub back: Option<Rectangle>,
    unwrap: Arc<Unwrap>,
}

impl Entry {
    /// Whose coordinates it has.
    pub fn coordinates(&self) -> Coordinates {
        self.unwrap.coordinates
    }

    /// Texels per metre of its surface; fewer than asked for where it would be larger than a page.
    pub fn texels_per_metre(&self) -> f32 {
        self.unwrap.texels_per_metre
    }

    /// Per triangle of the object's mesh, the coordinates of its corners: u to the right, v down. For
    /// [`Coordinates::File`] they are the file's.
    pub fn texcoords(&self) -> impl Iterator<Item = [Vec2; 3]> + '_ {
        let Unwrap { places, scale, offset, .. } = &*self.unwrap;
        places.iter().map(move |corners| corners.map(|at| ((at.as_dvec2() - *offset) / *scale).as_vec2()))
    }

    /// Scale and offset of one of its rectangles: coordinates on the page (0 to 1, origin top left) are
    /// texcoord × scale + offset.
    pub fn to_page(&self, rectangle: &Rectangle, page: Page) -> (DVec2, DVec2) {
        let size = DVec2::new(f64::from(page.width), f64::from(page.height));
        let corner = DVec2::new(f64::from(rectangle.corner[0]), f64::from(rectangle.corner[1]));
        (self.unwrap.scale / size, (self.unwrap.offset + corner) / size)
    }

    /// Places of the corners of a triangle of the object's surface, in their order there; texels of a rectangle.
    pub(crate) fn places_of(&self, source: FileTriangle) -> [Vec2; 3] {
        let [a, b, c] = self.unwrap.places[source.triangle()];
        if source.turned() { [a, c, b] } else { [a, b, c] }
    }

    fn rectangles(&self) -> impl Iterator<Item = &Rectangle> {
        std::iter::once(&self.front).chain(&self.back)
    }

    fn texels(&self) -> u64 {
        self.rectangles().map(|r| u64::from(r.size[0]) * u64::from(r.size[1])).sum()
    }
}

impl Atlas {
    /// An atlas without objects, for elements of some spacing (metres).
    ///
    /// # Errors
    /// [`AtlasError::Density`]
    pub(crate) fn new(options: AtlasOptions, spacing: f32) -> Result<Atlas, AtlasError> {
        let AtlasOptions { texels_per_metre, max_texels } = options;
        let texels_per_metre = texels_per_metre.unwrap_or(1.0 / spacing);
        if !(texels_per_metre.is_finite() && texels_per_metre > 0.0) {
            return Err(AtlasError::Density(texels_per_metre));
        }
        Ok(Atlas { texels_per_metre, max_texels, pages: Pages::default(), entries: BTreeMap::new() })
    }

    /// Texels per metre of surface that were asked for.
    pub fn texels_per_metre(&self) -> f32 {
        self.texels_per_metre
    }

    /// Its pages.
    pub fn pages(&self) -> Vec<Page> {
        self.pages.sizes().map(|[width, height]| Page { width, height }).collect()
    }

    /// Where an object lies; none where it has no surface.
    pub fn entry(&self, object: &str) -> Option<&Entry> {
        self.entries.get(object).map(|entry| &**entry)
    }

    /// Bytes held; what is shared with other atlases counts here too.
    pub fn memory_bytes(&self) -> usize {
        let unwraps: BTreeMap<*const Unwrap, usize> =
            self.entries.values().map(|e| (Arc::as_ptr(&e.unwrap), e.unwrap.memory_bytes())).collect();
        unwraps.values().sum::<usize>() + self.entries.len() * size_of::<Entry>()
    }

    /// The atlas after an edit. Objects that are hidden keep what they have.
    ///
    /// # Errors
    /// [`AtlasError`]: objects that have no room.
    pub(crate) fn next<'a>(&self, items: impl Iterator<Item = Item<'a>>) -> Result<Atlas, AtlasError> {
        let items: Vec<Item> = items.collect();
        let mut next = self.clone();
        let mut new = Vec::new();
        for item in &items {
            let name = &item.object.name;
            match self.entries.get(name) {
                Some(_) if item.object.is_hidden => {}
                Some(entry) if entry.is_of(item) => {}
                _ => new.extend(Shape::of(item.object).map(|shape| (*item, shape))),
            }
        }
        let there: BTreeSet<&str> = items.iter().map(|item| item.object.name.as_str()).collect();
        let replaced: BTreeSet<&str> = new.iter().map(|(item, _)| item.object.name.as_str()).collect();
        for (name, entry) in &self.entries {
            if !there.contains(name.as_str()) || replaced.contains(name.as_str()) {
                entry.rectangles().for_each(|rectangle| next.pages.free(rectangle));
                next.entries.remove(name);
            }
        }
        new.retain(|(item, _)| !item.object.is_hidden);
        next.allocate(&new)?;
        Ok(next)
    }

    /// Gives objects rectangles, the highest first.
    fn allocate(&mut self, new: &[(Item, Shape)]) -> Result<(), AtlasError> {
        self.check_area(new)?;
        let unwraps = self.unwraps(new)?;
        let mut order: Vec<usize> = (0..new.len()).filter(|&k| unwraps[k].size != [0; 2]).collect();
        order.sort_by_key(|&k| (std::cmp::Reverse(unwraps[k].size[1]), std::cmp::Reverse(unwraps[k].size[0]), k));
        let sides = |k: usize| if new[k].0.with_back { 2 } else { 1 };
        let texels = |k: usize| u64::from(unwraps[k].size[0]) * u64::from(unwraps[k].size[1]) * sides(k);
        let more: u64 = order.iter().map(|&k| texels(k)).sum();
        if more > self.free_texels() {
            return Err(self.too_large());
        }
        self.pages.expect(more);
        for k in order {
            let ((item, _), unwrap) = (&new[k], &unwraps[k]);
            let front = self.pages.allocate(unwrap.size);
            let back = item.with_back.then(|| self.pages.allocate(unwrap.size));
            let entry = Entry { front, back, unwrap: Arc::clone(unwrap) };
            self.entries.insert(item.object.name.clone(), Arc::new(entry));
        }
        Ok(())
    }

    /// Refuses what cannot have room before anything is made of it.
    fn check_area(&self, new: &[(Item, Shape)]) -> Result<(), AtlasError> {
        // Charts keep half of their area at least.
        let texels = |(_, shape): &(Item, Shape)| 0.5 * shape.area() * f64::from(self.texels_per_metre).powi(2);
        let least: f64 = new.iter().map(texels).sum();
        if least > self.free_texels() as f64 { Err(self.too_large()) } else { Ok(()) }
    }

    fn free_texels(&self) -> u64 {
        self.max_texels.saturating_sub(self.entries.values().map(|entry| entry.texels()).sum())
    }

    fn too_large(&self) -> AtlasError {
        AtlasError::TooLarge { limit: self.max_texels, texels_per_metre: self.texels_per_metre }
    }

    /// The coordinates of some objects: of meshes that are the same, and have the same size, made once.
    fn unwraps(&self, new: &[(Item, Shape)]) -> Result<Vec<Arc<Unwrap>>, AtlasError> {
        let mut known: BTreeMap<u64, Vec<Arc<Unwrap>>> = BTreeMap::new();
        if !new.is_empty() {
            for entry in self.entries.values() {
                known.entry(entry.unwrap.content_hash).or_default().push(Arc::clone(&entry.unwrap));
            }
        }
        let hashes: Vec<u64> = new.par_iter().map(|(_, shape)| shape.content_hash()).collect();
        // What is like one before it waits for that.
        let mut firsts: Vec<usize> = Vec::new();
        let mut by_hash: BTreeMap<u64, Vec<usize>> = BTreeMap::new();
        for (k, (_, shape)) in new.iter().enumerate() {
            let alike = by_hash.entry(hashes[k]).or_default();
            let is_known = known.get(&hashes[k]).is_some_and(|list| list.iter().any(|u| u.shape.is_like(shape)));
            if !is_known && !alike.iter().any(|&first| new[first].1.is_like(shape)) {
                alike.push(k);
                firsts.push(k);
            }
        }
        let unwrap = |&k: &usize| {
            let (item, shape) = &new[k];
            let too_many = |NoRoom| AtlasError::Pieces { object: item.object.name.clone() };
            Unwrap::of(shape.clone(), self.texels_per_metre, self.max_texels).map(Arc::new).map_err(too_many)
        };
        let made: Vec<Arc<Unwrap>> = firsts.par_iter().map(unwrap).collect::<Result<_, _>>()?;
        for unwrap in made {
            known.entry(unwrap.content_hash).or_default().push(unwrap);
        }
        let find = |(k, (_, shape)): (usize, &(Item, Shape))| {
            let like = known[&hashes[k]].iter().find(|unwrap| unwrap.shape.is_like(shape));
            Arc::clone(like.expect("every shape was unwrapped, or one like it"))
        };
        Ok(new.iter().enumerate().map(find).collect())
    }
}

impl Entry {
    /// Whether it is right for an object as it is now.
    fn is_of(&self, item: &Item) -> bool {
        let shape = Shape::of(item.object);
        self.back.is_some() == item.with_back && shape.is_some_and(|shape| self.unwrap.shape.is_like(&shape))
    }
}
