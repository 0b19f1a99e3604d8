//! The parsers with files to begin from.

use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use facile::core::identity::IdentityModel;
use facile::core::io::glb::{Glb, GlbPart, GlbTexture, Packing};
use facile::core::io::{ScanOptions, decode_texture, parse_scan};
use facile::core::{Mesh, Point3, ReferenceHead, Subject, Texture};
use facile::flow::ScanLandmarks;
use facile::plan::Grid;
use facile::sim::{ExpressionSet, MuscleSet};
use facile::trace::SceneFile;
use facile::verify::verify;
use facile::{Error, Recipe};

/// A parser of files from outside.
pub(crate) struct Parser {
    pub(crate) name: &'static str,
    /// Parses, uses what comes of it, and says what came of it.
    pub(crate) parse: fn(&[u8]) -> String,
    pub(crate) seeds: fn() -> Vec<Vec<u8>>,
    /// Pieces that mean something.
    pub(crate) words: &'static [&'static str],
    /// Executions are fewer by this factor.
    pub(crate) cost: u64,
    /// Outcomes that the corpus and a few edits reach at least: edits that all end at the first check test nothing.
    pub(crate) least_outcomes: usize,
}

pub(crate) const PARSERS: [Parser; 13] = [
    Parser {
        name: "obj",
        parse: |bytes| scan("a.obj", bytes),
        seeds: || vec![OBJ.to_vec()],
        words: &[
            "v ", "vt ", "vn ", "f ", "g ", "o ", "usemtl ", "mtllib ", "\\\n", "//", "#",
        ],
        cost: 1,
        least_outcomes: 8,
    },
    Parser {
        name: "mtl",
        parse: mtl,
        seeds: || vec![MTL.to_vec()],
        words: &[
            "newmtl ", "map_Kd ", "Kd ", "-s ", "-o ", "-bm ", "../", "\\", "skin.png",
        ],
        cost: 1,
        least_outcomes: 3,
    },
    Parser {
        name: "ply",
        parse: |bytes| scan("a.ply", bytes),
        seeds: || vec![PLY.to_vec(), binary_ply()],
        words: &[
            "element ",
            "property ",
            "list ",
            "uchar ",
            "float ",
            "double ",
            "int ",
            "end_header\n",
            "format binary_big_endian 1.0",
            "vertex",
            "face",
            "comment TextureFile ",
        ],
        cost: 1,
        least_outcomes: 10,
    },
    Parser {
        name: "glb",
        parse: |bytes| scan("a.glb", bytes),
        seeds: || vec![glb().to_vec()],
        words: JSON_WORDS,
        cost: 1,
        least_outcomes: 6,
    },
    Parser {
        name: "gltf",
        parse: |bytes| scan("a.gltf", bytes),
        seeds: || vec![gltf()],
        words: JSON_WORDS,
        cost: 1,
        least_outcomes: 8,
    },
    Parser {
        name: "subject",
        parse: |bytes| {
            said(Subject::from_glb(
                bytes,
                Path::new("a.glb"),
                ReferenceHead::embedded(),
            ))
        },
        seeds: || vec![glb().to_vec()],
        words: JSON_WORDS,
        cost: 1,
        least_outcomes: 3,
    },
    Parser {
        name: "image",
        parse: |bytes| said(decode_texture(bytes, Path::new("a.png")).map(|t| t.width() > 0)),
        seeds: images,
        words: &[
            "IHDR", "IDAT", "PLTE", "tRNS", "IEND", "VP8L", "VP8 ", "VP8X", "RIFF", "BM",
        ],
        cost: 1,
        least_outcomes: 5,
    },
    Parser {
        name: "recipe",
        parse: recipe,
        seeds: || {
            vec![
                RECIPE.as_bytes().to_vec(),
                include_bytes!("../../dataset.toml").to_vec(),
            ]
        },
        words: TOML_WORDS,
        cost: 1,
        least_outcomes: 15,
    },
    Parser {
        name: "scene",
        parse: |bytes| {
            said(
                SceneFile::parse(&text(bytes), Path::new("s.toml")).and_then(|file| {
                    let _ = (file.settings(), file.truth());
                    file.camera().map(|camera| camera.width() > 0)
                }),
            )
        },
        seeds: || vec![SCENE.as_bytes().to_vec()],
        words: TOML_WORDS,
        cost: 1,
        least_outcomes: 8,
    },
    Parser {
        name: "muscles",
        parse: |bytes| {
            let (text, muscles) = (text(bytes), MuscleSet::embedded());
            let expressions = ExpressionSet::parse(&text, "e.toml").and_then(|set| {
                let poses = set.expressions().iter().map(|e| e.pose(muscles));
                poses.collect::<Result<Vec<_>, _>>()
            });
            said(expressions) + &said(MuscleSet::parse(&text, "m.toml"))
        },
        seeds: || {
            let pieces = [
                include_str!("../../assets/expressions.toml"),
                include_str!("../../assets/muscles.toml"),
            ];
            pieces
                .map(|t| t.chars().take(1_200).collect::<String>().into_bytes())
                .to_vec()
        },
        words: TOML_WORDS,
        cost: 1,
        least_outcomes: 6,
    },
    Parser {
        name: "landmarks",
        parse: |bytes| said(ScanLandmarks::parse(&text(bytes)).map(|l| l.points().len())),
        seeds: || {
            let points = "1 2 3\n4.5 -6 7e1\n0 0 0\n9 9 9\n1 1 1\n";
            let json = "{\"landmarks\": {\"points\": [[1, 2, 3], [4, 5, 6], [7, 8, 9], [1, 1, 1], [0, 0, 0]]}}";
            vec![
                format!("version: 1\nn_points: 5\n{{\n{points}}}\n").into_bytes(),
                json.into(),
            ]
        },
        words: &["[", "]", "{", ",", "null", "[[", "\n"],
        cost: 1,
        least_outcomes: 3,
    },
    Parser {
        name: "dataset",
        parse: dataset,
        seeds: || vec![DATASET.to_vec()],
        words: &[
            "\u{1}",
            "\u{2}",
            "  ",
            "../",
            "null",
            "true",
            "\"complete\":",
            "\"part\":",
        ],
        cost: 4,
        least_outcomes: 4,
    },
    Parser {
        name: "identity",
        parse: identity,
        seeds: || vec![npy_head()],
        words: &[
            "<i2",
            "<f8",
            "|O",
            "fortran_order",
            "True",
            "shape",
            "(",
            "1,",
        ],
        cost: 200,
        least_outcomes: 1,
    },
];

