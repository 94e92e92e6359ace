//! The outer layer of a file: the chunks of a `.glb` or the bare JSON of a `.gltf`, where its buffers come from, and
//! the checks of the document as a whole.

use std::borrow::Cow;
use std::cell::{Cell, OnceCell};

use ::gltf::json;
use json::validation::{Checked, Error, Validate};

use super::document::{self, Document, Extensions};
use super::files::{Files, Named, resolve};
use super::{LoadError, LoadLimits, malformed};

const HEADER_BYTES: usize = 12;
const CHUNK_HEADER_BYTES: usize = 8;
const CHUNK_JSON: [u8; 4] = *b"JSON";
const CHUNK_BIN: [u8; 4] = *b"BIN\0";
/// Messages of the schema check that are passed on; the others say the same of other places.
const MESSAGES_SHOWN: usize = 4;

/// An opened file. All indices within `root` exist.
#[derive(Debug)]
pub(super) struct File<'a> {
    /// The document.
    pub(super) root: json::Root,
    /// What its extensions say that `root` does not hold.
    pub(super) more: Extensions,
    /// Whether there are animations.
    pub(super) has_animations: bool,
    /// Per buffer: at least the bytes that the document states. Absent: data of compressed views only.
    pub(super) buffers: Vec<Option<Cow<'a, [u8]>>>,
    /// Per buffer view: its bytes, once decompressed.
    pub(super) decompressed: Vec<OnceCell<Vec<u8>>>,
    /// Where files lie that the document names.
    pub(super) files: &'a Files<'a>,
    /// What may still be unpacked.
    pub(super) unpacked: Allowance,
    /// What may still be read of accessors and compressed meshes.
    pub(super) read: Allowance,
    /// What of it may still be zeros that the file does not hold.
    pub(super) zeros: Allowance,
}

/// Bytes that may still be spent on the file as a whole.
#[derive(Debug)]
pub(super) struct Allowance {
    left: Cell<usize>,
    limit: usize,
    /// What they are spent on.
    what: &'static str,
}

impl Allowance {
    /// Of what is unpacked.
    pub(super) fn of_unpacked(limits: &LoadLimits) -> Self {
        let limit = limits.max_unpacked_bytes;
        Self { left: Cell::new(limit), limit, what: "unpacked, the file has" }
    }

    /// Of values that are read.
    fn of_read(limits: &LoadLimits) -> Self {
        let limit = limits.max_read_bytes;
        Self { left: Cell::new(limit), limit, what: "counted as often as they are used, its accessors have" }
    }

    /// Of values that the file does not hold.
    fn of_zeros(limits: &LoadLimits) -> Self {
        let limit = limits.max_zero_bytes;
        Self {
            left: Cell::new(limit),
            limit,
            what: "in accessors without a bufferView, whose values are zeros, it has",
        }
    }

    /// What is left.
    pub(super) fn left(&self) -> usize {
        self.left.get()
    }

    /// Takes `bytes` of it, before they are allocated.
    pub(super) fn take(&self, bytes: usize, place: &str) -> Result<(), LoadError> {
        match self.left.get().checked_sub(bytes) {
            Some(left) => {
                self.left.set(left);
                Ok(())
            }
            None => Err(self.exceeded(place)),
        }
    }

    pub(super) fn exceeded(&self, place: &str) -> LoadError {
        LoadError::TooLarge(format!("{place}: {} more than {} bytes", self.what, self.limit))
    }
}

/// Parses the document, gets its buffers and checks all indices in it.
pub(super) fn open<'a>(bytes: &'a [u8], files: &'a Files<'a>, limits: &LoadLimits) -> Result<File<'a>, LoadError> {
    let (document, bin) = if bytes.starts_with(b"glTF") { split(bytes)? } else { (bare(bytes)?, None) };
    let Document { root, more, has_animations } = document::parse(document, limits)?;
    if !root.asset.version.starts_with("2.") {
        let version = root.asset.version.chars().take(16).collect::<String>();
        return Err(LoadError::Malformed(format!("asset.version is \"{version}\"; this reads glTF 2.0")));
    }
    if let Some(least) = root.asset.min_version.as_deref().filter(|least| !matches!(*least, "2.0" | "1.0")) {
        let least = least.chars().take(16).collect::<String>();
        return Err(LoadError::Malformed(format!("asset.minVersion is \"{least}\"; this reads glTF 2.0")));
    }
    check_indices(&root)?;
    let (unpacked, read) = (Allowance::of_unpacked(limits), Allowance::of_read(limits));
    let zeros = Allowance::of_zeros(limits);
    let buffers = buffers(&root, &more, bin, files, &unpacked)?;
    let decompressed = root.buffer_views.iter().map(|_| OnceCell::new()).collect();
    Ok(File { root, more, has_animations, buffers, decompressed, files, unpacked, read, zeros })
}

/// The JSON of a file, without a byte order mark.
pub(super) fn text(bytes: &[u8]) -> Result<&[u8], LoadError> {
    let text = if bytes.starts_with(b"glTF") { split(bytes)?.0 } else { bare(bytes)? };
    Ok(text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(text))
}

/// The document of a `.gltf`.
fn bare(bytes: &[u8]) -> Result<&[u8], LoadError> {
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    if text.trim_ascii_start().first() == Some(&b'{') {
        return Ok(bytes);
    }
    Err(LoadError::Malformed(
        "this is no glTF: a .glb file starts with the letters glTF, a .gltf file with {, a zip archive with PK".into(),
    ))
}

