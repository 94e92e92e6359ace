//! The vertices of a primitive, from accessors or from compressed data.

use ::gltf::json;
use json::accessor::ComponentType;
use json::mesh::{Primitive, Semantic};
use json::validation::Checked;

use super::accessor::{Most, read_colors, read_floats, read_indices, read_joints, read_vec3, require_finite};
use super::container::File;
use super::draco::Decoded;
use super::{LoadError, malformed};

/// The attributes of a primitive. Each has as many values as the primitive has vertices, or is refused.
pub(super) struct Attributes<'f> {
    pub(super) file: &'f File<'f>,
    pub(super) primitive: &'f Primitive,
    /// Decompressed attributes and indices.
    pub(super) draco: Option<Decoded<'f>>,
    pub(super) max_vertices: Most,
    pub(super) place: &'f str,
}

impl Attributes<'_> {
    /// The accessor of an attribute.
    pub(super) fn accessor(&self, semantic: Semantic) -> Option<json::Index<json::Accessor>> {
        self.primitive.attributes.get(&Checked::Valid(semantic)).copied()
    }

    /// Finite positions, at least one.
    pub(super) fn positions(&self) -> Result<Vec<[f32; 3]>, LoadError> {
        let place = format!("{}, POSITION", self.place);
        let positions = match self.compressed("POSITION") {
            Some(draco) => draco.floats("POSITION", &place)?,
            None => {
                let index = self.accessor(Semantic::Positions);
                let index = index.ok_or_else(|| malformed(self.place, "has no POSITION"))?;
                read_vec3(self.file, index, self.max_vertices, &place)?
            }
        };
        require_finite(&positions, &place)?;
        Ok(self.scaled(&Semantic::Positions, "POSITION", positions))
    }

    /// Normals of any length, perhaps not finite.
    pub(super) fn normals(&self, count: usize) -> Result<Option<Vec<[f32; 3]>>, LoadError> {
        let place = format!("{}, NORMAL", self.place);
        let Some(index) = self.accessor(Semantic::Normals) else { return Ok(None) };
        let normals = match self.compressed("NORMAL") {
            Some(draco) => self.scaled(&Semantic::Normals, "NORMAL", draco.floats("NORMAL", &place)?),
            None => read_vec3(self.file, index, self.max_vertices, &place)?,
        };
        self.checked(normals, count, "normals").map(Some)
    }

    /// Texture coordinates of a set, perhaps not finite.
    pub(super) fn texcoords(&self, set: u32, count: usize) -> Result<Option<Vec<[f32; 2]>>, LoadError> {
        let name = format!("TEXCOORD_{set}");
        let place = format!("{}, {name}", self.place);
        let Some(index) = self.accessor(Semantic::TexCoords(set)) else { return Ok(None) };
        let values = match self.compressed(&name) {
            Some(draco) => self.scaled(&Semantic::TexCoords(set), &name, draco.floats(&name, &place)?),
            None => read_floats::<2>(self.file, index, self.max_vertices, &place)?,
        };
        self.checked(values, count, "texture coordinates").map(Some)
    }

    /// Whether colours are integers that the file does not call fractions, as it ought to: they are all the same.
    pub(super) fn has_plain_integer_colors(&self) -> bool {
        let accessor = self.accessor(Semantic::Colors(0)).and_then(|index| self.file.root.get(index));
        accessor.is_some_and(|accessor| {
            let is_float =
                matches!(accessor.component_type, Checked::Valid(component) if component.0 == ComponentType::F32);
            !accessor.normalized && !is_float
        })
    }

    /// Finite colours of set 0, linear RGBA.
    pub(super) fn colors(&self, count: usize) -> Result<Option<Vec<[f32; 4]>>, LoadError> {
        let place = format!("{}, COLOR_0", self.place);
        let Some(index) = self.accessor(Semantic::Colors(0)) else { return Ok(None) };
        let colors = match self.compressed("COLOR_0") {
            Some(draco) if draco.components("COLOR_0") == 4 => {
                self.scaled(&Semantic::Colors(0), "COLOR_0", draco.floats::<4>("COLOR_0", &place)?)
            }
            Some(draco) => {
                let colors = self.scaled(&Semantic::Colors(0), "COLOR_0", draco.floats::<3>("COLOR_0", &place)?);
                colors.into_iter().map(|[r, g, b]| [r, g, b, 1.0]).collect()
            }
            None => read_colors(self.file, index, self.max_vertices, &place)?,
        };
        require_finite(&colors, &place)?;
        self.checked(colors, count, "colours").map(Some)
    }

    /// Joints and weights of a set.
    #[expect(clippy::type_complexity, reason = "two lists that belong together, taken apart by the one caller")]
    pub(super) fn influences(
        &self,
        set: u32,
        count: usize,
    ) -> Result<Option<(Vec<[u32; 4]>, Vec<[f32; 4]>)>, LoadError> {
        let (joints, weights) = (self.accessor(Semantic::Joints(set)), self.accessor(Semantic::Weights(set)));
        let Some((joint_index, weight_index)) = joints.zip(weights) else { return Ok(None) };
        let (joint_name, weight_name) = (format!("JOINTS_{set}"), format!("WEIGHTS_{set}"));
        let place = format!("{}, {joint_name}", self.place);
        let joints = match self.compressed(&joint_name) {
            Some(draco) => {
                let joints = draco.floats::<4>(&joint_name, &place)?;
                joints.into_iter().map(|joints| joints.map(|joint| joint as u32)).collect()
            }
            None => read_joints(self.file, joint_index, self.max_vertices, &place)?,
        };
        let joints = self.checked(joints, count, "joints")?;
        let place = format!("{}, {weight_name}", self.place);
        let weights = match self.compressed(&weight_name) {
            Some(draco) => self.scaled(&Semantic::Weights(set), &weight_name, draco.floats(&weight_name, &place)?),
            None => read_floats::<4>(self.file, weight_index, self.max_vertices, &place)?,
        };
        require_finite(&weights, &place)?;
        let weights = self.checked(weights, count, "weights")?;
        Ok(Some((joints, weights)))
    }

    /// Vertex indices, perhaps out of range; of all vertices in their order where the primitive has none.
    pub(super) fn indices(&self, count: usize, max_indices: Most) -> Result<Vec<u32>, LoadError> {
        match (&self.draco, self.primitive.indices) {
            (Some(draco), _) => draco.indices(self.place),
            (None, Some(index)) => read_indices(self.file, index, max_indices, &format!("{}, indices", self.place)),
            (None, None) => Ok((0..count as u32).collect()),
        }
    }

    fn compressed(&self, name: &str) -> Option<&Decoded<'_>> {
        self.draco.as_ref().filter(|draco| draco.has(name))
    }

    /// Integers that the accessor calls normalised become fractions.
    fn scaled<const N: usize>(&self, semantic: &Semantic, name: &str, mut values: Vec<[f32; N]>) -> Vec<[f32; N]> {
        let accessor = self.accessor(semantic.clone()).and_then(|index| self.file.root.get(index));
        let is_fraction = |accessor: &json::Accessor| accessor.normalized || *semantic == Semantic::Colors(0);
        let component = match accessor.filter(|accessor| is_fraction(accessor) && self.compressed(name).is_some()) {
            Some(json::Accessor { component_type: Checked::Valid(component), .. }) => component.0,
            _ => return values,
        };
        let largest = match component {
            ComponentType::I8 => 127.0,
            ComponentType::U8 => 255.0,
            ComponentType::I16 => 32767.0,
            ComponentType::U16 => 65535.0,
            ComponentType::U32 | ComponentType::F32 => return values,
        };
        values.iter_mut().flatten().for_each(|value| *value = (*value / largest).max(-1.0));
        values
    }

    fn checked<T>(&self, values: Vec<T>, count: usize, what: &str) -> Result<Vec<T>, LoadError> {
        if values.len() == count {
            return Ok(values);
        }
        Err(malformed(self.place, &format!("has {count} positions but {} {what}", values.len())))
    }
}
