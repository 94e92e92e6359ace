//! Files of parts that are computed for a request: one or several values per element.

use glam::Vec3;
use rebake_core::delta::Frame;
use rebake_core::export::{EXR_WIDTH, Precision, write_exr, write_pages_exr, write_pages_ktx2};
use rebake_core::texels::read_page;

use crate::engine::{Atlas, Canceled, Observer, World};
use crate::store::computed::ComputedPart;

/// What a file of a computed part says of itself.
fn about_part(part: &ComputedPart, version: &str) -> Vec<(&'static str, String)> {
    let mut about = vec![("lightMapVersion", version.to_owned())];
    about.extend(part.about.iter().cloned());
    about
}

fn borrowed<'a>(about: &'a [(&'static str, String)]) -> Vec<(&'a str, &'a str)> {
    about.iter().map(|(name, text)| (*name, text.as_str())).collect()
}

/// All bands of a part: side by side in an OpenEXR picture, or one after the other as a delta from version 0.
pub(crate) fn file(part: &ComputedPart, version: u64, is_exr: bool) -> Result<Vec<u8>, String> {
    if !is_exr {
        let values: Vec<Vec3> = part.bands.iter().flat_map(|(_, values)| values).copied().collect();
        return Ok(Frame::whole(&values, version).encode());
    }
    let about = about_part(part, &version.to_string());
    let bands: Vec<(&str, &[Vec3])> = part.bands.iter().map(|(name, values)| (*name, values.as_slice())).collect();
    write_exr(&bands, EXR_WIDTH, &borrowed(&about)).map_err(|error| error.to_string())
}

/// All bands of a part on a page of an atlas, as an OpenEXR picture or the layers of a KTX2 texture.
pub(crate) fn page(
    (world, atlas): (&World, &Atlas),
    index: usize,
    part: &ComputedPart,
    version: u64,
    (precision, is_ktx2): (Precision, bool),
    observer: &dyn Observer,
) -> Result<Vec<u8>, String> {
    let read =
        |(name, values): &(&'static str, Vec<Vec3>)| Ok((*name, read_page(world, atlas, index, values, observer)?));
    let pages = part.bands.iter().map(read).collect::<Result<Vec<_>, Canceled>>();
    let pages = pages.map_err(|Canceled| "nobody waits for it".to_owned())?;
    let about = about_part(part, &version.to_string());
    let about = borrowed(&about);
    let file =
        if is_ktx2 { write_pages_ktx2(&pages, precision, &about) } else { write_pages_exr(&pages, precision, &about) };
    file.map_err(|error| error.to_string())
}
