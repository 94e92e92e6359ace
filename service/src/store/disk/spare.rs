//! Room that is kept free for what makes room: a transaction that deletes needs some itself, and on a full disk there
//! would be none.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use rusqlite::Transaction;

use super::super::StoreError;
use super::Disk;

/// Pages that a deletion writes to the log, with a margin.
const BYTES: usize = 1 << 20;
const FULL: &str = "the disk is full";

/// A file of no use but its size.
#[derive(Debug)]
pub(super) struct Spare(PathBuf);

impl Spare {
    pub(super) fn new(directory: &Path) -> Spare {
        let spare = Spare(directory.join("spare"));
        spare.refill();
        spare
    }

    /// Takes the room again, where there is any.
    fn refill(&self) {
        let is_there = fs::metadata(&self.0).is_ok_and(|file| file.len() == BYTES as u64);
        if is_there {
            return;
        }
        let write = || -> io::Result<()> {
            let mut file = File::create(&self.0)?;
            file.write_all(&vec![0x5a; BYTES])?;
            file.sync_all()
        };
        if let Err(error) = write() {
            tracing::warn!(%error, "no room could be kept for deleting on a full disk");
        }
    }

    fn give(&self) -> bool {
        fs::remove_file(&self.0).is_ok()
    }
}

impl Disk {
    /// Runs a change that makes room, on a full disk too.
    pub(super) fn freeing<T>(
        &self,
        change: impl Fn(&Transaction<'_>) -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        match self.transact(&change) {
            Err(full) if full.reason == FULL && self.spare.give() => {
                let changed = self.transact(&change);
                // What the log grew by is given back to the file system.
                let checkpoint = |connection: &rusqlite::Connection| {
                    connection.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |_| Ok(()))
                };
                if let Some(Err(error)) = self.connection().as_ref().map(checkpoint) {
                    tracing::debug!(%error, "checkpoint");
                }
                changed
            }
            result => result,
        }
    }

    /// After files were removed.
    pub(super) fn keep_spare(&self) {
        self.spare.refill();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};

    use super::super::super::Store;
    use crate::store::disk::Disk;
    use crate::store::faults::{Faults, WriteStep};

    #[test]
    fn a_full_disk_is_freed_by_deleting() {
        let directory = tempfile::tempdir().unwrap();
        let (spare, is_full) = (directory.path().join("spare"), Arc::new(AtomicBool::new(false)));
        let (its_spare, its_full) = (spare.clone(), is_full.clone());
        // There is room for a transaction where the spare file is gone.
        let faults = Faults::new(move |step| {
            let is_transaction = matches!(step, WriteStep::Begin | WriteStep::Commit);
            match its_full.load(Ordering::SeqCst) && (its_spare.exists() || !is_transaction) {
                true => Err(std::io::ErrorKind::StorageFull.into()),
                false => Ok(()),
            }
        });
        let disk = Disk::open(directory.path(), faults, 2).unwrap();
        disk.load("x").unwrap();
        let id = blake3::hash(b"glb").to_hex().to_string();
        disk.asset_added(&id, b"glb").unwrap();
        is_full.store(true, Ordering::SeqCst);
        assert!(disk.asset_added(blake3::hash(b"more").to_hex().as_str(), b"more").is_err());
        disk.asset_deleted(&id).unwrap();
        assert!(disk.asset(&id).is_err(), "its file has gone, and what it took is free");
        disk.scene_deleted(1).unwrap();
        is_full.store(false, Ordering::SeqCst);
        assert!(disk.load("x").unwrap().assets.is_empty());
        assert!(spare.exists(), "kept for the next time");
    }
}
