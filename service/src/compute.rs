//! Threads that compute. Async threads only wait for them.
//!
//! Every job slot has a rayon pool of its own, beside one for building worlds (uploads, fresh trees), one for pictures
//! and one for short tasks (applying edits, encoding answers). In one shared pool a worker that waits for its part of
//! one bake picks up the next task of the injector, which may be the whole of another bake, and sits on the first one
//! until that is over: time budgets and cancels would depend on strangers. Between pools the operating system shares
//! the cores fairly.
//!
//! For the same reason no task of a pool waits for a lock that another holds while it computes, such as a scene's head: it may
//! have been picked up by the very thread that holds it. Who wants one takes it before, as edits do, or runs apart.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};
use tokio::sync::oneshot;

/// A task panicked; the text is for the log and for `error` fields.
#[derive(Clone, Debug, thiserror::Error)]
#[error("internal error: {0}")]
pub(crate) struct Panicked(pub(crate) String);

/// The pools that are not a job's.
#[derive(Clone, Debug)]
pub(crate) struct Compute {
    short: Arc<ThreadPool>,
    builds: Arc<ThreadPool>,
    pictures: Arc<ThreadPool>,
}

impl Compute {
    pub(crate) fn new(threads: usize) -> Result<Compute, ThreadPoolBuildError> {
        Ok(Compute {
            short: Arc::new(build_pool("short", threads)?),
            builds: Arc::new(build_pool("build", threads)?),
            pictures: Arc::new(build_pool("picture", threads)?),
        })
    }

    /// Runs a task of milliseconds and waits for it without blocking the async thread. A caller that goes away leaves
    /// the task to its end.
    pub(crate) async fn run<T, F>(&self, task: F) -> Result<T, Panicked>
    where
        T: Send + 'static,
        F: FnOnce() -> T + Send + 'static,
    {
        run_on(&self.short, false, task).await
    }

    /// Runs a task of milliseconds that only its caller wants, and waits for it without blocking the async thread: one
    /// that has gone away by the time its turn comes gets nothing done.
    pub(crate) async fn answer<T, F>(&self, task: F) -> Result<T, Panicked>
    where
        T: Send + 'static,
        F: FnOnce() -> T + Send + 'static,
    {
        run_on(&self.short, true, task).await
    }

    /// Runs a task that may take seconds and waits for it without blocking the async thread. A caller that goes away
    /// leaves the task to its end.
    pub(crate) async fn build<T, F>(&self, task: F) -> Result<T, Panicked>
    where
        T: Send + 'static,
        F: FnOnce() -> T + Send + 'static,
    {
        run_on(&self.builds, false, task).await
    }

    /// Draws a picture that only its caller wants: that takes seconds too, and waits for no upload. A caller that has
    /// gone away by the time its turn comes gets nothing done.
    pub(crate) async fn draw<T, F>(&self, task: F) -> Result<T, Panicked>
    where
        T: Send + 'static,
        F: FnOnce() -> T + Send + 'static,
    {
        run_on(&self.pictures, true, task).await
    }

    /// Runs a task that waits for locks which others hold while they compute, or holds some while it computes; nobody waits
    /// for it. On a thread of its own: one of a pool that waits for its part of a computation takes up the next task, and
    /// would wait for itself where that wants the same lock.
    pub(crate) fn spawn_apart(&self, task: impl FnOnce() + Send + 'static) {
        let task = move || {
            // What it computes it computes itself: outside of all pools rayon has one of its own, of all cores.
            let alone = ThreadPoolBuilder::new().num_threads(1).use_current_thread().build();
            if let Err(error) = &alone {
                tracing::error!(%error, "a background task computes on all cores");
            }
            logged(task);
        };
        if let Err(error) = std::thread::Builder::new().name("rebake-apart".to_owned()).spawn(task) {
            tracing::error!(%error, "no thread for a background task");
        }
    }

    /// Runs a task that may take seconds on the threads that build, and waits for it: from a task that runs apart.
    pub(crate) fn build_here<T: Send>(&self, task: impl FnOnce() -> T + Send) -> T {
        self.builds.install(task)
    }

    /// Runs a task that may take seconds; nobody waits for it.
    pub(crate) fn spawn(&self, task: impl FnOnce() + Send + 'static) {
        self.builds.spawn(move || logged(task));
    }
}

/// Runs a task that nobody waits for.
fn logged(task: impl FnOnce()) {
    if let Err(panic) = catching(task) {
        tracing::error!(%panic, "background task");
    }
}

/// `for_caller`: nobody else wants it done.
async fn run_on<T, F>(pool: &ThreadPool, for_caller: bool, task: F) -> Result<T, Panicked>
where
    T: Send + 'static,
    F: FnOnce() -> T + Send + 'static,
{
    let (send, receive) = oneshot::channel();
    let span = tracing::Span::current();
    pool.spawn(move || {
        let _in_span = span.entered();
        if for_caller && send.is_closed() {
            return tracing::debug!("the client has gone: its answer is not made");
        }
        // The receiver may have gone away with its connection: nobody waits for the result then.
        let _ = send.send(catching(task));
    });
    receive.await.unwrap_or_else(|_| Err(Panicked("the task was dropped".to_owned())))
}

/// A pool whose threads are named `rebake-<name>-<n>`.
pub(crate) fn build_pool(name: &str, threads: usize) -> Result<ThreadPool, ThreadPoolBuildError> {
    let name = name.to_owned();
    ThreadPoolBuilder::new().num_threads(threads).thread_name(move |n| format!("rebake-{name}-{n}")).build()
}

/// Runs `task`; a panic becomes an error.
pub(crate) fn catching<T>(task: impl FnOnce() -> T) -> Result<T, Panicked> {
    catch_unwind(AssertUnwindSafe(task)).map_err(|payload| Panicked(panic_text(&*payload)))
}

fn panic_text(payload: &(dyn Any + Send)) -> String {
    payload
        .downcast_ref::<&str>()
        .map(|text| (*text).to_owned())
        .or_else(|| payload.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "a panic without a text".to_owned())
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::sync::mpsc;

    use super::*;

    #[tokio::test]
    async fn what_nobody_waits_for_any_more_is_not_begun() {
        let compute = Compute::new(1).unwrap();
        let (go, wait) = mpsc::channel::<()>();
        let held = tokio::spawn({
            let compute = compute.clone();
            async move { compute.run(move || wait.recv().is_ok()).await.unwrap() }
        });
        let done = Arc::new(AtomicUsize::new(0));
        let add = |by| {
            let done = done.clone();
            move || done.fetch_add(by, Ordering::SeqCst)
        };
        // Polled once, so that they stand in line, and dropped.
        let (answer, change) = (compute.answer(add(1)), compute.run(add(10)));
        let stand_in_line = async { tokio::join!(answer, change) };
        tokio::select! {
            biased;
            _ = stand_in_line => unreachable!("the thread is taken"),
            () = std::future::ready(()) => {}
        }
        go.send(()).unwrap();
        assert!(held.await.unwrap());
        compute.answer(add(100)).await.unwrap();
        assert_eq!(done.load(Ordering::SeqCst), 110);
    }
}
