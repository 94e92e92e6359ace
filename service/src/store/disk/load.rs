//! Reading a data directory at the start.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use jiff::Timestamp;
use rusqlite::Connection;

use super::blobs::BlobId;
use super::write::BASE;
use super::{Disk, codec, open, schema};
use crate::engine::LightMap;
use crate::jobs::queue::{JobNumber, SceneNumber};
use crate::store::StoreError;
use crate::store::lighting::Sequence;
use crate::store::records::{
    EarlierLight, JobRecord, KeyRecord, LightRecord, LightState, Origin, SceneRecord, UploadRecord,
};

/// All that was kept, files aside.
pub(crate) struct Saved {
    /// Suffix of all ids.
    pub(crate) suffix: String,
    /// How often the directory was opened.
    pub(crate) life: u64,
    pub(crate) newest_scene: SceneNumber,
    pub(crate) newest_job: JobNumber,
    pub(crate) assets: Vec<String>,
    /// The oldest first.
    pub(crate) upload_keys: Vec<UploadRecord>,
    pub(crate) scenes: Vec<SavedScene>,
    /// In the order of arrival. An error: the record cannot be read.
    pub(crate) jobs: Vec<Result<JobRecord, StoreError>>,
}

/// A scene as it was kept.
pub(crate) struct SavedScene {
    pub(crate) number: SceneNumber,
    pub(crate) record: Result<SceneRecord, StoreError>,
    pub(crate) jobs: u64,
    pub(crate) reserved: u64,
    pub(crate) edits: Vec<SavedEdit>,
    /// The oldest first.
    pub(crate) keys: Vec<KeyRecord>,
    blob: BlobId,
    light: Option<SavedLight>,
}

/// An accepted edit request as it was kept.
pub(crate) struct SavedEdit {
    pub(crate) sequence: Sequence,
    pub(crate) body: Vec<u8>,
    /// Not kept by earlier builds.
    pub(crate) job: Option<JobNumber>,
    pub(crate) accepted_at: Option<Timestamp>,
}

#[derive(Default)]
struct SavedLight {
    about: String,
    map: BlobId,
    changed: BlobId,
    lit: Option<(Sequence, BlobId)>,
    /// Of earlier states: place, sequence number and map.
    earlier: Vec<(i64, Sequence, BlobId)>,
}

impl Disk {
    /// Begins a new life of the directory and reads what is there. `suffix`: of ids, where the directory is new.
    pub(crate) fn load(&self, suffix: &str) -> Result<Saved, StoreError> {
        let (life, suffix) = self.transact(|t| {
            let life = schema::number(t, "life")? + 1;
            schema::raise(t, "life", life)?;
            Ok((life, schema::text(t, "suffix", suffix)?))
        })?;
        let connection = self.connection();
        let connection = open(&connection)?;
        self.sweep(connection)?;
        let (assets, _) = column(connection, "SELECT id FROM assets")?;
        Ok(Saved {
            suffix,
            life,
            newest_scene: schema::number(connection, "newest_scene")?,
            newest_job: schema::number(connection, "newest_job")?,
            assets,
            upload_keys: upload_keys(connection)?,
            scenes: scenes(connection)?,
            jobs: jobs(connection)?,
        })
    }

    /// The upload of a scene.
    pub(crate) fn upload_of(&self, scene: &SavedScene) -> Result<Vec<u8>, StoreError> {
        self.blobs.get(&scene.blob)
    }

    /// How a scene came to be, up to an edit.
    pub(super) fn read_origin(&self, scene: SceneNumber, sequence: Sequence) -> Result<Origin, StoreError> {
        let connection = self.connection();
        let connection = open(&connection)?;
        let sql = "SELECT record FROM scenes WHERE number = ?1";
        let record: String = connection.query_row(sql, [scene as i64], |row| row.get(0))?;
        let (edits, left_out) = edits(connection, scene)?;
        if left_out > 0 {
            return Err(StoreError::damaged("edits of the scene cannot be read", format!("{left_out} of them")));
        }
        let edits = edits.into_iter().filter(|edit| edit.sequence <= sequence).map(|edit| edit.body).collect();
        Ok(Origin { record: from_json(&record)?, edits })
    }

