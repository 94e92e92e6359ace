//! What files have of the triangles of an object, beside what its scene holds.

use std::collections::BTreeMap;

use glam::{DMat3, DMat4, Vec2};

use crate::scene::{Object, Original, OriginalMesh, OriginalNode};

/// The files that a scene was made of.
#[derive(Debug, Default)]
pub struct Originals {
    /// The upload.
    pub scene: Option<Original>,
    /// What was inserted from, by the name that the scene has for it ([`crate::scene::Scene::asset`]).
    pub assets: BTreeMap<String, Original>,
}

impl Originals {
    /// The node of the upload that an object is.
    pub(super) fn node_of(&self, object: &Object) -> Option<&OriginalNode> {
        let index = object.node.as_ref()?.index as usize;
        let nodes = &self.scene.as_ref()?.nodes;
        nodes.binary_search_by_key(&index, |node| node.index).ok().map(|at| &nodes[at])
    }
}

/// The meshes of a file that an object consists of.
pub(super) struct Told<'a> {
    pub(super) file: &'a Original,
    pub(super) pieces: Vec<Piece<'a>>,
}

/// One of them.
pub(super) struct Piece<'a> {
    /// The first of its triangles in the object's mesh.
    first: usize,
    pub(super) mesh: &'a OriginalMesh,
    /// Space of the mesh to that of the object; none where they are the same.
    pub(super) object_from_mesh: Option<DMat4>,
}

impl Piece<'_> {
    /// Its triangles are wound the other way in the object.
    pub(super) fn is_mirrored(&self) -> bool {
        self.object_from_mesh.is_some_and(|matrix| DMat3::from_mat4(matrix).determinant() < 0.0)
    }
}

impl<'a> Told<'a> {
    /// None where the file is not there, or does not have the object's triangles.
    pub(super) fn of(originals: &'a Originals, object: &Object) -> Option<Told<'a>> {
        let (file, parts): (&Original, Vec<(&OriginalMesh, Option<DMat4>)>) = match &object.asset {
            Some(asset) => {
                let file = originals.assets.get(&**asset)?;
                let objects = file.nodes.iter().filter_map(|node| Some((node.mesh.as_deref()?, &node.objects)));
                (file, objects.flat_map(|(mesh, places)| places.iter().map(move |p| (mesh, Some(*p)))).collect())
            }
            None => {
                let node = originals.node_of(object)?;
                (originals.scene.as_ref()?, vec![(node.mesh.as_deref()?, None)])
            }
        };
        let mut first = 0;
        let pieces = parts.into_iter().map(|(mesh, object_from_mesh)| {
            let piece = Piece { first, mesh, object_from_mesh };
            first += mesh.solid.mesh.triangles.len();
            piece
        });
        let pieces = pieces.collect();
        (first == object.mesh.triangles.len()).then_some(Told { file, pieces })
    }

    fn piece(&self, triangle: usize) -> &Piece<'a> {
        &self.pieces[self.pieces.partition_point(|piece| piece.first <= triangle) - 1]
    }

    /// Whether it has a set of texture coordinates anywhere.
    pub(super) fn has_texcoords(&self, set: usize) -> bool {
        self.pieces.iter().any(|piece| !piece.mesh.solid.mesh.texcoords[set].is_empty())
    }

    /// Index in the file of the material of one of the object's triangles.
    pub(super) fn material(&self, triangle: usize) -> Option<usize> {
        let piece = self.piece(triangle);
        let solid = &piece.mesh.solid;
        solid.materials[solid.mesh.triangle_materials[triangle - piece.first] as usize]
    }

    /// Texture coordinates at the corners of one of the object's triangles, in their order there; zero where there are
    /// none.
    pub(super) fn texcoords(&self, triangle: usize, set: usize) -> [Vec2; 3] {
        let piece = self.piece(triangle);
        let mesh = &piece.mesh.solid.mesh;
        let [a, b, c] = mesh.triangles[triangle - piece.first];
        let corners = if piece.is_mirrored() { [a, c, b] } else { [a, b, c] };
        corners.map(|vertex| mesh.texcoords[set].get(vertex as usize).copied().unwrap_or_default())
    }
}
