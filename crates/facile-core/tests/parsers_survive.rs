//! No bytes make a parser panic: random ones, and valid files with bytes changed, cut out or repeated. `tests/fuzz` of the
//! workspace's root goes on for longer.

use std::path::Path;
use std::sync::LazyLock;

use facile_core::io::glb::{Glb, GlbPart, GlbTexture, Packing};
use facile_core::io::{ScanOptions, decode_texture, parse_scan};
use facile_core::{Mesh, Point3, ReferenceHead, Subject, Texture};
use proptest::prelude::*;

const OBJ: &[u8] = b"mtllib a.mtl\no head\nv 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 1 1 0 0 0 1\nv 0.2 0.2 0 0 1 0\n\
    vt 0 0\nvt 1 0\nvt 1 1\nusemtl a\ng nose\nf 1/1 2/2 3/3 4/3\nf -1 -2 -3\nf 1//1 2//1 \\\n3//1\n";

const PLY: &[u8] = b"ply\nformat ascii 1.0\ncomment TextureFile a.png\nelement vertex 3\nproperty float x\n\
    property float y\nproperty float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
    element face 1\nproperty list uchar int vertex_indices\nproperty int texnumber\nend_header\n\
    0 0 0 1 2 3\n1 0 0 4 5 6\n0 1 0 7 8 9\n3 0 1 2 0\n";

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

fn mesh() -> Mesh {
    Mesh {
        positions: [[0.0, 0.0, 0.0], [9.0, 0.0, 0.0], [0.0, 9.0, 1.0]]
            .map(Point3::from)
            .to_vec(),
        triangles: vec![[0, 1, 2]],
        texcoords: vec![[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]],
        texcoord_triangles: vec![[0, 1, 2]],
        ..Mesh::default()
    }
}

static GLB: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let (mesh, texture) = (mesh(), Texture::new(2, 2, vec![[1; 3]; 4]));
    let glb = Glb {
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
    glb.to_bytes(Path::new("a.glb")).expect("valid")
});

/// A change of a file: where (as a fraction), what, with which bytes.
type Edit = (f64, u8, Vec<u8>);

fn edits() -> impl Strategy<Value = Vec<Edit>> {
    // Digits and signs hit numbers in text, the rest anything.
    let byte = prop_oneof![
        any::<u8>(),
        prop::sample::select(&b"0123456789-+.e/ \n\\\"[]{},"[..]),
        Just(0xff),
    ];
    prop::collection::vec((0.0..1.0, 0..3_u8, prop::collection::vec(byte, 1..6)), 1..8)
}

fn edited(file: &[u8], edits: &[Edit]) -> Vec<u8> {
    let mut bytes = file.to_vec();
    for (at, what, new) in edits {
        let at = (at * bytes.len() as f64) as usize;
        let end = (at + new.len()).min(bytes.len());
        match what {
            0 => {
                bytes.splice(at..end, new.iter().copied());
            }
            1 => {
                bytes.splice(at..at, new.iter().copied());
            }
            _ => {
                bytes.drain(at..end);
            }
        }
    }
    bytes
}

/// Parses; whatever comes out of it valid is also safe to use.
fn survive(name: &str, bytes: &[u8]) {
    if let Ok(scan) = parse_scan(bytes, Path::new(name), &ScanOptions::default()) {
        scan.mesh
            .validate(Path::new(name))
            .expect("what is read is valid");
        assert_eq!(scan.mesh.vertex_normals().len(), scan.mesh.positions.len());
    }
}

const MTL: &[u8] =
    b"newmtl a\nKd 1 0.5 0\nmap_Kd -s 1 1 1 -o 0 0 a.png\nnewmtl b\nmap_Kd ../b.png\nTr 0.5\n";

/// The PNG inside the GLB.
fn png() -> &'static [u8] {
    let magic = b"\x89PNG";
    let start = GLB.windows(4).position(|w| w == magic);
    &GLB[start.expect("a picture")..]
}

/// Parses an OBJ whose material library lies beside it.
fn survive_mtl(mtl: &[u8]) {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("parsers_survive");
    std::fs::create_dir_all(&folder).expect("makes");
    let name = format!("{:?}.mtl", std::thread::current().id()).replace(['(', ')'], "_");
    std::fs::write(folder.join(&name), mtl).expect("writes");
    let obj = [b"mtllib ", name.as_bytes(), b"\n", &OBJ[14..]].concat();
    let _ = parse_scan(&obj, &folder.join("a.obj"), &ScanOptions::default());
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(400) })]

    #[test]
    fn random_bytes(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        for name in ["a.obj", "a.ply", "a.glb", "a.gltf"] {
            survive(name, &bytes);
        }
        let with_magic = |magic: &[u8]| [magic, &bytes].concat();
        survive("a.ply", &with_magic(b"ply\nformat binary_big_endian 1.0\n"));
        survive("a.glb", &with_magic(b"glTF\x02\0\0\0"));
        for magic in [&b"\x89PNG\r\n\x1a\n"[..], b"\xff\xd8\xff", b"BM", b"RIFF"] {
            let _ = decode_texture(&with_magic(magic), Path::new("a"));
        }
    }

    #[test]
    fn edited_obj(edits in edits()) {
        survive("a.obj", &edited(OBJ, &edits));
    }

    #[test]
    fn edited_ply(edits in edits()) {
        survive("a.ply", &edited(PLY, &edits));
        survive("a.ply", &edited(&binary_ply(), &edits));
    }

    #[test]
    fn edited_glb(edits in edits()) {
        let file = edited(&GLB, &edits);
        survive("a.glb", &file);
        let _ = Subject::from_glb(&file, Path::new("a.glb"), ReferenceHead::embedded());
    }

    #[test]
    fn edited_gltf_text(edits in edits()) {
        // The JSON chunk alone: edits keep lengths right and reach the tables.
        let length = u32::from_le_bytes([GLB[12], GLB[13], GLB[14], GLB[15]]) as usize;
        let json = edited(&GLB[20..20 + length], &edits);
        let mut file = GLB[..12].to_vec();
        file.extend((json.len() as u32).to_le_bytes());
        file.extend(b"JSON");
        file.extend(&json);
        file.resize(file.len().next_multiple_of(4), b' ');
        file.extend(&GLB[20 + length..]);
        let total = file.len() as u32;
        file[8..12].copy_from_slice(&total.to_le_bytes());
        survive("a.glb", &file);
    }

    #[test]
    fn edited_png(edits in edits()) {
        let _ = decode_texture(&edited(png(), &edits), Path::new("a.png"));
    }

    #[test]
    fn edited_mtl(edits in edits()) {
        survive_mtl(&edited(MTL, &edits));
    }

    #[test]
    fn cut_files(at in 0.0..1.0) {
        for (name, file) in [("a.obj", OBJ), ("a.ply", PLY), ("a.ply", &binary_ply()), ("a.glb", &GLB)] {
            survive(name, &file[..(at * file.len() as f64) as usize]);
        }
    }
}
