//! Objects one by one: what a client needs of one without the whole file.

use std::collections::HashMap;
use std::sync::Arc;

use axum::extract::State;
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use rebake_core::scene::LightKind;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use super::coding::encode_body;
use super::extract::{ApiPath, ApiQuery, Coding, first_named};
use super::paging::Onward;
use super::problem::{ApiResult, Kind, Problem};
use super::scenes::ListQuery;
use super::types::{ElementRange, SceneObject, finite};
use super::versioned::Versioned;
use super::{Shared, find_scene};
use crate::engine::{self, ObjectSummary, Scene};
use crate::store::accepted::AcceptedWorld;
use crate::store::lighting::Sequence;

use crate::store::versions::{Published, Stated, Wanted};

/// One page of objects.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub(super) struct ObjectPage {
    /// In the order of `index`.
    items: Vec<SceneObject>,
    /// Version of the light map.
    #[schema(example = 7)]
    version: u64,
    /// Version at which elements, objects or lights last changed. Pages of different ones, or of different numbers of
    /// accepted edits, do not belong together.
    #[schema(example = 3)]
    elements_version: u64,
    /// Edits of the scene that were accepted: all of them are in the list.
    #[schema(example = 3)]
    accepted_edits: u64,
    /// Asks for the next page; absent on the last.
    next_cursor: Option<String>,
}

/// An object with its materials, and its light as a whole.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub(super) struct ObjectDetail {
    /// Version of the light map.
    #[schema(example = 7)]
    version: u64,
    /// Version at which elements, objects or lights last changed.
    #[schema(example = 3)]
    elements_version: u64,
    /// As the scene lists it.
    object: SceneObject,
    /// Its mesh as the file has it.
    mesh: ObjectMesh,
    /// Its materials, in the order of its file.
    materials: Vec<ObjectMaterial>,
    /// Area of its elements, m².
    #[schema(example = 3.2)]
    area: f64,
    /// Mean of the light map over that area, in the scene's mode; none where it has no elements.
    #[schema(example = json!([0.21, 0.2, 0.18]))]
    light: Option<[f32; 3]>,
}

/// A mesh as the file has it, before subdivision.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub(super) struct ObjectMesh {
    /// Its vertices.
    #[schema(example = 482)]
    vertices: u64,
    /// Its triangles.
    #[schema(example = 920)]
    triangles: u64,
    /// Some of it has normals of its own.
    has_normals: bool,
    /// Sets of texture coordinates that are known: those that pictures of its materials read.
    #[schema(example = 1)]
    texture_coordinates: u64,
}

/// A material of an object.
#[derive(Clone, Debug, Serialize, Deserialize, ToSchema)]
pub(super) struct ObjectMaterial {
    /// Its name in the file; empty where it has none.
    #[schema(example = "wood")]
    name: String,
    /// Mean diffuse albedo, linear RGB, as the file or the last repaint has it.
    #[schema(example = json!([0.3, 0.2, 0.1]))]
    albedo: [f32; 3],
    /// Radiance that it emits now, linear RGB.
    #[schema(example = json!([0, 0, 0]))]
    emission: [f32; 3],
    /// Mean share of light that does not go through it.
    #[schema(example = 1.0)]
    opacity: f32,
    /// Its back is a surface like its front.
    double_sided: bool,
}

/// The objects of a scene, hidden ones too, as the scene tells them.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/objects", tag = "scenes", operation_id = "list_objects",
    params(("scene" = String, Path, description = "The scene's id"), ListQuery),
    responses((status = 200, body = ObjectPage, description = "A page of objects"))
)]
pub(super) async fn list(
    State(app): Shared,
    ApiPath(id): ApiPath<String>,
    ApiQuery(query): ApiQuery<ListQuery>,
) -> ApiResult<Response> {
    let scene = find_scene(&app, &id).await?;
    let page = Onward::new(&app.config, query.limit, query.cursor.as_deref())?;
    let write = move || {
        // Numbers of entries begin with 1: nothing is before the first page.
        let number = |object: &SceneObject| u64::from(object.index) + 1;
        let (published, shown) = scene.shown();
        let accepted = scene.accepted();
        let mut found = tell(&published, shown, &accepted);
        found.retain(|object| number(object) > page.after);
        let (items, next_cursor) = page.cut(found, number);
        let (version, elements_version) = (published.version, published.elements_version);
        let accepted_edits = accepted.sequence;
        serde_json::to_vec(&ObjectPage { items, version, elements_version, accepted_edits, next_cursor })
    };
    let json = app.compute.answer(write).await?.map_err(Problem::internal)?;
    Ok(([(header::CONTENT_TYPE, "application/json")], json).into_response())
}

