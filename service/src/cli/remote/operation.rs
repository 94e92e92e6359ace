//! The edits of `rebake edit` and their JSON.

use std::path::{Path, PathBuf};

use glam::{DMat4, DQuat, DVec3};
use serde_json::{Value, json};

use super::super::values::{Matrix, Point, Rgb, albedo, is_scene_file, not_negative, positive};

/// One edit.
#[derive(Debug, clap::Subcommand)]
pub(super) enum Operation {
    /// Put an asset into the scene as one object
    Insert {
        /// A file (.glb, .gltf with its files beside it, or both in a .zip), or the id of an asset uploaded before
        #[arg(value_name = "ASSET.glb|ID")]
        asset: String,
        /// Name of the new object [default: the file's]
        #[arg(long)]
        name: Option<String>,
        #[command(flatten)]
        place: Pose,
    },
    /// Take objects out, with the lights on them
    Remove {
        /// Names of objects; `*` stands for any part of a name
        #[arg(value_name = "OBJECT", required = true)]
        objects: Vec<String>,
    },
    /// Give an object a new place, instead of its present one
    Move {
        /// Name of the object
        object: String,
        #[command(flatten)]
        place: Pose,
    },
    /// Repaint an object, a material wherever it is, or one material of an object
    #[command(group(clap::ArgGroup::new("painted").required(true).multiple(true).args(["object", "material"])))]
    Material {
        /// Name of the object
        object: Option<String>,
        /// Name of the material in the file
        #[arg(long)]
        material: Option<String>,
        /// Diffuse albedo: linear RGB, or 8-bit sRGB as #rrggbb
        #[arg(long, value_name = "R,G,B", value_parser = albedo)]
        albedo: Rgb,
        /// Multiply the file's textures and vertex colours by it, instead of its base colour factor
        #[arg(long)]
        multiply: bool,
    },
    /// Take objects out of the light, to come back later
    Hide {
        /// Names of objects; `*` stands for any part of a name
        #[arg(value_name = "OBJECT", required = true)]
        objects: Vec<String>,
    },
    /// Bring hidden objects back
    Show {
        /// Names of objects; `*` stands for any part of a name
        #[arg(value_name = "OBJECT", required = true)]
        objects: Vec<String>,
    },
    /// Take the last edit back
    Undo,
    /// Make the edit again that was taken back last
    Redo,
    /// Change a light's colour or intensity
    #[command(group(clap::ArgGroup::new("change").required(true).multiple(true).args(["color", "intensity"])))]
    Relight {
        /// Name of the light
        light: String,
        /// Linear RGB, or 8-bit sRGB as #rrggbb
        #[arg(long, value_name = "R,G,B")]
        color: Option<Rgb>,
        /// Factor of the colour
        #[arg(long, value_parser = not_negative)]
        intensity: Option<f64>,
    },
    /// Add a light
    InsertLight(NewLight),
    /// Give the scene its light from outside, instead of what it has of it
    #[command(group(clap::ArgGroup::new("what").required(true).args(["picture", "radiance"])))]
    Sky {
        /// An equirectangular picture: an .exr or .hdr file, or the id of an asset
        picture: Option<String>,
        /// Radiance that is alike from everywhere, linear RGB
        #[arg(long, value_name = "R,G,B")]
        radiance: Option<Rgb>,
        /// Turn the picture about the vertical, counter-clockwise seen from above
        #[arg(long, value_name = "DEGREES", allow_hyphen_values = true, requires = "picture")]
        rotation: Option<f64>,
        /// Factor on the radiance [default: 1]
        #[arg(long, value_name = "FACTOR", value_parser = not_negative)]
        strength: Option<f64>,
    },
    /// Take a light away
    RemoveLight {
        /// Name of the light
        light: String,
    },
    /// Give a light a new place or direction
    #[command(group(clap::ArgGroup::new("change").required(true).multiple(true).args(["position", "direction"])))]
    MoveLight {
        /// Name of the light
        light: String,
        /// Metres
        #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
        position: Option<Point>,
        /// Where it shines
        #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
        direction: Option<Point>,
        /// It is being dragged: show an estimate first
        #[arg(long)]
        drag: bool,
    },
    /// Let lights share a layer of the light map, so that they are relit together without rays
    GroupLights {
        /// Names of lights
        #[arg(value_name = "LIGHT", required = true)]
        lights: Vec<String>,
        /// Name of the layer [default: the lights leave their groups]
        #[arg(long)]
        name: Option<String>,
    },
}

