//! Files that machines share: a folder, or whatever else the `object_store` crate reaches.

use std::sync::Arc;

use bytes::Bytes;
use futures_util::{StreamExt, TryStreamExt};
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt, PutPayload};
use url::Url;

use super::ClusterError;

/// Prefixes of the environment variables that tell credentials and regions.
const SETTINGS: [&str; 3] = ["AWS_", "AZURE_", "GOOGLE_"];

/// Where machines put what they share. Cheap to clone.
#[derive(Clone, Debug)]
pub(crate) struct Objects {
    store: Arc<dyn ObjectStore>,
    root: Path,
}

impl Objects {
    /// Those at an address: `file:///folder`, a folder's path, or `s3://bucket/prefix` where that is built in.
    pub(crate) fn open(address: &str) -> Result<Objects, ClusterError> {
        let invalid = |reason: String| ClusterError::Address { what: "objects", address: address.to_owned(), reason };
        let url = match Url::parse(address) {
            // A letter and a colon is a drive.
            Ok(url) if url.scheme().len() > 1 => url,
            _ => {
                let folder = std::path::absolute(address).map_err(|error| invalid(error.to_string()))?;
                Url::from_directory_path(folder).map_err(|()| invalid("is no folder".to_owned()))?
            }
        };
        if url.scheme() == "file" {
            let folder = url.to_file_path().map_err(|()| invalid("is no folder".to_owned()))?;
            std::fs::create_dir_all(&folder).map_err(|error| invalid(error.to_string()))?;
            // Folders of what was removed are removed, too.
            let store = LocalFileSystem::new_with_prefix(folder)?.with_automatic_cleanup(true);
            return Ok(Objects { store: Arc::new(store), root: Path::default() });
        }
        let setting = |(name, value): (String, String)| {
            SETTINGS.iter().any(|prefix| name.starts_with(prefix)).then(|| (name.to_ascii_lowercase(), value))
        };
        let settings = std::env::vars().filter_map(setting);
        let (store, root) = object_store::parse_url_opts(&url, settings).map_err(|error| invalid(error.to_string()))?;
        Ok(Objects { store: store.into(), root })
    }

    /// Keeps a file under the hash of its bytes, and answers that. One that is there already stays.
    pub(crate) async fn put_file(&self, bytes: Bytes) -> Result<String, ClusterError> {
        let hash = blake3::hash(&bytes).to_hex().to_string();
        let path = file_path(&hash);
        let found = self.store.head(&self.at(&path)).await;
        if found.is_err() || found.is_ok_and(|found| found.size != bytes.len() as u64) {
            self.put(&path, bytes).await?;
        }
        Ok(hash)
    }

    /// The file with a hash; an error where its bytes have another.
    pub(crate) async fn file(&self, hash: &str) -> Result<Bytes, ClusterError> {
        checked(self.get(&file_path(hash)).await?, hash)
    }

    /// Keeps a file in a folder under the hash of its bytes, and answers that.
    pub(crate) async fn put_into(&self, folder: &str, bytes: Bytes) -> Result<String, ClusterError> {
        let hash = blake3::hash(&bytes).to_hex().to_string();
        self.put(&format!("{folder}/{hash}"), bytes).await?;
        Ok(hash)
    }

    /// The file of a folder with a hash; an error where its bytes have another.
    pub(crate) async fn file_of(&self, folder: &str, hash: &str) -> Result<Bytes, ClusterError> {
        checked(self.get(&format!("{folder}/{hash}")).await?, hash)
    }

    /// What lies at a path, if anything does.
    pub(crate) async fn find(&self, path: &str) -> Result<Option<Bytes>, ClusterError> {
        match self.get(path).await {
            Ok(bytes) => Ok(Some(bytes)),
            Err(ClusterError::Objects(object_store::Error::NotFound { .. })) => Ok(None),
            Err(error) => Err(error),
        }
    }

    pub(crate) async fn put(&self, path: &str, bytes: Bytes) -> Result<(), ClusterError> {
        self.store.put(&self.at(path), PutPayload::from(bytes)).await?;
        Ok(())
    }

