//! A client's copy of a light map that follows the service's, across lost connections.

use std::time::{Duration, Instant};

use glam::Vec3;
use rebake_core::delta::{Decoder, DeltaError, Frame, MAX_ELEMENTS};
use reqwest::Response;

use super::{Client, ClientError};

/// How patiently to reconnect.
#[derive(Clone, Copy, Debug)]
pub struct Retry {
    /// Give up after so many failures in a row; `None`: never.
    pub max_attempts: Option<u32>,
    /// Wait before the first new attempt; doubles with every failure.
    pub first_wait: Duration,
    /// Longest wait between attempts.
    pub longest_wait: Duration,
}

impl Default for Retry {
    fn default() -> Retry {
        Retry { max_attempts: Some(10), first_wait: Duration::from_millis(100), longest_wait: Duration::from_secs(10) }
    }
}

/// What one snapshot brought.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arrival {
    /// Version before.
    pub from: u64,
    /// Version now.
    pub version: u64,
    /// Elements that got a new value.
    pub changed: usize,
    /// Bytes of its frames.
    pub bytes: usize,
    /// The whole map was replaced.
    pub replaced: bool,
}

/// Map and version, kept up to date by deltas.
///
/// Snapshots are applied whole or not at all: whenever the connection breaks, the map is at [`DeltaFollower::version`]
/// bit for bit, and the next connection goes on from there.
#[derive(Debug)]
pub struct DeltaFollower {
    client: Client,
    scene: String,
    map: Vec<Vec3>,
    version: u64,
    retry: Retry,
    failures: u32,
    connection: Option<Connection>,
}

/// One connection: what has arrived of the next snapshot.
#[derive(Debug)]
struct Connection {
    since: Instant,
    response: Response,
    decoder: Decoder,
    frames: Vec<Frame>,
    values: usize,
    bytes: usize,
}

impl DeltaFollower {
    /// Starts from nothing, at version 0.
    pub fn new(client: Client, scene: &str) -> DeltaFollower {
        DeltaFollower::resume(client, scene, Vec::new(), 0)
    }

    /// Goes on from a map that an earlier follower left.
    pub fn resume(client: Client, scene: &str, map: Vec<Vec3>, version: u64) -> DeltaFollower {
        let scene = scene.to_owned();
        DeltaFollower { client, scene, map, version, retry: Retry::default(), failures: 0, connection: None }
    }

    /// How patiently to reconnect.
    #[must_use]
    pub fn with_retry(mut self, retry: Retry) -> DeltaFollower {
        self.retry = retry;
        self
    }

    /// The light map at [`DeltaFollower::version`].
    pub fn map(&self) -> &[Vec3] {
        &self.map
    }

    /// The version the map is at.
    pub fn version(&self) -> u64 {
        self.version
    }

    /// The map and its version, to resume later.
    pub fn into_map(self) -> (Vec<Vec3>, u64) {
        (self.map, self.version)
    }

    /// Waits for the next snapshot and applies it. Reconnects where the connection is lost. May be dropped at any
    /// time without losing anything.
    pub async fn next(&mut self) -> Result<Arrival, ClientError> {
        loop {
            let failure = match self.advance(true).await {
                Ok(Some(update)) => {
                    self.failures = 0;
                    return Ok(update);
                }
                Ok(None) => ClientError::Ended,
                Err(error) => error,
            };
            // A connection that lasted was not a failure: idle ones are cut by proxies now and then.
            if self.connection.take().is_some_and(|lost| lost.since.elapsed() > self.retry.longest_wait) {
                self.failures = 0;
            }
            // Damaged bytes and gaps are worth a fresh start too: the version is still good.
            if !failure.is_transient() && !matches!(failure, ClientError::Delta(_)) {
                return Err(failure);
            }
            if self.retry.max_attempts.is_some_and(|max| self.failures >= max) {
                return Err(ClientError::Lost { attempts: self.failures, last: Box::new(failure) });
            }
            let wait = self.retry.first_wait.saturating_mul(1 << self.failures.min(16));
            self.failures += 1;
            tokio::time::sleep(wait.min(self.retry.longest_wait)).await;
        }
    }

