//! Room for connections. One that has not asked for anything yet gives way to the next: however many of them there are,
//! whoever asks is let in.

use std::collections::BTreeMap;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncReadExt};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};

/// What a client of HTTP/2 sends first.
const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";

/// All open connections.
#[derive(Debug)]
pub(crate) struct Connections {
    room: Arc<Semaphore>,
    silent: Mutex<Silent>,
}

/// Those without a request so far, by age.
#[derive(Debug, Default)]
struct Silent {
    count: u64,
    by_age: BTreeMap<u64, oneshot::Sender<()>>,
}

/// The place of one connection; free again when it is dropped.
#[derive(Debug)]
pub(crate) struct Seat {
    connections: Arc<Connections>,
    number: u64,
    _permit: OwnedSemaphorePermit,
}

impl Connections {
    pub(crate) fn new(limit: usize) -> Arc<Connections> {
        Arc::new(Connections { room: Arc::new(Semaphore::new(limit)), silent: Mutex::default() })
    }

    /// A place for one more connection, the oldest silent one's where there is no other. The receiver gets a word
    /// when the connection has to give way, and an error when it never has to.
    pub(crate) async fn enter(self: &Arc<Connections>) -> Option<(Arc<Seat>, oneshot::Receiver<()>)> {
        let permit = match self.room.clone().try_acquire_owned() {
            Ok(permit) => permit,
            Err(_) => {
                if let Some((_, oldest)) = self.silent().by_age.pop_first() {
                    // One that has just ended has made room too.
                    let _ = oldest.send(());
                }
                self.room.clone().acquire_owned().await.ok()?
            }
        };
        let (send, receive) = oneshot::channel();
        let mut silent = self.silent();
        silent.count += 1;
        let number = silent.count;
        silent.by_age.insert(number, send);
        drop(silent);
        Some((Arc::new(Seat { connections: self.clone(), number, _permit: permit }), receive))
    }

    fn silent(&self) -> MutexGuard<'_, Silent> {
        self.silent.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Seat {
    /// The connection has asked for something: it stays.
    pub(crate) fn has_asked(&self) {
        // Whoever waits for the receiver sees that the sender is gone without a word.
        self.connections.silent().by_age.remove(&self.number);
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.connections.silent().by_age.remove(&self.number);
    }
}

/// Reads until it is clear whether the client speaks HTTP/1 or HTTP/2: what has been read. hyper waits without end for
/// that.
pub(crate) async fn first_bytes(stream: &mut (impl AsyncRead + Unpin), limit: Duration) -> io::Result<Vec<u8>> {
    let read = async {
        let mut bytes = Vec::with_capacity(PREFACE.len());
        while bytes.len() < PREFACE.len() && PREFACE.starts_with(&bytes) {
            let mut piece = [0; PREFACE.len()];
            let room = PREFACE.len() - bytes.len();
            let count = stream.read(&mut piece[..room]).await?;
            if count == 0 {
                break;
            }
            bytes.extend_from_slice(&piece[..count]);
        }
        Ok(bytes)
    };
    tokio::time::timeout(limit, read).await.unwrap_or_else(|_| Err(io::ErrorKind::TimedOut.into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn the_oldest_silent_connection_gives_way() {
        let connections = Connections::new(2);
        let (asking, _stays) = connections.enter().await.unwrap();
        asking.has_asked();
        let (silent, mut goes) = connections.enter().await.unwrap();
        assert!(goes.try_recv().is_err());
        let next = tokio::spawn({
            let connections = connections.clone();
            async move { connections.enter().await.unwrap() }
        });
        goes.await.unwrap();
        drop(silent);
        let (place, _) = next.await.unwrap();
        assert!(place.number == 3 && connections.room.available_permits() == 0);
        drop((asking, place));
        assert_eq!(connections.room.available_permits(), 2);
        assert!(connections.silent().by_age.is_empty());
    }

    #[tokio::test]
    async fn the_protocol_is_told_by_the_first_bytes_and_in_time() {
        let read = async |text: &[u8]| first_bytes(&mut &*text, Duration::from_secs(60)).await.unwrap();
        assert_eq!(read(b"PUT / HTTP/1.1\r\n\r\nand a body behind").await, b"PUT / HTTP/1.1\r\n\r\nand a ");
        assert_eq!(read(&[PREFACE, b"more"].concat()).await, PREFACE);
        assert_eq!(read(b"PRI").await, b"PRI");
        let (mut near, _far) = tokio::io::duplex(8);
        let late = first_bytes(&mut near, Duration::from_millis(1)).await.unwrap_err();
        assert_eq!(late.kind(), io::ErrorKind::TimedOut);
    }
}
