//! The reference head: topology, annotations and mean shape that every subject shares.
//!
//! A control cage of quads carries the annotations of physics; one level of Catmull-Clark subdivision gives the fine
//! mesh that is registered and rendered. Cage vertex `i` and fine vertex `i` are the same place. The files are in
//! `assets/reference`, see `assets/README.md`; read next [`crate::subdivision`] and [`crate::subject`].

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::OnceLock;

use serde::Deserialize;

use crate::assets::{self, Files};
use crate::io::decode_texture;
use crate::io::obj::{NO_TEXCOORD, ObjFile};
use crate::subdivision::{Subdivision, catmull_clark};
use crate::{
    CoreError, Eye, LandmarkScheme, Mesh, Point3, Segment, Similarity3, SurfacePoint, Texture,
    UnitQuaternion,
};

/// How a cage vertex takes part in the physics.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Simulated skin.
    Free,
    /// Moves with skull and jaw only: scalp, ears, back, lower neck.
    Fixed,
    /// Follows its neighbours smoothly: inner mouth, inside of the eye sockets.
    Passive,
}

/// The control cage: quads and what physics needs to know of each vertex.
#[derive(Clone, Debug)]
pub struct Cage {
    /// Faces, counter-clockwise seen from outside.
    pub faces: Vec<Vec<u32>>,
    /// Mean shape, mm, head frame.
    pub positions: Vec<Point3>,
    /// Part in the physics, per vertex.
    pub roles: Vec<Role>,
    /// Weight in `[0, 1]` of the mandible's motion for what lies under each vertex.
    pub jaw: Vec<f64>,
    /// Weight in `[-1, 1]` of the tarsal plate's motion: positive on the upper lid, negative on the lower.
    pub lid: Vec<f64>,
    /// Tissue between skin and skull, mm.
    pub thickness: Vec<f64>,
    /// Whether the fascia is attached to the skull.
    pub attached: Vec<bool>,
    /// The vertex on the other side of the mid-plane.
    pub mirror: Vec<u32>,
}

/// A rigid part that skull or jaw carries.
#[derive(Clone, Debug)]
pub struct Part {
    /// What it is: an eye, a row of teeth, the tongue.
    pub segment: Segment,
    /// Its surface in the reference head's frame, mm.
    pub mesh: Mesh,
}

/// The jaw's hinge.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JawHinge {
    /// Centre of the left condyle, mm.
    pub hinge_left: Point3,
    /// Centre of the right condyle, mm.
    pub hinge_right: Point3,
}

/// The reference head.
#[derive(Clone, Debug)]
pub struct ReferenceHead {
    /// Cage with the annotations of physics.
    pub cage: Cage,
    /// Fine vertices from cage vertices.
    pub subdivision: Subdivision,
    /// Mean head: the subdivided cage as triangles, two per fine quad, with texture coordinates and segments.
    pub mesh: Mesh,
    /// Eyeballs, teeth, tongue.
    pub parts: Vec<Part>,
    /// Left and right eye of the mean head.
    pub eyes: [Eye; 2],
    /// The jaw's axis in the mean head.
    pub jaw: JawHinge,
    /// Landmark schemes.
    pub landmarks: Vec<LandmarkScheme>,
    /// Mean skin in the reference UV.
    pub texture: Texture,
    /// Textures of the eye parts, by colour.
    pub eye_textures: BTreeMap<String, Texture>,
    /// Texture of teeth, gums and tongue.
    pub mouth_texture: Texture,
}

#[derive(Deserialize)]
struct HeadToml {
    jaw: JawHinge,
    eyes: EyesToml,
}

#[derive(Deserialize)]
struct EyesToml {
    left: Eye,
    right: Eye,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SchemeToml {
    points: Vec<Point3>,
    /// Classes that single points must lie on, by their number: the lips touch, and the nearest point alone does not
    /// say which of them is meant.
    #[serde(default)]
    on: BTreeMap<String, Vec<usize>>,
}

impl ReferenceHead {
    /// The head that ships with the program. Built once per process.
    ///
    /// # Panics
    /// If the embedded files are damaged; a test reads them.
    pub fn embedded() -> &'static Self {
        static HEAD: OnceLock<ReferenceHead> = OnceLock::new();
        HEAD.get_or_init(|| {
            Self::from_files(&Files::embedded()).expect("the embedded reference head is tested")
        })
    }