/// The objects of a scene after its accepted edits, in the order of `index`, with the elements that are published, up to
/// the edit `shown`.
pub(super) fn tell(published: &Published, shown: Sequence, accepted: &AcceptedWorld) -> Vec<SceneObject> {
    let known: Vec<SceneObject> = (published.objects().iter().zip(published.stated_of_objects()))
        .map(|(object, stated)| SceneObject::new(object, stated))
        .collect();
    if accepted.sequence <= shown {
        return known;
    }
    let mut behind = known.len() as u32..;
    let by_name: HashMap<&str, &SceneObject> = known.iter().map(|object| (object.name.as_str(), object)).collect();
    let in_version = |object: &ObjectSummary| {
        let told = SceneObject::new(object, Stated::default());
        match by_name.get(object.name.as_str()) {
            Some(SceneObject { index, elements, light_error, with_back, triangles, .. }) => SceneObject {
                index: *index,
                elements: *elements,
                light_error: *light_error,
                with_back: *with_back,
                triangles: *triangles,
                ..told
            },
            None => SceneObject {
                index: behind.next().unwrap_or(u32::MAX),
                elements: ElementRange { first: published.world.slots() as u32, count: 0 },
                with_back: false,
                triangles: 0,
                ..told
            },
        }
    };
    let mut objects: Vec<SceneObject> = accepted.objects().iter().map(in_version).collect();
    // What was removed and came back under its name stands where it stood.
    objects.sort_by_key(|object| object.index);
    objects
}

/// What to tell of an object.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum ObjectFormat {
    /// Its mesh as the file has it, in the place that it has now, as scene 0; the cells between its elements, with the
    /// light map as float `COLOR_0`, as scene 1.
    Glb,
    /// The object with its materials, and its light as a whole.
    Json,
    /// Its elements: 48 bytes each.
    Elements,
}

impl ObjectFormat {
    const ALL: [ObjectFormat; 3] = [ObjectFormat::Glb, ObjectFormat::Json, ObjectFormat::Elements];

    fn content_type(self) -> &'static str {
        match self {
            ObjectFormat::Glb => "model/gltf-binary",
            ObjectFormat::Json => "application/json",
            ObjectFormat::Elements => "application/octet-stream",
        }
    }
}

/// What to fetch.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ObjectQuery {
    /// What to tell; by `Accept`, else `glb`, where absent.
    #[param(inline)]
    format: Option<ObjectFormat>,
}