/// A light to add.
#[derive(Debug, clap::Args)]
pub(super) struct NewLight {
    /// Name of the new light
    name: String,
    /// How it spreads
    #[arg(long, value_parser = ["point", "spot", "directional", "environment"])]
    kind: String,
    /// Metres
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true,
        required_if_eq_any([("kind", "point"), ("kind", "spot")]))]
    position: Option<Point>,
    /// Where it shines
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true,
        required_if_eq_any([("kind", "spot"), ("kind", "directional")]))]
    direction: Option<Point>,
    /// Spot: full intensity up to this angle from the direction
    #[arg(long, value_name = "DEGREES", value_parser = not_negative)]
    inner_cone: Option<f64>,
    /// Spot: no light beyond this angle
    #[arg(long, value_name = "DEGREES", value_parser = positive)]
    outer_cone: Option<f64>,
    /// Directional: angle that its disc takes up [default: 0, hard shadows]
    #[arg(long, value_name = "DEGREES", value_parser = not_negative)]
    angle: Option<f64>,
    /// Point, spot: its light ends here [default: never]
    #[arg(long, value_name = "METRES", value_parser = positive)]
    range: Option<f64>,
    /// Linear RGB, or 8-bit sRGB as #rrggbb
    #[arg(long, value_name = "R,G,B", default_value = "1")]
    color: Rgb,
    /// Candela (point, spot), lux (directional) or radiance (environment)
    #[arg(long, value_parser = not_negative)]
    intensity: f64,
}

/// Where something stands: a matrix, or a position with a turn and a size.
#[derive(Debug, clap::Args)]
#[group(required = true, multiple = true)]
pub(super) struct Pose {
    /// 16 numbers, column-major, object to world
    #[arg(long, value_name = "M,…", allow_hyphen_values = true, conflicts_with_all = ["at", "rotate_y", "scale"])]
    transform: Option<Matrix>,
    /// Position, metres
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    at: Option<Point>,
    /// Turn about the vertical
    #[arg(long, value_name = "DEGREES", allow_hyphen_values = true)]
    rotate_y: Option<f64>,
    /// Size
    #[arg(long, value_name = "FACTOR", value_parser = positive)]
    scale: Option<f64>,
}

impl Pose {
    fn matrix(&self) -> [f64; 16] {
        if let Some(Matrix(matrix)) = self.transform {
            return matrix;
        }
        DMat4::from_scale_rotation_translation(
            DVec3::splat(self.scale.unwrap_or(1.0)),
            DQuat::from_rotation_y(self.rotate_y.unwrap_or(0.0).to_radians()),
            self.at.map_or(DVec3::ZERO, |Point(at)| DVec3::from_array(at)),
        )
        .to_cols_array()
    }
}

impl Operation {
    /// The file to upload first, where the edit inserts one.
    pub(super) fn asset_file(&self) -> Option<PathBuf> {
        match self {
            Operation::Insert { asset, .. } if is_scene_file(Path::new(asset)) => Some(asset.into()),
            Operation::Sky { picture: Some(picture), .. } => {
                let name = picture.to_ascii_lowercase();
                (name.ends_with(".exr") || name.ends_with(".hdr")).then(|| picture.into())
            }
            _ => None,
        }
    }

    /// The colour of a light, where a channel is above 1.
    pub(super) fn bright_color(&self) -> Option<Rgb> {
        let color = match self {
            Operation::Relight { color, .. } => *color,
            Operation::InsertLight(new) => Some(new.color),
            _ => None,
        };
        color.filter(|Rgb(channels)| channels.iter().any(|channel| *channel > 1.0))
    }

