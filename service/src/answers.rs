//! Room for large answers on their way. What a client asked for and does not take in is held for it: there is room for
//! so many bytes, and an answer of which nothing was taken for a while gives way to the next.

use std::collections::BTreeMap;
use std::io;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::body::Body;
use bytes::Bytes;
use hyper::body::{Body as HttpBody, Frame, SizeHint};
use tokio::sync::Notify;
use tokio::time::{Instant, timeout_at};

/// Bytes that are handed on at a time.
const PIECE: usize = 64 << 10;

/// All large answers that are made or sent.
#[derive(Debug)]
pub(crate) struct Answers {
    limit: u64,
    /// An answer may lie so long before it has to give way.
    stall: Duration,
    /// A request waits so long for room.
    wait: Duration,
    ledger: Mutex<Ledger>,
    freed: Notify,
}

#[derive(Debug, Default)]
struct Ledger {
    /// Bytes of all answers, made or promised.
    taken: u64,
    count: u64,
    sent: BTreeMap<u64, Sent>,
}

/// An answer that is being sent.
#[derive(Debug)]
struct Sent {
    bytes: u64,
    rest: Bytes,
    moved: Instant,
}

/// Room for one answer, until it is sent or dropped.
#[derive(Debug)]
pub(crate) struct Room {
    answers: Arc<Answers>,
    bytes: u64,
}

impl Answers {
    pub(crate) fn new(limit: u64, stall: Duration, wait: Duration) -> Arc<Answers> {
        Arc::new(Answers { limit, stall, wait, ledger: Mutex::default(), freed: Notify::new() })
    }

    /// Room for an answer of about so many bytes; none where others keep it for too long. One that is larger than all
    /// room there is waits until it is the only one.
    pub(crate) async fn room(self: &Arc<Answers>, bytes: u64) -> Option<Room> {
        let end = Instant::now() + self.wait;
        loop {
            let freed = self.freed.notified();
            let next = match self.try_room(bytes) {
                Ok(room) => return Some(room),
                Err(_) if Instant::now() >= end => return None,
                Err(next) => next,
            };
            // Whether something is free, or has to give way, is looked at anew either way.
            let _ = timeout_at(next.min(end), freed).await;
        }
    }

    /// Room, or when the next answer has to give way.
    fn try_room(self: &Arc<Answers>, bytes: u64) -> Result<Room, Instant> {
        let mut ledger = self.lock();
        while ledger.taken > 0 && ledger.taken.saturating_add(bytes) > self.limit {
            let oldest = ledger.sent.iter().min_by_key(|(_, sent)| sent.moved);
            let Some((number, moved)) = oldest.map(|(number, sent)| (*number, sent.moved)) else {
                return Err(Instant::now() + self.stall);
            };
            if moved + self.stall > Instant::now() {
                return Err(moved + self.stall);
            }
            tracing::info!("an answer that nobody takes in gives way");
            ledger.remove(number);
        }
        ledger.taken += bytes;
        Ok(Room { answers: self.clone(), bytes })
    }

    fn lock(&self) -> MutexGuard<'_, Ledger> {
        self.ledger.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Ledger {
    fn remove(&mut self, number: u64) {
        self.taken -= self.sent.remove(&number).map_or(0, |sent| sent.bytes);
    }
}

impl Room {
    /// Sends `answer`, and keeps as much room as it takes. `with` is let go once it is sent.
    pub(crate) fn send<T: Send + Unpin + 'static>(mut self, answer: Bytes, with: T) -> Body {
        let bytes = answer.len() as u64;
        let answers = self.answers.clone();
        let mut ledger = answers.lock();
        ledger.taken = ledger.taken - std::mem::take(&mut self.bytes) + bytes;
        ledger.count += 1;
        let number = ledger.count;
        ledger.sent.insert(number, Sent { bytes, rest: answer, moved: Instant::now() });
        drop(ledger);
        answers.freed.notify_waiters();
        Body::new(Sending { answers, number, left: bytes, _with: with })
    }
}

