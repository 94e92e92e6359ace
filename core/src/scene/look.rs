//! What of a material varies from place to place, and what lets light through.

use glam::Vec3;

use super::TextureUse;

/// Colour, emission and transparency of a material by place, as the file has them. At a place the base colour is
/// `factor` × the texture × the mesh's colour, and the emission is `emission` × its texture; texels that alpha rules
/// out are no surface.
#[derive(Clone, Debug, PartialEq)]
pub struct Look {
    /// Base colour factor, linear RGB, each in 0..=1.
    pub factor: Vec3,
    /// Alpha factor, 0..=1.
    pub alpha: f32,
    /// What alpha means.
    pub alpha_mode: AlphaMode,
    /// Base colour and alpha texture.
    pub base_color: Option<TextureUse>,
    /// Emissive factor times strength, radiance.
    pub emission: Vec3,
    /// Emissive texture.
    pub emissive: Option<TextureUse>,
    /// Share of the light that is not reflected at the surface and goes through it (`KHR_materials_transmission`),
    /// 0..=1.
    pub transmission: f32,
}

/// What the alpha of a material means.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AlphaMode {
    /// Nothing.
    Opaque,
    /// Places whose alpha is below this are holes, the others are opaque.
    Mask(f32),
    /// A surface lets 1 − alpha of the light through.
    Blend,
}

impl Look {
    /// One colour all over, opaque.
    pub fn plain(factor: Vec3) -> Self {
        Self {
            factor,
            alpha: 1.0,
            alpha_mode: AlphaMode::Opaque,
            base_color: None,
            emission: Vec3::ZERO,
            emissive: None,
            transmission: 0.0,
        }
    }

    /// Whether it says more than one albedo and one emission do.
    pub fn varies(&self) -> bool {
        let is_plain = self.alpha_mode == AlphaMode::Opaque && self.transmission == 0.0;
        !is_plain || self.base_color.is_some() || self.emissive.is_some()
    }
}
