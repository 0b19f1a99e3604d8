//! Equilibria kept on disk: a face at rest under contractions, by the hash of shape, pose, solver and code.
//!
//! An entry is the certificate as a line of JSON, then numbers as they are in memory, so that a face from the cache has
//! the very bytes of a fresh one.

use facile_core::{Isometry3, Point3, Subject, UnitQuaternion};
use facile_sim::{Certificate, Pose, SolverKind};
use facile_trace::head::Gaze;
use nalgebra::{Quaternion, Translation3};

use super::Face;
use super::cache::{Cache, Counts};

/// Names the code that solves, so that what other code left in a cache is not taken.
const CODE: &str = env!("FACILE_SIMULATION_CODE");
/// Numbers before the vertices: translation, rotation, two directions of sight.
const HEAD: usize = 3 + 4 + 4;

/// Equilibria of earlier runs.
#[derive(Debug)]
pub(super) struct Equilibria {
    cache: Cache,
    counts: Counts,
}

impl Equilibria {
    /// With the user's cache.
    pub(super) fn new() -> Self {
        Self {
            cache: Cache::of_user(),
            counts: Counts::default(),
        }
    }

    pub(super) fn counts(&self) -> &Counts {
        &self.counts
    }

    /// The face of this key with so many vertices.
    pub(super) fn get(&self, key: &blake3::Hash, vertices: usize) -> Option<Face> {
        let face = decode(&self.cache.get(key)?).filter(|f| f.positions.len() == vertices)?;
        self.counts.hit();
        Some(face)
    }

    /// Stores a face that was made.
    pub(super) fn put(&self, key: &blake3::Hash, face: &Face) {
        self.counts.made();
        self.cache.put(key, &encode(face));
    }
}

/// Hash of what an equilibrium depends on.
pub(super) fn key(shape: &blake3::Hash, pose: &Pose, solver: SolverKind) -> blake3::Hash {
    let mut hasher = blake3::Hasher::new();
    let asked = serde_json::to_vec(&(pose, solver)).expect("names and numbers are plain JSON");
    hasher
        .update(CODE.as_bytes())
        .update(shape.as_bytes())
        .update(&asked);
    hasher.finalize()
}

/// Hash of what the physics sees of a subject.
pub(super) fn shape(subject: &Subject) -> blake3::Hash {
    let mut hasher = blake3::Hasher::new();
    let rigid = serde_json::to_vec(&(subject.eyes, subject.skull_from_reference));
    hasher.update(&rigid.expect("numbers are plain JSON"));
    let coordinates = subject.positions.iter().flat_map(|p| [p.x, p.y, p.z]);
    hasher.update(&coordinates.flat_map(f64::to_le_bytes).collect::<Vec<u8>>());
    hasher.finalize()
}

fn encode(face: &Face) -> Vec<u8> {
    let mut bytes = serde_json::to_vec(&face.certificate).expect("numbers are plain JSON");
    bytes.push(b'\n');
    let (t, r) = (face.jaw.translation.vector, face.jaw.rotation.coords);
    let head = [t.x, t.y, t.z, r.x, r.y, r.z, r.w];
    let gaze = face.gaze.iter().flat_map(|g| [g.yaw, g.pitch]);
    let positions = face.positions.iter().flat_map(|p| [p.x, p.y, p.z]);
    let numbers = head.into_iter().chain(gaze).chain(positions);
    bytes.extend(numbers.flat_map(f64::to_le_bytes));
    bytes
}

fn decode(bytes: &[u8]) -> Option<Face> {
    let end = bytes.iter().position(|b| *b == b'\n')?;
    let certificate: Option<Certificate> = serde_json::from_slice(&bytes[..end]).ok()?;
    let (numbers, rest) = bytes[end + 1..].as_chunks::<8>();
    let numbers: Vec<f64> = numbers.iter().map(|b| f64::from_le_bytes(*b)).collect();
    if !rest.is_empty() || numbers.len() < HEAD {
        return None;
    }
    let (head, positions) = numbers.split_at(HEAD);
    let (positions, rest) = positions.as_chunks::<3>();
    let rotation = Quaternion::new(head[6], head[3], head[4], head[5]);
    rest.is_empty().then(|| Face {
        positions: positions.iter().map(|p| Point3::from(*p)).collect(),
        jaw: Isometry3::from_parts(
            Translation3::new(head[0], head[1], head[2]),
            // As it was stored: normalising again could change its last bits.
            UnitQuaternion::new_unchecked(rotation),
        ),
        gaze: [7, 9].map(|i| Gaze {
            yaw: head[i],
            pitch: head[i + 1],
        }),
        certificate,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_face_reads_back_to_the_last_bit_and_a_cut_one_does_not() {
        let face = Face {
            positions: vec![
                Point3::new(0.1, -2.0 / 3.0, 1e-300),
                Point3::new(7.0, -0.0, 3.5),
            ],
            jaw: Isometry3::new(
                facile_core::Vector3::new(1.0, 0.1, -0.3),
                facile_core::Vector3::new(0.2, 0.0, 0.1),
            ),
            gaze: [
                Gaze {
                    yaw: 0.1,
                    pitch: 0.2,
                },
                Gaze {
                    yaw: -0.1,
                    pitch: 0.3,
                },
            ],
            certificate: None,
        };
        let bytes = encode(&face);
        let back = decode(&bytes).expect("reads");
        assert_eq!(encode(&back), bytes);
        assert_eq!((back.positions, back.jaw), (face.positions, face.jaw));
        assert!(decode(&bytes[..bytes.len() - 8]).is_none());
        assert!(decode(b"").is_none());
    }
}