    /// The light of a scene, where any was saved.
    pub(crate) fn light(&self, scene: &SavedScene) -> Result<Option<LightRecord>, StoreError> {
        let Some(light) = &scene.light else { return Ok(None) };
        let about: LightState = from_json(&light.about)?;
        let map = Arc::new(self.map(&light.map)?);
        let changed = codec::decode_versions(&self.blobs.get(&light.changed)?, map.len());
        let changed =
            changed.ok_or_else(|| StoreError::damaged("a file of the data directory is no list", &light.changed))?;
        let lit = match &light.lit {
            Some((sequence, id)) if *id == light.map => Some((*sequence, map.clone())),
            Some((sequence, id)) => Some((*sequence, Arc::new(self.map(id)?))),
            None => None,
        };
        let mut maps: HashMap<&BlobId, Arc<LightMap>> = HashMap::from([(&light.map, map.clone())]);
        maps.extend(light.lit.iter().zip(&lit).map(|((_, id), (_, lit))| (id, lit.clone())));
        let mut earlier = EarlierLight::default();
        for (place, sequence, id) in &light.earlier {
            let known = maps.get(id).cloned();
            // Nothing that is seen is lost with it.
            let Ok(map) = known.map_or_else(|| self.map(id).map(Arc::new), Ok) else { continue };
            maps.insert(id, map.clone());
            match place {
                &BASE => earlier.base = Some((*sequence, map)),
                _ => earlier.kept.push((*sequence, map)),
            }
        }
        Ok(Some(LightRecord { about, map, changed: changed.into(), lit, earlier }))
    }

    fn map(&self, id: &str) -> Result<LightMap, StoreError> {
        let bytes = self.blobs.get(id)?;
        codec::decode_map(&bytes).ok_or_else(|| StoreError::damaged("a file of the data directory is no light map", id))
    }

    fn sweep(&self, connection: &Connection) -> Result<(), StoreError> {
        let sql = "SELECT blob FROM scenes UNION SELECT id FROM assets UNION SELECT map FROM light
            UNION SELECT changed FROM light UNION SELECT lit FROM light WHERE lit IS NOT NULL
            UNION SELECT map FROM earlier";
        let (referred, left_out) = column(connection, sql)?;
        let referred: HashSet<BlobId> = referred.into_iter().collect();
        // Rather too much is kept than an emptied database believed, or a row that names nobody knows which file.
        if referred.is_empty() || left_out > 0 {
            return Ok(());
        }
        let removed = self.blobs.sweep(&referred)?;
        if removed > 0 {
            tracing::info!(removed, "files that nothing refers to");
        }
        Ok(())
    }
}

/// The texts of a column, and how many rows were left out.
fn column(connection: &Connection, sql: &str) -> Result<(Vec<String>, usize), StoreError> {
    let mut select = connection.prepare(sql)?;
    let rows = select.query_map([], |row| row.get(0))?;
    readable(rows, sql)
}

/// The rows that can be read. Others are told and left out, and counted: one bad row must not cost all that is good.
/// Where the database itself fails there is no telling what is missing, so nothing is answered.
fn readable<T>(rows: impl Iterator<Item = rusqlite::Result<T>>, what: &str) -> Result<(Vec<T>, usize), StoreError> {
    let (mut good, mut left_out) = (Vec::new(), 0);
    for row in rows {
        match row {
            Ok(row) => good.push(row),
            Err(error) if is_of_the_row(&error) => {
                tracing::error!(%error, what, "a row is left out");
                left_out += 1;
            }
            Err(error) => return Err(error.into()),
        }
    }
    Ok((good, left_out))
}

/// Whether an error says that a row was read and does not hold what it should.
fn is_of_the_row(error: &rusqlite::Error) -> bool {
    use rusqlite::Error::{FromSqlConversionFailure, IntegralValueOutOfRange, InvalidColumnType, Utf8Error};
    matches!(error, FromSqlConversionFailure(..) | IntegralValueOutOfRange(..) | InvalidColumnType(..) | Utf8Error(..))
}

