//! glTF 2.0 files as scans: nodes with their transforms, primitives merged, base colour textures.
//!
//! Vertices that were doubled along texture seams are joined again where their positions are equal in every bit, since
//! a scan's surface is one. Files that Facile wrote, known by `asset.extras.facile`, come back in mm.

use std::collections::HashMap;
use std::path::Path;

use nalgebra::{Matrix3, Matrix4, Quaternion, UnitQuaternion, Vector3};

use super::draft::{Draft, Paint, check_count};
use super::folder::{Folder, shown};
use super::gltf_accessor::{Buffers, read_uri};
use super::gltf_json::{Document, KNOWN_EXTENSIONS, Node, Primitive, TextureInfo};
use super::picture::decode_texture_at;
use crate::{CoreError, Point3};

/// Deepest nesting of nodes.
const MAX_DEPTH: usize = 1_000;

/// A parsed container: the JSON document and the binary chunk of a GLB.
pub(crate) struct Container<'a> {
    pub(crate) document: Document,
    pub(crate) binary: Option<&'a [u8]>,
}

/// Splits a GLB into its chunks, or takes the whole file as JSON, and checks version and required extensions.
pub(crate) fn open<'a>(bytes: &'a [u8], path: &Path) -> Result<Container<'a>, CoreError> {
    let (json, binary) = if bytes.starts_with(b"glTF") {
        split_chunks(bytes, path)?
    } else {
        (bytes, None)
    };
    let document: Document = serde_json::from_slice(json).map_err(|e| {
        let reason = format!("the glTF document cannot be read: {e}");
        CoreError::format(path, None, reason)
    })?;
    if !document.asset.version.starts_with("2.") {
        let version = shown(&document.asset.version);
        let reason = format!("expected glTF version 2, found `{version}`");
        return Err(CoreError::format(path, None, reason));
    }
    let unknown = document
        .extensions_required
        .iter()
        .find(|e| !KNOWN_EXTENSIONS.contains(&e.as_str()));
    if let Some(extension) = unknown {
        let reason = format!(
            "needs the glTF extension `{}`, which is not supported",
            shown(extension)
        );
        return Err(CoreError::format(path, None, reason));
    }
    Ok(Container { document, binary })
}

fn split_chunks<'a>(
    bytes: &'a [u8],
    path: &Path,
) -> Result<(&'a [u8], Option<&'a [u8]>), CoreError> {
    let bad = |reason: String| CoreError::format(path, None, reason);
    let word = |at: usize| {
        let word = bytes.get(at..at + 4).and_then(|w| w.first_chunk::<4>());
        word.map(|w| u32::from_le_bytes(*w) as usize)
            .ok_or_else(|| bad("the file ends early, inside its header".to_owned()))
    };
    let (version, length) = (word(4)?, word(8)?);
    if version != 2 {
        return Err(bad(format!("expected GLB version 2, found {version}")));
    }
    if length > bytes.len() {
        let found = bytes.len();
        return Err(bad(format!(
            "the file ends early: expected {length} bytes, found {found}"
        )));
    }
    let (mut json, mut binary) = (None, None);
    let mut at = 12;
    while at < length {
        let (size, kind) = (word(at)?, word(at + 4)?);
        let chunk = bytes.get(at + 8..at + 8 + size);
        let chunk = chunk.ok_or_else(|| bad("the file ends early, inside a chunk".to_owned()))?;
        match kind {
            0x4E4F_534A if json.is_none() => json = Some(chunk),
            0x004E_4942 if binary.is_none() => binary = Some(chunk),
            _ => {}
        }
        at += 8 + size.next_multiple_of(4);
    }
    let json = json.ok_or_else(|| bad("the file has no JSON chunk".to_owned()))?;
    Ok((json, binary))
}

