//! Content-addressed files: `blobs/<two digits>/<blake3 of the bytes>`. Written beside, forced to the disk, then
//! renamed, so a file under its name is whole; its name is its checksum, so damage is found when it is read.

use std::collections::{HashMap, HashSet};
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::super::StoreError;
use super::super::faults::{Faults, WriteStep};

/// Hash of a file's bytes, as hexadecimal digits.
pub(crate) type BlobId = String;

/// The files of a data directory.
#[derive(Debug)]
pub(super) struct Blobs {
    blobs: PathBuf,
    temporary: PathBuf,
    faults: Faults,
    count: AtomicU64,
    /// Files that are written and not yet referred to: they must not be collected.
    pins: Mutex<HashMap<BlobId, usize>>,
}

/// Keeps a file from being collected until the database refers to it.
#[derive(Debug)]
pub(super) struct Pin<'a> {
    blobs: &'a Blobs,
    pub(super) id: BlobId,
}

/// A file as it was written.
#[derive(Clone, Debug)]
pub(super) struct Whole {
    pub(super) id: BlobId,
    pub(super) bytes: u64,
}

impl Drop for Pin<'_> {
    fn drop(&mut self) {
        let mut pins = self.blobs.pins();
        if let Some(count) = pins.get_mut(&self.id) {
            *count -= 1;
            if *count == 0 {
                pins.remove(&self.id);
            }
        }
    }
}

impl Blobs {
    /// Opens the files of `directory` and clears what an earlier life left half-written.
    pub(super) fn open(directory: &Path, faults: Faults) -> io::Result<Blobs> {
        let (blobs, temporary) = (directory.join("blobs"), directory.join("tmp"));
        fs::create_dir_all(&blobs)?;
        fs::create_dir_all(&temporary)?;
        for entry in fs::read_dir(&temporary)? {
            let entry = entry?;
            // Ours have numbers.
            if entry.file_name().to_str().is_some_and(|name| name.parse::<u64>().is_ok()) {
                fs::remove_file(entry.path())?;
            }
        }
        sync_directory(directory)?;
        Ok(Blobs { blobs, temporary, faults, count: AtomicU64::new(0), pins: Mutex::default() })
    }

    /// Writes `bytes` unless they are there already.
    pub(super) fn put(&self, bytes: &[u8]) -> Result<Pin<'_>, StoreError> {
        let id = blake3::hash(bytes).to_hex().to_string();
        *self.pins().entry(id.clone()).or_default() += 1;
        let pin = Pin { blobs: self, id };
        let path = self.path_of(&pin.id);
        // A file of the right length that was damaged since is found damaged when it is read, and only then.
        let is_there = fs::metadata(&path).is_ok_and(|file| file.len() == bytes.len() as u64);
        if !is_there {
            self.write(&path, bytes)?;
        }
        Ok(pin)
    }

    /// A file that was written before; none where it is not there as it was.
    pub(super) fn pin(&self, file: &Whole) -> Option<Pin<'_>> {
        *self.pins().entry(file.id.clone()).or_default() += 1;
        let pin = Pin { blobs: self, id: file.id.clone() };
        let is_there = fs::metadata(self.path_of(&pin.id)).is_ok_and(|found| found.len() == file.bytes);
        is_there.then_some(pin)
    }

    /// Reads a file and checks it.
    pub(super) fn get(&self, id: &str) -> Result<Vec<u8>, StoreError> {
        let bytes = fs::read(self.path_of(id)).map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => StoreError::damaged("a file of the data directory is missing", id),
            _ => error.into(),
        })?;
        if blake3::hash(&bytes).to_hex().as_str() != id {
            return Err(StoreError::damaged("a file of the data directory is truncated or corrupted", id));
        }
        Ok(bytes)
    }

    /// Removes a file that `is_referred` says nobody needs.
    pub(super) fn collect(&self, id: &str, is_referred: impl FnOnce() -> Result<bool, StoreError>) {
        let pins = self.pins();
        if pins.contains_key(id) || !matches!(is_referred(), Ok(false)) {
            return;
        }
        // What stays behind is swept at the next start.
        if let Err(error) = fs::remove_file(self.path_of(id)) {
            tracing::debug!(%error, id, "not removed");
        }
    }

    /// Removes all files that nobody refers to.
    pub(super) fn sweep(&self, referred: &HashSet<BlobId>) -> io::Result<usize> {
        let mut removed = 0;
        for directory in fs::read_dir(&self.blobs)? {
            let directory = directory?.path();
            if !directory.is_dir() {
                continue;
            }
            for file in fs::read_dir(directory)? {
                let file = file?;
                let name = file.file_name();
                // What has no hash for a name is not ours.
                if name.to_str().is_some_and(|name| blake3::Hash::from_hex(name).is_ok() && !referred.contains(name)) {
                    fs::remove_file(file.path())?;
                    removed += 1;
                }
            }
        }
        Ok(removed)
    }

    fn write(&self, path: &Path, bytes: &[u8]) -> Result<(), StoreError> {
        let temporary = self.temporary.join(self.count.fetch_add(1, Ordering::Relaxed).to_string());
        let result = self.write_beside(&temporary, path, bytes);
        if result.is_err() {
            // Nothing more can be done about a file that cannot be removed; the next start tries again.
            let _ = fs::remove_file(&temporary);
        }
        Ok(result?)
    }

    fn write_beside(&self, temporary: &Path, path: &Path, bytes: &[u8]) -> io::Result<()> {
        self.faults.check(WriteStep::Create)?;
        let mut file = File::create_new(temporary)?;
        if let Err(fault) = self.faults.check(WriteStep::Write) {
            file.write_all(&bytes[..bytes.len() / 2])?;
            return Err(fault);
        }
        file.write_all(bytes)?;
        self.faults.check(WriteStep::Sync)?;
        file.sync_all()?;
        let directory = path.parent().unwrap_or(&self.blobs);
        if !directory.is_dir() {
            fs::create_dir_all(directory)?;
            sync_directory(&self.blobs)?;
        }
        self.faults.check(WriteStep::Rename)?;
        fs::rename(temporary, path)?;
        self.faults.check(WriteStep::SyncDirectory)?;
        sync_directory(directory)
    }

    fn path_of(&self, id: &str) -> PathBuf {
        self.blobs.join(&id[..2.min(id.len())]).join(id)
    }

    fn pins(&self) -> MutexGuard<'_, HashMap<BlobId, usize>> {
        self.pins.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Forces names in a directory to the disk.
