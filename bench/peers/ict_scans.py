"""Exports random ICT-FaceKit identities as scans, with their true topology, for the transfer error.

Writes to OUT for every identity k: `scan_k.obj` (the surface subdivided, new points jittered on its edges and
triangles, vertices and triangles permuted, posed at random) and `truth_k.obj` (the ICT face topology in the same
pose); `landmarks.txt` (the 68 landmark vertices of the truth). Measure with
`cargo run --release -p facile-flow --example transfer_error -- OUT`.

    python bench/peers/ict_scans.py --data ../shared/data/ict --out OUT [--count 10] [--seed 1] [--angle-deg 10]
"""

import argparse
from pathlib import Path

import numpy as np

FACE_VERTICES = 9409


def rotation(rng, angle_deg):
    """A rotation by yaw, pitch and roll, each uniform in [-angle, angle]."""
    yaw, pitch, roll = np.radians(rng.uniform(-angle_deg, angle_deg, 3))
    cy, sy, cp, sp, cr, sr = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_x = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    about_z = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    return about_z @ about_x @ about_y


def remesh(positions, triangles, rng):
    """The same surface with other vertices: a point on every edge and in every triangle, all at random places."""
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    edges, inverse = np.unique(edges, axis=0, return_inverse=True)
    t = rng.uniform(0.3, 0.7, (len(edges), 1))
    on_edges = positions[edges[:, 0]] * t + positions[edges[:, 1]] * (1 - t)
    weights = rng.dirichlet([4, 4, 4], len(triangles))[:, :, None]
    n, m = len(positions), len(triangles)
    ab, bc, ca = (n + inverse.reshape(3, m)).astype(int)
    corners = np.stack([on_edges[ab - n], on_edges[bc - n], on_edges[ca - n]], axis=1)
    inside = (corners * weights).sum(axis=1)
    center = n + len(edges) + np.arange(m)
    a, b, c = triangles.T
    new = [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, center), (bc, ca, center), (ca, ab, center)]
    fine = np.concatenate([np.stack(t, axis=1) for t in new])
    points = np.concatenate([positions, on_edges, inside])
    order = rng.permutation(len(points))
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    return points[order], place[fine][rng.permutation(len(fine))]


def write_obj(path, positions, triangles):
    with open(path, "w") as f:
        f.writelines(f"v {x:.5f} {y:.5f} {z:.5f}\n" for x, y, z in positions)
        f.writelines(f"f {a} {b} {c}\n" for a, b, c in triangles + 1)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data/ict"))
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--angle-deg", type=float, default=10)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    model = np.load(args.data / "ict_compact.npz")
    triangles = model["F"][(model["F"] < FACE_VERTICES).all(axis=1)]
    mean, modes = model["V0"][:FACE_VERTICES] * 10.0, model["ids"][:, :FACE_VERTICES] * 10.0
    landmarks = (args.data / "landmarks68.txt").read_text()
    (args.out / "landmarks.txt").write_text(landmarks)
    for k in range(args.count):
        rng = np.random.default_rng([args.seed, k])
        weights = np.clip(rng.standard_normal(len(modes)), -2, 2)
        positions = mean + np.tensordot(weights, modes, axes=1)
        positions = positions @ rotation(rng, args.angle_deg).T + rng.uniform(-20, 20, 3)
        write_obj(args.out / f"truth_{k}.obj", positions, triangles)
        write_obj(args.out / f"scan_{k}.obj", *remesh(positions, triangles, rng))


if __name__ == "__main__":
    main()
