//! Textures as light needs them: means over the footprints of elements, in linear light.

mod mean;
mod reduce;
#[cfg(test)]
mod tests;

use glam::{DVec2, Mat2, Vec2, Vec3, Vec4};

use self::reduce::Level;
use crate::bits::Bits;

/// A picture with its reductions to half the size, down to a single texel.
#[derive(Clone, PartialEq)]
pub struct Texture {
    /// From the largest that is kept to 1 × 1.
    levels: Vec<Level>,
    /// Where alpha is not below the cut-off, at the full resolution; only of cut-outs.
    mask: Option<Mask>,
    /// Whether some texel's weight is below 1.
    is_transparent: bool,
}

/// What the alpha of a texel means.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AlphaUse {
    /// Nothing: every texel counts in full.
    Ignored,
    /// Texels whose alpha is below this are holes and do not count; the others count in full. Within 0..=1.
    Cutoff(f32),
    /// A texel counts by its alpha.
    Blend,
}

/// What happens to texture coordinates outside 0..=1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wrap {
    /// The picture is repeated.
    #[default]
    Repeat,
    /// The picture is repeated, every other time mirrored.
    Mirror,
    /// The texels at the border go on.
    Clamp,
}

/// The mean of a texture over an area.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextureMean {
    /// Mean linear RGB of the texels, each counted by its weight ([`AlphaUse`]); zero where none has any.
    pub color: Vec3,
    /// Mean weight: the share of the area that is no hole, or the mean alpha.
    pub weight: f32,
}

/// A texture as a material uses it.
#[derive(Clone, Debug, PartialEq)]
pub struct TextureUse {
    /// The picture.
    pub texture: std::sync::Arc<Texture>,
    /// Which of the mesh's sets of texture coordinates: an index into [`super::Mesh::texcoords`].
    pub texcoord: usize,
    /// Texture coordinates are multiplied by this … (`KHR_texture_transform`)
    pub linear: Mat2,
    /// … and then moved by this.
    pub offset: Vec2,
    /// Along u and v.
    pub wrap: [Wrap; 2],
}

/// Which texels are there, row by row.
#[derive(Clone, Debug, PartialEq)]
struct Mask {
    width: u32,
    height: u32,
    texels: Bits,
}

impl Texture {
    /// Of `width` × `height` texels of 8-bit sRGB (IEC 61966-2-1) and alpha, row by row from the top. More than
    /// `max_texels` are reduced to half the size, in linear light, until they are few enough; cut-outs keep one bit
    /// for each texel besides.
    ///
    /// # Panics
    /// Where `rgba` has another length, or there is no texel.
    pub fn new(width: u32, height: u32, rgba: &[u8], alpha: AlphaUse, max_texels: usize) -> Self {
        let (texels, []) = rgba.as_chunks::<4>() else { panic!("four bytes a texel") };
        assert!(width > 0 && height > 0 && texels.len() == width as usize * height as usize, "{width} x {height}");
        let weights = alpha.weights();
        let mask = matches!(alpha, AlphaUse::Cutoff(_)).then(|| Mask::new(width, height, texels, &weights));
        let is_transparent = texels.iter().any(|texel| weights[texel[3] as usize] < 1.0);
        let levels = reduce::pyramid(width, height, texels, [&reduce::srgb_codes(), &weights], max_texels.max(1));
        Self { levels, mask, is_transparent }
    }

    /// Of texels that hold numbers and no colours: 255 is 1, and half of it half. Alpha does not count; else as
    /// [`Texture::new`].
    ///
    /// # Panics
    /// Where `rgba` has another length, or there is no texel.
    pub fn of_numbers(width: u32, height: u32, rgba: &[u8], max_texels: usize) -> Self {
        let (texels, []) = rgba.as_chunks::<4>() else { panic!("four bytes a texel") };
        assert!(width > 0 && height > 0 && texels.len() == width as usize * height as usize, "{width} x {height}");
        let codes = std::array::from_fn(|code| code as f32 / 255.0);
        let levels = reduce::pyramid(width, height, texels, [&codes, &AlphaUse::Ignored.weights()], max_texels.max(1));
        Self { levels, mask: None, is_transparent: false }
    }

    /// Width and height of the largest level that is kept, texels.
    pub fn size(&self) -> (u32, u32) {
        (self.levels[0].width, self.levels[0].height)
    }

    /// Bytes of memory.
    pub fn bytes(&self) -> usize {
        let levels: usize = self.levels.iter().map(|level| level.texels.len() * size_of::<[u16; 4]>()).sum();
        levels + self.mask.as_ref().map_or(0, |mask| mask.texels.memory_bytes())
    }

