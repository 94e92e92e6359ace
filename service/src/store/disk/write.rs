//! [`Store`] on a data directory.

use std::sync::{Arc, PoisonError};

use bytes::Bytes;
use rusqlite::{OptionalExtension, Transaction};

use super::blobs::{BlobId, Pin, Whole};
use super::{Disk, codec, open, schema, to_json};
use crate::engine::LightMap;
use crate::jobs::queue::{JobNumber, SceneNumber};
use crate::store::lighting::Sequence;
use crate::store::records::{
    Accepted, EarlierLight, JobRecord, KeyRecord, LightRecord, Origin, SceneChange, SceneRecord, UploadRecord,
};
use crate::store::versions::FIRST_RESERVE;
use crate::store::{Store, StoreError};

/// Place, among light maps of earlier states, of the one that the light to start from was computed from.
pub(super) const BASE: i64 = -1;

impl Store for Disk {
    fn upload(&self, scene: SceneNumber) -> Result<Bytes, StoreError> {
        let blob: String = {
            let connection = self.connection();
            let sql = "SELECT blob FROM scenes WHERE number = ?1";
            open(&connection)?.query_row(sql, [scene as i64], |row| row.get(0))?
        };
        self.blobs.get(&blob).map(Bytes::from)
    }

    fn asset(&self, id: &str) -> Result<Bytes, StoreError> {
        self.blobs.get(id).map(Bytes::from)
    }

    fn origin(&self, scene: SceneNumber, sequence: Sequence) -> Result<Origin, StoreError> {
        self.read_origin(scene, sequence)
    }

    fn is_durable(&self) -> bool {
        true
    }

    fn close(&self) {
        self.connection().take();
        self.lock.lock().unwrap_or_else(PoisonError::into_inner).take();
    }

    fn scene_created(
        &self,
        number: SceneNumber,
        scene: &SceneRecord,
        glb: &[u8],
        bake: Option<&JobRecord>,
        key: Option<&UploadRecord>,
    ) -> Result<(), StoreError> {
        let record = to_json(scene)?;
        self.with_file(glb, |t, blob| {
            let sql = "INSERT INTO scenes (number, record, blob, jobs, reserved) VALUES (?1, ?2, ?3, ?4, ?5)";
            let jobs = i64::from(bake.is_some());
            t.execute(sql, (number as i64, record, blob, jobs, FIRST_RESERVE as i64))?;
            schema::raise(t, "newest_scene", number)?;
            key.map_or(Ok(()), |key| put_upload_key(t, key, self.max_keys))?;
            bake.map_or(Ok(()), |job| put_job(t, job))
        })
    }

    fn upload_keyed(&self, key: &UploadRecord) -> Result<(), StoreError> {
        self.transact(|t| put_upload_key(t, key, self.max_keys))
    }

    fn scene_changed(&self, number: SceneNumber, change: &SceneChange<'_>) -> Result<(), StoreError> {
        let target = change.target.map(to_json).transpose()?;
        self.transact(|t| {
            let sql = "UPDATE scenes SET record = json_set(record, '$.name', ?2) WHERE number = ?1";
            change.name.map_or(Ok(0), |name| t.execute(sql, (number as i64, name)))?;
            let sql = "UPDATE scenes SET record = json_set(record, '$.target', json(?2)) WHERE number = ?1";
            target.as_ref().map_or(Ok(0), |target| t.execute(sql, (number as i64, target)))?;
            Ok(())
        })
    }