const JSON_WORDS: &[&str] = &[
    "{",
    "}",
    "[",
    "]",
    ",",
    "null",
    "true",
    "\"byteOffset\":",
    "\"byteLength\":",
    "\"byteStride\":",
    "\"count\":",
    "\"componentType\":",
    "\"type\":",
    "\"SCALAR\"",
    "\"VEC3\"",
    "\"sparse\":",
    "\"uri\":",
    "\"data:\"",
    "\"../a.bin\"",
    "\"indices\":",
    "\"matrix\":",
    "\"children\":",
    "\"mesh\":",
    "\"extensionsRequired\":",
    "5121",
    "5123",
    "5125",
    "5126",
];
const TOML_WORDS: &[&str] = &[
    "[",
    "]",
    "[[",
    "]]",
    "{",
    "}",
    "=",
    "\n",
    "#",
    "true",
    "[]",
    "{}",
    "\"\"",
    "\u{fffd}",
    "../x",
    "inf",
    "uniform = ",
    "normal = ",
    "within = ",
    "choice = ",
    "weights = ",
];

const OBJ: &[u8] = b"mtllib a.mtl\no head\nv 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 1 1 0 0 0 1\nv 0.2 0.2 0 0 1 0\n\
    vt 0 0\nvt 1 0\nvt 1 1\nusemtl a\ng nose\nf 1/1 2/2 3/3 4/3\nf -1 -2 -3\nf 1//1 2//1 \\\n3//1\n";

const MTL: &[u8] =
    b"newmtl a\nKd 1 0.5 0\nmap_Kd -s 1 1 1 -o 0 0 a.png\nnewmtl b\nmap_Kd ../b.png\nTr 0.5\n";

const PLY: &[u8] = b"ply\nformat ascii 1.0\ncomment TextureFile a.png\nelement vertex 3\nproperty float x\n\
    property float y\nproperty float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
    element face 1\nproperty list uchar int vertex_indices\nproperty int texnumber\nend_header\n\
    0 0 0 1 2 3\n1 0 0 4 5 6\n0 1 0 7 8 9\n3 0 1 2 0\n";

const SCENE: &str = r#"
[image]
size = [256, 256]
samples = "adaptive"
truth = ["depth", "normals"]
[camera]
position = [60, 10, 640]
target = [0, -5, 20]
fov_y_deg = 25
[[mesh]]
file = "head.obj"
texture = "tex.png"
transmission = [1, 0.5, 1]
[[light]]
kind = "spot"
position = [-260, 300, 520]
target = [0, 0, 0]
angle_deg = 20
[sensor]
blur_px = 0.5
"#;