fn sync_directory(directory: &Path) -> io::Result<()> {
    #[cfg(unix)]
    File::open(directory)?.sync_all()?;
    #[cfg(not(unix))]
    let _ = directory;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_found_by_content_and_damage_is_seen() {
        let directory = tempfile::tempdir().unwrap();
        let blobs = Blobs::open(directory.path(), Faults::default()).unwrap();
        let id = blobs.put(b"light").unwrap().id.clone();
        assert_eq!(blobs.put(b"light").unwrap().id, id);
        assert_eq!(blobs.get(&id).unwrap(), b"light");
        fs::write(blobs.path_of(&id), b"lighf").unwrap();
        assert!(blobs.get(&id).unwrap_err().to_string().contains("corrupted"));
        fs::write(blobs.path_of(&id), b"lig").unwrap();
        assert!(blobs.get(&id).is_err());
        // A truncated file is written anew when the same bytes come again.
        blobs.put(b"light").unwrap();
        assert_eq!(blobs.get(&id).unwrap(), b"light");
        fs::remove_file(blobs.path_of(&id)).unwrap();
        assert!(blobs.get(&id).unwrap_err().to_string().contains("missing"));
    }

    #[test]
    fn what_is_pinned_or_referred_to_stays() {
        let directory = tempfile::tempdir().unwrap();
        let blobs = Blobs::open(directory.path(), Faults::default()).unwrap();
        let pin = blobs.put(b"a").unwrap();
        let id = pin.id.clone();
        blobs.collect(&id, || Ok(false));
        assert!(blobs.get(&id).is_ok(), "pinned");
        drop(pin);
        blobs.collect(&id, || Ok(true));
        assert!(blobs.get(&id).is_ok(), "referred to");
        blobs.collect(&id, || Ok(false));
        assert!(blobs.get(&id).is_err());
        let kept = blobs.put(b"kept").unwrap().id.clone();
        blobs.put(b"swept").unwrap();
        assert_eq!(blobs.sweep(&HashSet::from([kept.clone()])).unwrap(), 1);
        assert!(blobs.get(&kept).is_ok());
    }

    #[test]
    fn a_fault_at_any_step_leaves_no_half_file() {
        let directory = tempfile::tempdir().unwrap();
        for failing in
            [WriteStep::Create, WriteStep::Write, WriteStep::Sync, WriteStep::Rename, WriteStep::SyncDirectory]
        {
            let faults = Faults::new(move |step| match step == failing {
                true => Err(io::Error::other("injected")),
                false => Ok(()),
            });
            let blobs = Blobs::open(directory.path(), faults).unwrap();
            let bytes = format!("{failing:?}").into_bytes();
            let id = blake3::hash(&bytes).to_hex().to_string();
            assert!(blobs.put(&bytes).is_err());
            match blobs.get(&id) {
                Ok(found) => assert!(found == bytes && failing == WriteStep::SyncDirectory),
                Err(error) => assert!(error.to_string().contains("missing"), "{error}"),
            }
            assert_eq!(fs::read_dir(directory.path().join("tmp")).unwrap().count(), 0);
        }
    }
}
