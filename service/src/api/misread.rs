//! JSON into the types that the description tells, with the place of what is wrong.
//!
//! Most types are read by their derived `Deserialize`, and `serde_path_to_error` follows the way there. What a tagged
//! object is becomes known with its tag, which may stand anywhere in it: it is read as a whole first, where that way is
//! lost. [`tagged`] makes such types, whose errors begin with the place; [`Misread`] puts both together.

use std::fmt;

use serde::Deserialize;
use serde::de::{DeserializeOwned, Error};
use serde_json::{Map, Value};

use super::problem::{ApiResult, Kind, Problem};

/// Why a value could not be read, and where.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Misread {
    /// Such as `edits[1].transform[3]`; empty where it is about all of it.
    pub(crate) path: String,
    /// What is wrong there.
    pub(crate) reason: String,
}

impl fmt::Display for Misread {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.path.is_empty() {
            true => f.write_str(&self.reason),
            false => write!(f, "at `{}`: {}", self.path, self.reason),
        }
    }
}

impl Misread {
    pub(super) fn new(path: &str, reason: impl Into<String>) -> Misread {
        Misread { path: path.to_owned(), reason: reason.into() }
    }

    /// From an error and the way to it, which ends where an object was read as a whole: the rest is in its text.
    fn of(way: &str, text: &str) -> Misread {
        let way = if way == "." { "" } else { way };
        let told = text.strip_prefix("at `").and_then(|rest| rest.split_once("`: "));
        let (path, reason) = told.map_or((way.to_owned(), text), |(rest, reason)| (join(way, rest), reason));
        // Missing and unknown fields are told without a place of their own; their name is between backticks.
        let named = reason.strip_prefix("missing field `").or_else(|| reason.strip_prefix("unknown field `"));
        match named.and_then(|rest| rest.split_once('`')) {
            Some((field, _)) if !path.ends_with(field) => Misread::new(&join(&path, field), reason),
            _ => Misread::new(&path, reason),
        }
    }

    /// Within a field of something larger.
    pub(super) fn within(self, path: &str) -> Misread {
        Misread { path: join(path, &self.path), ..self }
    }

    pub(super) fn problem(self) -> Problem {
        match self.path.is_empty() {
            true => Problem::new(Kind::InvalidValue, self.reason),
            false => Problem::field(Kind::InvalidValue, self.path, self.reason),
        }
    }
}

/// `path.field`, or whichever of them is not empty.
pub(super) fn join(path: &str, field: &str) -> String {
    match (path.is_empty(), field.is_empty()) {
        (true, _) => field.to_owned(),
        (_, true) => path.to_owned(),
        _ => format!("{path}.{field}"),
    }
}

/// Reads a value.
pub(super) fn from_value<T: DeserializeOwned>(value: Value) -> Result<T, Misread> {
    serde_path_to_error::deserialize(value)
        .map_err(|error| Misread::of(&error.path().to_string(), &error.inner().to_string()))
}

/// Reads a value that stands at `path`.
pub(super) fn read<T: DeserializeOwned>(value: Value, path: &str) -> ApiResult<T> {
    from_value(value).map_err(|misread| misread.within(path).problem())
}

/// Takes a field out of an object that is read as a whole; `null` is as good as absent where `T` may be.
pub(super) fn take<T: DeserializeOwned>(fields: &mut Map<String, Value>, name: &str) -> Result<Option<T>, Misread> {
    let read = |value| from_value(value).map_err(|misread| misread.within(name));
    fields.remove(name).map_or(Ok(None), read)
}

/// Takes the tag out of an object.
pub(super) fn take_tag(fields: &mut Map<String, Value>, name: &str) -> Result<String, Misread> {
    match fields.remove(name) {
        Some(Value::String(tag)) => Ok(tag),
        Some(_) => Err(Misread::new(name, "has to be a string")),
        None => Err(Misread::new(name, "is missing")),
    }
}

/// A type that is read from all fields of an object.
pub(super) trait FromFields: Sized {
    /// Reads it.
    fn from_fields(fields: Map<String, Value>) -> Result<Self, Misread>;

