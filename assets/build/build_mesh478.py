"""Places the 478 points of MediaPipe's face mesh on the reference head.

The same way as build_landmarks.py: renders the head from many sides, runs the face mesh on the pictures and intersects the
rays of all views that see a point. The result is made symmetric and snapped onto the skin, lips onto their own lip, lids
onto the lid's margin. The ten points of the irises are not stored: they lie on the eyeballs, wherever these look.

Writes assets/landmarks/mesh478.csv. Needs requirements-landmarks.txt; run after build_landmarks.py.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from build_landmarks import REFERENCE, Head, observe

#: Points without those of the irises.
POINTS = 468
#: A view counts for a point if the mesh there faces the camera by this much (cosine).
FACING = 0.25


def rings() -> dict[str, list[int]]:
    """Points on the edges of lips and lids, by the class of the surface that they lie on."""
    from mediapipe.python.solutions import face_mesh_connections as c

    def corners(edges: frozenset[tuple[int, int]]) -> set[int]:
        return {i for edge in edges for i in edge}

    upper_outer = {61, 185, 40, 39, 37, 0, 267, 269, 270, 409, 291}
    upper_inner = {78, 191, 80, 81, 82, 13, 312, 311, 310, 415, 308}
    lips = corners(c.FACEMESH_LIPS)
    upper = upper_outer | upper_inner
    return {
        "upper_lip": sorted(upper),
        "lower_lip": sorted(lips - upper),
        "right_eyelid": sorted(corners(c.FACEMESH_RIGHT_EYE)),
        "left_eyelid": sorted(corners(c.FACEMESH_LEFT_EYE)),
    }


def triangulate(points: np.ndarray, cameras: list, found: np.ndarray, normals: np.ndarray | None) -> np.ndarray:
    """Robust intersection of rays (n x 3), as in build_landmarks.py; with normals, of the views that a point faces."""
    out = np.zeros((POINTS, 3))
    backs = np.array([c.position / np.linalg.norm(c.position) for c in cameras])
    for i in range(POINTS):
        use = found if normals is None else found & (backs @ normals[i] > FACING)
        if use.sum() < 3:
            use = found & (backs @ normals[i] >= np.sort(backs[found] @ normals[i])[-3])
        k = np.flatnonzero(use)
        rays = np.array([cameras[j].rays(points[j, i][None])[0] for j in k])
        origins = np.array([cameras[j].position for j in k])
        weight = np.ones(len(k))
        for _ in range(20):
            m = weight[:, None, None] * (np.eye(3) - rays[:, :, None] * rays[:, None, :])
            x = np.linalg.solve(m.sum(0), np.einsum("kij,kj->i", m, origins))
            off = x - origins
            miss = np.linalg.norm(off - rays * np.sum(off * rays, 1, keepdims=True), axis=1)
            weight = 1.0 / np.maximum(miss, 0.5)
        out[i] = x
    return out


def mirror_of(p: np.ndarray) -> np.ndarray:
    """The index of each point's mirror image: near it, and with the mirror images of its neighbours for neighbours."""
    from mediapipe.python.solutions.face_mesh_connections import FACEMESH_TESSELATION
    from scipy.optimize import linear_sum_assignment

    near = np.linalg.norm(p[:, None] - p[None] * [-1.0, 1.0, 1.0], axis=2)
    near = near + near.T
    edges = np.zeros((POINTS, POINTS))
    for a, b in FACEMESH_TESSELATION:
        edges[a, b] = edges[b, a] = 1.0
    pair = linear_sum_assignment(near)[1]
    for _ in range(30):
        # Neighbours of i whose image is a neighbour of j, for each i and j
        shared = edges @ np.eye(POINTS)[pair] @ edges
        cost = near - 4.0 * (shared + shared.T)
        pair = linear_sum_assignment(cost)[1]
    assert (pair[pair] == np.arange(POINTS)).all(), "points do not pair up"
    # A few diagonals of the mesh are not mirrored.
    kept = (edges[np.ix_(pair, pair)] * edges).sum() / edges.sum()
    assert kept > 0.9, f"only {kept:.0%} of the neighbours stay neighbours"
    return pair


def main() -> None:
    head = Head()
    points, cameras, found = observe(head)
    print(f"face found in {found.sum()} of {len(found)} views")
    surface = head.outer()
    rough = triangulate(points, cameras, found, None)
    near = surface.tree.query(rough)[1]
    p = triangulate(points, cameras, found, surface.normal[surface.face[near]])
    pair = mirror_of(p)
    p = (p + p[pair] * [-1.0, 1.0, 1.0]) / 2
    on = np.full(POINTS, "", dtype=object)
    for name, indices in rings().items():
        on[indices] = name
    snapped = surface.nearest(p)
    for name in filter(None, set(on)):
        which = np.flatnonzero(on == name)
        snapped[which] = head.only(name).nearest(p[which])
    # Snapping is not symmetric to the last micrometre.
    snapped = (snapped + snapped[pair] * [-1.0, 1.0, 1.0]) / 2
    off = np.linalg.norm(snapped - p, axis=1)
    print(f"from the skin: median {np.median(off):.2f} mm, 95 % {np.quantile(off, 0.95):.2f} mm, most {off.max():.2f} mm")
    rows = [f"{x:.3f},{y:.3f},{z:.3f},{name}" for (x, y, z), name in zip(snapped + 0.0, on)]
    (REFERENCE.parent / "landmarks" / "mesh478.csv").write_text("x_mm,y_mm,z_mm,on\n" + "\n".join(rows) + "\n")


if __name__ == "__main__":
    main()
