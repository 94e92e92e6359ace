//! The API's description, made from the code.

mod shapes;
#[cfg(test)]
mod tests;

use utoipa::OpenApi;
use utoipa::openapi::content::ContentBuilder;
use utoipa::openapi::path::Operation;
use utoipa::openapi::response::ResponseBuilder;
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityRequirement, SecurityScheme};
use utoipa::openapi::{Ref, RefOr};

use super::problem::{self, Kind, ProblemDocument};
use super::{
    accuracy, assets, atlas, atlas_deltas, between, deltas, edit_types, edits, elements, events, health, history, jobs,
    lightmap, objects, probes, render, sample, scenes, types, uploads,
};

#[derive(OpenApi)]
#[openapi(
    info(
        title = "rebake",
        description = "Keeps the light maps of scenes up to date while they are edited. Errors are problem documents (RFC 9457). Lists are paged by `limit` and `cursor`. The formats of deltas are described in the documentation.",
        license(name = "MIT OR Apache-2.0", identifier = "MIT OR Apache-2.0")
    ),
    paths(
        uploads::create, scenes::list, scenes::get, scenes::patch, scenes::delete, assets::create, assets::list, assets::delete, edits::create,
        history::list,
        jobs::list, jobs::get, jobs::cancel, jobs::pause, jobs::resume, events::of_job, events::of_scene,
        objects::list, objects::get, lightmap::get, deltas::get, between::get, elements::get, atlas::get, atlas::get_page, atlas_deltas::get, atlas_deltas::get_between, render::get, sample::create, accuracy::get, probes::get, probes::create, health::alive, health::ready, health::metrics, health::problem, get
    ),
    components(schemas(ProblemDocument, types::SnapshotEvent, types::SceneEvent, types::SceneSummary, edit_types::EditRequest)),
    servers((url = "/", description = "The service that tells this")),
    tags(
        (name = "scenes", description = "Geometry, materials, lights"),
        (name = "assets", description = "What can be inserted"),
        (name = "edits", description = "Changes"),
        (name = "jobs", description = "Work on light maps"),
        (name = "light map", description = "Results"),
        (name = "service", description = "The service itself")
    )
)]
struct Described;

/// The OpenAPI document.
pub fn document() -> utoipa::openapi::OpenApi {
    let mut document = Described::openapi();
    let bearer = HttpBuilder::new().scheme(HttpAuthScheme::Bearer);
    let bearer = bearer.description(Some("Where the service was started with a token file")).build();
    let components = document.components.get_or_insert_default();
    components.add_security_scheme("bearer", SecurityScheme::Http(bearer));
    shapes::tag_unions(components);
    for item in document.paths.paths.values_mut() {
        for operation in [&mut item.get, &mut item.post, &mut item.patch, &mut item.delete].into_iter().flatten() {
            add_problems(operation);
            shapes::mark_bytes(operation);
        }
    }
    document
}

/// This document.
#[utoipa::path(get, path = "/openapi.json", tag = "service", operation_id = "openapi", responses((status = 200, body = Object, description = "OpenAPI 3.1")))]
pub(super) async fn get() -> axum::Json<utoipa::openapi::OpenApi> {
    axum::Json(document())
}