    fn scene_deleted(&self, number: SceneNumber) -> Result<(), StoreError> {
        let number = number as i64;
        let files = self.freeing(|t| {
            let mut files = light_files(t, number)?;
            let sql = "SELECT blob FROM scenes WHERE number = ?1";
            files.extend(t.query_row(sql, [number], |row| row.get::<_, BlobId>(0)).optional()?);
            // Jobs that are open end with their scene.
            let sql = "UPDATE jobs SET is_open = 0, record = json_set(record, '$.job.state', 'canceled',
                '$.job.finished_at', ?2) WHERE scene = ?1 AND is_open";
            t.execute(sql, (number, jiff::Timestamp::now().to_string()))?;
            t.execute("DELETE FROM scenes WHERE number = ?1", [number])?;
            Ok(files)
        })?;
        self.collect(&files);
        Ok(())
    }

    fn asset_added(&self, id: &str, glb: &[u8]) -> Result<(), StoreError> {
        self.with_file(glb, |t, blob| {
            if blob != id {
                return Err(StoreError::damaged("an asset has another hash than its bytes", id));
            }
            t.execute("INSERT OR IGNORE INTO assets (id) VALUES (?1)", [id])?;
            Ok(())
        })
    }

    fn asset_deleted(&self, id: &str) -> Result<(), StoreError> {
        self.freeing(|t| {
            t.execute("DELETE FROM assets WHERE id = ?1", [id])?;
            Ok(())
        })?;
        self.collect(&[id.to_owned()]);
        Ok(())
    }

    fn accepted(&self, request: &Accepted<'_>) -> Result<(), StoreError> {
        let scene = request.scene as i64;
        self.transact(|t| {
            if let Some(edit) = &request.edit {
                let sql = "INSERT INTO edits (scene, sequence, body) VALUES (?1, ?2, ?3)";
                t.execute(sql, (scene, edit.sequence as i64, edit.body))?;
                let sql = "INSERT INTO history (scene, sequence, job, accepted_at) VALUES (?1, ?2, ?3, ?4)";
                let job = request.job.job.number as i64;
                t.execute(sql, (scene, edit.sequence as i64, job, edit.accepted_at.to_string()))?;
            }
            t.execute("UPDATE scenes SET jobs = ?2 WHERE number = ?1", (scene, request.jobs as i64))?;
            if let Some(key) = request.key {
                put_key(t, scene, key, self.max_keys)?;
            }
            put_job(t, request.job)
        })
    }

    fn job_changed(&self, job: &JobRecord) -> Result<(), StoreError> {
        self.transact(|t| put_job(t, job))
    }

    fn job_ended(&self, job: &JobRecord, light: Option<&LightRecord>) -> Result<(), StoreError> {
        self.save(job.job.scene, light, |t| put_job(t, job))
    }

    fn jobs_forgotten(&self, jobs: &[JobNumber]) -> Result<(), StoreError> {
        self.transact(|t| {
            let mut delete = t.prepare_cached("DELETE FROM jobs WHERE number = ?1 AND NOT is_open")?;
            for number in jobs {
                delete.execute([*number as i64])?;
            }
            Ok(())
        })
    }

    fn light_saved(&self, scene: SceneNumber, light: &LightRecord) -> Result<(), StoreError> {
        self.save(scene, Some(light), |_| Ok(()))
    }

    fn versions_reserved(&self, scene: SceneNumber, version: u64) -> Result<(), StoreError> {
        self.transact(|t| {
            let sql = "UPDATE scenes SET reserved = ?2 WHERE number = ?1";
            t.execute(sql, (scene as i64, version as i64))?;
            Ok(())
        })
    }
}

impl Disk {
    /// Writes a file, then what refers to it. Where that fails the file goes again: nobody was told of it.
    fn with_file(
        &self,
        bytes: &[u8],
        change: impl FnOnce(&Transaction<'_>, &str) -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        let pin = self.blobs.put(bytes)?;
        let changed = self.transact(|t| change(t, &pin.id));
        let id = pin.id.clone();
        drop(pin);
        if changed.is_err() {
            self.collect(&[id]);
        }
        changed
    }

    /// Files first, then the row that refers to them and whatever else `also` keeps.
    fn save(
        &self,
        scene: SceneNumber,
        light: Option<&LightRecord>,
        also: impl FnOnce(&Transaction<'_>) -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        let files = light.map(|light| self.light_pins(light)).transpose()?;
        let old = self.transact(|t| {
            let mut old = Vec::new();
            if let (Some(light), Some(files)) = (light, &files) {
                old = light_files(t, scene as i64)?;
                put_light(t, scene as i64, light, files)?;
            }
            also(t)?;
            Ok(old)
        })?;
        self.collect(&old);
        Ok(())
    }

    fn light_pins(&self, light: &LightRecord) -> Result<LightPins<'_>, StoreError> {
        let map = self.map_pin(&light.map)?;
        let changed = self.blobs.put(&codec::encode_versions(&light.changed)?)?;
        let lit = light.lit.as_ref().map(|(_, lit)| self.map_pin(lit)).transpose()?;
        let EarlierLight { kept, base } = &light.earlier;
        let of_base = base.iter().map(|state| (BASE, state));
        let earlier =
            (0..).zip(kept).chain(of_base).map(|(place, (sequence, map))| Ok((place, *sequence, self.map_pin(map)?)));
        let earlier = earlier.collect::<Result<_, StoreError>>()?;
        Ok(LightPins { map, changed, lit, earlier })
    }

    /// Writes a map, unless that was done.
    fn map_pin(&self, map: &Arc<LightMap>) -> Result<Pin<'_>, StoreError> {
        let written = || self.written.lock().unwrap_or_else(PoisonError::into_inner);
        let known = {
            let mut written = written();
            written.retain(|(map, _)| map.strong_count() > 0);
            written.iter().find(|(known, _)| known.as_ptr() == Arc::as_ptr(map)).map(|(_, file)| file.clone())
        };
        if let Some(pin) = known.and_then(|file| self.blobs.pin(&file)) {
            return Ok(pin);
        }
        let bytes = codec::encode_map(map);
        let pin = self.blobs.put(&bytes)?;
        written().push((Arc::downgrade(map), Whole { id: pin.id.clone(), bytes: bytes.len() as u64 }));
        Ok(pin)
    }

    /// Removes those of the files that nothing refers to any more.
    fn collect(&self, files: &[BlobId]) {
        for id in files {
            self.blobs.collect(id, || {
                let sql = "SELECT EXISTS (SELECT 1 FROM scenes WHERE blob = ?1)
                    OR EXISTS (SELECT 1 FROM assets WHERE id = ?1)
                    OR EXISTS (SELECT 1 FROM light WHERE map = ?1 OR changed = ?1 OR lit = ?1)
                    OR EXISTS (SELECT 1 FROM earlier WHERE map = ?1)";
                let connection = self.connection();
                Ok(open(&connection)?.query_row(sql, [id], |row| row.get(0))?)
            });
        }
        self.keep_spare();
    }
}

