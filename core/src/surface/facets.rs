//! Emission by place: triangles whose emissive texture varies are divided into facets, each of which sends out the mean of
//! what its part of the picture shows, in linear light. The energy is right whatever their size, and no texture is read while
//! rays are traced.

use std::sync::Arc;

use glam::{Vec2, Vec3};

use super::{Corners, Surface, triangle_area};
use crate::scene::{Look, Object, TextureUse};

/// Facets that the triangles of one material of an object are divided into, at most; those that are not divided come on
/// top. About 110 bytes each.
const MAX_FACETS: usize = 1 << 14;
/// Edges of facets are at most this part of the spacing …
const OF_SPACING: f32 = 0.5;
/// … and of the diagonal of the box around all triangles of the material, where the picture varies.
const OF_EXTENT: f32 = 1.0 / 16.0;
/// Texels of a facet at most: the mean over more is not exact.
const MAX_TEXELS: f32 = 1024.0;
/// Facets whose colours (0..=1) differ less are one.
const SAME: f32 = 1.0 / 1024.0;

/// A part of a triangle, with what it sends out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Facet {
    /// Index of the triangle in its surface.
    pub face: u32,
    /// Its corners, in the order of the triangle's: barycentric weights of the triangle's second and third corner.
    pub corners: [Vec2; 3],
    /// How often the triangle was divided in four to get it.
    pub level: u32,
    /// Mean of the emissive texture, linear RGB, each in 0..=1, not all zero.
    pub color: Vec3,
}

/// The facets of the triangles of one material. What does not shine has none.
#[derive(Debug, PartialEq)]
pub(crate) struct Facets {
    list: Vec<Facet>,
    /// The triangles, ascending.
    faces: Vec<u32>,
    /// First those of `faces`, then fours.
    nodes: Vec<Node>,
}

/// A triangle, or a fourth of a node.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Node {
    Dark,
    /// Index of the facet.
    Facet(u32),
    /// Index of the first of four nodes: at the corners, and in the middle.
    Four(u32),
}

/// A node while the picture is read.
enum Quarter {
    Whole(Vec3),
    Four(Box<[Quarter; 4]>),
}

impl Facets {
    /// Per material of an object: its facets, where its emission varies; empty where none does. `spacing` is the largest
    /// distance between elements, metres.
    pub(crate) fn of_materials(object: &Object, surface: &Surface, spacing: f32) -> Vec<Option<Arc<Facets>>> {
        let emissive = |look: &Option<Arc<Look>>| look.as_ref().is_some_and(|look| look.emissive.is_some());
        if !object.looks.iter().any(emissive) {
            return Vec::new();
        }
        let of = |(material, look): (usize, &Option<Arc<Look>>)| {
            let texture = look.as_ref()?.emissive.as_ref()?;
            Some(Arc::new(Facets::new(object, surface, material as u32, texture, spacing)))
        };
        object.looks.iter().enumerate().map(of).collect()
    }

    fn new(object: &Object, surface: &Surface, material: u32, texture: &TextureUse, spacing: f32) -> Facets {
        let of_material = |face: &usize| surface.triangle_materials[*face] == material;
        let faces: Vec<usize> = (0..surface.triangles.len()).filter(of_material).collect();
        let texcoords = |face: usize| Corners::new(&object.mesh, surface, face as u32).texcoords(texture.texcoord);
        let finest = finest_edge(surface, &faces, spacing);
        let level = |face: &usize| level(surface.corners(*face), finest, texels(texture, texcoords(*face)));
        let levels = within_bounds(&faces.iter().map(level).collect::<Vec<u32>>());
        let mut facets = Facets {
            list: Vec::new(),
            faces: faces.iter().map(|face| *face as u32).collect(),
            nodes: vec![Node::Dark; faces.len()],
        };
        for (index, (face, level)) in faces.into_iter().zip(levels).enumerate() {
            let part = divide(texture, texcoords(face), level);
            facets.add(index, &part, Facet { face: face as u32, corners: WHOLE, level: 0, color: Vec3::ZERO });
        }
        facets.list.shrink_to_fit();
        facets.nodes.shrink_to_fit();
        facets
    }

    /// Makes a part the node at `index`; `place` is where it is.
    fn add(&mut self, index: usize, part: &Quarter, place: Facet) {
        self.nodes[index] = match part {
            Quarter::Whole(Vec3::ZERO) => Node::Dark,
            Quarter::Whole(color) => {
                self.list.push(Facet { color: *color, ..place });
                Node::Facet(self.list.len() as u32 - 1)
            }
            Quarter::Four(parts) => {
                let first = self.nodes.len();
                self.nodes.extend([Node::Dark; 4]);
                for (k, (part, corners)) in parts.iter().zip(fourths(place.corners)).enumerate() {
                    self.add(first + k, part, Facet { corners, level: place.level + 1, ..place });
                }
                Node::Four(first as u32)
            }
        };
    }

    /// All that shine, by ascending face.
    pub(crate) fn list(&self) -> &[Facet] {
        &self.list
    }

