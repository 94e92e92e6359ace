//! What of a material varies from place to place, and what lets light through.

use glam::{DVec3, Vec2, Vec3, Vec4};

use super::{Object, TextureMean, TextureUse};

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
    /// An edit has painted over the colour: of texture and vertex colours only alpha counts, and what goes through.
    pub is_painted: bool,
    /// Emissive factor times strength, radiance, at upload. What is in force is the strength of the [`super::Light`] of this
    /// material.
    pub emission: Vec3,
    /// Emissive texture.
    pub emissive: Option<TextureUse>,
    /// Share of the light that is not reflected at the surface and goes through it (`KHR_materials_transmission`),
    /// 0..=1 …
    pub transmission: f32,
    /// … times the red of this.
    pub transmission_texture: Option<TextureUse>,
    /// What the volume below takes of that light, per metre, linear RGB, each 0 or more (`KHR_materials_volume`) …
    pub absorption: Vec3,
    /// … over this length, in the mesh's space; 0: a thin sheet without a volume …
    pub thickness: f32,
    /// … times the green of this.
    pub thickness_texture: Option<TextureUse>,
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

/// How a place lets light through that is not reflected at the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Through {
    /// Share of that light, 0..=1.
    pub share: f32,
    /// What the volume behind leaves of it, linear RGB, each 0..=1.
    pub volume: Vec3,
}

/// What happens to light that meets a surface at a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Passage {
    /// Share of the place that is surface, 0..=1: as much of what it emits it sends out.
    pub covered: f32,
    /// Share that does not go through, 0..=1: it is reflected as the albedo says.
    pub opacity: f32,
    /// What is left of the rest behind the surface, linear RGB, each 0..=1.
    pub tint: Vec3,
}

impl Passage {
    /// What of the light is left behind the surface, linear RGB.
    pub(crate) fn transmittance(self) -> Vec3 {
        self.tint * (1.0 - self.opacity)
    }
}

impl Look {
    /// One colour all over, opaque.
    pub fn plain(factor: Vec3) -> Self {
        Self {
            factor,
            alpha: 1.0,
            alpha_mode: AlphaMode::Opaque,
            base_color: None,
            is_painted: false,
            emission: Vec3::ZERO,
            emissive: None,
            transmission: 0.0,
            transmission_texture: None,
            absorption: Vec3::ZERO,
            thickness: 0.0,
            thickness_texture: None,
        }
    }

    /// All textures.
    pub(crate) fn textures(&self) -> impl Iterator<Item = &TextureUse> {
        [&self.base_color, &self.emissive, &self.transmission_texture, &self.thickness_texture].into_iter().flatten()
    }

    /// All textures.
    pub(crate) fn textures_mut(&mut self) -> impl Iterator<Item = &mut TextureUse> {
        let glass = [&mut self.transmission_texture, &mut self.thickness_texture];
        [&mut self.base_color, &mut self.emissive].into_iter().chain(glass).flatten()
    }

    /// Whether it says more than one albedo and one emission do.
    pub fn varies(&self) -> bool {
        self.may_let_light_through() || self.base_color.is_some() || self.emissive.is_some()
    }

    /// Whether light may go through some place.
    pub fn may_let_light_through(&self) -> bool {
        self.alpha_mode != AlphaMode::Opaque || self.transmission > 0.0
    }

    /// Whether all light goes through every place, whatever the mesh: as if there were no surface.
    pub fn is_clear(&self) -> bool {
        let is_white = self.factor == Vec3::ONE && self.base_color.is_none();
        let is_thin = self.thickness == 0.0 || self.absorption == Vec3::ZERO;
        self.is_gone() || self.transmission >= 1.0 && self.transmission_texture.is_none() && is_white && is_thin
    }

    /// Whether alpha leaves nothing of it, whatever the mesh.
    pub fn is_gone(&self) -> bool {
        match self.alpha_mode {
            AlphaMode::Opaque => false,
            AlphaMode::Mask(cutoff) => self.alpha < cutoff,
            AlphaMode::Blend => self.alpha == 0.0,
        }
    }