/// The files of a scene's light, pinned until the database refers to them.
struct LightPins<'a> {
    map: Pin<'a>,
    changed: Pin<'a>,
    lit: Option<Pin<'a>>,
    /// Place, sequence number and map.
    earlier: Vec<(i64, Sequence, Pin<'a>)>,
}

fn put_light(t: &Transaction<'_>, scene: i64, light: &LightRecord, files: &LightPins<'_>) -> Result<(), StoreError> {
    let lit_sequence = light.lit.as_ref().map(|(sequence, _)| *sequence as i64);
    // A scene that was deleted meanwhile keeps nothing.
    let sql = "INSERT INTO light (scene, about, map, changed, lit_sequence, lit)
        SELECT ?1, ?2, ?3, ?4, ?5, ?6 WHERE EXISTS (SELECT 1 FROM scenes WHERE number = ?1)
        ON CONFLICT (scene) DO UPDATE SET about = excluded.about, map = excluded.map, changed = excluded.changed,
            lit_sequence = excluded.lit_sequence, lit = excluded.lit";
    let about = to_json(&light.about)?;
    let lit = files.lit.as_ref().map(|lit| &lit.id);
    t.execute(sql, (scene, about, &files.map.id, &files.changed.id, lit_sequence, lit))?;
    t.execute("DELETE FROM earlier WHERE scene = ?1", [scene])?;
    let sql = "INSERT INTO earlier (scene, place, sequence, map)
        SELECT ?1, ?2, ?3, ?4 WHERE EXISTS (SELECT 1 FROM scenes WHERE number = ?1)";
    let mut insert = t.prepare_cached(sql)?;
    for (place, sequence, map) in &files.earlier {
        insert.execute((scene, place, *sequence as i64, &map.id))?;
    }
    Ok(())
}

fn light_files(t: &Transaction<'_>, scene: i64) -> Result<Vec<BlobId>, StoreError> {
    let sql = "SELECT map, changed, lit FROM light WHERE scene = ?1";
    let files = |row: &rusqlite::Row<'_>| -> rusqlite::Result<[Option<BlobId>; 3]> {
        Ok([row.get(0)?, row.get(1)?, row.get(2)?])
    };
    let light = t.query_row(sql, [scene], files).optional()?.into_iter().flatten().flatten();
    let mut earlier = t.prepare_cached("SELECT map FROM earlier WHERE scene = ?1")?;
    let earlier = earlier.query_map([scene], |row| row.get(0))?;
    light.map(Ok).chain(earlier).collect::<Result<_, _>>().map_err(StoreError::from)
}

fn put_job(t: &Transaction<'_>, job: &JobRecord) -> Result<(), StoreError> {
    let sql = "INSERT INTO jobs (number, scene, is_open, record) VALUES (?1, ?2, ?3, ?4)
        ON CONFLICT (number) DO UPDATE SET is_open = excluded.is_open, record = excluded.record
            WHERE jobs.is_open OR NOT excluded.is_open";
    // What has ended stays so: its end is kept before the queue knows of it, and a request to stop may come between.
    let is_open = !job.job.has_ended();
    t.execute(sql, (job.job.number as i64, job.job.scene as i64, is_open, to_json(job)?))?;
    schema::raise(t, "newest_job", job.job.number)
}

fn put_key(t: &Transaction<'_>, scene: i64, key: &KeyRecord, max_keys: usize) -> Result<(), StoreError> {
    let sql = "INSERT OR REPLACE INTO keys (scene, key, body_hash, job, answer) VALUES (?1, ?2, ?3, ?4, ?5)";
    let hash = key.body_hash.to_hex();
    t.execute(sql, (scene, &key.key, hash.as_str(), key.job as i64, &*key.answer))?;
    let sql = "DELETE FROM keys WHERE scene = ?1 AND number <=
        (SELECT number FROM keys WHERE scene = ?1 ORDER BY number DESC LIMIT 1 OFFSET ?2)";
    t.execute(sql, (scene, max_keys as i64))?;
    Ok(())
}

fn put_upload_key(t: &Transaction<'_>, key: &UploadRecord, max_keys: usize) -> Result<(), StoreError> {
    let sql = "INSERT OR IGNORE INTO upload_keys (key, hash, scene, job) VALUES (?1, ?2, ?3, ?4)";
    let hash = key.hash.to_hex();
    t.execute(sql, (&key.key, hash.as_str(), key.scene.map(|n| n as i64), key.job.map(|n| n as i64)))?;
    let sql = "DELETE FROM upload_keys WHERE number <=
        (SELECT number FROM upload_keys ORDER BY number DESC LIMIT 1 OFFSET ?1)";
    t.execute(sql, [max_keys as i64])?;
    Ok(())
}
