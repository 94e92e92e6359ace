//! Files that a document names: within the document (`data:`), in the same zip archive, or in the document's folder.
//! Nothing is ever fetched.

use std::borrow::Cow;
use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD_NO_PAD;
use zip::ZipArchive;

use super::container::Allowance;
use super::{LoadError, LoadLimits, malformed, too_large};

/// Files within an archive.
const MAX_ENTRIES: usize = 10_000;

/// Where the files lie that a document names.
#[derive(Debug)]
pub(super) enum Files<'a> {
    /// Nowhere: the document stands alone.
    None,
    /// Beside the document in an archive.
    Archive(Archive<'a>),
    /// Beside the document in a folder of this machine.
    Folder(PathBuf),
}

/// What a name leads to.
pub(super) enum Named {
    /// The data.
    Here(Vec<u8>),
    /// No such file, or one that is not read: an address of the network.
    Missing,
}

/// The data that `uri` names, at most what is still allowed.
pub(super) fn resolve(uri: &str, files: &Files<'_>, unpacked: &Allowance, place: &str) -> Result<Named, LoadError> {
    let uri = uri.trim_ascii();
    if let Some((scheme, data)) = uri.split_at_checked("data:".len())
        && scheme.eq_ignore_ascii_case("data:")
    {
        return inline(data, unpacked, place).map(Named::Here);
    }
    let Some(path) = relative_path(uri) else { return Ok(Named::Missing) };
    let found = match files {
        Files::None => None,
        Files::Archive(archive) => archive.read(&path, unpacked, place)?,
        Files::Folder(folder) => read_file(&folder.join(path), unpacked, place)?,
    };
    Ok(found.map_or(Named::Missing, Named::Here))
}

/// `[<media type>][;base64],<data>` (RFC 2397). As browsers read it: escaped, with spaces and line ends in it, without
/// `=` at its end, in either alphabet of base64.
fn inline(data: &str, unpacked: &Allowance, place: &str) -> Result<Vec<u8>, LoadError> {
    let (kind, text) = data.split_once(',').ok_or_else(|| malformed(place, "its data: URI has no comma"))?;
    let is_base64 = kind.rsplit(';').next().is_some_and(|last| last.trim().eq_ignore_ascii_case("base64"));
    unpacked.take(if is_base64 { text.len() / 4 * 3 + 3 } else { text.len() }, place)?;
    let mut bytes = unescaped(text);
    if !is_base64 {
        return Ok(bytes);
    }
    bytes.retain(|byte| !byte.is_ascii_whitespace());
    for byte in &mut bytes {
        *byte = match *byte {
            b'-' => b'+',
            b'_' => b'/',
            byte => byte,
        };
    }
    let end = bytes.iter().rposition(|&byte| byte != b'=').map_or(0, |last| last + 1);
    let not_base64 = |error| malformed(place, &format!("its data: URI is not base64: {error}"));
    STANDARD_NO_PAD.decode(&bytes[..end]).map_err(not_base64)
}

/// The path of a relative URI: unescaped, its dots resolved; none for anything else. Leading `..` stay.
pub(super) fn relative_path(uri: &str) -> Option<String> {
    let path = uri.split(['?', '#']).next().unwrap_or_default();
    // Unescaped, as some exporters write it, a colon may only be part of a name behind the first slash.
    let has_scheme = path.split('/').next().is_some_and(|first| first.contains(':'));
    if has_scheme || path.starts_with('/') || path.starts_with('\\') || path.is_empty() {
        return None;
    }
    Some(without_dots(&unescape(path).replace('\\', "/")))
}

fn unescape(path: &str) -> String {
    String::from_utf8(unescaped(path)).unwrap_or_else(|_| path.to_owned())
}

/// The bytes of a text in which `%` and two digits stand for a byte; other `%` stand for themselves.
fn unescaped(text: &str) -> Vec<u8> {
    let bytes = text.as_bytes();
    let mut plain = Vec::with_capacity(bytes.len());
    let mut at = 0;
    while at < bytes.len() {
        let digits = text.get(at + 1..at + 3).filter(|_| bytes[at] == b'%');
        match digits.and_then(|digits| u8::from_str_radix(digits, 16).ok()) {
            Some(byte) => {
                plain.push(byte);
                at += 3;
            }
            None => {
                plain.push(bytes[at]);
                at += 1;
            }
        }
    }
    plain
}

fn without_dots(path: &str) -> String {
    let mut parts: Vec<&str> = Vec::new();
    for part in path.split('/') {
        match part {
            "" | "." => {}
            ".." if parts.last().is_some_and(|last| *last != "..") => {
                parts.pop();
            }
            part => parts.push(part),
        }
    }
    parts.join("/")
}

fn read_file(path: &Path, unpacked: &Allowance, place: &str) -> Result<Option<Vec<u8>>, LoadError> {
    let Ok(file) = std::fs::File::open(path) else { return Ok(None) };
    let unreadable = |error| malformed(place, &format!("its file cannot be read: {error}"));
    read_at_most(file, unpacked, place, unreadable).map(Some)
}

