//! GLB files out: meshes as named nodes, each with a texture or vertex colours, and raw blocks for exact values.
//!
//! Positions are single precision, in mm, under a root node that scales them to metres as glTF wants. Vertices are
//! doubled where a texture seam or nothing else tells them apart; the attribute `_VERTEX` holds the index of the
//! vertex before that, as a float since glTF allows no 32-bit integers there (exact up to 16,777,216). All that Facile
//! adds is in `asset.extras.facile`. The bytes depend on nothing but the content. Read [`super::subject_file`] next.

use std::collections::HashMap;
use std::path::Path;

use serde_json::{Map, Value, json};

use super::picture::encode_texture;
use super::write_file;
use crate::{CoreError, Mesh, Texture};

pub use super::picture::Packing;

/// A mesh in a GLB file: one node, one primitive, one material.
#[derive(Clone, Copy, Debug)]
pub struct GlbPart<'a> {
    /// Name of the node, the mesh and the material.
    pub name: &'a str,
    /// Surface, mm. Vertex colours are written only if there is no texture.
    pub mesh: &'a Mesh,
    /// Index in [`Glb::textures`]; the mesh then has texture coordinates.
    pub texture: Option<usize>,
}

/// A texture in a GLB file.
#[derive(Clone, Copy, Debug)]
pub struct GlbTexture<'a> {
    /// Name of the image.
    pub name: &'a str,
    /// The texels.
    pub texture: &'a Texture,
    /// How they are packed.
    pub packing: Packing,
}

/// The content of a GLB file.
#[derive(Clone, Debug, Default)]
pub struct Glb<'a> {
    /// Meshes, each a node.
    pub parts: Vec<GlbPart<'a>>,
    /// Textures; those that no part uses are written all the same.
    pub textures: Vec<GlbTexture<'a>>,
    /// What `asset.extras.facile` holds beside `unit` and `blocks`.
    pub extras: Map<String, Value>,
    /// Named bytes; `asset.extras.facile.blocks` gives the buffer view of each.
    pub blocks: Vec<(&'a str, Vec<u8>)>,
}

/// Writes one mesh with at most one texture. `extras` go to `asset.extras.facile`.
///
/// # Errors
/// As [`Glb::write`].
pub fn write_glb(
    path: &Path,
    mesh: &Mesh,
    texture: Option<GlbTexture<'_>>,
    extras: Map<String, Value>,
) -> Result<(), CoreError> {
    let glb = Glb {
        parts: vec![GlbPart {
            name: "mesh",
            mesh,
            texture: texture.map(|_| 0),
        }],
        textures: texture.into_iter().collect(),
        extras,
        blocks: Vec::new(),
    };
    glb.write(path)
}

