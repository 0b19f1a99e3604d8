//! Every kind of scan file is read, and every kind of bad one gives one error with file and place.

use std::path::{Path, PathBuf};

use facile_core::io::{ScanOptions, load_scan, load_scan_with, parse_scan};
use facile_core::{CoreError, Segment, Texture};

/// A folder of files that goes when it is dropped.
struct Folder(tempfile::TempDir);

impl Folder {
    fn with(files: &[(&str, &[u8])]) -> Self {
        let folder = Self(tempfile::tempdir().expect("folder"));
        for (name, bytes) in files {
            std::fs::write(folder.path(name), bytes).expect("file");
        }
        folder
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// The error of loading a file, without the folder's name.
    fn error(&self, name: &str) -> String {
        let error = load_scan(&self.path(name), None).expect_err("the file is bad");
        let folder = format!("{}/", self.0.path().display());
        error.to_string().replace(&folder, "")
    }
}

fn png(color: [u8; 3]) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::RgbImage::from_pixel(4, 4, image::Rgb(color))
        .write_to(&mut bytes, image::ImageFormat::Png)
        .expect("encodes");
    bytes.into_inner()
}

fn parse(name: &str, bytes: &[u8]) -> Result<facile_core::io::Scan, CoreError> {
    parse_scan(bytes, Path::new(name), &ScanOptions::default())
}

fn assert_close(found: [f32; 3], expected: [f32; 3]) {
    let close = (0..3).all(|k| (found[k] - expected[k]).abs() < 1e-6);
    assert!(close, "{found:?} instead of {expected:?}");
}

const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n";