/// One object: its mesh, its materials, its elements and their light.
///
/// `format=glb`: scene 0 holds the mesh as the file has it: positions and normals in object space, the texture
/// coordinates that its materials read, materials by name with their mean albedo; pictures stay with the file. The node's
/// `matrix` is its present place; its `extras` are `node` and `id`, where it has them. Scene 1, absent where the object
/// has no elements, holds the cells between its elements in world space: vertex *i* is the element in slot
/// `extras.first_element + i` of the light map, its light the float `COLOR_0`.
///
/// `format=elements`: per element 48 bytes, little-endian: what `/elements` tells of it (32 bytes), `f32` light R G B in
/// the scene's mode, `f32` standard error.
#[utoipa::path(
    get, path = "/v1/scenes/{scene}/objects/{object}", tag = "scenes", operation_id = "get_object",
    params(
        ("scene" = String, Path, description = "The scene's id"),
        ("object" = String, Path, description = "The object's name, percent-encoded: it may hold any character", example = "sofa"),
        ObjectQuery,
        ("If-None-Match" = Option<String>, Header, description = "The `ETag` that the client has"),
    ),
    responses(
        (status = 200, description = "The object", headers(
            ("ETag" = String, description = "The version of the light map"),
            ("X-Rebake-Version" = String, description = "The version of the light map"),
        ), content(
            (Vec<u8> = "model/gltf-binary"), (ObjectDetail = "application/json"), (Vec<u8> = "application/octet-stream")
        )),
        (status = 304, description = "The client has this version"),
    )
)]
pub(super) async fn get(
    State(app): Shared,
    ApiPath((id, name)): ApiPath<(String, String)>,
    ApiQuery(query): ApiQuery<ObjectQuery>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let published = find_scene(&app, &id).await?.published();
    let by_header = || first_named(&headers, ObjectFormat::ALL, ObjectFormat::content_type);
    let format = query.format.or_else(by_header).unwrap_or(ObjectFormat::Glb);
    let versioned = Versioned::of_light(&published, &headers, Some("accept, accept-encoding"))?;
    let is_known = versioned.is_known;
    let coding = Coding::accepted(&headers);
    let write = move || {
        let object = find(&published, &name)?;
        // Whether there is such an object is told in any case.
        let body = if is_known { Vec::new() } else { write(&published, object, format).map_err(Problem::internal)? };
        encode_body(coding, body).map_err(Problem::internal)
    };
    let body = app.compute.answer(write).await??;
    if is_known {
        return Ok(versioned.not_modified());
    }
    Ok((versioned.about, [(header::CONTENT_TYPE, format.content_type())], coding.headers(), body).into_response())
}

fn find<'a>(published: &'a Arc<Published>, name: &str) -> ApiResult<&'a ObjectSummary> {
    let found = published.objects().iter().find(|object| object.name == name);
    found.ok_or_else(|| Problem::new(Kind::ObjectNotFound, format!("the scene has no object {name:?}")))
}

fn write(published: &Published, object: &ObjectSummary, format: ObjectFormat) -> Result<Vec<u8>, String> {
    let light = published.values();
    match format {
        ObjectFormat::Glb => engine::object_glb(&published.world, object.index, light),
        ObjectFormat::Json => serde_json::to_vec(&detail(published, object)).map_err(|error| error.to_string()),
        ObjectFormat::Elements => {
            Ok(engine::object_records(&published.world, object, light, &published.deliver(Wanted::Error)))
        }
    }
}

fn detail(published: &Published, summary: &ObjectSummary) -> ObjectDetail {
    let world = &published.world;
    let object = &world.scene.objects[summary.index as usize];
    let mesh = &*object.mesh;
    let slots = || summary.first_element as usize..(summary.first_element + summary.elements) as usize;
    let mean = |channel: usize| world.area_mean(slots(), |slot| f64::from(published.values()[slot][channel])) as f32;
    ObjectDetail {
        version: published.version,
        elements_version: published.elements_version,
        object: SceneObject::new(
            summary,
            published.stated_of_objects().nth(summary.index as usize).unwrap_or_default(),
        ),
        mesh: ObjectMesh {
            vertices: mesh.positions.len() as u64,
            triangles: mesh.triangles.len() as u64,
            has_normals: !mesh.normals.is_empty(),
            texture_coordinates: mesh.texcoords.iter().filter(|set| !set.is_empty()).count() as u64,
        },
        materials: (0..object.materials.len()).map(|material| of_material(&world.scene, object, material)).collect(),
        area: world.areas().range(slots()).map(|area| f64::from(*area)).sum(),
        light: (summary.elements > 0).then(|| [0, 1, 2].map(|channel| finite(mean(channel)).unwrap_or(f32::MAX))),
    }
}

fn of_material(scene: &Scene, object: &engine::Object, index: usize) -> ObjectMaterial {
    let of_this = |kind: &LightKind| matches!(kind, LightKind::Emissive { object: o, material } if *o == object.name && *material as usize == index);
    let light = scene.lights.iter().find(|light| of_this(&light.kind));
    let material = &object.materials[index];
    ObjectMaterial {
        name: object.material_names.get(index).map_or_else(String::new, |name| (**name).to_owned()),
        albedo: material.albedo.to_array(),
        emission: light.map_or([0.0; 3], |light| light.strength().to_array()),
        opacity: object.mean_opacity(index),
        double_sided: material.double_sided,
    }
}