/// Reads a glTF or GLB file.
pub(crate) fn read(bytes: &[u8], path: &Path, folder: &Folder) -> Result<Draft, CoreError> {
    let Container { document, binary } = open(bytes, path)?;
    let mut draft = Draft::default();
    let buffers = Buffers::load(&document, binary, path, folder, &mut draft.notices)?;
    let placed = placed_meshes(&document, path)?;
    if !document.skins.is_empty() {
        let notice = "skins are not read; the mesh is taken in its bind pose";
        draft.notices.push(notice.to_owned());
    }
    let mut reader = Reader {
        path,
        document: &document,
        buffers,
        draft,
        vertex_at: HashMap::new(),
        has_colors: true,
    };
    for (node, mesh, transform) in placed {
        reader.mesh(node, mesh, &transform)?;
    }
    reader.paint(folder)?;
    let mut draft = reader.draft;
    if !reader.has_colors {
        draft.mesh.colors.clear();
    }
    if draft
        .mesh
        .texcoord_triangles
        .iter()
        .all(|t| *t == [u32::MAX; 3])
    {
        draft.mesh.texcoord_triangles.clear();
    }
    Ok(draft)
}

/// Node, mesh and transform of every placed mesh of the default scene.
type PlacedMesh = (usize, usize, Matrix4<f64>);

fn placed_meshes(document: &Document, path: &Path) -> Result<Vec<PlacedMesh>, CoreError> {
    let nodes = &document.nodes;
    let scene = document.scenes.get(document.scene.unwrap_or(0));
    let roots: Vec<usize> = if let Some(scene) = scene {
        scene.nodes.clone()
    } else {
        let mut has_parent = vec![false; nodes.len()];
        for child in nodes.iter().flat_map(|n| &n.children) {
            if let Some(flag) = has_parent.get_mut(*child) {
                *flag = true;
            }
        }
        (0..nodes.len()).filter(|i| !has_parent[*i]).collect()
    };
    // A file of Facile's is in metres by its root's scale of 0.001, as glTF wants; mm come back exactly.
    let is_ours = document.asset.extras["facile"]["unit"] == "mm";
    let unit = if is_ours { 1000.0 } else { 1.0 };
    let root = Matrix4::new_scaling(unit);
    let mut placed = Vec::new();
    let mut visited = vec![false; nodes.len()];
    let mut stack: Vec<(usize, Matrix4<f64>, usize)> =
        roots.iter().rev().map(|r| (*r, root, 0)).collect();
    while let Some((index, parent, depth)) = stack.pop() {
        let bad = |reason: String| CoreError::format(path, Some(format!("node {index}")), reason);
        let node = nodes
            .get(index)
            .ok_or_else(|| bad(format!("the file has {} nodes", nodes.len())))?;
        if visited[index] || depth > MAX_DEPTH {
            return Err(bad("the nodes do not form a tree".to_owned()));
        }
        visited[index] = true;
        let transform = parent * local_transform(node);
        if !transform.iter().all(|v| v.is_finite()) {
            return Err(bad("the transform is not finite".to_owned()));
        }
        if let Some(mesh) = node.mesh {
            placed.push((index, mesh, transform));
        }
        stack.extend(
            node.children
                .iter()
                .rev()
                .map(|c| (*c, transform, depth + 1)),
        );
    }
    Ok(placed)
}

fn local_transform(node: &Node) -> Matrix4<f64> {
    if let Some(columns) = node.matrix {
        return Matrix4::from_column_slice(&columns);
    }
    let [x, y, z, w] = node.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]);
    let rotation = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-12);
    let rotation = rotation.unwrap_or_else(UnitQuaternion::identity);
    let translation = Vector3::from(node.translation.unwrap_or_default());
    let scale = Vector3::from(node.scale.unwrap_or([1.0; 3]));
    Matrix4::new_translation(&translation)
        * rotation.to_homogeneous()
        * Matrix4::new_nonuniform_scaling(&scale)
}

struct Reader<'a> {
    path: &'a Path,
    document: &'a Document,
    buffers: Buffers<'a>,
    draft: Draft,
    /// First vertex of each position.
    vertex_at: HashMap<[u64; 3], u32>,
    /// Whether every primitive so far has vertex colours.
    has_colors: bool,
}