impl Glb<'_> {
    /// Writes the file; an existing one is replaced only when the new one is whole.
    ///
    /// # Errors
    /// [`CoreError::Mesh`] for a mesh that breaks a rule, [`CoreError::Io`] if the file cannot be written.
    ///
    /// # Panics
    /// As [`Self::to_bytes`].
    pub fn write(&self, path: &Path) -> Result<(), CoreError> {
        write_file(path, &self.to_bytes(path)?)
    }

    /// The bytes of the file; `path` is only used in errors.
    ///
    /// # Errors
    /// [`CoreError::Mesh`] for a mesh that breaks a rule, [`CoreError::Format`] for more than 4 GiB.
    ///
    /// # Panics
    /// If a part names a texture that does not exist.
    pub fn to_bytes(&self, path: &Path) -> Result<Vec<u8>, CoreError> {
        let mut writer = Writer::default();
        for part in &self.parts {
            assert!(
                part.texture.is_none_or(|t| t < self.textures.len()),
                "a part's texture exists"
            );
            part.mesh.validate(Path::new(part.name))?;
            writer.part(part);
        }
        for texture in &self.textures {
            let bytes = encode_texture(texture.texture, texture.packing, path)?;
            let view = writer.view(&bytes, None);
            writer.images.push(json!({
                "name": texture.name,
                "bufferView": view,
                "mimeType": texture.packing.media_type(),
            }));
        }
        let mut blocks = Map::new();
        for (name, bytes) in &self.blocks {
            blocks.insert((*name).to_owned(), writer.view(bytes, None).into());
        }
        let mut facile = self.extras.clone();
        facile.insert("unit".to_owned(), "mm".into());
        if !blocks.is_empty() {
            facile.insert("blocks".to_owned(), blocks.into());
        }
        let document = self.document(&writer, &facile);
        pack(&document, writer.binary)
            .ok_or_else(|| CoreError::format(path, None, "a GLB file holds at most 4 GiB"))
    }

    fn document(&self, writer: &Writer, facile: &Map<String, Value>) -> Value {
        let count = self.parts.len();
        let mut nodes = vec![json!({
            "name": "facile",
            "scale": [0.001, 0.001, 0.001],
            "children": (1..=count).collect::<Vec<_>>(),
        })];
        nodes.extend((0..count).map(|i| json!({ "name": self.parts[i].name, "mesh": i })));
        let materials: Vec<Value> = self
            .parts
            .iter()
            .map(|part| {
                let mut surface = json!({ "metallicFactor": 0.0, "roughnessFactor": 0.6 });
                if let Some(texture) = part.texture {
                    surface["baseColorTexture"] = json!({ "index": texture });
                }
                json!({ "name": part.name, "pbrMetallicRoughness": surface })
            })
            .collect();
        let mut document = json!({
            "asset": {
                "version": "2.0",
                "generator": concat!("facile ", env!("CARGO_PKG_VERSION")),
                "extras": { "facile": facile },
            },
            "scene": 0,
            "scenes": [{ "nodes": [0] }],
            "nodes": nodes,
            "meshes": writer.meshes,
            "materials": materials,
            "accessors": writer.accessors,
            "bufferViews": writer.views,
            "buffers": [{ "byteLength": writer.binary.len() }],
        });
        if !writer.images.is_empty() {
            let textures = 0..writer.images.len();
            let textures: Vec<Value> = textures
                .map(|i| json!({ "source": i, "sampler": 0 }))
                .collect();
            document["images"] = writer.images.clone().into();
            document["textures"] = textures.into();
            // Linear, clamped to the edge.
            document["samplers"] = json!([
                { "magFilter": 9729, "minFilter": 9987, "wrapS": 33071, "wrapT": 33071 }
            ]);
        }
        document
    }
}

/// Header and chunks of a GLB, both padded to four bytes. `None` if the lengths do not fit 32 bits.
fn pack(document: &Value, mut binary: Vec<u8>) -> Option<Vec<u8>> {
    let mut json = document.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    binary.resize(binary.len().next_multiple_of(4), 0);
    let length = u32::try_from(12 + 8 + json.len() + 8 + binary.len()).ok()?;
    let mut bytes = Vec::with_capacity(length as usize);
    bytes.extend_from_slice(b"glTF");
    bytes.extend_from_slice(&2_u32.to_le_bytes());
    bytes.extend_from_slice(&length.to_le_bytes());
    for (kind, chunk) in [(b"JSON", &json), (b"BIN\0", &binary)] {
        bytes.extend_from_slice(&(chunk.len() as u32).to_le_bytes());
        bytes.extend_from_slice(kind);
        bytes.extend_from_slice(chunk);
    }
    Some(bytes)
}

const ARRAY_BUFFER: u32 = 34_962;
const ELEMENT_ARRAY_BUFFER: u32 = 34_963;
const U32: u32 = 5_125;
const F32: u32 = 5_126;

/// Collects the binary chunk and the tables that point into it.
#[derive(Default)]
struct Writer {
    binary: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    meshes: Vec<Value>,
    images: Vec<Value>,
}