fn read_at_most(
    source: impl Read,
    unpacked: &Allowance,
    place: &str,
    unreadable: impl Fn(std::io::Error) -> LoadError,
) -> Result<Vec<u8>, LoadError> {
    let mut data = Vec::new();
    source.take(unpacked.left() as u64 + 1).read_to_end(&mut data).map_err(unreadable)?;
    unpacked.take(data.len(), place)?;
    Ok(data)
}

/// A zip archive with a document and its files.
pub(super) struct Archive<'a> {
    /// Cheap to clone, which reading an entry asks for.
    zip: ZipArchive<Cursor<&'a [u8]>>,
    /// Path of the document.
    document: String,
}

impl std::fmt::Debug for Archive<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Archive").field("document", &self.document).finish_non_exhaustive()
    }
}

impl<'a> Archive<'a> {
    /// Opens an archive that holds one `.gltf` or `.glb` file.
    pub(super) fn open(bytes: &'a [u8]) -> Result<Self, LoadError> {
        let cut = || LoadError::Malformed("the zip archive is not whole: the list of its files is missing".into());
        if stated_entries(bytes).ok_or_else(cut)? > MAX_ENTRIES {
            return Err(too_large("files in its archive", MAX_ENTRIES));
        }
        let zip = ZipArchive::new(Cursor::new(bytes))
            .map_err(|error| LoadError::Malformed(format!("the zip archive cannot be read: {error}")))?;
        let document = find_document(&zip)?;
        Ok(Self { zip, document })
    }

    /// The document's own data.
    pub(super) fn document(&self, limits: &LoadLimits) -> Result<Vec<u8>, LoadError> {
        let place = format!("\"{}\" in the archive", self.document);
        let missing = || malformed(&place, "is missing");
        let allowance = Allowance::of_unpacked(limits);
        self.entry(&self.document, &allowance, &place)?.ok_or_else(missing)
    }

    /// A file by its path from the document.
    fn read(&self, path: &str, unpacked: &Allowance, place: &str) -> Result<Option<Vec<u8>>, LoadError> {
        let folder = self.document.rsplit_once('/').map_or("", |(folder, _)| folder);
        let path = without_dots(&format!("{folder}/{path}"));
        if let Some(data) = self.entry(&path, unpacked, place)? {
            return Ok(Some(data));
        }
        // Archives come from systems that do not tell upper case from lower.
        let other = self.zip.file_names().flatten().find(|name| name.eq_ignore_ascii_case(&path));
        other.map_or(Ok(None), |other| self.entry(&other, unpacked, place))
    }

    fn entry(&self, name: &str, unpacked: &Allowance, place: &str) -> Result<Option<Vec<u8>>, LoadError> {
        let mut zip = self.zip.clone();
        let unreadable = |error: &dyn std::fmt::Display| {
            malformed(place, &format!("\"{name}\" cannot be unpacked from the archive: {error}"))
        };
        match zip.by_name(name) {
            Ok(entry) => read_at_most(entry, unpacked, place, |error| unreadable(&error)).map(Some),
            Err(zip::result::ZipError::FileNotFound) => Ok(None),
            Err(error) => Err(unreadable(&error)),
        }
    }
}

/// The number of files that the end of the archive states, before anything is allocated for them.
fn stated_entries(bytes: &[u8]) -> Option<usize> {
    let tail = &bytes[bytes.len().saturating_sub(22 + (1 << 16))..];
    let at = tail.windows(4).rposition(|window| window == b"PK\x05\x06")?;
    let field = tail.get(at + 10..at + 12)?;
    Some(usize::from(u16::from_le_bytes([field[0], field[1]])))
}

/// The one document, or the one that lies highest.
fn find_document(zip: &ZipArchive<Cursor<&[u8]>>) -> Result<String, LoadError> {
    let is_document = |name: &Cow<'_, str>| {
        let lower = name.to_ascii_lowercase();
        (lower.ends_with(".gltf") || lower.ends_with(".glb")) && !lower.starts_with("__macosx/")
    };
    let depth = |name: &str| name.matches('/').count();
    let mut documents: Vec<Cow<'_, str>> = zip.file_names().flatten().filter(is_document).collect();
    documents.sort_by(|a, b| (depth(a), a).cmp(&(depth(b), b)));
    match documents.as_slice() {
        [] => Err(LoadError::Unsupported("the archive holds neither a .gltf nor a .glb file".into())),
        [first, second, ..] if depth(first) == depth(second) => Err(LoadError::Unsupported(format!(
            "the archive holds several documents, \"{first}\" and \"{second}\" among them; one is wanted"
        ))),
        [first, ..] => Ok(first.clone().into_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_resolved_and_addresses_are_not() {
        let cases = [
            ("room.bin", Some("room.bin")),
            ("./a/../b%20c.png", Some("b c.png")),
            ("a\\b.png?v=1", Some("a/b.png")),
            ("../a.png", Some("../a.png")),
            ("100%.png", Some("100%.png")),
            ("/etc/passwd", None),
            ("http://localhost/room.bin", None),
            ("c:/room.bin", None),
            ("", None),
        ];
        for (uri, path) in cases {
            assert_eq!(relative_path(uri).as_deref(), path, "{uri}");
        }
    }
}