/// The problems of each operation; those of every one come on top.
fn problems_of(operation: &str) -> &'static [Kind] {
    use Kind::{
        AssetNeeded, AssetNotFound, EditTooLarge, InvalidJson, InvalidQuery, InvalidValue, JobEnded, KeyReused,
        MalformedFile, NameTaken, NoMemory, NotFound, NothingToTurn, ObjectNotFound, PayloadTooLarge,
        PreconditionFailed, QueueFull, Restoring, SceneDamaged, SceneGone, SceneTooLarge, ShuttingDown, Storage,
        Timeout, TooManyAnswers, TooManyAssets, TooManyScenes, TooManyStreams, TooManyUploads, UnknownAsset,
        UnknownCamera, UnknownJob, UnknownLight, UnknownMaterial, UnknownObject, UnknownScene, UnknownVersion,
        UnsupportedFile, UnsupportedMediaType, VersionAhead, VersionForgotten,
    };
    match operation {
        "create_scene" => &[
            InvalidQuery,
            MalformedFile,
            Timeout,
            NameTaken,
            SceneGone,
            UnknownLight,
            TooManyScenes,
            NoMemory,
            PayloadTooLarge,
            SceneTooLarge,
            UnsupportedMediaType,
            UnsupportedFile,
            QueueFull,
            TooManyUploads,
            ShuttingDown,
            Storage,
        ],
        "create_asset" => &[
            MalformedFile,
            Timeout,
            TooManyAssets,
            NoMemory,
            PayloadTooLarge,
            SceneTooLarge,
            UnsupportedMediaType,
            UnsupportedFile,
            TooManyUploads,
            ShuttingDown,
            Storage,
        ],
        "create_edit" => &[
            InvalidJson,
            UnknownScene,
            SceneDamaged,
            Timeout,
            NameTaken,
            NothingToTurn,
            NoMemory,
            PreconditionFailed,
            PayloadTooLarge,
            SceneTooLarge,
            UnsupportedMediaType,
            InvalidValue,
            UnknownObject,
            UnknownLight,
            UnknownMaterial,
            UnknownAsset,
            UnknownCamera,
            EditTooLarge,
            KeyReused,
            QueueFull,
            ShuttingDown,
            Storage,
        ],
        "list_scenes" | "list_jobs" | "list_assets" => &[InvalidQuery],
        "list_edits" => &[InvalidQuery, UnknownScene, SceneDamaged],
        "get_scene" => &[UnknownScene],
        "patch_scene" => &[
            InvalidJson,
            UnknownScene,
            SceneDamaged,
            Timeout,
            PreconditionFailed,
            PayloadTooLarge,
            UnsupportedMediaType,
            InvalidValue,
            ShuttingDown,
            Storage,
        ],
        "delete_scene" => &[UnknownScene, PreconditionFailed, Storage],
        "delete_asset" => &[AssetNotFound, AssetNeeded, ShuttingDown, Storage],
        "get_job" => &[UnknownJob],
        "cancel_job" | "pause_job" | "resume_job" => &[UnknownJob, JobEnded, Storage],
        "job_events" => &[UnknownJob, TooManyStreams],
        "scene_events" => &[UnknownScene, SceneDamaged, TooManyStreams],
        "list_objects" => &[InvalidQuery, UnknownScene, SceneDamaged],
        "get_object" => &[InvalidQuery, UnknownScene, SceneDamaged, ObjectNotFound, TooManyAnswers],
        "get_lightmap" => {
            &[InvalidQuery, UnknownScene, SceneDamaged, SceneTooLarge, TooManyAnswers, NoMemory, ShuttingDown]
        }
        "get_deltas" => &[InvalidQuery, UnknownScene, SceneDamaged, VersionAhead, TooManyStreams],
        "get_delta_between" => &[UnknownScene, SceneDamaged, UnknownVersion, VersionForgotten, TooManyAnswers],
        "get_atlas" => &[UnknownScene, SceneDamaged, SceneTooLarge],
        "get_atlas_page" => {
            &[InvalidQuery, UnknownScene, SceneDamaged, SceneTooLarge, NotFound, TooManyAnswers, NoMemory, ShuttingDown]
        }
        "get_atlas_deltas" => &[
            InvalidQuery,
            UnknownScene,
            SceneDamaged,
            SceneTooLarge,
            VersionAhead,
            TooManyStreams,
            TooManyAnswers,
            NoMemory,
            ShuttingDown,
        ],
        "get_atlas_delta_between" => &[
            InvalidQuery,
            UnknownScene,
            SceneDamaged,
            SceneTooLarge,
            UnknownVersion,
            VersionForgotten,
            TooManyAnswers,
            NoMemory,
            ShuttingDown,
        ],
        "get_elements" => &[UnknownScene, SceneDamaged, TooManyAnswers],
        "render_scene" => &[InvalidQuery, UnknownScene, SceneDamaged, VersionForgotten, NoMemory, ShuttingDown],
        "sample_light" => &[
            InvalidJson,
            UnknownScene,
            SceneDamaged,
            Timeout,
            PayloadTooLarge,
            UnsupportedMediaType,
            InvalidValue,
            ShuttingDown,
        ],
        "get_error" => &[InvalidQuery, UnknownScene, SceneDamaged, ShuttingDown],
        "get_probes" => &[InvalidQuery, UnknownScene, SceneDamaged, VersionAhead, ShuttingDown],
        "sample_probes" => &[
            InvalidJson,
            UnknownScene,
            SceneDamaged,
            Timeout,
            PayloadTooLarge,
            UnsupportedMediaType,
            InvalidValue,
            VersionAhead,
            ShuttingDown,
        ],
        "describe_problem" => &[NotFound],
        "ready" => &[Restoring, ShuttingDown],
        _ => &[],
    }
}

fn add_problems(operation: &mut Operation) {
    let id = operation.operation_id.as_deref().unwrap_or_default();
    let is_open = matches!(id, "alive" | "ready" | "openapi" | "describe_problem");
    let always: &[Kind] = match is_open {
        true => &[Kind::BadRequest, Kind::ForeignHost, Kind::Internal],
        false => {
            &[Kind::BadRequest, Kind::ForeignHost, Kind::Internal, Kind::Unauthorized, Kind::Forbidden, Kind::Restoring]
        }
    };
    let own = problems_of(id);
    // Where the service was started without tokens, none is needed.
    let either = || vec![SecurityRequirement::new("bearer", [""; 0]), SecurityRequirement::default()];
    operation.security = Some(if is_open { Vec::new() } else { either() });
    // A request waits for a scene that is being prepared; only its events come at once.
    let waits = own.contains(&Kind::SceneDamaged) && id != "scene_events";
    let mut by_status = std::collections::BTreeMap::<u16, Vec<String>>::new();
    for kind in own.iter().chain(waits.then_some(&Kind::ScenePreparing)).chain(always) {
        let (slug, status, _, about) = kind.row();
        by_status.entry(status.as_u16()).or_default().push(format!("`{slug}`: {about}"));
    }
    for (status, about) in by_status {
        let document = ContentBuilder::new().schema(Some(Ref::from_schema_name("ProblemDocument"))).build();
        let response =
            ResponseBuilder::new().description(about.join("\n\n")).content(problem::CONTENT_TYPE, document).build();
        operation.responses.responses.insert(status.to_string(), RefOr::T(response));
    }
}