    /// Follows until the map is at `version` or newer.
    pub async fn reach(&mut self, version: u64) -> Result<(), ClientError> {
        while self.version < version {
            self.next().await?;
        }
        Ok(())
    }

    /// Brings the map to the service's present version and returns. Does not reconnect.
    pub async fn catch_up(&mut self) -> Result<(), ClientError> {
        self.connection = None;
        let result = loop {
            match self.advance(false).await {
                Ok(Some(_)) => {}
                Ok(None) => break Ok(()),
                Err(error) => break Err(error),
            }
        };
        self.connection = None;
        result
    }

    /// Reads on until a snapshot is complete and applies it; `None` at the end of the stream.
    async fn advance(&mut self, follow: bool) -> Result<Option<Arrival>, ClientError> {
        let connection = match &mut self.connection {
            Some(connection) => connection,
            None => {
                let response = self.client.deltas(&self.scene, self.version, follow).await?;
                self.connection.insert(Connection::new(response))
            }
        };
        loop {
            while let Some((frame, bytes)) = connection.decoder.next_frame()? {
                if let Some(snapshot) = connection.take(frame, bytes)?
                    && let Some(update) = apply(&snapshot, &mut self.map, &mut self.version)?
                {
                    return Ok(Some(update));
                }
            }
            match connection.response.chunk().await.map_err(ClientError::Http)? {
                Some(chunk) => connection.decoder.push(&chunk),
                None if connection.decoder.pending_bytes() > 0 || !connection.frames.is_empty() => {
                    return Err(ClientError::Ended);
                }
                None => return Ok(None),
            }
        }
    }
}

/// All frames of one snapshot and their size.
struct Snapshot {
    frames: Vec<Frame>,
    bytes: usize,
}

impl Connection {
    fn new(response: Response) -> Connection {
        Connection { since: Instant::now(), response, decoder: Decoder::new(), frames: Vec::new(), values: 0, bytes: 0 }
    }

    /// Collects frames until the last one of a snapshot.
    fn take(&mut self, frame: Frame, bytes: usize) -> Result<Option<Snapshot>, DeltaError> {
        self.values += frame.values.len();
        self.bytes += bytes;
        if self.values > MAX_ELEMENTS {
            return Err(DeltaError::TooLong { end: self.values as u64, limit: MAX_ELEMENTS });
        }
        let last = frame.flags.last;
        self.frames.push(frame);
        if !last {
            return Ok(None);
        }
        self.values = 0;
        let frames = std::mem::take(&mut self.frames);
        Ok(Some(Snapshot { frames, bytes: std::mem::take(&mut self.bytes) }))
    }
}

/// Applies a snapshot; `None` where the map is at its version already.
fn apply(snapshot: &Snapshot, map: &mut Vec<Vec3>, version: &mut u64) -> Result<Option<Arrival>, DeltaError> {
    let replaced = snapshot.frames.first().is_some_and(|frame| frame.flags.replace_all);
    let new = snapshot.frames.last().map_or(0, |frame| frame.new);
    for frame in &snapshot.frames {
        // A frame from an older version than ours holds newer values for all that changed since: it applies.
        if !replaced && frame.base > *version {
            return Err(DeltaError::Gap { version: *version, base: frame.base });
        }
        frame.validate()?;
    }
    if new <= *version {
        return Ok(None);
    }
    for frame in &snapshot.frames {
        frame.apply(map)?;
    }
    let update = Arrival {
        from: *version,
        version: new,
        changed: snapshot.frames.iter().map(|frame| frame.values.len()).sum(),
        bytes: snapshot.bytes,
        replaced,
    };
    *version = new;
    Ok(Some(update))
}
