//! The running service: connections in, and an orderly end.

use std::io;
use std::sync::Arc;
use std::time::Duration;

use hyper::Request;
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto::Builder;
use hyper_util::server::graceful::{GracefulShutdown, Watcher};
use hyper_util::service::TowerToHyperService;
use tokio::io::AsyncReadExt;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::oneshot;
use tokio_io_timeout::TimeoutStream;

use crate::api::{self, Turns};
use crate::config::Config;
use crate::connections::{Connections, Seat, first_bytes};
use crate::restore;
use crate::state::{App, Phase};

/// Requests of one HTTP/2 connection at the same time.
const HTTP2_STREAMS: u32 = 64;
/// Bytes that wait for one HTTP/2 stream's window.
const HTTP2_SEND_BYTES: usize = 256 << 10;

/// Serves on `listener` until `shutdown` is ready. Then: takes nothing new, cancels jobs (their last published version
/// stays consistent), lets every stream send what is left, and returns within the time of `config`.
///
/// # Errors
/// Where the compute threads cannot be started or the data directory cannot be used.
pub async fn run(listener: TcpListener, mut config: Config, shutdown: impl Future<Output = ()>) -> io::Result<()> {
    config.host_names.push(listener.local_addr()?.ip().to_string());
    let app = tokio::task::spawn_blocking(move || App::new(config)).await.map_err(io::Error::other)?;
    let (app, saved) = app.map_err(io::Error::other)?;
    if let Some((disk, saved)) = saved {
        // Scenes of an earlier life are built while health is answered.
        let its_app = app.clone();
        app.compute.spawn(move || restore::restore(&its_app, &disk, saved));
    }
    serve(listener, &app, shutdown).await;
    Ok(())
}

/// Serves what there is on `listener` until `shutdown` is ready, and ends as [`run`] does.
pub(crate) async fn serve(listener: TcpListener, app: &Arc<App>, shutdown: impl Future<Output = ()>) {
    let router = api::router(app.clone());
    let connections = Connections::new(app.config.limits.connections);
    let graceful = GracefulShutdown::new();
    let address = listener.local_addr().map_or_else(|_| "unknown".to_owned(), |address| address.to_string());
    tracing::info!(address, "listening");
    let mut shutdown = std::pin::pin!(shutdown);
    loop {
        let accepted = tokio::select! {
            accepted = accept(&listener, &connections) => accepted,
            () = &mut shutdown => break,
        };
        let Some((stream, place, gives_way)) = accepted else { continue };
        let (app, router, watcher) = (app.clone(), router.clone(), graceful.watcher());
        tokio::spawn(async move {
            tokio::select! {
                () = connection(app, router, stream, place, watcher) => {}
                Ok(()) = gives_way => tracing::debug!("a silent connection gives way"),
            }
        });
    }
    drop(listener);
    close(app, graceful).await;
}

/// Serves on `listener` while `work` goes on, then ends as [`run`] does: what `work` came to.
///
/// # Errors
/// Those of [`run`].
pub async fn run_while<T>(listener: TcpListener, config: Config, work: impl Future<Output = T>) -> io::Result<T> {
    let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
    let service = tokio::spawn(run(listener, config, async {
        // A dropped sender means the same.
        let _ = stopped.await;
    }));
    let done = work.await;
    drop(stop);
    service.await.map_err(io::Error::other)??;
    Ok(done)
}

/// The next connection, when there is room for it.
async fn accept(
    listener: &TcpListener,
    connections: &Arc<Connections>,
) -> Option<(TcpStream, Arc<Seat>, oneshot::Receiver<()>)> {
    match listener.accept().await {
        Ok((stream, _)) => {
            // One at a time waits for room; what comes behind it stays in the kernel's backlog.
            let (place, gives_way) = connections.enter().await?;
            Some((stream, place, gives_way))
        }
        Err(error) => {
            // Out of file descriptors, most likely: trying again at once would only burn time.
            tracing::warn!(%error, "accept");
            tokio::time::sleep(Duration::from_millis(200)).await;
            None
        }
    }
}

async fn connection(app: Arc<App>, router: axum::Router, mut stream: TcpStream, place: Arc<Seat>, watcher: Watcher) {
    // Frames and events are small and wanted at once.
    if let Err(error) = stream.set_nodelay(true) {
        tracing::debug!(%error, "TCP_NODELAY");
    }
    let first = match first_bytes(&mut stream, app.config.timeouts.header).await {
        Ok(first) => first,
        Err(error) => return tracing::debug!(%error, "first bytes"),
    };
    let mut builder = Builder::new(TokioExecutor::new());
    builder.http1().timer(TokioTimer::new()).header_read_timeout(app.config.timeouts.header);
    builder.http2().timer(TokioTimer::new()).keep_alive_interval(app.config.timeouts.keep_alive);
    builder.http2().max_concurrent_streams(HTTP2_STREAMS).max_send_buf_size(HTTP2_SEND_BYTES);
    // A client that takes nothing in for so long holds a connection and what is queued for it: it may come back.
    let mut stream = TimeoutStream::new(stream);
    stream.set_write_timeout(Some(app.config.timeouts.write));
    let (read, write) = tokio::io::split(Box::pin(stream));
    let io = TokioIo::new(tokio::io::join(std::io::Cursor::new(first).chain(read), write));
    let router = TowerToHyperService::new(router);
    let turns = Turns::new();
    let service = service_fn(move |mut request: Request<_>| {
        place.has_asked();
        request.extensions_mut().insert(turns.clone());
        router.call(request)
    });
    let served = builder.serve_connection(io, service).into_owned();
    if let Err(error) = watcher.watch(served).await {
        tracing::debug!(error = %error, "connection");
    }
}

async fn close(app: &Arc<App>, graceful: GracefulShutdown) {
    let limit = app.config.timeouts.shutdown;
    tracing::info!(connections = graceful.count(), seconds = limit.as_secs_f32(), "closing");
    app.phase.send_replace(Phase::Draining);
    app.jobs.close();
    let end_streams = async {
        let mut running = app.jobs.watch_running();
        // Streams end with whatever is published by then.
        let idle = tokio::time::timeout(limit.mul_f32(0.8), running.wait_for(|running| *running == 0)).await;
        if idle.is_err() {
            tracing::warn!("jobs did not stop in time");
        }
        app.phase.send_replace(Phase::Closing);
    };
    let both = async { tokio::join!(graceful.shutdown(), end_streams) };
    match tokio::time::timeout(limit, both).await {
        Ok(_) => tracing::info!("closed"),
        Err(_elapsed) => tracing::warn!("some connections did not end in time"),
    }
    let its_app = app.clone();
    if tokio::task::spawn_blocking(move || its_app.saving.save_all(&its_app.scenes)).await.is_err() {
        tracing::error!("the light could not be saved");
    }
}