    /// Whether no light goes through a triangle, given by the mesh's texture coordinates of each set, with these alphas
    /// of the mesh's colour at its corners. Holes that are a millionth of it may be overlooked.
    pub(crate) fn is_opaque_over(&self, texcoords: impl Fn(usize) -> [Vec2; 3], alphas: [f32; 3]) -> bool {
        let least = alphas.into_iter().fold(self.alpha, |least, alpha| least.min(self.alpha * alpha));
        let weight = self.weight_over(&texcoords);
        self.transmission_over(&texcoords) <= 0.0
            && match self.alpha_mode {
                AlphaMode::Opaque => true,
                AlphaMode::Mask(cutoff) => weight >= 1.0 && least >= cutoff,
                AlphaMode::Blend => weight >= 1.0 && least >= 1.0,
            }
    }

    /// Mean weight of the base colour texture over a triangle.
    fn weight_over(&self, texcoords: impl Fn(usize) -> [Vec2; 3]) -> f32 {
        self.base_color.as_ref().map_or(1.0, |texture| texture.mean_over(texcoords(texture.texcoord)).weight)
    }

    /// Mean transmission over a triangle.
    fn transmission_over(&self, texcoords: impl Fn(usize) -> [Vec2; 3]) -> f32 {
        let texture = self.transmission_texture.as_ref();
        self.transmission * texture.map_or(1.0, |texture| texture.mean_over(texcoords(texture.texcoord)).color.x)
    }

    /// How it lets light through at a place, given by texture coordinates of the transmission and of the thickness
    /// picture; `volume` is what the volume behind leaves of light at its full thickness.
    #[inline]
    pub(crate) fn through(&self, [transmission, thickness]: [Vec2; 2], volume: Vec3) -> Through {
        let share = self.transmission_texture.as_ref().map_or(1.0, |texture| texel(texture, transmission).color.x);
        let volume = match &self.thickness_texture {
            Some(texture) => volume.powf(texel(texture, thickness).color.y),
            None => volume,
        };
        Through { share: self.transmission * share, volume }
    }

    /// What happens to light at a place, given by texture coordinates of the picture (the whole counts where they are no
    /// numbers); `color` is the mesh's there.
    #[inline]
    pub(crate) fn passage(&self, uv: Vec2, color: Vec4, Through { share, volume }: Through) -> Passage {
        let covered = self.coverage(uv, color.w);
        if share <= 0.0 {
            return Passage { covered, opacity: covered, tint: Vec3::ONE };
        }
        let texture = self.base_color.as_ref().map_or(Vec3::ONE, |texture| texel(texture, uv).color);
        let base = (self.factor * texture * color.truncate()).clamp(Vec3::ZERO, Vec3::ONE);
        let (opacity, through) = (covered * (1.0 - share), covered * share);
        let behind = Vec3::splat(1.0 - covered) + base * volume * through;
        let tint = if opacity < 1.0 { (behind / (1.0 - opacity)).min(Vec3::ONE) } else { Vec3::ONE };
        Passage { covered, opacity, tint }
    }

    /// Share of a place that is surface.
    #[inline]
    fn coverage(&self, uv: Vec2, vertex_alpha: f32) -> f32 {
        let alpha = self.alpha * vertex_alpha;
        let texture = self.base_color.as_ref();
        let of_texel = |texture: &TextureUse| texel(texture, uv).weight;
        let if_all = |is_there: bool| f32::from(u8::from(is_there));
        match (self.alpha_mode, texture) {
            (AlphaMode::Opaque, _) => 1.0,
            (AlphaMode::Mask(cutoff), None) => if_all(alpha >= cutoff),
            (AlphaMode::Mask(cutoff), Some(t)) if t.texture.has_mask() => {
                let is_there = alpha >= cutoff && t.texture.is_solid_at(uv, t.wrap);
                if uv.is_finite() { if_all(is_there) } else { if_all(alpha >= cutoff) * of_texel(t) }
            }
            (AlphaMode::Mask(cutoff), Some(t)) => if_all(alpha * of_texel(t) >= cutoff),
            (AlphaMode::Blend, _) => (alpha * texture.map_or(1.0, of_texel)).clamp(0.0, 1.0),
        }
    }