impl Reader<'_> {
    fn mesh(
        &mut self,
        node: usize,
        index: usize,
        transform: &Matrix4<f64>,
    ) -> Result<(), CoreError> {
        let meshes = &self.document.meshes;
        let mesh = meshes.get(index).ok_or_else(|| {
            let reason = format!("mesh {index} of {}", meshes.len());
            CoreError::format(self.path, Some(format!("node {node}")), reason)
        })?;
        let name = self.document.nodes[node]
            .name
            .as_ref()
            .or(mesh.name.as_ref());
        let name = name.cloned().unwrap_or_else(|| format!("mesh_{index}"));
        let groups = &mut self.draft.groups;
        let group = groups.iter().position(|g| *g == name).unwrap_or_else(|| {
            groups.push(name);
            groups.len() - 1
        });
        for (k, primitive) in mesh.primitives.iter().enumerate() {
            let place = format!("mesh {index}, primitive {k}");
            self.primitive(primitive, transform, &place)?;
            let n = self.draft.mesh.triangles.len();
            self.draft.triangle_groups.resize(n, group as u32);
        }
        Ok(())
    }

    fn primitive(
        &mut self,
        primitive: &Primitive,
        transform: &Matrix4<f64>,
        place: &str,
    ) -> Result<(), CoreError> {
        let path = self.path;
        let bad = |reason: String| CoreError::format(path, Some(place.to_owned()), reason);
        let mode = primitive.mode.unwrap_or(4);
        if !matches!(mode, 4..=6) {
            let notice = format!("{place}: points and lines are not read");
            self.draft.notices.push(notice);
            return Ok(());
        }
        if !primitive.targets.is_empty() {
            let notice = format!("{place}: morph targets are not read");
            self.draft.notices.push(notice);
        }
        let positions = primitive.attributes.get("POSITION");
        let positions = positions.ok_or_else(|| bad("has no positions".to_owned()))?;
        let positions = self.buffers.read::<3>(*positions)?;
        let count = positions.len();
        let indices = match primitive.indices {
            Some(accessor) => self.buffers.indices(accessor)?,
            None => (0..count as u32).collect(),
        };
        if let Some((k, v)) = indices
            .iter()
            .enumerate()
            .find(|(_, v)| **v as usize >= count)
        {
            return Err(bad(format!(
                "vertex index {v} (number {k}) is out of range, the primitive has {count} vertices"
            )));
        }
        let vertices = self.vertices(&positions, transform, place)?;
        self.colors(primitive, &vertices, &bad)?;
        let first_texcoord = self.texcoords(primitive, count, &bad)?;
        let mirrored = transform.fixed_view::<3, 3>(0, 0).determinant() < 0.0;
        let material = primitive.material.map_or(u32::MAX, |m| m as u32);
        for mut corners in triangles_of(&indices, mode) {
            if mirrored {
                corners.swap(1, 2);
            }
            let mesh = &mut self.draft.mesh;
            mesh.triangles.push(corners.map(|v| vertices[v as usize]));
            let texcoord = |v: u32| first_texcoord.map_or(u32::MAX, |first| first + v);
            mesh.texcoord_triangles.push(corners.map(texcoord));
            self.draft.triangle_materials.push(material);
        }
        check_count("triangles", self.draft.mesh.triangles.len(), path)
    }

    /// Places vertices in the scene; returns the index of each in the draft.
    fn vertices(
        &mut self,
        positions: &[[f64; 3]],
        transform: &Matrix4<f64>,
        place: &str,
    ) -> Result<Vec<u32>, CoreError> {
        let linear: Matrix3<f64> = transform.fixed_view::<3, 3>(0, 0).into_owned();
        let shift: Vector3<f64> = transform.fixed_view::<3, 1>(0, 3).into_owned();
        let is_identity = *transform == Matrix4::identity();
        let mesh = &mut self.draft.mesh;
        check_count(
            "vertices",
            mesh.positions.len() + positions.len(),
            self.path,
        )?;
        let mut vertices = Vec::with_capacity(positions.len());
        for (i, position) in positions.iter().enumerate() {
            let position = Vector3::from(*position);
            if !position.iter().all(|v| v.is_finite()) {
                let [x, y, z] = [position.x, position.y, position.z];
                let reason = format!("coordinates must be finite, found {x} {y} {z}");
                let place = format!("{place}, vertex {i}");
                return Err(CoreError::format(self.path, Some(place), reason));
            }
            let placed = if is_identity {
                position
            } else {
                linear * position + shift
            };
            // -0 and 0 are one place.
            let key = [placed.x, placed.y, placed.z].map(|v| (v + 0.0).to_bits());
            let vertex = *self.vertex_at.entry(key).or_insert_with(|| {
                mesh.positions.push(Point3::from(placed));
                mesh.positions.len() as u32 - 1
            });
            vertices.push(vertex);
        }
        Ok(vertices)
    }

    fn colors(
        &mut self,
        primitive: &Primitive,
        vertices: &[u32],
        bad: &impl Fn(String) -> CoreError,
    ) -> Result<(), CoreError> {
        let colors = match primitive.attributes.get("COLOR_0") {
            Some(accessor) if self.has_colors => self.buffers.read::<3>(*accessor)?,
            _ => {
                self.has_colors = false;
                return Ok(());
            }
        };
        if colors.len() != vertices.len() {
            let (got, expected) = (colors.len(), vertices.len());
            return Err(bad(format!("has {got} colours for {expected} vertices")));
        }
        let all = &mut self.draft.mesh.colors;
        let known = all.len();
        all.resize(self.draft.mesh.positions.len(), [0.0; 3]);
        for (&vertex, color) in vertices.iter().zip(&colors) {
            if vertex as usize >= known {
                all[vertex as usize] = color.map(|v| v.clamp(0.0, 1.0) as f32);
            }
        }
        Ok(())
    }

    /// Appends the texture coordinates that the primitive's material uses; returns the index of the first.
    fn texcoords(
        &mut self,
        primitive: &Primitive,
        count: usize,
        bad: &impl Fn(String) -> CoreError,
    ) -> Result<Option<u32>, CoreError> {
        let info = primitive.material.and_then(|m| self.base_color(m).1);
        let transform = info.as_ref().and_then(|i| i.extensions.transform.clone());
        let set = info.map_or(0, |i| i.tex_coord);
        let set = transform.as_ref().and_then(|t| t.tex_coord).unwrap_or(set);
        let Some(accessor) = primitive.attributes.get(&format!("TEXCOORD_{set}")) else {
            return Ok(None);
        };
        let texcoords = self.buffers.read::<2>(*accessor)?;
        if texcoords.len() != count {
            let got = texcoords.len();
            return Err(bad(format!(
                "has {got} texture coordinates for {count} vertices"
            )));
        }
        let all = &mut self.draft.mesh.texcoords;
        check_count("texture coordinates", all.len() + count, self.path)?;
        let first = all.len() as u32;
        all.extend(texcoords.iter().map(|uv| {
            let [u, v] = uv.map(|c| c as f32);
            let [u, v] = match &transform {
                None => [u, v],
                Some(t) => {
                    let ([sx, sy], [ox, oy]) =
                        (t.scale.unwrap_or([1.0; 2]), t.offset.unwrap_or_default());
                    let (sin, cos) = (libm::sinf(t.rotation), libm::cosf(t.rotation));
                    let (x, y) = (u * sx, v * sy);
                    [cos * x + sin * y + ox, cos * y - sin * x + oy]
                }
            };
            // glTF counts v downwards.
            [u, 1.0 - v]
        }));
        Ok(Some(first))
    }

    /// Linear base colour and its texture, of the metallic or the older specular model.
    fn base_color(&self, material: usize) -> (Option<[f32; 4]>, Option<TextureInfo>) {
        let Some(material) = self.document.materials.get(material) else {
            return (None, None);
        };
        if let Some(specular) = &material.extensions.specular_glossiness {
            return (specular.diffuse_factor, specular.diffuse_texture.clone());
        }
        match &material.pbr_metallic_roughness {
            Some(pbr) => (pbr.base_color_factor, pbr.base_color_texture.clone()),
            None => (None, None),
        }
    }

    /// Loads the textures of used materials.
    fn paint(&mut self, folder: &Folder) -> Result<(), CoreError> {
        let mut used = vec![false; self.document.materials.len()];
        for &m in &self.draft.triangle_materials {
            if m == u32::MAX {
                continue;
            }
            let count = used.len();
            *used.get_mut(m as usize).ok_or_else(|| {
                let reason = format!("the file has {count}");
                CoreError::format(self.path, Some(format!("material {m}")), reason)
            })? = true;
        }
        let mut loaded: HashMap<usize, usize> = HashMap::new();
        for (m, is_used) in used.into_iter().enumerate() {
            let (factor, info) = self.base_color(m);
            let color = factor.map(|[r, g, b, _]| [r, g, b].map(|v| v.clamp(0.0, 1.0)));
            let paint = match info {
                Some(info) if is_used => {
                    let image = self.image_of(&info, m)?;
                    let texture = if let Some(texture) = loaded.get(&image) {
                        *texture
                    } else {
                        let texture = self.load_image(image, folder)?;
                        self.draft.textures.push(texture);
                        loaded.insert(image, self.draft.textures.len() - 1);
                        self.draft.textures.len() - 1
                    };
                    Paint::Image {
                        texture,
                        factor: color.unwrap_or([1.0; 3]),
                    }
                }
                _ => color.map_or(Paint::Unknown, Paint::Color),
            };
            self.draft.materials.push(paint);
        }
        Ok(())
    }

    fn image_of(&self, info: &TextureInfo, material: usize) -> Result<usize, CoreError> {
        let texture = self.document.textures.get(info.index);
        let webp = texture.and_then(|t| t.extensions.webp.as_ref()?.source);
        webp.or(texture.and_then(|t| t.source))
            .filter(|image| *image < self.document.images.len())
            .ok_or_else(|| {
                let reason = format!("its texture {} has no image", info.index);
                CoreError::format(self.path, Some(format!("material {material}")), reason)
            })
    }

    fn load_image(&mut self, index: usize, folder: &Folder) -> Result<crate::Texture, CoreError> {
        let image = &self.document.images[index];
        let place = format!("image {index}");
        match (&image.uri, image.buffer_view) {
            (Some(uri), _) => {
                let notices = &mut self.draft.notices;
                let bytes = read_uri(uri, self.path, Some(place.clone()), folder, notices)?;
                decode_texture_at(&bytes, self.path, Some(&place))
            }
            (None, Some(view)) => {
                decode_texture_at(self.buffers.view(view)?.0, self.path, Some(&place))
            }
            (None, None) => {
                let reason = "has neither a file nor a buffer view";
                Err(CoreError::format(self.path, Some(place), reason))
            }
        }
    }
}

/// Triangles of a list (mode 4), a strip (5) or a fan (6).
fn triangles_of(indices: &[u32], mode: u32) -> Vec<[u32; 3]> {
    match mode {
        4 => indices
            .chunks_exact(3)
            .map(|t| [t[0], t[1], t[2]])
            .collect(),
        5 => indices
            .windows(3)
            .enumerate()
            .map(|(i, t)| {
                if i % 2 == 0 {
                    [t[0], t[1], t[2]]
                } else {
                    [t[1], t[0], t[2]]
                }
            })
            .collect(),
        _ => indices
            .windows(2)
            .skip(1)
            .map(|t| [indices[0], t[0], t[1]])
            .collect(),
    }
}
