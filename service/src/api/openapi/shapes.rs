//! What the derived description of bodies gets wrong, mended: unions with a tag, and bodies that are bytes.

use std::collections::BTreeMap;

use utoipa::openapi::content::Content;
use utoipa::openapi::path::Operation;
use utoipa::openapi::schema::{AllOf, Discriminator, KnownFormat, Object, OneOf, SchemaFormat, SchemaType, Type};
use utoipa::openapi::{Components, Ref, RefOr, Required, Schema};

const SCHEMAS: &str = "#/components/schemas/";

/// Edits and new lights: one schema for each kind, with its tag and all that may stand beside it.
///
/// The derived ones put several closed schemas over the same object (`allOf`), none of which allows the fields of the
/// others, so that no edit is valid.
pub(super) fn tag_unions(components: &mut Components) {
    tag_variants(components, "NewLight", "kind", &[]);
    let Some(RefOr::T(Schema::AllOf(single))) = components.schemas.get("SingleEdit") else { return };
    let (description, beside) = (single.description.clone(), own_properties(single));
    tag_variants(components, "EditOp", "op", &beside);
    if let Some(RefOr::T(Schema::OneOf(mut union))) = components.schemas.remove("EditOp") {
        union.description = description;
        components.schemas.insert("SingleEdit".to_owned(), RefOr::T(Schema::OneOf(union)));
    }
}

/// Properties that an `allOf` adds to what it refers to.
fn own_properties(all: &AllOf) -> Vec<(String, RefOr<Schema>)> {
    let objects = all.items.iter().filter_map(|item| match item {
        RefOr::T(Schema::Object(object)) => Some(object),
        _ => None,
    });
    objects.flat_map(|object| object.properties.clone()).collect()
}

/// Gives every variant of a union its tag and the properties `beside`, and the union a discriminator.
fn tag_variants(components: &mut Components, union: &str, tag: &str, beside: &[(String, RefOr<Schema>)]) {
    let Some(RefOr::T(Schema::OneOf(derived))) = components.schemas.get(union) else { return };
    let variants: Vec<(String, Object)> = derived.items.iter().filter_map(|item| variant(item, tag)).collect();
    let (mut items, mut mapping) = (Vec::new(), BTreeMap::new());
    for (name, word) in variants {
        let words = word.enum_values.iter().flatten().filter_map(|word| word.as_str());
        mapping.extend(words.map(|word| (word.to_owned(), format!("{SCHEMAS}{name}"))));
        items.push(RefOr::Ref(Ref::from_schema_name(&name)));
        if let Some(RefOr::T(Schema::Object(object))) = components.schemas.get_mut(&name) {
            object.properties.shift_insert(0, tag.to_owned(), RefOr::T(Schema::Object(word)));
            object.required.insert(0, tag.to_owned());
            object.properties.extend(beside.iter().cloned());
        }
    }
    if let Some(RefOr::T(Schema::OneOf(union))) = components.schemas.get_mut(union) {
        let mut discriminator = Discriminator::new(tag);
        discriminator.mapping = mapping;
        *union = OneOf { items, discriminator: Some(discriminator), ..std::mem::take(union) };
    }
}

/// The schema that a derived variant refers to, and that of its tag.
fn variant(item: &RefOr<Schema>, tag: &str) -> Option<(String, Object)> {
    let RefOr::T(Schema::AllOf(all)) = item else { return None };
    let [RefOr::Ref(fields), RefOr::T(Schema::Object(tagged))] = &all.items[..] else { return None };
    let Some(RefOr::T(Schema::Object(word))) = tagged.properties.get(tag) else { return None };
    Some((fields.ref_location.strip_prefix(SCHEMAS)?.to_owned(), word.clone()))
}

/// Bodies that are neither JSON nor text are bytes. The derived schema of bytes is a list of numbers.
pub(super) fn mark_bytes(operation: &mut Operation) {
    if let Some(RefOr::T(body)) = &mut operation.request_body {
        body.content.iter_mut().for_each(|(media_type, content)| mark(media_type, content));
        // No call takes a body that may be absent. openapi-python-client forgets an import where one of several kinds is
        // required.
        body.required = (body.content.len() == 1).then_some(Required::True);
    }
    for response in operation.responses.responses.values_mut() {
        if let RefOr::T(response) = response {
            response.content.iter_mut().for_each(|(media_type, content)| mark(media_type, content));
        }
    }
}

fn mark(media_type: &str, content: &mut RefOr<Content>) {
    let is_text = media_type.starts_with("text/") || media_type.starts_with("application/openmetrics-text");
    // A glTF is a file, whatever is in it: generators would write the one that they are given as JSON.
    let is_readable = is_text || (media_type.ends_with("json") && media_type != "model/gltf+json");
    if let (false, RefOr::T(content)) = (is_readable, content) {
        let mut bytes = Object::with_type(SchemaType::Type(Type::String));
        bytes.format = Some(SchemaFormat::KnownFormat(KnownFormat::Binary));
        content.schema = Some(RefOr::T(Schema::Object(bytes)));
    }
}