/// The JSON chunk and, where there is one, the binary chunk.
fn split(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), LoadError> {
    let fail = |text: String| Err(LoadError::Malformed(text));
    let (Some(version), Some(length)) = (read_u32(bytes, 4), read_u32(bytes, 8)) else {
        return fail(format!("the file ends within its header, after {} bytes", bytes.len()));
    };
    if version != 2 {
        return fail(format!("the binary glTF has container version {version}; this reads version 2"));
    }
    let length = length as usize;
    if length > bytes.len() || length < HEADER_BYTES {
        return fail(format!("the header states a length of {length} bytes, but the file has {}", bytes.len()));
    }
    let mut rest = &bytes[HEADER_BYTES..length];
    let (kind, document) = chunk(&mut rest, "first")?;
    if kind != CHUNK_JSON {
        return fail("the first chunk is not the JSON chunk".into());
    }
    // Chunks of other types than the binary one are reserved for extensions: readers skip them.
    while !rest.is_empty() {
        let (kind, data) = chunk(&mut rest, "next")?;
        if kind == CHUNK_BIN {
            return Ok((document, Some(data)));
        }
    }
    Ok((document, None))
}

/// Takes one chunk off the front of `rest`.
fn chunk<'a>(rest: &mut &'a [u8], which: &str) -> Result<([u8; 4], &'a [u8]), LoadError> {
    let header = read_u32(rest, 0).zip(rest.get(4..CHUNK_HEADER_BYTES));
    let Some((length, kind)) = header else {
        return Err(LoadError::Malformed(format!("the file ends within the header of the {which} chunk")));
    };
    let body = &rest[CHUNK_HEADER_BYTES..];
    let Some((data, tail)) = body.split_at_checked(length as usize) else {
        return Err(LoadError::Malformed(format!(
            "the {which} chunk states {length} bytes, but only {} are left in the file",
            body.len()
        )));
    };
    *rest = tail;
    Ok(([kind[0], kind[1], kind[2], kind[3]], data))
}

fn read_u32(bytes: &[u8], at: usize) -> Option<u32> {
    let four = bytes.get(at..at.checked_add(4)?)?;
    Some(u32::from_le_bytes([four[0], four[1], four[2], four[3]]))
}

/// Runs the schema check of the `gltf` crate, which covers all indices and enumerations.
fn check_indices(root: &json::Root) -> Result<(), LoadError> {
    // The crate's check indexes with this one before it has checked it.
    for (mesh_index, mesh) in root.meshes.iter().enumerate() {
        for (primitive_index, primitive) in mesh.primitives.iter().enumerate() {
            let position = primitive.attributes.get(&Checked::Valid(json::mesh::Semantic::Positions));
            if let Some(index) = position
                && root.get(*index).is_none()
            {
                return Err(malformed(
                    &format!("mesh {mesh_index}, primitive {primitive_index}"),
                    &format!("POSITION is accessor {}, there are {}", index.value(), root.accessors.len()),
                ));
            }
        }
    }
    let (mut messages, mut more) = (Vec::new(), 0_usize);
    root.validate(root, json::Path::new, &mut |path, error| {
        // Extensions are judged by `extensions::check`; bounds are recomputed from the vertices.
        let is_extension = matches!(error, Error::Unsupported);
        // Without data of its own an accessor is all zeros, or compressed elsewhere.
        let is_without_data = matches!(error, Error::Missing) && path().as_str().ends_with("].bufferView");
        // What is absent or odd there is mended where it is read, or does not count.
        let is_mended = [".byteStride", "].spot", "<invalid semantic name>\"]"];
        let is_mended = is_mended.iter().any(|end| path().as_str().ends_with(end));
        if is_extension || is_without_data || is_mended || is_about_bounds(path().as_str()) {
        } else if messages.len() < MESSAGES_SHOWN {
            messages.push(format!("{}: {}", path(), error.to_string().to_lowercase()));
        } else {
            more += 1;
        }
    });
    if messages.is_empty() {
        return Ok(());
    }
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    Err(LoadError::Malformed(format!("{}{more}", messages.join("; "))))
}

fn is_about_bounds(path: &str) -> bool {
    path.ends_with("[\"POSITION\"].min") || path.ends_with("[\"POSITION\"].max")
}

/// The data of all buffers: the binary chunk, data within the document, files.
fn buffers<'a>(
    root: &json::Root,
    more: &Extensions,
    mut bin: Option<&'a [u8]>,
    files: &Files<'_>,
    unpacked: &Allowance,
) -> Result<Vec<Option<Cow<'a, [u8]>>>, LoadError> {
    let mut buffers = Vec::with_capacity(root.buffers.len());
    for (index, buffer) in root.buffers.iter().enumerate() {
        let place = format!("buffer {index}");
        let data = match &buffer.uri {
            Some(uri) => match resolve(uri, files, unpacked, &place)? {
                Named::Here(data) => Some(Cow::Owned(data)),
                Named::Missing if more.is_fallback(index) => None,
                Named::Missing => return Err(missing_file(&place, uri)),
            },
            // The specification has the chunk belong to the first buffer alone.
            None if index == 0 => bin.take().map(Cow::Borrowed),
            None => None,
        };
        let stated = buffer.byte_length.0;
        match &data {
            Some(data) if stated > data.len() as u64 => {
                let text = format!("states {stated} bytes, but there are {}", data.len());
                return Err(malformed(&place, &text));
            }
            None if !more.is_fallback(index) && (stated > 0 || index > 0) => {
                return Err(malformed(&place, "has no data: neither a binary chunk nor a uri"));
            }
            _ => {}
        }
        buffers.push(data);
    }
    Ok(buffers)
}

fn missing_file(place: &str, uri: &str) -> LoadError {
    let start: String = uri.chars().take(80).collect();
    LoadError::Unsupported(format!(
        "{place} refers to \"{start}\", which is not there; a .gltf is sent with its files as one zip archive, or \
         exported as .glb, which holds them"
    ))
}