#[test]
fn an_obj_with_library_texture_and_groups_is_read() {
    let obj = format!("mtllib a.mtl\n{SQUARE}g nose\nusemtl skin\nf 1/1 2/2 3/3 4/4\n");
    let folder = Folder::with(&[
        ("a.obj", obj.as_bytes()),
        ("a.mtl", b"newmtl skin\nmap_Kd my skin.png\n"),
        ("my skin.png", &png([10, 20, 30])),
    ]);
    let scan = load_scan(&folder.path("a.obj"), None).expect("valid");
    assert_eq!(scan.name, "a");
    assert_eq!(scan.mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
    assert_eq!(scan.mesh.segments, [Segment::Nose; 2]);
    assert_eq!(scan.texture.expect("texture").texel(0, 0), [10, 20, 30]);
    assert!(scan.notices.is_empty(), "{:?}", scan.notices);
}

#[test]
fn a_lost_library_is_replaced_by_the_image_of_the_same_name_with_a_notice() {
    let obj = format!("mtllib ./a.obj.mtl\n{SQUARE}f 1/1 2/2 3/3\n");
    let folder = Folder::with(&[("a.obj", obj.as_bytes()), ("a.jpg", &png([1, 2, 3]))]);
    let scan = load_scan(&folder.path("a.obj"), None).expect("valid");
    assert_eq!(scan.texture, Some(Texture::new(4, 4, vec![[1, 2, 3]; 16])));
    assert_eq!(
        scan.notices,
        ["the material library `./a.obj.mtl` is missing; took the texture `a.jpg`"]
    );
}

#[test]
fn an_overriding_texture_wins_over_everything() {
    let obj = format!("mtllib gone.mtl\n{SQUARE}f 1/1 2/2 3/3\n");
    let folder = Folder::with(&[("a.obj", obj.as_bytes()), ("other.png", &png([9, 9, 9]))]);
    let scan = load_scan(&folder.path("a.obj"), Some(&folder.path("other.png"))).expect("valid");
    assert_eq!(scan.texture.expect("texture").texel(0, 0), [9, 9, 9]);
    let missing = load_scan(&folder.path("a.obj"), Some(&folder.path("none.png")));
    assert!(matches!(missing, Err(CoreError::Io { path, .. }) if path.ends_with("none.png")));
}

#[test]
fn an_overriding_texture_needs_texture_coordinates() {
    let folder = Folder::with(&[
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
        ("t.png", &png([9, 9, 9])),
    ]);
    let error = load_scan(&folder.path("a.obj"), Some(&folder.path("t.png"))).expect_err("bad");
    assert!(
        error
            .to_string()
            .contains("a.obj: has no texture coordinates")
    );
}

#[test]
fn several_materials_share_one_texture_after_reading() {
    let obj = format!(
        "mtllib a.mtl\n{SQUARE}usemtl red\nf 1/1 2/2 3/3\nusemtl blue\nf 1/1 3/3 4/4\nusemtl plain\nf 1 2 4\n"
    );
    let folder = Folder::with(&[
        ("a.obj", obj.as_bytes()),
        (
            "a.mtl",
            b"newmtl red\nmap_Kd r.png\nnewmtl blue\nmap_Kd b.png\nnewmtl plain\nKd 0 1 0\n",
        ),
        ("r.png", &png([255, 0, 0])),
        ("b.png", &png([0, 0, 255])),
    ]);
    let scan = load_scan(&folder.path("a.obj"), None).expect("valid");
    let texture = scan.texture.expect("texture");
    let color = |t: usize| {
        let uv = scan.mesh.texcoord_triangles[t].map(|c| scan.mesh.texcoords[c as usize]);
        texture.sample([0, 1].map(|k| (uv[0][k] + uv[1][k] + uv[2][k]) / 3.0))
    };
    assert_close(color(0), [1.0, 0.0, 0.0]);
    assert_close(color(1), [0.0, 0.0, 1.0]);
    assert_close(color(2), [0.0, 1.0, 0.0]);
}

#[test]
fn a_bad_obj_is_named_with_file_and_place() {
    let square = |rest: &str| format!("{SQUARE}{rest}").into_bytes();
    let folder = Folder::with(&[
        ("empty.obj", b""),
        ("nan.obj", b"v 0 0 0\nv 1 nan 0\n"),
        ("index.obj", &square("f 1 2 9\n")),
        ("faceless.obj", SQUARE.as_bytes()),
        ("far.obj", b"v 0 0 0\nv 1e200 0 0\nv 0 1 0\nf 1 2 3\n"),
        ("point.obj", b"v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n"),
        (
            "image.obj",
            &square("mtllib image.mtl\nusemtl m\nf 1/1 2/2 3/3\n"),
        ),
        ("image.mtl", b"# skin\nnewmtl m\nmap_Kd gone.png\n"),
        ("library.obj", &square("mtllib gone.mtl\nf 1/1 2/2 3/3\n")),
        (
            "outside.obj",
            &square("mtllib outside.mtl\nusemtl m\nf 1/1 2/2 3/3\n"),
        ),
        ("outside.mtl", b"newmtl m\nmap_Kd ../../secret.png\n"),
        (
            "damaged.obj",
            &square("mtllib damaged.mtl\nusemtl m\nf 1/1 2/2 3/3\n"),
        ),
        ("damaged.mtl", b"newmtl m\nmap_Kd damaged.png\n"),
        ("damaged.png", &png([1, 2, 3])[..40]),
        ("text.xyz", b"hello"),
    ]);
    assert_eq!(folder.error("empty.obj"), "empty.obj: the file is empty");
    assert_eq!(
        folder.error("nan.obj"),
        "nan.obj, line 2: y: expected a finite number, found `nan`"
    );
    assert_eq!(
        folder.error("index.obj"),
        "index.obj, line 9: vertex index 9 is out of range, the file has 4"
    );
    assert_eq!(
        folder.error("faceless.obj"),
        "faceless.obj: triangle 0: the mesh has no triangles"
    );
    assert!(
        folder
            .error("far.obj")
            .starts_with("far.obj: vertex 1: coordinates must be within")
    );
    assert_eq!(
        folder.error("point.obj"),
        "point.obj: all vertices lie at one point"
    );
    assert_eq!(
        folder.error("image.obj"),
        "image.mtl, line 3: the texture `gone.png` of the material `m` is missing"
    );
    assert!(
        folder
            .error("library.obj")
            .contains("the material library `gone.mtl` is missing")
    );
    assert_eq!(
        folder.error("outside.obj"),
        "outside.mtl, line 2: `../../secret.png` lies outside the scan's folder and is not read"
    );
    assert!(
        folder
            .error("damaged.obj")
            .starts_with("damaged.png: the image cannot be decoded")
    );
    assert!(folder.error("text.xyz").contains("unknown file type"));
    assert!(folder.error("gone.obj").starts_with("gone.obj: "));
}

#[test]
fn files_outside_the_folder_are_read_if_allowed() {
    let folder = Folder::with(&[("skin.png", &png([7, 7, 7]))]);
    let inner = folder.path("inner");
    std::fs::create_dir(&inner).expect("folder");
    let obj = format!("mtllib a.mtl\n{SQUARE}usemtl m\nf 1/1 2/2 3/3\n");
    std::fs::write(inner.join("a.obj"), obj).expect("file");
    std::fs::write(inner.join("a.mtl"), "newmtl m\nmap_Kd ../skin.png\n").expect("file");
    assert!(load_scan(&inner.join("a.obj"), None).is_err());
    let options = ScanOptions {
        outside_folder: true,
        ..ScanOptions::default()
    };
    let scan = load_scan_with(&inner.join("a.obj"), &options).expect("allowed");
    assert_eq!(scan.texture.expect("texture").texel(0, 0), [7, 7, 7]);
}

const PLY: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
    property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 1\n\
    property list uchar int vertex_indices\nend_header\n";

#[test]
fn a_text_ply_with_colours_is_read_in_linear_light() {
    let text =
        format!("{PLY}0 0 0 255 0 0\n1 0 0 188 188 188\n1 1 0 0 0 0\n0 1 0 0 0 0\n4 0 1 2 3\n");
    let scan = parse("a.ply", text.as_bytes()).expect("valid");
    assert_eq!(scan.mesh.triangles.len(), 2);
    assert_close(scan.mesh.colors[0], [1.0, 0.0, 0.0]);
    assert!((scan.mesh.colors[1][0] - 0.502_886_5).abs() < 1e-4);
    assert!(scan.texture.is_none());
}

#[test]
fn ply_textures_per_vertex_and_per_face_are_read() {
    let per_vertex = "ply\nformat ascii 1.0\ncomment TextureFile skin.png\nelement vertex 3\nproperty float x\n\
        property float y\nproperty float z\nproperty float s\nproperty float t\nelement face 1\n\
        property list uchar int vertex_indices\nend_header\n0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n3 0 1 2\n";
    let per_face = "ply\nformat ascii 1.0\ncomment TextureFile skin.png\nelement vertex 3\nproperty float x\n\
        property float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\n\
        property list uchar float texcoord\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2 6 0 0 1 0 0 1\n";
    let folder = Folder::with(&[
        ("v.ply", per_vertex.as_bytes()),
        ("f.ply", per_face.as_bytes()),
        ("skin.png", &png([50, 60, 70])),
    ]);
    let expected = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
    for name in ["v.ply", "f.ply"] {
        let scan = load_scan(&folder.path(name), None).expect("valid");
        assert_eq!(scan.mesh.texcoords, expected, "{name}");
        assert_eq!(scan.texture.expect("texture").texel(0, 0), [50, 60, 70]);
    }
    std::fs::remove_file(folder.path("skin.png")).expect("removed");
    assert_eq!(
        folder.error("v.ply"),
        "v.ply, comment TextureFile: the texture `skin.png` is missing"
    );
}

/// The same square in both byte orders.
fn binary_ply(big: bool) -> Vec<u8> {
    let order = if big { "big" } else { "little" };
    let mut bytes = PLY
        .replace("ascii", &format!("binary_{order}_endian"))
        .into_bytes();
    for [x, y] in [[0.0_f32, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]] {
        for v in [x, y, 0.5] {
            bytes.extend(if big {
                v.to_be_bytes()
            } else {
                v.to_le_bytes()
            });
        }
        bytes.extend([255, 0, 0]);
    }
    bytes.push(4);
    for i in 0..4_i32 {
        bytes.extend(if big {
            i.to_be_bytes()
        } else {
            i.to_le_bytes()
        });
    }
    bytes
}

#[test]
fn binary_ply_is_read_in_both_byte_orders() {
    let little = parse("a.ply", &binary_ply(false)).expect("valid");
    let big = parse("a.ply", &binary_ply(true)).expect("valid");
    assert_eq!(little, big);
    assert_eq!(
        little.mesh.positions[2],
        facile_core::Point3::new(1.0, 1.0, 0.5)
    );
    assert_close(little.mesh.colors[3], [1.0, 0.0, 0.0]);
}

#[test]
fn another_writers_ply_is_read() {
    use ply_rs_bw::ply::{
        Addable, DefaultElement, ElementDef, Encoding, Ply, Property, PropertyDef, PropertyType,
        ScalarType,
    };
    for encoding in [
        Encoding::Ascii,
        Encoding::BinaryLittleEndian,
        Encoding::BinaryBigEndian,
    ] {
        let mut ply = Ply::<DefaultElement>::new();
        ply.header.encoding = encoding;
        let mut vertex = ElementDef::new("vertex".to_owned());
        for axis in ["x", "y", "z"] {
            let kind = PropertyType::Scalar(ScalarType::Double);
            vertex
                .properties
                .add(PropertyDef::new(axis.to_owned(), kind));
        }
        let mut face = ElementDef::new("face".to_owned());
        let kind = PropertyType::List(ScalarType::UChar, ScalarType::UInt);
        face.properties
            .add(PropertyDef::new("vertex_index".to_owned(), kind));
        ply.header.elements.add(vertex);
        ply.header.elements.add(face);
        let corners = [[0.0, 0.0, 0.1], [1.5, 0.0, 0.0], [0.0, 2.5, 0.0]];
        let vertices = corners.map(|c| {
            let mut row = DefaultElement::new();
            for (axis, value) in ["x", "y", "z"].into_iter().zip(c) {
                row.insert(axis.to_owned(), Property::Double(value));
            }
            row
        });
        let mut row = DefaultElement::new();
        row.insert("vertex_index".to_owned(), Property::ListUInt(vec![0, 1, 2]));
        ply.payload.insert("vertex".to_owned(), vertices.to_vec());
        ply.payload.insert("face".to_owned(), vec![row]);
        let mut bytes = Vec::new();
        ply_rs_bw::writer::Writer::new()
            .write_ply(&mut bytes, &mut ply)
            .expect("writes");
        let scan = parse("a.ply", &bytes).expect("valid");
        assert_eq!(scan.mesh.positions, corners.map(facile_core::Point3::from));
        assert_eq!(scan.mesh.triangles, [[0, 1, 2]]);
    }
}

#[test]
fn a_bad_ply_is_named_with_row() {
    let message = |bytes: &[u8]| parse("a.ply", bytes).expect_err("bad").to_string();
    let text = |rest: &str| message(format!("{PLY}{rest}").as_bytes());
    let whole = binary_ply(false);
    assert_eq!(
        message(b"plx\n"),
        "a.ply, line 1: does not begin with `ply`"
    );
    assert_eq!(
        message(b"ply\nformat ascii 1.0\n"),
        "a.ply, line 3: the header has no `end_header`"
    );
    assert_eq!(
        text("0 0 0 1 1 1\n1 0 nan 1 1 1\n1 1 0 1 1 1\n0 1 0 1 1 1\n3 0 1 2\n"),
        "a.ply, line 14, vertex 1: z: expected a finite number, found NaN"
    );
    assert_eq!(
        text("0 0 0 1 1 1\n1 0 0 1 1 1\n1 1 0 1 1 1\n0 1 0 1 1 1\n3 0 1 4\n"),
        "a.ply, line 17, face 0: vertex index 4 is out of range, the file has 4 vertices"
    );
    assert!(text("0 0 0 1 1 1\n1 0 0 1 1 1\n1 x 0 1 1 1\n").contains("ends early"));
    let cut = message(&whole[..whole.len() - 3]);
    assert_eq!(cut, "a.ply, face 0: the file ends early");
    let huge = PLY.replace("vertex 4", "vertex 4000000000000000000");
    assert!(message(huge.as_bytes()).contains("the limit is 50000000"));
    let huge = PLY.replace("vertex 4", "vertex 40000000");
    assert!(message(huge.as_bytes()).contains("the file ends early: 40000000 rows of `vertex`"));
    let cloud = PLY.replace("face 1", "face 0") + &"1 2 3 4 5 6\n".repeat(4);
    assert_eq!(
        message(cloud.as_bytes()),
        "a.ply: triangle 0: the mesh has no triangles"
    );
}

/// A glTF text with one triangle in a data URI, and its parts replaced.
fn gltf(replacements: &[(&str, &str)]) -> Vec<u8> {
    let mut text = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],
        "nodes":[{"mesh":0,"name":"face","translation":[0,0,5]}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"},
                     {"bufferView":1,"componentType":5121,"count":3,"type":"SCALAR"}],
        "bufferViews":[{"buffer":0,"byteLength":36},{"buffer":0,"byteOffset":36,"byteLength":3}],
        "buffers":[{"byteLength":39,"uri":"data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAAAAEC"}]}"#
        .to_owned();
    for (from, to) in replacements {
        assert!(text.contains(from), "{from}");
        text = text.replacen(from, to, 1);
    }
    text.into_bytes()
}

