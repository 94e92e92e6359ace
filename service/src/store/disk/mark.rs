//! Whose a directory is. What this program did not make it does not touch: a new data directory is empty, and an old
//! one has a mark.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::Path;

use super::super::StoreError;

const MARK: &str = "rebake-data";
const MARK_TEXT: &str = "This is a data directory of rebake. Without this file rebake refuses it.\n";
pub(super) const DATABASE: &str = "rebake.db";
/// What a data directory from before there were marks may hold.
const UNMARKED: [&str; 6] = ["blobs", "lock", "rebake.db", "rebake.db-shm", "rebake.db-wal", "tmp"];
/// What file systems put at their root.
const OF_THE_SYSTEM: &str = "lost+found";

/// Checks that a directory is empty or a data directory, before anything in it is touched.
pub(super) fn check(directory: &Path) -> Result<(), StoreError> {
    let names = names(directory)?;
    let has_database = fs::metadata(directory.join(DATABASE)).is_ok_and(|file| file.len() > 0);
    if names.contains(MARK) {
        if !has_database && has_blobs(directory)? {
            return Err(database_lost());
        }
        return Ok(());
    }
    let unmarked = has_database && names.iter().all(|name| UNMARKED.contains(&name.as_str()));
    if names.is_empty() || unmarked || is_begun(directory, &names) {
        return Ok(());
    }
    let detail = format!("it has no file {MARK:?} and holds other things; give an empty directory");
    Err(StoreError::damaged("the directory is not a data directory of rebake", detail))
}

/// Whether a start ended between its lock and its mark: an empty lock is all there is.
fn is_begun(directory: &Path, names: &BTreeSet<String>) -> bool {
    let is_empty = |name: &str| fs::metadata(directory.join(name)).is_ok_and(|file| file.is_file() && file.len() == 0);
    names.iter().eq(["lock"]) && is_empty("lock")
}

/// Marks a directory that was checked.
pub(super) fn mark(directory: &Path) -> io::Result<()> {
    let path = directory.join(MARK);
    if path.exists() {
        return Ok(());
    }
    let mut file = File::create(path)?;
    file.write_all(MARK_TEXT.as_bytes())?;
    file.sync_all()
}

/// The files are worth nothing without the database, and everything with it: somebody has to look.
pub(super) fn database_lost() -> StoreError {
    let detail = format!("bring back {DATABASE}, or move the directory away; no file was touched");
    StoreError::damaged("the database is missing or empty, and there are uploads and light maps beside it", detail)
}

/// Whether there is any upload or light map.
pub(super) fn has_blobs(directory: &Path) -> io::Result<bool> {
    let blobs = directory.join("blobs");
    if !blobs.is_dir() {
        return Ok(false);
    }
    for below in fs::read_dir(blobs)? {
        let below = below?.path();
        if below.is_dir() && fs::read_dir(below)?.next().is_some() {
            return Ok(true);
        }
    }
    Ok(false)
}

fn names(directory: &Path) -> io::Result<BTreeSet<String>> {
    let names = fs::read_dir(directory)?.map(|entry| Ok(entry?.file_name().to_string_lossy().into_owned()));
    let mut names = names.collect::<io::Result<BTreeSet<String>>>()?;
    names.remove(OF_THE_SYSTEM);
    Ok(names)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::super::super::Store;
    use super::super::Disk;
    use super::*;
    use crate::store::faults::Faults;

    fn open(directory: &Path) -> Result<Disk, StoreError> {
        Disk::open(directory, Faults::default(), 2)
    }

    /// Every file with its bytes.
    fn all(directory: &Path) -> BTreeMap<String, Vec<u8>> {
        let mut files = BTreeMap::new();
        for entry in fs::read_dir(directory).unwrap() {
            let path = entry.unwrap().path();
            match path.is_dir() {
                true => files.extend(all(&path)),
                false => drop(files.insert(path.display().to_string(), fs::read(&path).unwrap())),
            }
        }
        files
    }

    fn refused(directory: &Path, about: &str) {
        let before = all(directory);
        let told = open(directory).unwrap_err().to_string();
        assert!(told.contains(about), "{told}");
        assert!(all(directory) == before, "{about}: every file is as it was");
    }

    #[test]
    fn a_directory_of_others_is_refused_and_not_touched() {
        for name in ["letter.txt", "blobs/ab/photo", "tmp/1", "lock"] {
            let directory = tempfile::tempdir().unwrap();
            let path = directory.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(&path, b"mine").unwrap();
            refused(directory.path(), "not a data directory");
        }
        let empty = tempfile::tempdir().unwrap();
        fs::create_dir(empty.path().join(OF_THE_SYSTEM)).unwrap();
        open(empty.path()).unwrap();
        open(empty.path()).unwrap();
    }

    #[test]
    fn a_start_that_ended_after_its_lock_is_begun_again() {
        let directory = tempfile::tempdir().unwrap();
        fs::write(directory.path().join("lock"), b"").unwrap();
        open(directory.path()).unwrap();
        assert!(directory.path().join(MARK).exists());
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("lock")).unwrap();
        refused(folder.path(), "not a data directory");
    }

    #[test]
    fn a_directory_from_before_there_were_marks_gets_one() {
        let directory = tempfile::tempdir().unwrap();
        drop(open(directory.path()).unwrap());
        fs::remove_file(directory.path().join(MARK)).unwrap();
        fs::remove_file(directory.path().join("spare")).unwrap();
        open(directory.path()).unwrap();
        assert!(directory.path().join(MARK).exists());
    }

    #[test]
    fn a_lost_database_beside_files_is_an_error_that_leaves_them() {
        let lose: [fn(&Path); 3] = [
            |database| fs::remove_file(database).unwrap(),
            |database| fs::write(database, b"").unwrap(),
            |database| {
                // As a tool would make it anew.
                fs::remove_file(database).unwrap();
                rusqlite::Connection::open(database).unwrap().execute_batch("PRAGMA user_version = 0; VACUUM").unwrap();
            },
        ];
        for lose in lose {
            let directory = tempfile::tempdir().unwrap();
            let disk = open(directory.path()).unwrap();
            disk.load("x").unwrap();
            disk.asset_added(blake3::hash(b"glb").to_hex().as_str(), b"glb").unwrap();
            disk.close();
            drop(disk);
            lose(&directory.path().join(DATABASE));
            refused(directory.path(), "the database is missing or empty");
        }
    }

    #[test]
    fn files_of_others_among_the_own_ones_stay() {
        let directory = tempfile::tempdir().unwrap();
        open(directory.path()).unwrap().load("x").unwrap();
        let foreign = ["tmp/notes", "blobs/ab/notes", "notes"].map(|name| directory.path().join(name));
        for path in &foreign {
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, b"mine").unwrap();
        }
        open(directory.path()).unwrap().load("x").unwrap();
        assert!(foreign.iter().all(|path| path.exists()));
    }
}