impl Writer {
    /// Appends bytes, aligned to eight so that doubles may be read in place.
    fn view(&mut self, bytes: &[u8], target: Option<u32>) -> usize {
        self.binary.resize(self.binary.len().next_multiple_of(8), 0);
        let mut view = json!({
            "buffer": 0,
            "byteOffset": self.binary.len(),
            "byteLength": bytes.len(),
        });
        if let Some(target) = target {
            view["target"] = target.into();
        }
        self.binary.extend_from_slice(bytes);
        self.views.push(view);
        self.views.len() - 1
    }

    fn floats<const N: usize>(&mut self, values: &[[f32; N]]) -> usize {
        let flat: Vec<u8> = values
            .as_flattened()
            .iter()
            .flat_map(|v| v.to_le_bytes())
            .collect();
        let view = self.view(&flat, Some(ARRAY_BUFFER));
        let kind = ["SCALAR", "VEC2", "VEC3"][N - 1];
        self.accessors.push(json!({
            "bufferView": view,
            "componentType": F32,
            "count": values.len(),
            "type": kind,
        }));
        self.accessors.len() - 1
    }

    fn part(&mut self, part: &GlbPart<'_>) {
        let mesh = part.mesh;
        let Corners { vertices, indices } = split_at_seams(mesh, part.texture.is_some());
        let per_corner = |f: &dyn Fn(usize) -> [f32; 3]| -> Vec<[f32; 3]> {
            vertices.iter().map(|c| f(c[0] as usize)).collect()
        };
        let positions = per_corner(&|v| mesh.positions[v].coords.map(|x| x as f32).into());
        let normals = mesh.vertex_normals();
        let normals = per_corner(&|v| normals[v].map(|x| x as f32).into());
        let mut attributes = Map::new();
        let position = self.floats(&positions);
        for (name, start, pick) in [
            ("min", f32::INFINITY, f32::min as fn(f32, f32) -> f32),
            ("max", f32::NEG_INFINITY, f32::max),
        ] {
            let bound: [f32; 3] =
                std::array::from_fn(|k| positions.iter().map(|p| p[k]).fold(start, pick));
            self.accessors[position][name] = json!(bound);
        }
        attributes.insert("POSITION".to_owned(), position.into());
        attributes.insert("NORMAL".to_owned(), self.floats(&normals).into());
        if part.texture.is_some() {
            let texcoords: Vec<[f32; 2]> = vertices
                .iter()
                .map(|c| {
                    mesh.texcoords
                        .get(c[1] as usize)
                        .copied()
                        .unwrap_or_default()
                })
                .map(|[u, v]| [u, 1.0 - v])
                .collect();
            attributes.insert("TEXCOORD_0".to_owned(), self.floats(&texcoords).into());
        } else if !mesh.colors.is_empty() {
            let colors = per_corner(&|v| mesh.colors[v]);
            attributes.insert("COLOR_0".to_owned(), self.floats(&colors).into());
        }
        let origins: Vec<[f32; 1]> = vertices.iter().map(|c| [c[0] as f32]).collect();
        attributes.insert("_VERTEX".to_owned(), self.floats(&origins).into());

        let flat: Vec<u8> = indices.iter().flat_map(|i| i.to_le_bytes()).collect();
        let view = self.view(&flat, Some(ELEMENT_ARRAY_BUFFER));
        self.accessors.push(json!({
            "bufferView": view,
            "componentType": U32,
            "count": indices.len(),
            "type": "SCALAR",
        }));
        self.meshes.push(json!({
            "name": part.name,
            "primitives": [{
                "attributes": attributes,
                "indices": self.accessors.len() - 1,
                "material": self.meshes.len(),
            }],
        }));
    }
}

/// Vertices of a mesh with one texture coordinate each.
struct Corners {
    /// Vertex and texture coordinate, by first use.
    vertices: Vec<[u32; 2]>,
    /// Three indices in `vertices` per triangle.
    indices: Vec<u32>,
}

