//! Versions as clients want them: as they are, or filtered.

use std::sync::Arc;

use super::problem::{ApiResult, Kind, Problem};
use super::uploads::memory_problem;
use crate::engine::FILTER_BYTES;
use crate::filter::Filter;
use crate::pictures::Watch;
use crate::state::App;
use crate::store::filtered::FilteredLight;
use crate::store::versions::Published;

/// A version as a client wants it.
pub(super) async fn view(
    app: &Arc<App>,
    filtered: &Arc<FilteredLight>,
    published: Arc<Published>,
    filter: Filter,
) -> ApiResult<Arc<Published>> {
    let known = match filter {
        Filter::None => return Ok(published),
        Filter::Statistical => || filtered.known(published.version),
    };
    if let Some(known) = known() {
        return Ok(known);
    }
    let _turn = filtered.turn.lock().await;
    if let Some(known) = known() {
        return Ok(known);
    }
    let watch = Watch::default();
    let _guard = watch.guard();
    let (its_app, filtered) = (Arc::clone(app), Arc::clone(filtered));
    let work = move || {
        let bytes = (published.memory_bytes() + published.map.len() * FILTER_BYTES) as u64;
        let _promise = its_app.memory.promise(bytes, 0).map_err(|full| memory_problem("filter", full))?;
        let given_up = |_| Problem::new(Kind::ShuttingDown, "the filter was given up");
        filtered.of(&published, &watch).map_err(given_up)
    };
    app.compute.draw(work).await?
}
