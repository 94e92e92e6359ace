//! A data directory: what is small in a database (SQLite), uploads and light maps as files beside it.
//!
//! A change is kept in two steps: its files, forced to the disk; then one transaction that refers to them. Whatever
//! happens in between leaves files that nobody refers to, and the next start sweeps them.

mod blobs;
pub(crate) mod codec;
mod load;
mod mark;
mod schema;
mod spare;
mod write;

use std::fs::{File, TryLockError};
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError, Weak};

use rusqlite::{Connection, Transaction, TransactionBehavior};

use super::StoreError;
use super::faults::{Faults, WriteStep};
use crate::engine::LightMap;
use blobs::{Blobs, Whole};
pub(crate) use load::{Saved, SavedEdit, SavedScene};
use spare::Spare;

/// An open data directory. One process at a time has it.
#[derive(Debug)]
pub(crate) struct Disk {
    /// None once it is closed.
    connection: Mutex<Option<Connection>>,
    blobs: Blobs,
    spare: Spare,
    faults: Faults,
    max_keys: usize,
    lock: Mutex<Option<File>>,
    /// Light maps that are somewhere in memory, with their files.
    written: Mutex<Vec<(Weak<LightMap>, Whole)>>,
}

impl Disk {
    /// Opens a data directory, or makes one where there is none or an empty directory. `max_keys`: idempotency keys
    /// that are kept per scene.
    pub(crate) fn open(directory: &Path, faults: Faults, max_keys: usize) -> Result<Disk, StoreError> {
        std::fs::create_dir_all(directory)?;
        mark::check(directory)?;
        let lock = File::options().create(true).truncate(false).write(true).open(directory.join("lock"))?;
        match lock.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let detail = "one process at a time may have it";
                return Err(StoreError::damaged("another process uses the data directory", detail));
            }
            Err(TryLockError::Error(error)) => return Err(error.into()),
        }
        mark::mark(directory)?;
        let mut connection = Connection::open(directory.join(mark::DATABASE))?;
        schema::prepare(&mut connection, mark::has_blobs(directory)?)?;
        let blobs = Blobs::open(directory, faults.clone())?;
        let (connection, lock) = (Mutex::new(Some(connection)), Mutex::new(Some(lock)));
        Ok(Disk { connection, blobs, spare: Spare::new(directory), faults, max_keys, lock, written: Mutex::default() })
    }

    /// Runs `change` as one transaction.
    fn transact<T>(&self, change: impl FnOnce(&Transaction<'_>) -> Result<T, StoreError>) -> Result<T, StoreError> {
        let mut connection = self.connection();
        let connection = connection.as_mut().ok_or_else(closed)?;
        self.faults.check(WriteStep::Begin)?;
        let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
        let result = change(&transaction)?;
        self.faults.check(WriteStep::Commit)?;
        transaction.commit()?;
        Ok(result)
    }

    fn connection(&self) -> MutexGuard<'_, Option<Connection>> {
        // A transaction of a thread that panicked was rolled back when it was dropped.
        self.connection.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn open(connection: &Option<Connection>) -> Result<&Connection, StoreError> {
    connection.as_ref().ok_or_else(closed)
}

fn closed() -> StoreError {
    StoreError::damaged("the service is about to end", "the data directory is closed")
}

/// The JSON of a record.
fn to_json(record: &impl serde::Serialize) -> Result<String, StoreError> {
    serde_json::to_string(record).map_err(|error| StoreError::damaged("a record cannot be written", error))
}

#[cfg(test)]
mod tests {
    use jiff::Timestamp;

    use super::super::Store;
    use super::super::records::{JobRecord, SceneRecord, StoredOutside};
    use super::*;
    use crate::jobs::JobSpec;
    use crate::jobs::budget::JobBudget;
    use crate::jobs::queue::{Job, JobKind, JobState, Outcome, Priority};
    use crate::mode::Mode;
    use crate::sizing::StoredSpread;

    fn job(number: u64, scene: u64) -> JobRecord {
        let budget =
            JobBudget { samples_per_element: 4, max_seconds: Some(0.1), target_rmse: Some(1e-3), by_error: true };
        let job = Job::new(number, scene, JobKind::Bake, Priority::High, Timestamp::now());
        JobRecord { job, spec: JobSpec::new(budget, u64::MAX - 1, 0) }
    }

    #[test]
    fn a_job_that_has_ended_stays_so_and_jobs_end_with_their_scene() {
        let directory = tempfile::tempdir().unwrap();
        let disk = Disk::open(directory.path(), Faults::default(), 2).unwrap();
        let (name, created_at) = ("a".to_owned(), Timestamp::now());
        let scene = SceneRecord {
            name,
            mode: Mode::Full,
            spacing: 0.1,
            object_squares: None,
            elements: None,
            spread: StoredSpread::default(),
            environment: None,
            outside: StoredOutside::default(),
            unit: Default::default(),
            max_albedo: None,
            atlas: None,
            target: None,
            groups: Default::default(),
            created_at,
        };
        disk.scene_created(1, &scene, b"glb", Some(&job(1, 1)), None).unwrap();
        disk.job_changed(&job(2, 1)).unwrap();
        let mut done = job(1, 1);
        done.job.end(Outcome::Succeeded, Timestamp::now());
        disk.job_ended(&done, None).unwrap();
        disk.job_changed(&job(1, 1)).unwrap();
        disk.scene_deleted(1).unwrap();
        let saved = disk.load("x").unwrap();
        assert!(saved.scenes.is_empty() && saved.newest_scene == 1 && saved.newest_job == 2);
        let jobs: Vec<JobRecord> = saved.jobs.into_iter().map(Result::unwrap).collect();
        let states: Vec<JobState> = jobs.iter().map(|record| record.job.state()).collect();
        assert_eq!(states, [JobState::Succeeded, JobState::Canceled]);
        assert!(jobs[1].job.has_ended() && jobs[1].spec.seed == u64::MAX - 1);
    }
}