/// Manifest and list of hashes, parted by a byte.
const DATASET: &[u8] = b"{\"program\":\"facile\",\"recipe\":\"r\",\"recipe_hash\":\"h\",\"formats\":[\"folder\"],\"coco\":false,\
    \"samples\":3,\"samples_per_unit\":3,\"part\":null,\"written\":3,\"complete\":true,\"failures\":[]}\n\x02\
    af1349b9f5f9a1a6a0404dea36dcc9499bcb25c9adc112b7cc9a93cae41f3262  images/000000.png\n";

const RECIPE: &str = r#"
[dataset]
name = "edited"
formats = ["folder", "parquet"]

[image]
size = [32, 32]
samples = "adaptive"
landmarks = ["ibug68"]

[subjects]
sampled = 4

[[expression]]
name = "smirk"
muscles = { "zygomatic_major.left" = 0.8, risorius = 0.4 }
action_units = { AU4 = 0.5 }

[[light]]
name = "key"
sources = [{ kind = "spot", position = [300, 250, 700], target = [0, 0, 0], angle_deg = 20 }]

[[view]]
yaw_deg = [-30, 0]

[[occluder]]
kind = "glasses"
size = 1.1

[sampling]
count = 43
pattern = "sobol"
expression = { weights = { smirk = 1 }, intensity = { normal = [0.5, 0.2], within = [0, 1] } }
light = { turn_deg = { uniform = [-70, 70] }, z_mm = { choice = [0, 100], weights = [1, 2] } }

[[sampling.constraint]]
of = ["light.turn_deg", "intensity"]
absolute = true
max_sum = 60
"#;

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn said<T, E: std::fmt::Display>(result: Result<T, E>) -> String {
    match result {
        Ok(_) => "accepted".to_owned(),
        Err(error) => {
            let message = error.to_string();
            assert!(!message.is_empty());
            message
        }
    }
}

/// What is read is valid and safe to use.
fn scan(name: &str, bytes: &[u8]) -> String {
    let scan = parse_scan(bytes, Path::new(name), &ScanOptions::default());
    if let Ok(scan) = &scan {
        let mesh = &scan.mesh;
        mesh.validate(Path::new(name))
            .expect("what is read is valid");
        assert_eq!(mesh.vertex_normals().len(), mesh.positions.len());
    }
    said(scan)
}

fn scratch(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"))
        .join("fuzz")
        .join(name);
    std::fs::create_dir_all(&folder).expect("makes");
    folder
}

/// Replaces a file. Some file systems write one to disk that is cut to nothing and filled again, so it is made anew.
fn rewrite(path: &Path, bytes: &[u8]) {
    drop(std::fs::remove_file(path));
    std::fs::write(path, bytes).expect("writes");
}

/// An OBJ whose material library lies beside it.
fn mtl(bytes: &[u8]) -> String {
    static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| {
        let folder = scratch("mtl");
        std::fs::write(folder.join("skin.png"), png()).expect("writes");
        folder
    });
    rewrite(&FOLDER.join("a.mtl"), bytes);
    said(parse_scan(
        OBJ,
        &FOLDER.join("a.obj"),
        &ScanOptions::default(),
    ))
}

/// What is accepted can be planned.
fn recipe(bytes: &[u8]) -> String {
    match Recipe::parse(&text(bytes), Path::new("r.toml"), Path::new("")) {
        Ok(recipe) => {
            let last = Grid::of(&recipe).len() - 1;
            let scene = recipe.scene(last);
            assert!(
                matches!(scene, Ok(_) | Err(Error::Draw { .. })),
                "{scene:?}"
            );
            "accepted".to_owned()
        }
        Err(Error::Recipe(error)) => error.to_string(),
        Err(error) => panic!("{error}"),
    }
}

/// Manifest and hashes of a finished dataset.
fn dataset(bytes: &[u8]) -> String {
    static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| {
        let folder = scratch("dataset");
        std::fs::create_dir_all(folder.join("images")).expect("makes");
        std::fs::write(folder.join("images/000000.png"), b"").expect("writes");
        folder
    });
    let mut parts = bytes.splitn(2, |b| *b == 2);
    for name in ["manifest.json", "checksums.b3"] {
        rewrite(&FOLDER.join(name), parts.next().unwrap_or_default());
    }
    said(verify(&FOLDER))
}

/// The modes of an identity model: the head of the file edited, the numbers as they were.
fn identity(bytes: &[u8]) -> String {
    const MODES: &[u8] = include_bytes!("../../assets/identity/modes.npy");
    static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| {
        let folder = scratch("identity");
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/identity");
        std::fs::create_dir_all(folder.join("skins")).expect("makes");
        std::fs::copy(source.join("identity.toml"), folder.join("identity.toml")).expect("copies");
        for skin in std::fs::read_dir(source.join("skins")).expect("reads") {
            let skin = skin.expect("reads").path();
            let name = skin.file_name().expect("a name");
            std::fs::copy(&skin, folder.join("skins").join(name)).expect("copies");
        }
        folder
    });
    let modes = [bytes, &MODES[npy_head().len()..]].concat();
    rewrite(&FOLDER.join("modes.npy"), &modes);
    said(IdentityModel::load(&FOLDER, ReferenceHead::embedded()))
}

