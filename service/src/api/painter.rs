//! Draws pictures of one version for one request, one after the other, for as long as the client waits.

use std::collections::VecDeque;
use std::io;
use std::sync::Arc;

use axum::body::{Body, Bytes};
use futures_util::stream;

use super::problem::{ApiResult, Kind, Problem};
use crate::pictures::{CancelOnDrop, DrawError, Drawn, PictureFormat, PictureSpec, Watch, draw};
use crate::state::App;
use crate::store::versions::Published;

/// Between the parts of a progressive picture.
pub(super) const BOUNDARY: &str = "rebake-pass";

/// Pictures of one version; the client that leaves takes them with it.
pub(super) struct Painter {
    app: Arc<App>,
    published: Arc<Published>,
    before: Option<Arc<Published>>,
    watch: Watch,
    _guard: CancelOnDrop,
}

/// `Content-Type` of a picture.
pub(super) fn content_type(format: PictureFormat) -> &'static str {
    match format {
        PictureFormat::Png => "image/png",
        PictureFormat::Exr => "image/x-exr",
    }
}

impl Painter {
    pub(super) fn new(app: Arc<App>, published: Arc<Published>, before: Option<Arc<Published>>) -> Painter {
        let watch = Watch::default();
        let guard = watch.guard();
        Painter { app, published, before, watch, _guard: guard }
    }

    /// What is drawn.
    pub(super) fn version(&self) -> u64 {
        self.published.version
    }

    pub(super) async fn draw(&self, spec: PictureSpec) -> ApiResult<Drawn> {
        let (published, before) = (self.published.clone(), self.before.clone());
        // Every pass waits for its own turn: who takes the first one in slowly keeps no other client waiting.
        let turn = self.app.pictures.turns.clone().acquire_owned().await.map_err(Problem::internal)?;
        let watch = self.watch.clone();
        let work = move || {
            let _turn = turn;
            let before = before.as_ref().map(|before| (&before.world, &*before.map));
            draw((&published.world, &published.map), before, &spec, &watch)
        };
        match self.app.compute.draw(work).await? {
            Ok(drawn) => Ok(drawn),
            Err(DrawError::Canceled) => Err(Problem::new(Kind::ShuttingDown, "the picture was given up")),
            Err(DrawError::Export(error)) => Err(Problem::internal(error)),
        }
    }

    /// The passes of a picture as parts of one body, drawn at the client's pace.
    pub(super) fn parts(self, spec: &PictureSpec) -> Body {
        let passes: VecDeque<PictureSpec> = spec.passes().into();
        let opening = stream::once(async { Ok(Bytes::from(format!("--{BOUNDARY}\r\n"))) });
        let parts = stream::unfold((self, passes), |(painter, mut passes)| async {
            let pass = passes.pop_front()?;
            let end = if passes.is_empty() { "--" } else { "" };
            // Too late for a problem document: the body ends early, which is an error to whoever reads it.
            let part = painter
                .draw(pass)
                .await
                .map(|drawn| part(&pass, &drawn, end))
                .map_err(|problem| io::Error::other(problem.to_string()));
            Some((part, (painter, passes)))
        });
        Body::from_stream(stream::StreamExt::chain(opening, parts))
    }
}

/// One part and the boundary behind it: browsers show a part when they see that.
fn part(pass: &PictureSpec, drawn: &Drawn, end: &str) -> Bytes {
    let mut head = format!(
        "Content-Type: {}\r\nContent-Length: {}\r\nX-Rebake-Samples: {}\r\n",
        content_type(pass.format),
        drawn.bytes.len(),
        pass.options.samples
    );
    for (name, number) in [("X-Rebake-Exposure", drawn.exposure), ("X-Rebake-Scale", drawn.scale)] {
        if let Some(number) = number {
            head.push_str(&format!("{name}: {number}\r\n"));
        }
    }
    [head.as_bytes(), b"\r\n", &drawn.bytes, format!("\r\n--{BOUNDARY}{end}\r\n").as_bytes()].concat().into()
}
