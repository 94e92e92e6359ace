//! A document with the files that it names as one archive, to be sent.

use std::collections::BTreeSet;
use std::io::{Cursor, Write};
use std::path::Path;

use serde::Deserialize;
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

use super::LoadError;
use super::files::relative_path;

/// What of a document names files.
#[derive(Deserialize)]
struct Document {
    #[serde(default)]
    buffers: Vec<Resource>,
    #[serde(default)]
    images: Vec<Resource>,
}

#[derive(Deserialize)]
struct Resource {
    uri: Option<String>,
}

/// A file of this machine as a client sends it: a `.gltf` with the files that it names and that are there becomes a zip
/// archive, which [`super::load`] reads; every other file is what it is. The same files give the same bytes.
///
/// # Errors
/// [`LoadError::Malformed`]: a file that cannot be read.
pub fn packed(path: &Path) -> Result<Vec<u8>, LoadError> {
    let unreadable = |path: &Path, error: std::io::Error| LoadError::Malformed(format!("{}: {error}", path.display()));
    let bytes = std::fs::read(path).map_err(|error| unreadable(path, error))?;
    let json = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes).trim_ascii_start();
    let document = json.starts_with(b"{").then(|| serde_json::from_slice::<Document>(json).ok()).flatten();
    let folder = path.parent().unwrap_or(Path::new(""));
    let uris = document.into_iter().flat_map(|document| document.buffers.into_iter().chain(document.images));
    let named: BTreeSet<String> = uris.filter_map(|resource| relative_path(resource.uri?.trim_ascii())).collect();
    let there: Vec<&String> = named.iter().filter(|name| folder.join(name).is_file()).collect();
    if there.is_empty() {
        return Ok(bytes);
    }
    // Deep enough for names that lead out of the document's folder.
    let above = named.iter().map(|name| name.split('/').take_while(|part| *part == "..").count()).max().unwrap_or(0);
    let depth = vec!["above"; above];
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let mut add = |name: &str, bytes: &[u8]| -> std::io::Result<()> {
        archive.start_file(name, SimpleFileOptions::default())?;
        archive.write_all(bytes)
    };
    let failed =
        |error: &dyn std::fmt::Display| LoadError::Malformed(format!("{}: cannot be packed: {error}", path.display()));
    let in_folder = |name: &str| [&depth[..], &[name]].concat().join("/");
    add(&in_folder("scene.gltf"), &bytes).map_err(|error| failed(&error))?;
    for name in there {
        let file = folder.join(name);
        let bytes = std::fs::read(&file).map_err(|error| unreadable(&file, error))?;
        let ups = name.split('/').take_while(|part| *part == "..").count();
        let below = name.split('/').skip(ups);
        let place: Vec<&str> = depth[..above - ups].iter().copied().chain(below).collect();
        add(&place.join("/"), &bytes).map_err(|error| failed(&error))?;
    }
    let archive = archive.finish().map_err(|error| failed(&error))?;
    Ok(archive.into_inner())
}