fn split_at_seams(mesh: &Mesh, with_texcoords: bool) -> Corners {
    let mut index_of: HashMap<[u32; 2], u32> = HashMap::with_capacity(mesh.positions.len());
    let mut vertices = Vec::with_capacity(mesh.positions.len());
    let mut indices = Vec::with_capacity(3 * mesh.triangles.len());
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        let texcoords = match mesh.texcoord_triangles.get(t) {
            Some(texcoords) if with_texcoords => *texcoords,
            _ => [0; 3],
        };
        for (v, texcoord) in triangle.iter().zip(texcoords) {
            let corner = [*v, texcoord];
            indices.push(*index_of.entry(corner).or_insert_with(|| {
                vertices.push(corner);
                vertices.len() as u32 - 1
            }));
        }
    }
    Corners { vertices, indices }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::{ScanOptions, parse_scan};
    use crate::{Point3, Segment};

    /// Two triangles that share an edge in space but not in the texture.
    fn seam() -> Mesh {
        Mesh {
            positions: [
                [0.0, 0.0, 0.25],
                [10.0, 0.0, 0.0],
                [10.0, 10.0, 0.0],
                [0.0, 10.0, 0.0],
            ]
            .map(Point3::from)
            .to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            texcoords: vec![
                [0.0, 0.0],
                [0.5, 0.0],
                [0.5, 0.5],
                [0.5, 0.5],
                [1.0, 1.0],
                [0.5, 1.0],
            ],
            texcoord_triangles: vec![[0, 1, 2], [3, 4, 5]],
            ..Mesh::default()
        }
    }

    fn file() -> Vec<u8> {
        let texture = Texture::new(2, 2, vec![[10; 3], [20; 3], [30; 3], [40; 3]]);
        let mesh = seam();
        let glb = Glb {
            parts: vec![GlbPart {
                name: "nose",
                mesh: &mesh,
                texture: Some(0),
            }],
            textures: vec![GlbTexture {
                name: "skin",
                texture: &texture,
                packing: Packing::Png,
            }],
            extras: Map::new(),
            blocks: vec![("numbers", vec![1, 2, 3])],
        };
        glb.to_bytes(Path::new("a.glb")).expect("valid")
    }

    #[test]
    fn what_is_written_is_read_again_in_mm_and_joined_at_seams() {
        let scan = parse_scan(&file(), Path::new("a.glb"), &ScanOptions::default()).expect("valid");
        let mesh = seam();
        assert_eq!(scan.mesh.positions, mesh.positions);
        assert_eq!(scan.mesh.triangles, mesh.triangles);
        let corners = |m: &Mesh| -> Vec<[[f32; 2]; 3]> {
            let corner = |t: &[u32; 3]| t.map(|c| m.texcoords[c as usize]);
            m.texcoord_triangles.iter().map(corner).collect()
        };
        assert_eq!(corners(&scan.mesh), corners(&mesh));
        assert_eq!(scan.groups, ["nose"]);
        assert_eq!(scan.mesh.segments, [Segment::Nose; 2]);
        assert_eq!(scan.texture.expect("texture").texel(1, 1), [40; 3]);
        assert!(scan.notices.is_empty(), "{:?}", scan.notices);
    }

    #[test]
    fn another_reader_finds_the_file_valid() {
        let file = file();
        let gltf = gltf::Gltf::from_slice(&file).expect("valid glTF 2.0");
        let blob = gltf.blob.as_deref().expect("binary chunk");
        let primitive = gltf
            .meshes()
            .next()
            .and_then(|m| m.primitives().next())
            .expect("a primitive");
        let reader = primitive.reader(|_| Some(blob));
        assert_eq!(reader.read_positions().expect("positions").count(), 6);
        assert_eq!(
            reader.read_indices().expect("indices").into_u32().count(),
            6
        );
        let normal = reader.read_normals().expect("normals").next().expect("one");
        assert!(normal[2] > 0.99);
        assert_eq!(
            gltf.nodes().next().map(|n| n.transform().decomposed().2),
            Some([0.001; 3])
        );
        assert_eq!(file.len() % 4, 0);
    }

    #[test]
    fn the_same_content_gives_the_same_bytes() {
        assert_eq!(file(), file());
    }
}