impl Drop for Room {
    fn drop(&mut self) {
        if self.bytes > 0 {
            self.answers.lock().taken -= self.bytes;
            self.answers.freed.notify_waiters();
        }
    }
}

/// The body of an answer.
struct Sending<T> {
    answers: Arc<Answers>,
    number: u64,
    left: u64,
    _with: T,
}

impl<T: Unpin> HttpBody for Sending<T> {
    type Data = Bytes;
    type Error = io::Error;

    fn poll_frame(mut self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<Option<io::Result<Frame<Bytes>>>> {
        if self.left == 0 {
            return Poll::Ready(None);
        }
        let piece = match self.answers.lock().sent.get_mut(&self.number) {
            Some(sent) => {
                sent.moved = Instant::now();
                sent.rest.split_to(sent.rest.len().min(PIECE))
            }
            None => return Poll::Ready(Some(Err(io::Error::other("it gave way to another answer")))),
        };
        self.left -= piece.len() as u64;
        Poll::Ready(Some(Ok(Frame::data(piece))))
    }

    fn is_end_stream(&self) -> bool {
        self.left == 0
    }

    fn size_hint(&self) -> SizeHint {
        SizeHint::with_exact(self.left)
    }
}

impl<T> Drop for Sending<T> {
    fn drop(&mut self) {
        self.answers.lock().remove(self.number);
        self.answers.freed.notify_waiters();
    }
}

#[cfg(test)]
mod tests {
    use http_body_util::BodyExt;

    use super::*;

    const MINUTE: Duration = Duration::from_secs(60);

    #[tokio::test]
    async fn answers_take_the_room_that_they_need() {
        let answers = Answers::new(100, MINUTE, Duration::ZERO);
        let first = answers.room(80).await.unwrap();
        assert!(answers.room(30).await.is_none());
        let body = first.send(vec![7; 40].into(), ());
        let second = answers.room(60).await.unwrap();
        assert!(answers.room(1).await.is_none());
        assert_eq!(body.collect().await.unwrap().to_bytes(), vec![7; 40]);
        drop((answers.room(40).await.unwrap(), second));
        // More than all there is, by itself.
        drop(answers.room(1000).await.unwrap());
        assert!(answers.lock().taken == 0 && answers.lock().sent.is_empty());
    }

    #[tokio::test]
    async fn what_nobody_takes_in_gives_way_and_what_moves_does_not() {
        let answers = Answers::new(4 * PIECE as u64, Duration::ZERO, Duration::ZERO);
        let long = vec![1; 2 * PIECE + 1];
        let size = long.len() as u64;
        let mut stalled = answers.room(size).await.unwrap().send(long.clone().into(), ());
        assert_eq!(stalled.frame().await.unwrap().unwrap().into_data().unwrap().len(), PIECE);
        let taken = answers.room(size).await.unwrap().send(long.clone().into(), ());
        assert!(stalled.frame().await.unwrap().is_err(), "it is as if the connection had ended");
        assert_eq!(taken.collect().await.unwrap().to_bytes(), long);

        let patient = Answers::new(size, MINUTE, Duration::ZERO);
        let slow = patient.room(size).await.unwrap().send(long.clone().into(), ());
        assert!(patient.room(1).await.is_none(), "it has a minute");
        assert_eq!(slow.collect().await.unwrap().to_bytes(), long);
    }

    #[tokio::test]
    async fn who_waits_for_room_gets_it_as_soon_as_there_is_some() {
        let answers = Answers::new(10, MINUTE, MINUTE);
        let first = answers.room(10).await.unwrap();
        let waiting = tokio::spawn({
            let answers = answers.clone();
            async move { answers.room(10).await.is_some() }
        });
        tokio::task::yield_now().await;
        drop(first);
        assert!(waiting.await.unwrap());
    }
}