    /// A head from a folder laid out as `assets/reference`.
    ///
    /// # Errors
    /// [`CoreError`] with the file and place of what is wrong.
    pub fn load(dir: &Path) -> Result<Self, CoreError> {
        Self::from_files(&Files::read(dir)?)
    }

    /// The landmark scheme of that name.
    ///
    /// # Errors
    /// [`CoreError::UnknownName`] with the known schemes.
    pub fn scheme(&self, name: &str) -> Result<&LandmarkScheme, CoreError> {
        self.landmarks
            .iter()
            .find(|s| s.name == name)
            .ok_or_else(|| CoreError::UnknownName {
                kind: "landmark scheme",
                name: name.to_owned(),
                known: self
                    .landmarks
                    .iter()
                    .map(|s| s.name.as_str())
                    .collect::<Vec<_>>()
                    .join(", "),
            })
    }

    /// Digest of what ties a stored subject to this head: its triangles and texture coordinates, in hexadecimal.
    pub fn topology_digest(&self) -> String {
        let mut hasher = blake3::Hasher::new();
        let mut add = |values: &mut dyn Iterator<Item = u32>| {
            let bytes: Vec<u8> = values.flat_map(u32::to_le_bytes).collect();
            hasher.update(&(bytes.len() as u64).to_le_bytes());
            hasher.update(&bytes);
        };
        let mesh = &self.mesh;
        add(&mut std::iter::once(mesh.positions.len() as u32));
        add(&mut mesh.triangles.as_flattened().iter().copied());
        add(&mut mesh.texcoord_triangles.as_flattened().iter().copied());
        add(&mut mesh.texcoords.as_flattened().iter().map(|v| v.to_bits()));
        hasher.finalize().to_hex().to_string()
    }

    /// Where a rigid part lies on a head with these eyes and this skull, from its place here.
    pub(crate) fn part_place(
        &self,
        part: Segment,
        eyes: &[Eye; 2],
        skull_from_reference: &Similarity3,
    ) -> Similarity3 {
        let side = match part {
            Segment::LeftEye | Segment::LeftIris => 0,
            Segment::RightEye | Segment::RightIris => 1,
            _ => return *skull_from_reference,
        };
        let (own, mean) = (&eyes[side], &self.eyes[side]);
        let scale = own.radius / mean.radius;
        let shift = own.center.coords - mean.center.coords * scale;
        Similarity3::from_parts(shift.into(), UnitQuaternion::identity(), scale)
    }

    fn from_files(files: &Files) -> Result<Self, CoreError> {
        let path = Path::new("head.obj");
        let obj = ObjFile::parse(&files.head_obj, path)?;
        let cage = read_cage(&obj, &files.head_vertices_csv)?;
        let subdivision = catmull_clark(cage.positions.len(), &cage.faces);
        let mesh = fine_mesh(&obj, path, &cage, &subdivision)?;
        mesh.validate(path)?;
        let head: HeadToml = assets::parse_toml(&files.head_toml, "head.toml")?;
        let schemes: BTreeMap<String, SchemeToml> =
            assets::parse_toml(&files.landmarks_toml, "landmarks.toml")?;
        let landmarks = schemes
            .into_iter()
            .map(|(name, scheme)| {
                let points = snap(&mesh, &scheme)?;
                Ok(LandmarkScheme { name, points })
            })
            .collect::<Result<_, CoreError>>()?;
        let mut eye_textures = BTreeMap::new();
        for (name, bytes) in &files.eye_textures {
            eye_textures.insert(name.clone(), decode_texture(bytes, name.as_ref())?);
        }
        Ok(Self {
            parts: read_parts(&files.parts_obj)?,
            eyes: [head.eyes.left, head.eyes.right],
            jaw: head.jaw,
            landmarks,
            texture: decode_texture(&files.skin, Path::new("skin.jpg"))?,
            eye_textures,
            mouth_texture: decode_texture(&files.mouth, Path::new("mouth.png"))?,
            cage,
            subdivision,
            mesh,
        })
    }
}