    /// The edit as the API takes it (`openapi/openapi.json`); `uploaded` is the id of [`Operation::asset_file`].
    pub(super) fn json(&self, uploaded: Option<String>) -> Value {
        match self {
            Operation::Insert { asset, name, place } => {
                let file_name = self.asset_file().and_then(|path| rebake::client::types::NewScene::name_of(&path));
                let name = name.clone().or(file_name).unwrap_or_else(|| asset.chars().take(8).collect());
                let asset = uploaded.unwrap_or_else(|| asset.clone());
                json!({"op": "insert", "asset": asset, "name": name, "transform": place.matrix()})
            }
            Operation::Remove { objects } => json!({"op": "remove", "objects": objects}),
            Operation::Move { object, place } => {
                json!({"op": "move", "object": object, "transform": place.matrix()})
            }
            Operation::Material { object, material, albedo, multiply } => {
                let mut edit = json!({"op": "material", "albedo": albedo.0});
                set(&mut edit, "object", object.as_ref().map(|name| json!(name)));
                set(&mut edit, "material", material.as_ref().map(|name| json!(name)));
                set(&mut edit, "texture", multiply.then(|| json!("multiply")));
                edit
            }
            Operation::Hide { objects } => json!({"op": "hide", "objects": objects}),
            Operation::Show { objects } => json!({"op": "show", "objects": objects}),
            Operation::Undo => json!({"op": "undo"}),
            Operation::Redo => json!({"op": "redo"}),
            Operation::Relight { light, color, intensity } => {
                let mut change = json!({"light": light});
                set(&mut change, "color", color.map(|rgb| json!(rgb.0)));
                set(&mut change, "intensity", intensity.map(|intensity| json!(intensity)));
                json!({"op": "relight", "lights": [change]})
            }
            Operation::InsertLight(new) => json!({"op": "insert_light", "name": new.name, "light": new.json()}),
            Operation::Sky { picture, radiance, rotation, strength } => {
                let mut edit = json!({"op": "sky"});
                set(&mut edit, "asset", uploaded.or_else(|| picture.clone()).map(|asset| json!(asset)));
                set(&mut edit, "radiance", radiance.map(|rgb| json!(rgb.0)));
                set(&mut edit, "rotation", rotation.map(|degrees| json!(degrees)));
                set(&mut edit, "strength", strength.map(|factor| json!(factor)));
                edit
            }
            Operation::RemoveLight { light } => json!({"op": "remove_light", "light": light}),
            Operation::MoveLight { light, position, direction, drag } => {
                let mut edit = json!({"op": "move_light", "light": light});
                set(&mut edit, "drag", drag.then(|| json!(true)));
                set(&mut edit, "position", position.map(|point| json!(point.0)));
                set(&mut edit, "direction", direction.map(|point| json!(point.0)));
                edit
            }
            Operation::GroupLights { lights, name } => json!({"op": "group_lights", "name": name, "lights": lights}),
        }
    }
}

impl NewLight {
    fn json(&self) -> Value {
        let mut light = json!({"kind": self.kind, "color": self.color.0, "intensity": self.intensity});
        set(&mut light, "position", self.position.map(|point| json!(point.0)));
        set(&mut light, "direction", self.direction.map(|point| json!(point.0)));
        set(&mut light, "angle", self.angle.map(|angle| json!(angle.to_radians())));
        set(&mut light, "range", self.range.map(|range| json!(range)));
        set(&mut light, "inner_cone_angle", self.inner_cone.map(|angle| json!(angle.to_radians())));
        set(&mut light, "outer_cone_angle", self.outer_cone.map(|angle| json!(angle.to_radians())));
        light
    }
}

/// Sets a field where there is a value.
pub(super) fn set(object: &mut Value, field: &str, value: Option<Value>) {
    if let Some(value) = value {
        object[field] = value;
    }
}
