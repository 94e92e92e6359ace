//! Mean colour of a texture.

use ::gltf::json;
use glam::Vec3;

use super::container::File;
use super::warnings::Warnings;
use super::{LoadError, LoadLimits};

/// Means of the textures of a file, each computed once.
#[derive(Debug)]
pub(super) struct TextureMeans<'f> {
    _file: &'f File<'f>,
}

impl<'f> TextureMeans<'f> {
    pub(super) fn new(file: &'f File<'f>, _limits: &LoadLimits) -> Self {
        Self { _file: file }
    }

    /// Linear RGB mean of the sRGB texture.
    pub(super) fn mean(
        &mut self,
        _texture: &json::texture::Info,
        place: &str,
        kind: &str,
        warnings: &mut Warnings,
    ) -> Result<Vec3, LoadError> {
        warnings.add(format!("the {kind} texture is ignored"), place);
        Ok(Vec3::ONE)
    }
}
