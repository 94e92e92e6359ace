//! The demo's pictures: the room before and after its edits, what changed, and how sure the service is.

use std::path::{Path, PathBuf};

use anyhow::Context;
use rebake::client::Client;

/// Width and height of all pictures but that of the error, pixels.
const SIZE: (u32, u32) = (640, 360);
/// Width and height of the picture of the error, pixels: smaller, since noise does not compress.
const ERROR_SIZE: (u32, u32) = (560, 315);
/// Enough that soft shadows show no grain.
const SAMPLES: u32 = 256;
/// Stops: fixed, so that pictures compare.
const EXPOSURE: f32 = 1.0;

/// Asks the service for pictures of one scene.
pub(super) struct Pictures {
    dir: PathBuf,
    /// Version of the first picture: what changes are shown against.
    first_version: Option<String>,
}

impl Pictures {
    pub(super) fn new(dir: &Path) -> anyhow::Result<Pictures> {
        std::fs::create_dir_all(dir).with_context(|| format!("cannot create {}", dir.display()))?;
        Ok(Pictures { dir: dir.to_owned(), first_version: None })
    }

    /// Saves the scene as it is lit now.
    pub(super) async fn light(&mut self, client: &Client, scene: &str, name: &str) -> anyhow::Result<()> {
        let look = [("exposure", EXPOSURE.to_string()), ("tone", "neutral".to_owned())];
        let version = self.draw(client, scene, name, SIZE, look).await?;
        self.first_version.get_or_insert(version);
        Ok(())
    }

    /// Saves the change since the first picture, and the stated error.
    pub(super) async fn change_and_error(&self, client: &Client, scene: &str) -> anyhow::Result<()> {
        let since = self.first_version.clone().context("there is no picture to show a change against")?;
        let change = [("view", "change".to_owned()), ("since", since)];
        self.draw(client, scene, "room-change.png", SIZE, change).await?;
        let error = [("view", "error".to_owned())];
        self.draw(client, scene, "room-error.png", ERROR_SIZE, error).await?;
        Ok(())
    }

    /// Saves one picture; answers the version of its light map.
    async fn draw(
        &self,
        client: &Client,
        scene: &str,
        name: &str,
        size: (u32, u32),
        extra: impl IntoIterator<Item = (&'static str, String)>,
    ) -> anyhow::Result<String> {
        let numbers = [("width", size.0), ("height", size.1), ("spp", SAMPLES)];
        let mut query: Vec<_> = numbers.into_iter().map(|(name, number)| (name, number.to_string())).collect();
        query.extend(extra);
        let response = client.render(scene, &query).await?;
        let version = response.headers().get("x-rebake-version").and_then(|value| value.to_str().ok());
        let version = version.context("the service does not tell the picture's version")?.to_owned();
        let png = rebake::client::read_body(response, usize::MAX).await?;
        let path = self.dir.join(name);
        std::fs::write(&path, png).with_context(|| format!("cannot write {}", path.display()))?;
        Ok(version)
    }
}