    /// Index of the facet at a place of a triangle, given by the barycentric weights of its second and third corner; none
    /// where it does not shine.
    pub(crate) fn at(&self, face: u32, [u, v]: [f32; 2]) -> Option<usize> {
        let mut node = self.nodes[self.faces.binary_search(&face).ok()?];
        let mut weights = Vec3::new(1.0 - u - v, u, v);
        loop {
            match node {
                Node::Dark => return None,
                Node::Facet(facet) => return Some(facet as usize),
                Node::Four(first) => {
                    let corner = (0..3).find(|corner| weights[*corner] >= 0.5);
                    weights = match corner {
                        Some(corner) => 2.0 * weights - Vec3::AXES[corner],
                        None => Vec3::ONE - 2.0 * weights,
                    };
                    node = self.nodes[first as usize + corner.unwrap_or(3)];
                }
            }
        }
    }

    /// Bytes held.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.list.capacity() * size_of::<Facet>()
            + self.faces.capacity() * size_of::<u32>()
            + self.nodes.capacity() * size_of::<Node>()
    }
}

impl Facet {
    /// A place given by weights of its corners, as weights of the triangle's second and third corner.
    pub(crate) fn place(&self, weights: [f32; 3]) -> [f32; 2] {
        self.corners.iter().zip(weights).map(|(corner, w)| *corner * w).sum::<Vec2>().to_array()
    }
}

/// A whole triangle.
const WHOLE: [Vec2; 3] = [Vec2::ZERO, Vec2::X, Vec2::Y];

/// A triangle divided at the middles of its sides: the parts at its corners, and the one between, turned about. Corners
/// keep their order.
fn fourths([a, b, c]: [Vec2; 3]) -> [[Vec2; 3]; 4] {
    let [ab, bc, ca] = [(a + b) * 0.5, (b + c) * 0.5, (c + a) * 0.5];
    [[a, ab, ca], [ab, b, bc], [ca, bc, c], [bc, ca, ab]]
}

/// Reads a triangle of the picture, divided in four `levels` times; parts that are the same become one.
fn divide(texture: &TextureUse, texcoords: [Vec2; 3], levels: u32) -> Quarter {
    if levels == 0 {
        return Quarter::Whole(texture.mean_over(texcoords).color);
    }
    let parts = fourths(texcoords).map(|part| divide(texture, part, levels - 1));
    let whole = |part: &Quarter| if let Quarter::Whole(color) = part { Some(*color) } else { None };
    if let [Some(a), Some(b), Some(c), Some(d)] = [0, 1, 2, 3].map(|k| whole(&parts[k])) {
        let mean = (a + b + c + d) * 0.25;
        let is_same =
            |color: Vec3| (color - mean).abs().max_element() <= SAME && (color == Vec3::ZERO) == (mean == Vec3::ZERO);
        if [a, b, c, d].into_iter().all(is_same) {
            return Quarter::Whole(mean);
        }
    }
    Quarter::Four(Box::new(parts))
}

/// How long the edges of facets may be, metres.
fn finest_edge(surface: &Surface, faces: &[usize], spacing: f32) -> f32 {
    let corners = faces.iter().flat_map(|face| surface.corners(*face));
    let bounds = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let (low, high) = corners.fold(bounds, |(low, high), corner| (low.min(corner), high.max(corner)));
    (OF_SPACING * spacing).min(OF_EXTENT * (high - low).length())
}

/// Texels of the picture under a triangle.
fn texels(texture: &TextureUse, texcoords: [Vec2; 3]) -> f32 {
    let (width, height) = texture.texture.size();
    let [a, b, c] = texcoords.map(|texcoord| texture.map(texcoord) * Vec2::new(width as f32, height as f32));
    0.5 * (b - a).perp_dot(c - a).abs()
}

/// How often a triangle is to be divided in four.
fn level([a, b, c]: [Vec3; 3], finest: f32, texels: f32) -> u32 {
    let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
    let by_length = (longest / finest).log2();
    let by_texels = 0.5 * (texels / MAX_TEXELS).log2();
    // What is not a number, as where there are no texture coordinates, counts as 0.
    by_length.max(by_texels).ceil().clamp(0.0, 32.0) as u32
}

/// Levels as deep as [`MAX_FACETS`] allows: all are taken back by as much as it takes.
fn within_bounds(levels: &[u32]) -> Vec<u32> {
    let less = |by: u32| levels.iter().map(move |level| level.saturating_sub(by));
    let count = |by: u32| {
        let divided = less(by).filter(|level| *level > 0);
        divided.fold(0usize, |sum, level| sum.saturating_add(4usize.saturating_pow(level)))
    };
    let by = (0..=32).find(|by| count(*by) <= MAX_FACETS).unwrap_or(32);
    less(by).collect()
}

/// Area in m² of what a facet is part of, and of the facet.
pub(crate) fn facet_area(surface: &Surface, facet: &Facet) -> f32 {
    (triangle_area(surface.corners(facet.face as usize)) * 0.25f64.powi(facet.level as i32)) as f32
}

#[cfg(test)]
mod tests {
    use glam::{DMat4, Mat2};

    use super::*;
    use crate::random::Pcg32;
    use crate::scene::{AlphaUse, Material, Mesh, Texture, Wrap};