    /// Whether any texel is a hole, or not opaque where alpha counts.
    pub fn is_transparent(&self) -> bool {
        self.is_transparent
    }

    /// The mean over the whole picture.
    pub fn mean(&self) -> TextureMean {
        let last = &self.levels[self.levels.len() - 1];
        TextureMean::of(last.texel(0, 0).as_dvec4())
    }

    /// The texel at a place, linear RGB and weight; of the largest level that is kept.
    pub fn texel(&self, uv: Vec2, wrap: [Wrap; 2]) -> TextureMean {
        TextureMean::of(self.levels[0].at(uv.as_dvec2(), wrap).as_dvec4())
    }

    /// Whether holes are known to the texel: of textures made for [`AlphaUse::Cutoff`].
    #[inline]
    pub fn has_mask(&self) -> bool {
        self.mask.is_some()
    }

    /// Whether there is no hole at a place: exact to the texel. True everywhere for textures that are no cut-outs.
    pub fn is_solid_at(&self, uv: Vec2, wrap: [Wrap; 2]) -> bool {
        self.mask.as_ref().is_none_or(|mask| mask.is_set(uv, wrap))
    }
}

impl std::fmt::Debug for Texture {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (width, height) = self.size();
        write!(f, "Texture({width} x {height})")
    }
}

impl TextureUse {
    /// Texture coordinates of the mesh to those of the picture.
    pub fn map(&self, texcoord: Vec2) -> Vec2 {
        self.linear * texcoord + self.offset
    }

    /// Mean over a triangle given by the mesh's texture coordinates: see [`Texture::mean_over`].
    pub fn mean_over(&self, texcoords: [Vec2; 3]) -> TextureMean {
        self.texture.mean_over(texcoords.map(|texcoord| self.map(texcoord)), self.wrap)
    }

    /// The texel at a place, given by the mesh's texture coordinates; the mean where they are no numbers.
    pub fn texel(&self, texcoord: Vec2) -> TextureMean {
        let uv = self.map(texcoord);
        if uv.is_finite() { self.texture.texel(uv, self.wrap) } else { self.texture.mean() }
    }

    /// Whether there is no hole at a place, given by the mesh's texture coordinates.
    pub fn is_solid_at(&self, texcoord: Vec2) -> bool {
        self.texture.is_solid_at(self.map(texcoord), self.wrap)
    }
}

impl TextureMean {
    /// Of colour times weight, and weight.
    fn of(sum: glam::DVec4) -> Self {
        let color = if sum.w > 0.0 { sum.truncate() / sum.w } else { glam::DVec3::ZERO };
        Self { color: color.as_vec3(), weight: sum.w as f32 }
    }
}

impl AlphaUse {
    /// The weight of a texel for each alpha.
    fn weights(self) -> [f32; 256] {
        std::array::from_fn(|alpha| {
            let alpha = alpha as f32 / 255.0;
            match self {
                Self::Ignored => 1.0,
                Self::Cutoff(cutoff) => f32::from(u8::from(alpha >= cutoff)),
                Self::Blend => alpha,
            }
        })
    }
}

impl Wrap {
    /// The texel that stands at `index` of an endless row of `count`.
    fn apply(self, index: i64, count: u32) -> u32 {
        let count = i64::from(count);
        let inside = match self {
            _ if (0..count).contains(&index) => index,
            Self::Repeat => index.rem_euclid(count),
            Self::Mirror => {
                let within = index.rem_euclid(2 * count);
                within.min(2 * count - 1 - within)
            }
            Self::Clamp => index.clamp(0, count - 1),
        };
        inside as u32
    }
}

impl Level {
    /// The texel at a place.
    fn at(&self, uv: DVec2, wrap: [Wrap; 2]) -> Vec4 {
        let [x, y] = texel_at(uv, [self.width, self.height], wrap);
        self.texel(x, y)
    }
}

fn texel_at(uv: DVec2, size: [u32; 2], wrap: [Wrap; 2]) -> [u32; 2] {
    // What is not a number becomes 0, what is beyond i64 its end.
    [0, 1].map(|axis| wrap[axis].apply((uv[axis] * f64::from(size[axis])).floor() as i64, size[axis]))
}

impl Mask {
    fn new(width: u32, height: u32, texels: &[[u8; 4]], weights: &[f32; 256]) -> Self {
        let is_there = |&at: &usize| weights[texels[at][3] as usize] > 0.0;
        Self { width, height, texels: (0..texels.len()).filter(is_there).collect() }
    }

    fn is_set(&self, uv: Vec2, wrap: [Wrap; 2]) -> bool {
        let [x, y] = texel_at(uv.as_dvec2(), [self.width, self.height], wrap);
        self.texels.contains(y as usize * self.width as usize + x as usize)
    }
}
