//! Files that leave the engine: binary glTF, OpenEXR, KTX2 and PNG.

mod exr;
mod glb;
mod ktx2;
mod lightmap;
mod png;

pub use self::exr::{EXR_WIDTH, Precision, write_exr, write_page_exr, write_pages_exr, write_picture_exr};
pub use self::glb::{
    LightAbout, LightLayout, LitExport, MeshExport, ObjectExport, Originals, write_glb, write_lit_glb,
    write_object_glb, write_scene_glb,
};
pub use self::ktx2::write_pages_ktx2;
pub use self::lightmap::{lightmap_exr, lightmap_glb, object_glb};
pub use self::png::{srgb_from_linear, write_png};

/// Why a file could not be written.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ExportError {
    /// The lists of an object or layer do not fit together.
    #[error("\"{0}\": its lists differ in length, are empty, or refer to entries that do not exist")]
    Lists(String),
    /// A number of an object is not finite.
    #[error("\"{0}\": it has a number that is not finite")]
    NotFinite(String),
    /// Two layers of one name, a name that cannot be written, or none.
    #[error("layer or attribute \"{0}\": its name is taken or not possible")]
    Name(String),
    /// The format cannot hold this much.
    #[error("the data exceeds what the file format can hold")]
    TooLarge,
    /// The document could not be written as JSON.
    #[error("the glTF document could not be written")]
    Json,
    /// The EXR library refused.
    #[error("the EXR file could not be written: {0}")]
    Exr(String),
    /// The PNG library refused.
    #[error("the PNG file could not be written: {0}")]
    Png(String),
}