    /// Mean share of light that does not go through a triangle, as [`Look::is_opaque_over`] has it.
    fn mean_opacity_over(&self, texcoords: impl Fn(usize) -> [Vec2; 3], alphas: [f32; 3]) -> f32 {
        let weight = self.weight_over(&texcoords);
        let alpha = self.alpha * alphas.into_iter().sum::<f32>() / 3.0;
        let has_mask = self.base_color.as_ref().is_some_and(|texture| texture.texture.has_mask());
        let covered = match self.alpha_mode {
            AlphaMode::Opaque => 1.0,
            AlphaMode::Mask(cutoff) if has_mask => weight * f32::from(u8::from(alpha >= cutoff)),
            AlphaMode::Mask(cutoff) => f32::from(u8::from(alpha * weight >= cutoff)),
            AlphaMode::Blend => alpha * weight,
        };
        covered * (1.0 - self.transmission_over(&texcoords))
    }
}

/// The texel at a place, or the whole.
fn texel(texture: &TextureUse, uv: Vec2) -> TextureMean {
    if uv.is_finite() { texture.texture.texel(uv, texture.wrap) } else { texture.texture.mean() }
}

impl Object {
    /// Mean share of light that does not go through what an object has of a material, 0..=1.
    pub fn mean_opacity(&self, material: usize) -> f32 {
        let look = self.looks.get(material).and_then(Option::as_deref);
        let Some(look) = look.filter(|look| look.may_let_light_through()) else { return 1.0 };
        let (mut sum, mut total) = (0.0, 0.0);
        for corners in self.triangles_of(material) {
            let alphas = corners.map(|vertex| self.mesh.colors.get(vertex).map_or(1.0, |color| color.w));
            let area = self.double_area(corners);
            sum += area * f64::from(look.mean_opacity_over(|set| self.texcoords(set, corners), alphas));
            total += area;
        }
        if total > 0.0 { (sum / total) as f32 } else { 1.0 }
    }

    /// Mean over what an object has of a material of the emissive texture, linear RGB, each in 0..=1: one where there is
    /// none. The light of this material shines by as much less than its strength.
    pub fn mean_emission(&self, material: usize) -> Vec3 {
        let Some(texture) = self.emissive_texture(material) else { return Vec3::ONE };
        let (mut sum, mut total) = (DVec3::ZERO, 0.0);
        for corners in self.triangles_of(material) {
            let area = self.double_area(corners);
            sum += area * texture.mean_over(self.texcoords(texture.texcoord, corners)).color.as_dvec3();
            total += area;
        }
        if total > 0.0 { (sum / total).as_vec3() } else { texture.texture.mean().color }
    }

    /// Whether the emissive texture of a material is not black all over the object; also where there is none.
    pub(crate) fn shines(&self, material: usize) -> bool {
        self.emissive_texture(material).is_none_or(|texture| {
            let color = |corners| texture.mean_over(self.texcoords(texture.texcoord, corners)).color;
            self.triangles_of(material).any(|corners| color(corners) != Vec3::ZERO)
        })
    }

    fn emissive_texture(&self, material: usize) -> Option<&TextureUse> {
        self.looks.get(material)?.as_ref()?.emissive.as_ref()
    }

    /// Vertices of the triangles of a material.
    fn triangles_of(&self, material: usize) -> impl Iterator<Item = [usize; 3]> + '_ {
        let triangles = self.mesh.triangles.iter().zip(&self.mesh.triangle_materials);
        let of_material = triangles.filter(move |(_, m)| **m as usize == material);
        of_material.map(|(triangle, _)| triangle.map(|vertex| vertex as usize))
    }

    /// Of one set; not a number where the mesh has none.
    fn texcoords(&self, set: usize, corners: [usize; 3]) -> [Vec2; 3] {
        let texcoords = self.mesh.texcoords.get(set);
        corners.map(|vertex| texcoords.and_then(|set| set.get(vertex)).copied().unwrap_or(Vec2::NAN))
    }

    /// In the space of the mesh.
    fn double_area(&self, corners: [usize; 3]) -> f64 {
        let [a, b, c] = corners.map(|vertex| self.mesh.positions[vertex].as_dvec3());
        (b - a).cross(c - a).length()
    }
}