    /// For `Deserialize`: the place of an error begins its text.
    fn from_object<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Self::from_fields(Map::deserialize(deserializer)?).map_err(D::Error::custom)
    }
}

/// An enum whose variants are told apart by the string in field `$tag`, each with one type that holds the other fields.
/// Written, described and read by this one list.
macro_rules! tagged {
    (
        $(#[$about:meta])* $visible:vis enum $name:ident by $tag:tt
        { $($(#[$of_variant:meta])* $variant:ident($fields:ty) = $text:tt,)* }
    ) => {
        $(#[$about])*
        #[derive(Clone, Debug, serde::Serialize, utoipa::ToSchema)]
        #[serde(tag = $tag)]
        $visible enum $name { $($(#[$of_variant])* #[serde(rename = $text)] $variant($fields),)* }

        impl $crate::api::misread::FromFields for $name {
            fn from_fields(
                mut fields: serde_json::Map<String, serde_json::Value>,
            ) -> Result<Self, $crate::api::misread::Misread> {
                use $crate::api::misread::{Misread, from_value, take_tag};
                const KNOWN: &[&str] = &[$($text),*];
                match take_tag(&mut fields, $tag)?.as_str() {
                    $($text => from_value(fields.into()).map($name::$variant),)*
                    other => Err(Misread::new($tag, format!("{other:?} is none of {}", KNOWN.join(", ")))),
                }
            }
        }

        impl<'de> serde::Deserialize<'de> for $name {
            fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                $crate::api::misread::FromFields::from_object(deserializer)
            }
        }
    };
}
pub(super) use tagged;

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[derive(Clone, Debug, Deserialize, serde::Serialize, utoipa::ToSchema)]
    #[serde(deny_unknown_fields)]
    struct Leaf {
        numbers: [f32; 2],
    }

    #[derive(Clone, Debug, Deserialize, serde::Serialize, utoipa::ToSchema)]
    #[serde(deny_unknown_fields)]
    struct Branch {
        kinds: Vec<Kinds>,
    }

    tagged! {
        /// What may grow.
        enum Kinds by "kind" {
            /// Ends here.
            Leaf(Leaf) = "leaf",
            /// Goes on.
            Branch(Branch) = "branch",
        }
    }

    /// However deep objects lie that are read as a whole, an error tells its place from the top.
    #[test]
    fn errors_tell_their_place_through_tagged_objects() {
        let place = |value: Value| from_value::<Kinds>(value).expect_err("a mistake");
        let inner = |leaf: Value| json!({ "kinds": [{ "kind": "branch", "kinds": [leaf] }], "kind": "branch" });
        for (leaf, path, reason) in [
            (json!({ "numbers": [1, "x"], "kind": "leaf" }), "kinds[0].kinds[0].numbers[1]", "invalid type"),
            (json!({ "kind": "leaf" }), "kinds[0].kinds[0].numbers", "missing field"),
            (json!({ "kind": "leaf", "numbers": [1, 2], "x": 1 }), "kinds[0].kinds[0].x", "unknown field"),
            (json!({ "kind": "root" }), "kinds[0].kinds[0].kind", "\"root\" is none of leaf, branch"),
            (json!({ "kind": 3 }), "kinds[0].kinds[0].kind", "has to be a string"),
            (json!({ "numbers": [1, 2] }), "kinds[0].kinds[0].kind", "is missing"),
            (json!(3), "kinds[0].kinds[0]", "invalid type: integer `3`"),
        ] {
            let misread = place(inner(leaf.clone()));
            assert_eq!(misread.path, path, "{leaf}: {misread}");
            assert!(misread.reason.starts_with(reason), "{leaf}: {misread}");
        }
        let whole = inner(json!({ "kind": "leaf", "numbers": [1.0, 2.0] }));
        assert_eq!(serde_json::to_value(from_value::<Kinds>(whole.clone()).expect("right")).expect("text"), whole);
    }
}
