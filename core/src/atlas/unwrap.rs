//! Coordinates of one mesh in texels: those of its file, or made.

use glam::{DVec2, DVec3, Vec2};

use super::charts::{Room, Unfit, charts};
use super::file::of_file;
use super::pack::pack;
use super::pages::MAX_PAGE_SIDE;
use super::shape::Shape;

/// Texels between a chart and the edge of its box: half of what lies between charts.
pub(super) const MARGIN: u32 = 4;

/// Times that coordinates are tried at a lower density.
const TRIES: u32 = 24;

/// Whose texture coordinates an object has in an atlas.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Coordinates {
    /// The second set of the file, `TEXCOORD_1`.
    File,
    /// Made: the file has none, or they leave the unit square, lie on top of each other, or closer than a texel.
    Made,
}

/// Where a mesh of some size lies in a rectangle of its own.
#[derive(Clone, Debug)]
pub(super) struct Unwrap {
    pub shape: Shape,
    pub content_hash: u64,
    /// Texels per metre that there are: the mean over the area for coordinates of a file.
    pub texels_per_metre: f32,
    pub coordinates: Coordinates,
    /// Per triangle of the mesh, the places of its corners, texels.
    pub places: Vec<[Vec2; 3]>,
    /// Width and height, texels, margins included.
    pub size: [u32; 2],
    /// Texels of the whole unit square of the coordinates, and where its origin lies.
    pub scale: DVec2,
    pub offset: DVec2,
}

/// The coordinates have no room, whatever the density.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct NoRoom;

impl Unwrap {
    /// Coordinates at so many texels per metre, or fewer where a page has no room for as many.
    pub(super) fn of(shape: Shape, texels_per_metre: f32, max_texels: u64) -> Result<Unwrap, NoRoom> {
        let positions = shape.positions();
        let base = Unwrap {
            content_hash: shape.content_hash(),
            texels_per_metre,
            coordinates: Coordinates::Made,
            places: Vec::new(),
            size: [0; 2],
            scale: DVec2::ONE,
            offset: DVec2::ZERO,
            shape,
        };
        let mut density = f64::from(texels_per_metre);
        for _ in 0..TRIES {
            if let Some(found) = of_file(base.shape.mesh(), &positions, density) {
                return Ok(Unwrap { texels_per_metre: density as f32, ..found.into_unwrap(base) });
            }
            match made(&base, &positions, density, max_texels) {
                Ok(unwrap) => return Ok(unwrap),
                Err(Unfit::TooMany) => return Err(NoRoom),
                Err(Unfit::TooWide(side)) => density *= (0.98 * f64::from(MAX_PAGE_SIDE) / side).clamp(1e-6, 0.9),
            }
        }
        Err(NoRoom)
    }

    /// Bytes held, without the mesh.
    pub(super) fn memory_bytes(&self) -> usize {
        size_of::<Unwrap>() + self.places.capacity() * size_of::<[Vec2; 3]>()
    }
}

/// Charts, packed.
fn made(base: &Unwrap, positions: &[DVec3], texels_per_metre: f64, max_texels: u64) -> Result<Unwrap, Unfit> {
    let room = Room { max_side: f64::from(MAX_PAGE_SIDE - 2 * MARGIN - 2), max_texels: max_texels as f64 };
    let triangles = &base.shape.mesh().triangles;
    let charts = charts(positions, triangles, texels_per_metre, room)?;
    let boxes: Vec<[u32; 2]> = charts.iter().map(|chart| chart.size.map(|side| side + 2 * MARGIN)).collect();
    let (corners, size) = pack(&boxes);
    if size[0].max(size[1]) > MAX_PAGE_SIDE {
        return Err(Unfit::TooWide(f64::from(size[0].max(size[1]))));
    }
    if boxes.iter().map(|[w, h]| u64::from(*w) * u64::from(*h)).sum::<u64>() > max_texels {
        return Err(Unfit::TooMany);
    }
    let mut places = vec![[Vec2::splat(MARGIN as f32 + 0.5); 3]; triangles.len()];
    for (chart, corner) in charts.iter().zip(&corners) {
        let corner = DVec2::from(corner.map(f64::from)) + f64::from(MARGIN);
        for (triangle, at) in &chart.triangles {
            places[*triangle as usize] = at.map(|at| (at + corner).as_vec2());
        }
    }
    Ok(Unwrap {
        texels_per_metre: texels_per_metre as f32,
        places,
        size,
        scale: DVec2::from(size.map(f64::from)),
        ..base.clone()
    })
}