    pub(crate) async fn get(&self, path: &str) -> Result<Bytes, ClusterError> {
        Ok(self.store.get(&self.at(path)).await?.bytes().await?)
    }

    /// Removes a file; one that is not there is removed already.
    pub(crate) async fn remove(&self, path: &str) -> Result<(), ClusterError> {
        match self.store.delete(&self.at(path)).await {
            Ok(()) | Err(object_store::Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }

    /// Removes all that begins with a folder.
    pub(crate) async fn remove_all(&self, folder: &str) -> Result<(), ClusterError> {
        let found = self.store.list(Some(&self.at(folder))).map_ok(|found| found.location).boxed();
        let mut removed = self.store.delete_stream(found);
        while let Some(removed) = removed.next().await {
            match removed {
                Ok(_) | Err(object_store::Error::NotFound { .. }) => {}
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }

    /// Names in a folder, without it.
    pub(crate) async fn names(&self, folder: &str) -> Result<Vec<String>, ClusterError> {
        let listed = self.store.list_with_delimiter(Some(&self.at(folder))).await?;
        let files = listed.objects.iter().map(|object| &object.location);
        let names = files.chain(&listed.common_prefixes).filter_map(|path| path.filename().map(str::to_owned));
        Ok(names.collect())
    }

    fn at(&self, path: &str) -> Path {
        path.split('/').fold(self.root.clone(), |path, part| path.join(part))
    }
}

/// Bytes that have a hash.
pub(super) fn checked(bytes: Bytes, hash: &str) -> Result<Bytes, ClusterError> {
    match blake3::hash(&bytes).to_hex().as_str() == hash {
        true => Ok(bytes),
        false => Err(ClusterError::WrongHash),
    }
}

fn file_path(hash: &str) -> String {
    format!("files/{hash}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn files_are_found_by_their_hash_and_damage_is_seen() {
        let folder = tempfile::tempdir().unwrap();
        let objects = Objects::open(folder.path().to_str().unwrap()).unwrap();
        let hash = objects.put_file(Bytes::from_static(b"light")).await.unwrap();
        assert_eq!(objects.put_file(Bytes::from_static(b"light")).await.unwrap(), hash);
        assert_eq!(objects.file(&hash).await.unwrap(), "light");
        objects.put(&file_path(&hash), Bytes::from_static(b"lighf")).await.unwrap();
        assert!(matches!(objects.file(&hash).await, Err(ClusterError::WrongHash)));
        // One that is cut short is written anew.
        objects.put(&file_path(&hash), Bytes::from_static(b"li")).await.unwrap();
        objects.put_file(Bytes::from_static(b"light")).await.unwrap();
        assert_eq!(objects.file(&hash).await.unwrap(), "light");
        objects.remove(&file_path(&hash)).await.unwrap();
        objects.remove(&file_path(&hash)).await.unwrap();
        assert!(matches!(objects.file(&hash).await, Err(ClusterError::Objects(_))));
    }

    #[tokio::test]
    async fn folders_are_listed_and_removed() {
        let folder = tempfile::tempdir().unwrap();
        let objects = Objects::open(&format!("file://{}/deep", folder.path().display())).unwrap();
        for path in ["parts/a/0", "parts/a/1", "parts/b/0"] {
            objects.put(path, Bytes::from_static(b"x")).await.unwrap();
        }
        let mut names = objects.names("parts").await.unwrap();
        names.sort();
        assert_eq!(names, ["a", "b"]);
        objects.remove_all("parts/a").await.unwrap();
        assert_eq!(objects.names("parts/a").await.unwrap(), Vec::<String>::new());
        assert_eq!(objects.get("parts/b/0").await.unwrap(), "x");
    }

    #[test]
    fn addresses_that_lead_nowhere_are_told() {
        for address in ["ftp://a/b", "s3x://a"] {
            let told = Objects::open(address).unwrap_err().to_string();
            assert!(told.contains(address), "{told}");
        }
    }
}