/// Magic, version, length and dictionary of the modes.
fn npy_head() -> Vec<u8> {
    include_bytes!("../../assets/identity/modes.npy")[..128].to_vec()
}

fn binary_ply() -> Vec<u8> {
    let header = b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\n\
        property float z\nelement edge 1\nproperty list int short k\nelement face 1\n\
        property list uchar uint vertex_indices\nproperty list uchar float texcoord\nend_header\n";
    let mut bytes = header.to_vec();
    for v in [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0] {
        bytes.extend(v.to_le_bytes());
    }
    bytes.extend([2, 0, 0, 0, 1, 1, 2, 2, 3]);
    bytes.extend([0_u32, 1, 2].iter().flat_map(|v| v.to_le_bytes()));
    bytes.push(6);
    bytes.extend([0.0_f32; 6].iter().flat_map(|v| v.to_le_bytes()));
    bytes
}

fn glb() -> &'static [u8] {
    static FILE: LazyLock<Vec<u8>> = LazyLock::new(|| {
        let mesh = Mesh {
            positions: [[0.0, 0.0, 0.0], [9.0, 0.0, 0.0], [0.0, 9.0, 1.0]]
                .map(Point3::from)
                .to_vec(),
            triangles: vec![[0, 1, 2]],
            texcoords: vec![[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]],
            texcoord_triangles: vec![[0, 1, 2]],
            ..Mesh::default()
        };
        let texture = Texture::new(2, 2, vec![[1; 3]; 4]);
        let file = Glb {
            parts: vec![GlbPart {
                name: "head",
                mesh: &mesh,
                texture: Some(0),
            }],
            textures: vec![GlbTexture {
                name: "skin",
                texture: &texture,
                packing: Packing::Png,
            }],
            ..Glb::default()
        };
        file.to_bytes(Path::new("a.glb")).expect("valid")
    });
    &FILE
}

/// A triangle as text, its numbers in a data URI.
fn gltf() -> Vec<u8> {
    br#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"name":"head","mesh":0,"scale":[1,1,1]}],
"meshes":[{"primitives":[{"attributes":{"POSITION":1},"indices":0}]}],
"buffers":[{"uri":"data:application/octet-stream;base64,AAABAAIAAAAAAAAAAAAAAAAAAAAAAIA/AAAAAAAAAAAAAAAAAACAPwAAAAA=","byteLength":44}],
"bufferViews":[{"buffer":0,"byteOffset":0,"byteLength":6,"target":34963},{"buffer":0,"byteOffset":8,"byteLength":36}],
"accessors":[{"bufferView":0,"byteOffset":0,"componentType":5123,"count":3,"type":"SCALAR","max":[2],"min":[0]},
{"bufferView":1,"byteOffset":0,"componentType":5126,"count":3,"type":"VEC3","max":[1,1,0],"min":[0,0,0]}]}"#
        .to_vec()
}

fn png() -> Vec<u8> {
    image_as(image::ImageFormat::Png)
}

fn image_as(format: image::ImageFormat) -> Vec<u8> {
    let image = image::RgbImage::from_fn(9, 7, |x, y| image::Rgb([x as u8 * 20, y as u8 * 30, 90]));
    let mut file = std::io::Cursor::new(Vec::new());
    image.write_to(&mut file, format).expect("encodes");
    file.into_inner()
}

/// One of each kind, and PNGs of other depths.
fn images() -> Vec<Vec<u8>> {
    use image::ImageFormat::{Bmp, Jpeg, Png, WebP};
    let mut files = [Png, Jpeg, WebP, Bmp].map(image_as).to_vec();
    let gray = image::ImageBuffer::<image::Luma<u16>, _>::from_fn(5, 5, |x, y| {
        image::Luma([(x * y * 999) as u16])
    });
    let clear = image::RgbaImage::from_fn(4, 4, |x, _| image::Rgba([9, 9, 9, x as u8 * 60]));
    let mut file = std::io::Cursor::new(Vec::new());
    gray.write_to(&mut file, Png).expect("encodes");
    files.push(std::mem::take(file.get_mut()));
    file.set_position(0);
    clear.write_to(&mut file, Png).expect("encodes");
    files.push(file.into_inner());
    files
}