/// Snaps landmark positions onto the outer skin, or onto the class that the file names for them.
fn snap(mesh: &Mesh, scheme: &SchemeToml) -> Result<Vec<SurfacePoint>, CoreError> {
    let mut wanted = vec![None; scheme.points.len()];
    for (name, points) in &scheme.on {
        let segment = Segment::from_name(name)?;
        for &i in points {
            *wanted.get_mut(i).ok_or(CoreError::SizeMismatch {
                what: "landmark number under `on`, highest",
                expected: scheme.points.len().saturating_sub(1),
                got: i,
            })? = Some(segment);
        }
    }
    let outer = |s: Segment| !matches!(s, Segment::InnerMouth | Segment::EyeSocket);
    let points = scheme
        .points
        .iter()
        .zip(&wanted)
        .filter_map(|(p, segment)| {
            SurfacePoint::nearest(mesh, p, |s| segment.map_or(outer(s), |wanted| s == wanted))
        });
    Ok(points.collect())
}

fn read_cage(obj: &ObjFile, csv: &str) -> Result<Cage, CoreError> {
    let n = obj.positions.len();
    let mut cage = Cage {
        faces: obj
            .polygons
            .iter()
            .map(|p| obj.corners_of(p).iter().map(|c| c[0]).collect())
            .collect(),
        positions: obj.positions.clone(),
        roles: Vec::with_capacity(n),
        jaw: Vec::with_capacity(n),
        lid: Vec::with_capacity(n),
        thickness: Vec::with_capacity(n),
        attached: Vec::with_capacity(n),
        mirror: Vec::with_capacity(n),
    };
    for (i, line) in csv.lines().enumerate().skip(1) {
        let bad = || CoreError::Format {
            path: "head_vertices.csv".into(),
            place: Some(format!("line {}", i + 1)),
            reason: format!("expected role,jaw,lid,thickness_mm,attached,mirror, found `{line}`"),
        };
        let fields: Vec<&str> = line.split(',').collect();
        let [role, jaw, lid, thickness, attached, mirror] = fields[..] else {
            return Err(bad());
        };
        cage.roles.push(match role {
            "free" => Role::Free,
            "fixed" => Role::Fixed,
            "passive" => Role::Passive,
            _ => return Err(bad()),
        });
        cage.jaw.push(jaw.parse().map_err(|_| bad())?);
        cage.lid.push(lid.parse().map_err(|_| bad())?);
        cage.thickness.push(thickness.parse().map_err(|_| bad())?);
        cage.attached.push(attached == "1");
        cage.mirror.push(
            mirror
                .parse()
                .ok()
                .filter(|&m: &u32| (m as usize) < n)
                .ok_or_else(bad)?,
        );
    }
    if cage.roles.len() != n {
        return Err(CoreError::SizeMismatch {
            what: "rows of head_vertices.csv",
            expected: n,
            got: cage.roles.len(),
        });
    }
    Ok(cage)
}

fn group_segment(
    obj: &ObjFile,
    path: &Path,
    group: Option<u32>,
    line: u32,
) -> Result<Segment, CoreError> {
    let name = group.map_or("", |g| obj.groups[g as usize].as_str());
    Segment::from_name(name).map_err(|e| CoreError::Format {
        path: path.to_owned(),
        place: Some(format!("line {line}")),
        reason: e.to_string(),
    })
}

/// Texture coordinates of subdivided faces: corners, edge midpoints and face centres, shared where the cage shares.
struct FineTexcoords<'a> {
    obj: &'a ObjFile,
    texcoords: Vec<[f32; 2]>,
    midpoints: BTreeMap<(u32, u32), u32>,
}