#[test]
fn a_gltf_is_read_with_its_transform() {
    let scan = parse("a.gltf", &gltf(&[])).expect("valid");
    let points = [[0.0, 0.0, 5.0], [1.0, 0.0, 5.0], [0.0, 1.0, 5.0]];
    assert_eq!(scan.mesh.positions, points.map(facile_core::Point3::from));
    assert_eq!(scan.groups, ["face"]);
    let mirrored = gltf(&[("\"translation\":[0,0,5]", "\"scale\":[-1,1,1]")]);
    let scan = parse("a.gltf", &mirrored).expect("valid");
    assert_eq!(scan.mesh.vertex_normals()[0], facile_core::Vector3::z());
}

#[test]
fn a_bad_gltf_is_named_with_its_element() {
    let message = |replacements: &[(&str, &str)]| {
        parse("a.gltf", &gltf(replacements))
            .expect_err("bad")
            .to_string()
    };
    assert!(
        message(&[(
            "\"count\":3,\"type\":\"VEC3\"",
            "\"count\":4,\"type\":\"VEC3\""
        )])
        .contains("accessor 0: 4 values of 12 bytes overrun buffer view 0 of 36 bytes")
    );
    assert!(message(&[("\"count\":3", "\"count\":4000000000")]).contains("the limit is"));
    assert!(
        message(&[("\"byteLength\":36", "\"byteLength\":360")])
            .contains("buffer view 0: 360 bytes from 0 overrun the buffer's 39")
    );
    assert!(
        message(&[("\"byteLength\":39", "\"byteLength\":40")])
            .contains("buffer 0: the file ends early: expected 40 bytes, found 39")
    );
    assert!(message(&[("AAEC", "AAEJ")]).contains("mesh 0, primitive 0: vertex index 9"));
    assert!(
        message(&[("\"nodes\":[0]", "\"nodes\":[7]")]).contains("node 7: the file has 1 nodes")
    );
    assert!(
        message(&[("\"mesh\":0,", "\"mesh\":0,\"children\":[0],")]).contains("do not form a tree")
    );
    assert!(message(&[("\"POSITION\":0", "\"NORMAL\":0")]).contains("has no positions"));
    assert!(message(&[("\"2.0\"", "\"1.0\"")]).contains("expected glTF version 2, found `1.0`"));
    assert!(
        message(&[(
            "{\"asset\"",
            "{\"extensionsRequired\":[\"KHR_draco_mesh_compression\"],\"asset\""
        )])
        .contains("needs the glTF extension `KHR_draco_mesh_compression`")
    );
    assert!(
        message(&[("data:application/octet-stream;base64,", "../../x.bin?")])
            .contains("outside the scan's folder")
    );
    assert!(
        message(&[("AAAAAAAAAAAAAAAAAACAPw", "AADAfwAAAAAAAAAAAACAPw")])
            .contains("vertex 0: coordinates must be finite")
    );
    assert!(
        parse("a.glb", b"glTF\x02\0\0\0\xff\0\0\0")
            .expect_err("cut")
            .to_string()
            .contains("ends early")
    );
}

/// The folder of test data, if it is there.
fn shared() -> Option<PathBuf> {
    let dir = std::env::var_os("FACILE_SHARED").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    let data = dir.join("data");
    if !data.is_dir() {
        eprintln!("skipped: no shared data");
        return None;
    }
    Some(data)
}

#[test]
fn the_raw_scans_are_read_with_their_textures() {
    let Some(data) = shared() else { return };
    let james = load_scan(&data.join("scans/james/james.obj"), None).expect("valid");
    assert_eq!(
        (james.mesh.positions.len(), james.mesh.triangles.len()),
        (6_393, 12_228)
    );
    assert_eq!(
        james.notices,
        ["the material library `./james.obj.mtl` is missing; took the texture `james.jpg`"]
    );
    assert!(james.texture.expect("texture").width() > 500);
    let fran = load_scan(&data.join("scans/fran/fran.obj"), None).expect("valid");
    assert_eq!(fran.mesh.triangles.len(), 4_224);
    assert_eq!(
        fran.texture.map(|t| (t.width(), t.height())),
        Some((256, 256))
    );
    assert!(fran.notices.is_empty(), "{:?}", fran.notices);
}
