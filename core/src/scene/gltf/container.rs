//! The outer layer of a `.glb`: header, JSON chunk, binary chunk, and the checks of the document as a whole.

use ::gltf::json;
use json::validation::{Checked, Error, Validate};

use super::{LoadError, LoadLimits, malformed, too_large};

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
    /// Buffer 0, of at least the length that the document states.
    pub(super) bin: &'a [u8],
}

/// Splits the file, parses the document and checks all indices in it.
pub(super) fn open<'a>(bytes: &'a [u8], limits: &LoadLimits) -> Result<File<'a>, LoadError> {
    if bytes.len() > limits.max_bytes {
        return Err(LoadError::TooLarge(format!(
            "the file has {} bytes; at most {} are allowed",
            bytes.len(),
            limits.max_bytes
        )));
    }
    let (document, bin) = split(bytes)?;
    let root = json::Root::from_slice(document)
        .map_err(|error| LoadError::Malformed(format!("the JSON chunk is not a glTF document: {error}")))?;
    if !root.asset.version.starts_with("2.") {
        let version = root.asset.version.chars().take(16).collect::<String>();
        return Err(LoadError::Malformed(format!("asset.version is \"{version}\"; this reads glTF 2.0")));
    }
    if root.nodes.len() > limits.max_nodes {
        return Err(too_large("nodes", limits.max_nodes));
    }
    check_indices(&root)?;
    let bin = check_buffers(&root, bin)?;
    Ok(File { root, bin })
}

/// The JSON chunk and, where there is one, the binary chunk.
fn split(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), LoadError> {
    let fail = |text: String| Err(LoadError::Malformed(text));
    if bytes.get(..4) != Some(b"glTF") {
        return fail("this is not a binary glTF: a .glb file starts with the letters glTF".into());
    }
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
        if is_extension || is_about_bounds(path().as_str()) {
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

/// Exactly one buffer, and it is the binary chunk.
fn check_buffers<'a>(root: &json::Root, bin: Option<&'a [u8]>) -> Result<&'a [u8], LoadError> {
    for (index, buffer) in root.buffers.iter().enumerate() {
        if let Some(uri) = &buffer.uri {
            let start: String = uri.chars().take(40).collect();
            return Err(LoadError::Unsupported(format!(
                "buffer {index} refers to \"{start}\"; only .glb files that hold all their data in the binary \
                 chunk are read (export as glTF Binary)"
            )));
        }
        if index > 0 {
            return Err(malformed(&format!("buffer {index}"), "has no data: a .glb has one binary chunk"));
        }
    }
    let stated = root.buffers.first().map_or(0, |buffer| buffer.byte_length.0);
    let bin = bin.unwrap_or(&[]);
    if stated > bin.len() as u64 {
        return Err(malformed("buffer 0", &format!("states {stated} bytes, but the binary chunk has {}", bin.len())));
    }
    Ok(&bin[..stated as usize])
}
