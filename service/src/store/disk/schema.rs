//! The database's tables.

use rusqlite::{Connection, OptionalExtension};

use super::super::StoreError;

/// Grows with every change of the tables.
const VERSION: i64 = 1;

/// What is told of an accepted edit beside its body, idempotency keys of uploads, and light maps of earlier states. Made
/// where they are missing: the tables of earlier builds lack them, and those builds do not mind.
const ADDED: &str = "
CREATE TABLE IF NOT EXISTS history (
    scene INTEGER NOT NULL REFERENCES scenes ON DELETE CASCADE, sequence INTEGER NOT NULL, job INTEGER NOT NULL,
    accepted_at TEXT NOT NULL, PRIMARY KEY (scene, sequence)) WITHOUT ROWID;
-- `scene`: no reference, since a key outlives what it made.
CREATE TABLE IF NOT EXISTS upload_keys (
    number INTEGER PRIMARY KEY, key TEXT NOT NULL UNIQUE, hash TEXT NOT NULL, scene INTEGER, job INTEGER);
-- `place`: of what undo goes back to, the oldest first; -1 has what the light to start from was computed from.
CREATE TABLE IF NOT EXISTS earlier (
    scene INTEGER NOT NULL REFERENCES scenes ON DELETE CASCADE, place INTEGER NOT NULL, sequence INTEGER NOT NULL,
    map TEXT NOT NULL, PRIMARY KEY (scene, place)) WITHOUT ROWID;
";

const TABLES: &str = "
CREATE TABLE meta (key TEXT PRIMARY KEY, value) WITHOUT ROWID;
-- `blob`: the upload. `jobs`: jobs of the scene so far. `reserved`: no version above it was ever given.
CREATE TABLE scenes (
    number INTEGER PRIMARY KEY, record TEXT NOT NULL, blob TEXT NOT NULL, jobs INTEGER NOT NULL,
    reserved INTEGER NOT NULL);
CREATE TABLE assets (id TEXT PRIMARY KEY) WITHOUT ROWID;
CREATE TABLE edits (
    scene INTEGER NOT NULL REFERENCES scenes ON DELETE CASCADE, sequence INTEGER NOT NULL, body BLOB NOT NULL,
    PRIMARY KEY (scene, sequence)) WITHOUT ROWID;
CREATE TABLE keys (
    number INTEGER PRIMARY KEY, scene INTEGER NOT NULL REFERENCES scenes ON DELETE CASCADE, key TEXT NOT NULL,
    body_hash TEXT NOT NULL, job INTEGER NOT NULL, answer TEXT NOT NULL, UNIQUE (scene, key));
CREATE TABLE jobs (number INTEGER PRIMARY KEY, scene INTEGER NOT NULL, is_open INTEGER NOT NULL, record TEXT NOT NULL);
CREATE INDEX jobs_of_scene ON jobs (scene);
CREATE TABLE light (
    scene INTEGER PRIMARY KEY REFERENCES scenes ON DELETE CASCADE, about TEXT NOT NULL, map TEXT NOT NULL,
    changed TEXT NOT NULL, lit_sequence INTEGER, lit TEXT);
";

/// Makes a connection durable and checks that it is a database of this program. `has_files`: there are files that a
/// database has to know, so it cannot be new.
pub(super) fn prepare(connection: &mut Connection, has_files: bool) -> Result<(), StoreError> {
    let version: i64 = connection.query_row("PRAGMA user_version", [], |row| row.get(0))?;
    if has_files && (version == 0 || number(connection, "life")? == 0) {
        return Err(super::mark::database_lost());
    }
    // FULL: a commit is on the disk when it returns, whatever becomes of the power.
    connection.execute_batch(
        "PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL; PRAGMA foreign_keys = ON; PRAGMA busy_timeout = 5000;",
    )?;
    let health: String = connection.query_row("PRAGMA quick_check(1)", [], |row| row.get(0))?;
    if health != "ok" {
        return Err(StoreError::damaged("the database is damaged", health));
    }
    match version {
        0 => {
            let transaction = connection.transaction()?;
            transaction.execute_batch(TABLES)?;
            transaction.execute_batch(ADDED)?;
            transaction.pragma_update(None, "user_version", VERSION)?;
            Ok(transaction.commit()?)
        }
        VERSION => Ok(connection.execute_batch(ADDED)?),
        other => {
            let detail = format!("it has version {other}, this program knows up to {VERSION}");
            Err(StoreError::damaged("the database is of another version of this program", detail))
        }
    }
}

/// A number of `meta`; 0 where it is not there.
pub(super) fn number(connection: &Connection, key: &str) -> Result<u64, StoreError> {
    let sql = "SELECT value FROM meta WHERE key = ?1";
    let found: Option<i64> = connection.query_row(sql, [key], |row| row.get(0)).optional()?;
    Ok(found.unwrap_or(0) as u64)
}

/// Raises a number of `meta`.
pub(super) fn raise(connection: &Connection, key: &str, value: u64) -> Result<(), StoreError> {
    let sql = "INSERT INTO meta (key, value) VALUES (?1, ?2)
        ON CONFLICT (key) DO UPDATE SET value = max(value, excluded.value)";
    connection.execute(sql, (key, value as i64))?;
    Ok(())
}

/// A text of `meta`, which is `fresh` where there is none yet.
pub(super) fn text(connection: &Connection, key: &str, fresh: &str) -> Result<String, StoreError> {
    connection.execute("INSERT OR IGNORE INTO meta (key, value) VALUES (?1, ?2)", (key, fresh))?;
    Ok(connection.query_row("SELECT value FROM meta WHERE key = ?1", [key], |row| row.get(0))?)
}

impl From<rusqlite::Error> for StoreError {
    fn from(error: rusqlite::Error) -> StoreError {
        use rusqlite::ErrorCode;
        let reason = match error.sqlite_error_code() {
            Some(ErrorCode::DiskFull) => "the disk is full",
            Some(ErrorCode::ReadOnly) => "the data directory is read-only",
            Some(ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase) => "the database is damaged",
            Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => "the database is in use",
            _ => "the database failed",
        };
        StoreError { reason, detail: error.to_string() }
    }
}