fn scenes(connection: &Connection) -> Result<Vec<SavedScene>, StoreError> {
    let sql = "SELECT number, record, scenes.jobs, reserved, blob, about, map, changed, lit_sequence, lit
        FROM scenes LEFT JOIN light ON light.scene = scenes.number ORDER BY number";
    let mut select = connection.prepare(sql)?;
    let rows = select.query_map([], |row| {
        let record: String = row.get(1)?;
        // A row that cannot be read is light that cannot be: it is baked afresh.
        let light = saved_light(row).unwrap_or_else(|_| Some(SavedLight::default()));
        Ok(SavedScene {
            number: row.get::<_, i64>(0)? as SceneNumber,
            record: from_json(&record),
            jobs: row.get::<_, i64>(2)? as u64,
            reserved: row.get::<_, i64>(3)? as u64,
            edits: Vec::new(),
            keys: Vec::new(),
            blob: row.get(4)?,
            light,
        })
    })?;
    let (mut scenes, _) = readable(rows, "scenes")?;
    for scene in &mut scenes {
        let (edits, left_out) = edits(connection, scene.number)?;
        if left_out == 0 {
            scene.edits = edits;
        } else {
            // Without one of its edits it would be another scene.
            let detail = format!("{left_out} of them");
            scene.record = Err(StoreError::damaged("edits of the scene cannot be read", detail));
        }
        scene.keys = keys(connection, scene.number)?;
        if let Some(light) = &mut scene.light {
            light.earlier = earlier(connection, scene.number)?;
        }
    }
    Ok(scenes)
}

/// The columns of a scene's light, where it has any.
fn saved_light(row: &rusqlite::Row<'_>) -> rusqlite::Result<Option<SavedLight>> {
    let Some(about) = row.get::<_, Option<String>>(5)? else { return Ok(None) };
    let sequence: Option<i64> = row.get(8)?;
    let lit = sequence.map(|sequence| sequence as Sequence).zip(row.get(9)?);
    Ok(Some(SavedLight { about, map: row.get(6)?, changed: row.get(7)?, lit, earlier: Vec::new() }))
}

/// Light maps of a scene's earlier states.
fn earlier(connection: &Connection, scene: SceneNumber) -> Result<Vec<(i64, Sequence, BlobId)>, StoreError> {
    let mut select =
        connection.prepare_cached("SELECT place, sequence, map FROM earlier WHERE scene = ?1 ORDER BY place")?;
    let rows =
        select.query_map([scene as i64], |row| Ok((row.get(0)?, row.get::<_, i64>(1)? as Sequence, row.get(2)?)))?;
    Ok(readable(rows, "earlier light")?.0)
}

/// Edits of a scene, in their order, and how many rows were left out.
fn edits(connection: &Connection, scene: SceneNumber) -> Result<(Vec<SavedEdit>, usize), StoreError> {
    let sql = "SELECT sequence, body, job, accepted_at FROM edits LEFT JOIN history USING (scene, sequence)
        WHERE scene = ?1 ORDER BY sequence";
    let mut select = connection.prepare_cached(sql)?;
    let rows = select.query_map([scene as i64], |row| {
        // What cannot be read of these two is not told; the scene is whole without.
        let job = row.get::<_, Option<i64>>(2).ok().flatten().map(|job| job as JobNumber);
        let accepted_at = row.get::<_, Option<String>>(3).ok().flatten().and_then(|text| text.parse().ok());
        Ok(SavedEdit { sequence: row.get::<_, i64>(0)? as Sequence, body: row.get(1)?, job, accepted_at })
    })?;
    readable(rows, "edits")
}

