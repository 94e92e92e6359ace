//! Whether what the service answers is what its description says.

use std::sync::LazyLock;

use reqwest::{Method, StatusCode};
use serde_json::Value;

/// The description, read once: `{"/v1/scenes": {"get": {"responses": {"200": …}}}}`.
static PATHS: LazyLock<Value> = LazyLock::new(|| serde_json::to_value(&rebake::api::document().paths).unwrap());

/// A path of the API answers each of its methods with statuses that the description lists; others say nothing. Of `atlas/{page}`
/// and `atlas/deltas` the one with fewer wildcards counts.
#[track_caller]
pub(crate) fn check(method: &Method, path: &str, status: StatusCode) {
    let paths = PATHS.as_object().unwrap();
    let fitting = paths.iter().filter(|(template, _)| fits(template, path));
    let Some((template, operations)) = fitting.min_by_key(|(template, _)| template.matches('{').count()) else {
        return;
    };
    let Some(operation) = operations.get(method.as_str().to_ascii_lowercase()) else { return };
    let listed = operation["responses"].as_object().unwrap();
    assert!(listed.contains_key(status.as_str()), "{method} {template} does not tell of {status}");
}

fn fits(template: &str, path: &str) -> bool {
    let (template, path) = (template.split('/'), path.split('/'));
    template.clone().count() == path.clone().count()
        && template.zip(path).all(|(part, given)| part == given || (part.starts_with('{') && !given.is_empty()))
}
