//! Edits as plain data: what a client may change. [`crate::World::apply`] turns them into a new scene;
//! [`Edit::effects`] and [`Edit::cost`] tell what each writes and what its light costs.

mod effects;
mod restore;

use std::sync::Arc;

use glam::{DMat4, DVec3, Vec3};

#[cfg(doc)]
use crate::scene::ENVIRONMENT;
use crate::scene::{LightKind, Scene};

pub use effects::{Cost, Effect, Property, Thing};
pub use restore::Restore;
pub(crate) use restore::{Lights, Restored};

/// One change to a scene. A request may hold several; they are applied as a unit or not at all.
#[derive(Clone, Debug)]
pub enum Edit {
    /// Puts an asset into the scene as one object.
    Insert {
        /// What to insert: its objects are merged into one.
        asset: Arc<Scene>,
        /// Name of the new object; must be free.
        name: String,
        /// Asset space to world space, metres.
        transform: DMat4,
    },
    /// Takes objects out, with the lights on them.
    Remove {
        /// Names of objects; a name with `*` matches any part of a name.
        objects: Vec<String>,
    },
    /// Gives an object a new place.
    Move {
        /// Name of the object.
        object: String,
        /// Object space to world space, metres: replaces the present transform.
        transform: DMat4,
    },
    /// Repaints an object.
    Material {
        /// Name of the object.
        object: String,
        /// Diffuse albedo of all its materials, linear RGB, each in 0..=1.
        albedo: Vec3,
    },
    /// Repaints what has a material of some name.
    NamedMaterial {
        /// Name of the object; every object that has the material where absent.
        object: Option<String>,
        /// Name of the material in the file; not empty.
        material: String,
        /// Its diffuse albedo, linear RGB, each in 0..=1.
        albedo: Vec3,
    },
    /// Gives materials another base colour factor: textures and vertex colours stay and are multiplied by it. What was
    /// repainted has none any more.
    Tint {
        /// Name of the object; every object that has the material where absent.
        object: Option<String>,
        /// Name of the material in the file; all materials of the object where absent.
        material: Option<String>,
        /// Linear RGB, each in 0..=1.
        factor: Vec3,
    },
    /// Takes objects out of the light, with the lights on them. They keep their names, places and materials.
    Hide {
        /// Names of objects; a name with `*` matches any part of a name. Those that are hidden stay so.
        objects: Vec<String>,
    },
    /// Brings hidden objects back, with the lights on them.
    Show {
        /// Names of objects; a name with `*` matches any part of a name. Those that are not hidden stay so.
        objects: Vec<String>,
    },
    /// Makes the scene what it was at another time: what undo and redo do.
    Restore(Arc<Restore>),
    /// Changes colour or intensity of lights.
    Relight {
        /// What changes, light by light.
        lights: Vec<Relight>,
    },
    /// Adds a punctual light or an environment.
    InsertLight {
        /// Name of the new light; must be free.
        name: String,
        /// Anything but [`LightKind::Emissive`].
        kind: LightKind,
        /// Linear RGB factor.
        color: Vec3,
        /// Candela, lux or radiance, as the kind has it.
        intensity: f32,
    },
    /// Gives a scene its light from outside, named [`ENVIRONMENT`]: instead of the one that it has, or anew.
    Sky {
        /// [`LightKind::Environment`] or [`LightKind::Sky`].
        kind: LightKind,
        /// Linear RGB factor.
        color: Vec3,
        /// Radiance, or a factor on the picture.
        intensity: f32,
    },
    /// Takes a light away; an emissive surface stays as an object that emits nothing.
    RemoveLight {
        /// Name of the light.
        light: String,
    },
    /// Moves a point or spot light, turns a spot or directional light.
    MoveLight {
        /// Name of the light.
        light: String,
        /// New world-space position, metres.
        position: Option<DVec3>,
        /// New direction in which it shines.
        direction: Option<Vec3>,
        /// It gets a layer of its own where there is room for one, so that there are quick estimates of it at other
        /// places ([`crate::DragBasis`]).
        own_layer: bool,
    },
    /// Lets lights share a layer of the light map ([`crate::layers`]), whose colour and intensity then change together
    /// without rays.
    GroupLights {
        /// Name of the layer; without it the lights belong to no group any more, and stay in the layer that they are
        /// in.
        group: Option<String>,
        /// Names of lights.
        lights: Vec<String>,
    },
}

/// New colour or intensity of one light.
#[derive(Clone, Debug, PartialEq)]
pub struct Relight {
    /// Name of the light.
    pub light: String,
    /// New colour, linear RGB, each ≥ 0; unchanged where absent.
    pub color: Option<Vec3>,
    /// New intensity, ≥ 0; unchanged where absent.
    pub intensity: Option<f32>,
}

/// Why an edit was refused. Nothing has changed then.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{field}: {reason}")]
pub struct EditError {
    /// The field of the edit at fault, e.g. `edits[1].objects[0]`.
    pub field: String,
    /// What is wrong with it.
    pub reason: String,
    /// What kind of fault it is.
    pub kind: EditErrorKind,
}

impl EditError {
    /// Names the field from the top of a list of edits whose `index`-th was refused: `edits[1].name` for `name`.
    pub(crate) fn in_list(self, index: usize) -> EditError {
        EditError { field: format!("edits[{index}].{}", self.field), ..self }
    }
}

/// Kinds of refusal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EditErrorKind {
    /// A named object, light or asset does not exist.
    NotFound,
    /// A name is taken already.
    Conflict,
    /// A value is out of its range.
    Invalid,
    /// The scene would grow past its limits.
    TooLarge,
}

/// Whether a name matches a pattern in which `*` stands for any run of characters.
pub fn name_matches(pattern: &str, name: &str) -> bool {
    let mut pieces = pattern.split('*');
    let Some(mut rest) = pieces.next().and_then(|p| name.strip_prefix(p)) else { return false };
    let pieces: Vec<&str> = pieces.collect();
    let Some((last, middle)) = pieces.split_last() else { return rest.is_empty() };
    for piece in middle {
        let Some(at) = rest.find(piece) else { return false };
        rest = &rest[at + piece.len()..];
    }
    rest.ends_with(last)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_match_whole_names() {
        for (pattern, name, expected) in [
            ("Sofa_*", "Sofa_1", true),
            ("Sofa_*", "sofa_1", false),
            ("*", "", true),
            ("*_Glass", "Mesh1_Glass", true),
            ("*_Glass", "Mesh1_Glass2", false),
            ("a*b*c", "a-b-b-c", true),
            ("a*b*c", "a-c", false),
            ("plain", "plain", true),
            ("plain", "plainer", false),
        ] {
            assert_eq!(name_matches(pattern, name), expected, "{pattern} {name}");
        }
    }
}