impl FineTexcoords<'_> {
    fn midpoint(&mut self, a: u32, b: u32) -> u32 {
        let (a, b) = (a.min(b), a.max(b));
        *self.midpoints.entry((a, b)).or_insert_with(|| {
            let (p, q) = (
                self.obj.texcoords[a as usize],
                self.obj.texcoords[b as usize],
            );
            self.texcoords
                .push([p[0].midpoint(q[0]), p[1].midpoint(q[1])]);
            (self.texcoords.len() - 1) as u32
        })
    }

    fn center(&mut self, corners: &[u32]) -> u32 {
        let mean = |k: usize| {
            corners
                .iter()
                .map(|&c| self.obj.texcoords[c as usize][k])
                .sum::<f32>()
                / corners.len() as f32
        };
        let center = [mean(0), mean(1)];
        self.texcoords.push(center);
        (self.texcoords.len() - 1) as u32
    }
}

fn fine_mesh(
    obj: &ObjFile,
    path: &Path,
    cage: &Cage,
    subdivision: &Subdivision,
) -> Result<Mesh, CoreError> {
    let coords: Vec<_> = cage.positions.iter().map(|p| p.coords).collect();
    let fine = subdivision.stencils.apply(&coords, crate::Vector3::zeros());
    let mut mesh = Mesh {
        positions: fine.into_iter().map(Point3::from).collect(),
        ..Mesh::default()
    };
    let mut uv = FineTexcoords {
        obj,
        texcoords: obj.texcoords.clone(),
        midpoints: BTreeMap::new(),
    };
    let mut quads = subdivision.quads.iter();
    for polygon in &obj.polygons {
        let segment = group_segment(obj, path, polygon.group, polygon.line)?;
        let corners: Vec<u32> = obj.corners_of(polygon).iter().map(|c| c[1]).collect();
        if corners.contains(&NO_TEXCOORD) {
            let place = Some(format!("line {}", polygon.line));
            let reason = "every corner needs a texture coordinate".to_owned();
            return Err(CoreError::Format {
                path: path.to_owned(),
                place,
                reason,
            });
        }
        let center = uv.center(&corners);
        for (k, &corner) in corners.iter().enumerate() {
            let next = uv.midpoint(corner, corners[(k + 1) % corners.len()]);
            let previous = uv.midpoint(corners[(k + corners.len() - 1) % corners.len()], corner);
            if let Some(&[a, b, c, d]) = quads.next() {
                mesh.triangles.extend([[a, b, c], [a, c, d]]);
                mesh.texcoord_triangles
                    .extend([[corner, next, center], [corner, center, previous]]);
                mesh.segments.extend([segment; 2]);
            }
        }
    }
    mesh.texcoords = uv.texcoords;
    Ok(mesh)
}

fn read_parts(bytes: &[u8]) -> Result<Vec<Part>, CoreError> {
    let path = Path::new("parts.obj");
    let obj = ObjFile::parse(bytes, path)?;
    let mut parts: Vec<Part> = Vec::new();
    let mut remap: BTreeMap<u32, u32> = BTreeMap::new();
    for polygon in &obj.polygons {
        let segment = group_segment(&obj, path, polygon.group, polygon.line)?;
        if parts.last().is_none_or(|p| p.segment != segment) {
            parts.push(Part {
                segment,
                mesh: Mesh {
                    texcoords: obj.texcoords.clone(),
                    ..Mesh::default()
                },
            });
            remap.clear();
        }
        let Some(Part { mesh, .. }) = parts.last_mut() else {
            continue;
        };
        let corners: Vec<[u32; 2]> = obj
            .corners_of(polygon)
            .iter()
            .map(|&[v, t]| {
                let local = *remap.entry(v).or_insert_with(|| {
                    mesh.positions.push(obj.positions[v as usize]);
                    (mesh.positions.len() - 1) as u32
                });
                [local, t]
            })
            .collect();
        for k in 1..corners.len() - 1 {
            let [a, b, c] = [corners[0], corners[k], corners[k + 1]];
            mesh.triangles.push([a[0], b[0], c[0]]);
            mesh.texcoord_triangles.push([a[1], b[1], c[1]]);
            mesh.segments.push(segment);
        }
    }
    for part in &parts {
        part.mesh.validate(path)?;
    }
    Ok(parts)
}