fn keys(connection: &Connection, scene: SceneNumber) -> Result<Vec<KeyRecord>, StoreError> {
    let sql = "SELECT key, body_hash, job, answer FROM keys WHERE scene = ?1 ORDER BY number";
    let mut select = connection.prepare_cached(sql)?;
    let rows = select.query_map([scene as i64], |row| {
        let (key, job, answer): (String, i64, String) = (row.get(0)?, row.get(2)?, row.get(3)?);
        Ok(KeyRecord { key, body_hash: hash(row, 1)?, job: job as JobNumber, answer: answer.into() })
    })?;
    Ok(readable(rows, "keys")?.0)
}

fn upload_keys(connection: &Connection) -> Result<Vec<UploadRecord>, StoreError> {
    let mut select = connection.prepare("SELECT key, hash, scene, job FROM upload_keys ORDER BY number")?;
    let rows = select.query_map([], |row| {
        let number = |column| Ok::<_, rusqlite::Error>(row.get::<_, Option<i64>>(column)?.map(|number| number as u64));
        Ok(UploadRecord { key: row.get(0)?, hash: hash(row, 1)?, scene: number(2)?, job: number(3)? })
    })?;
    Ok(readable(rows, "upload keys")?.0)
}

/// What came with a key. One that cannot be read matches nothing: the key is refused rather than used twice.
fn hash(row: &rusqlite::Row<'_>, column: usize) -> rusqlite::Result<blake3::Hash> {
    let hash: String = row.get(column)?;
    Ok(blake3::Hash::from_hex(hash).unwrap_or_else(|_| blake3::Hash::from_bytes([0; 32])))
}

fn jobs(connection: &Connection) -> Result<Vec<Result<JobRecord, StoreError>>, StoreError> {
    let (records, _) = column(connection, "SELECT record FROM jobs ORDER BY number")?;
    Ok(records.iter().map(|json| from_json(json)).collect())
}

fn from_json<T: serde::de::DeserializeOwned>(json: &str) -> Result<T, StoreError> {
    serde_json::from_str(json).map_err(|error| StoreError::damaged("a record of the database cannot be read", error))
}

#[cfg(test)]
mod tests {
    use rusqlite::ffi;

    use super::*;
    use crate::store::Store;
    use crate::store::faults::Faults;

    #[test]
    fn bad_rows_are_left_out_and_a_failing_database_is_told() {
        let bad = || rusqlite::Error::InvalidColumnType(0, "id".to_owned(), rusqlite::types::Type::Blob);
        assert_eq!(readable([Ok(1), Err(bad()), Ok(3)].into_iter(), "a").unwrap(), (vec![1, 3], 1));
        let failing = rusqlite::Error::SqliteFailure(ffi::Error::new(ffi::SQLITE_IOERR_READ), None);
        let told = readable([Ok(1), Err(failing)].into_iter(), "a").unwrap_err();
        assert_eq!(told.reason, "the database failed");
    }

    #[test]
    fn files_stay_where_a_row_names_one_that_cannot_be_read() {
        let directory = tempfile::tempdir().unwrap();
        let ids = [b"one".as_slice(), b"two"].map(|glb| (blake3::hash(glb).to_hex().to_string(), glb));
        let life = |damage: &str| {
            let disk = Disk::open(directory.path(), Faults::default(), 2).unwrap();
            let assets = disk.load("x").unwrap().assets.len();
            let is_there = ids.each_ref().map(|(id, _)| disk.asset(id).is_ok());
            if damage.is_empty() {
                ids.iter().for_each(|(id, glb)| disk.asset_added(id, glb).unwrap());
            }
            disk.close();
            Connection::open(directory.path().join("rebake.db")).unwrap().execute_batch(damage).unwrap();
            (assets, is_there)
        };
        life("");
        assert_eq!(life(&format!("UPDATE assets SET id = CAST(id AS BLOB) WHERE id = '{}'", ids[0].0)).0, 2);
        // The row is left out, its file is not taken for one that nobody needs.
        assert_eq!(life("UPDATE assets SET id = CAST(id AS TEXT)"), (1, [true, true]));
        assert_eq!(life(&format!("DELETE FROM assets WHERE id = '{}'", ids[0].0)), (2, [true, true]));
        assert_eq!(life("SELECT 1"), (1, [false, true]));
    }
}