    /// The facets of a square of a metre that shows a picture once, and its surface.
    fn square(size: u32, texel: impl Fn(u32, u32) -> [u8; 3], spacing: f32) -> (Surface, Facets) {
        let rgba: Vec<u8> = (0..size * size)
            .flat_map(|i| {
                let [r, g, b] = texel(i % size, i / size);
                [r, g, b, 255]
            })
            .collect();
        let texture = Arc::new(Texture::new(size, size, &rgba, AlphaUse::Ignored, 1 << 20));
        let linear = Mat2::IDENTITY;
        let emissive = TextureUse { texture, texcoord: 0, linear, offset: Vec2::ZERO, wrap: [Wrap::Repeat; 2] };
        let mut mesh = Mesh::quad(Vec3::ZERO, Vec3::X, Vec3::Y);
        mesh.texcoords[0] = mesh.positions.iter().map(|p| Vec2::new(p.x, p.y)).collect();
        let mut object = Object::new("square", mesh, Material::emissive(Vec3::ONE));
        object.looks = vec![Some(Arc::new(Look { emissive: Some(emissive), ..Look::plain(Vec3::ONE) }))];
        let surface = Surface::build(&object, DMat4::IDENTITY).expect("a square");
        let mut facets = Facets::of_materials(&object, &surface, spacing);
        let facets = Arc::into_inner(facets.remove(0).expect("facets")).expect("one owner");
        (surface, facets)
    }

    fn energy(surface: &Surface, facets: &Facets) -> Vec3 {
        facets.list().iter().map(|facet| facet.color * facet_area(surface, facet)).sum()
    }

    #[test]
    fn what_is_the_same_is_one_facet_and_what_is_dark_is_none() {
        let (_, dark) = square(64, |_, _| [0; 3], 0.01);
        assert!(dark.list().is_empty() && dark.at(0, [0.2, 0.2]).is_none());
        let (surface, white) = square(64, |_, _| [255; 3], 0.01);
        assert_eq!(white.list().len(), 2, "one per triangle");
        assert!(energy(&surface, &white).distance(Vec3::ONE) < 1e-5);
        // An edge that middles of sides meet: four parts suffice.
        let (surface, half) = square(64, |x, _| if x < 32 { [255, 0, 0] } else { [0; 3] }, 0.01);
        assert!(half.list().len() <= 8, "{}", half.list().len());
        assert!(energy(&surface, &half).distance(Vec3::X * 0.5) < 1e-5);
    }

    #[test]
    fn the_facet_of_a_place_is_the_one_that_it_lies_in() {
        let (surface, facets) = square(16, |x, y| [255 * u8::from((x + y) % 2 == 0), (16 * x + 15) as u8, 0], 0.05);
        let texture_at =
            |p: Vec3| if ((p.x * 16.0) as u32 + (p.y * 16.0) as u32).is_multiple_of(2) { 1.0 } else { 0.0 };
        let mut rng = Pcg32::new(1, 2);
        let mut matches = 0;
        for _ in 0..4000 {
            let [mut u, mut v] = rng.next_2d();
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            let face = u32::from(rng.next_f32() < 0.5);
            let facet = facets.list()[facets.at(face, [u, v]).expect("all of it shines a little")];
            assert_eq!(facet.face, face);
            // Weights of the place in the facet: none is below zero.
            let [a, b, c] = facet.corners;
            let area = (b - a).perp_dot(c - a);
            let place = Vec2::new(u, v);
            let weights = [(b, c), (c, a), (a, b)].map(|(p, q)| (p - place).perp_dot(q - place) / area);
            assert!(weights.iter().all(|w| *w > -1e-4), "{weights:?}");
            assert!((Vec2::from_array(facet.place(weights)) - place).length() < 1e-4);
            let [p, q, r] = surface.corners(face as usize);
            matches += u32::from((texture_at(p + (q - p) * u + (r - p) * v) - facet.color.x).abs() < 0.51);
        }
        assert!(matches > 3500, "{matches}");
        let exact = (0..256).filter(|i| (i % 16 + i / 16) % 2 == 0).count() as f32 / 256.0;
        assert!((energy(&surface, &facets).x - exact).abs() < 1e-4);
    }

    /// A picture that varies everywhere, at a spacing that asks for more: bounded, and the energy is right.
    #[test]
    fn facets_are_bounded() {
        let noise = |x: u32, y: u32| [(x * 37 + y * 101) as u8, (x * 5 + y * 77) as u8, (x * y) as u8];
        let (surface, facets) = square(512, noise, 1e-4);
        assert!(facets.list().len() <= MAX_FACETS && facets.list().len() > MAX_FACETS / 8, "{}", facets.list().len());
        assert!(facets.memory_bytes() < 100 * MAX_FACETS);
        let code = |c: u8| {
            let value = f64::from(c) / 255.0;
            if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
        };
        let mean = (0..512 * 512).map(|i| code(noise(i % 512, i / 512)[0])).sum::<f64>() / (512.0 * 512.0);
        assert!((f64::from(energy(&surface, &facets).x) - mean).abs() < 1e-3 * mean);
    }
}
