"""Quad meshes: adjacency, Catmull-Clark in the vertex order of facile-core, OBJ files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, vstack
from scipy.sparse.csgraph import dijkstra


def triangles(quads: np.ndarray) -> np.ndarray:
    """Two triangles per quad, all first halves then all second halves."""
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def edges(quads: np.ndarray) -> np.ndarray:
    """Unique edges (a < b), sorted lexicographically."""
    e = np.concatenate([quads[:, [k, (k + 1) % 4]] for k in range(4)])
    return np.unique(np.sort(e, axis=1), axis=0)


def neighbours(quads: np.ndarray, n: int) -> list[np.ndarray]:
    """Edge neighbours of every vertex."""
    e = edges(quads)
    both = np.concatenate([e, e[:, ::-1]])
    both = both[np.lexsort((both[:, 1], both[:, 0]))]
    cut = np.searchsorted(both[:, 0], np.arange(n + 1))
    return [both[cut[i] : cut[i + 1], 1] for i in range(n)]


def border(quads: np.ndarray) -> np.ndarray:
    """The open border's vertices in order (one loop)."""
    directed = {(int(a), int(b)) for k in range(4) for a, b in quads[:, [k, (k + 1) % 4]]}
    following = {a: b for a, b in directed if (b, a) not in directed}
    loop = [min(following)]
    while following[loop[-1]] != loop[0]:
        loop.append(following[loop[-1]])
    assert len(loop) == len(following), "one open border expected"
    return np.array(loop)


def geodesic(vertices: np.ndarray, quads: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """Shortest path along edges and quad diagonals from the nearest seed, mm."""
    e = np.concatenate([edges(quads), quads[:, [0, 2]], quads[:, [1, 3]]])
    length = np.linalg.norm(vertices[e[:, 0]] - vertices[e[:, 1]], axis=1)
    n = len(vertices)
    graph = coo_matrix((np.maximum(length, 1e-6), (e[:, 0], e[:, 1])), (n, n)).tocsr()
    return dijkstra(graph, directed=False, indices=np.asarray(seeds), min_only=True)


def smooth(values: np.ndarray, adjacent: list[np.ndarray], keep: np.ndarray, rounds: int) -> np.ndarray:
    """Laplacian smoothing of a per-vertex value; entries where `keep` is true stay."""
    n = len(adjacent)
    rows = np.repeat(np.arange(n), [len(a) for a in adjacent])
    cols = np.concatenate(adjacent)
    weight = 1.0 / np.array([max(len(a), 1) for a in adjacent])
    average = csr_matrix((weight[rows], (rows, cols)), (n, n))
    out = values.astype(float).copy()
    free = ~keep
    for _ in range(rounds):
        out[free] = (0.5 * out + 0.5 * (average @ out))[free]
    return out


class Subdivision:
    """One level of Catmull-Clark: vertex points, then edge points (edges sorted), then face points.

    Boundary rules: edge point = midpoint, vertex point = 1/8, 6/8, 1/8. `stencil` maps coarse to fine positions.
    """

    def __init__(self, quads: np.ndarray, n: int) -> None:
        e = edges(quads)
        key = {(a, b): i for i, (a, b) in enumerate(e.tolist())}
        m, f = len(e), len(quads)
        edge_of = np.array([[key[tuple(sorted((q[k], q[(k + 1) % 4])))] for k in range(4)] for q in quads.tolist()])
        face_point = coo_matrix((np.full(4 * f, 0.25), (np.repeat(np.arange(f), 4), quads.ravel())), (f, n)).tocsr()
        count = np.bincount(edge_of.ravel(), minlength=m)
        ends = coo_matrix((np.ones(2 * m), (np.repeat(np.arange(m), 2), e.ravel())), (m, n)).tocsr()
        touch = coo_matrix((np.ones(4 * f), (edge_of.ravel(), np.repeat(np.arange(f), 4))), (m, f)).tocsr()
        inner = (count == 2).astype(float)
        edge_point = _diag(0.25 * inner + 0.5 * (1 - inner)) @ ends + _diag(0.25 * inner) @ (touch @ face_point)
        vertex_face = coo_matrix((np.ones(4 * f), (quads.ravel(), np.repeat(np.arange(f), 4))), (n, f)).tocsr()
        vertex_edge = ends.T.tocsr()
        valence = np.asarray(vertex_edge.sum(1)).ravel()
        faces_at = np.maximum(np.asarray(vertex_face.sum(1)).ravel(), 1)
        on_rim = np.asarray(vertex_edge @ (1 - inner)).ravel() > 0
        k = np.maximum(valence, 1)
        eye = _diag(np.ones(n))
        interior = (
            _diag(1 / (faces_at * k)) @ vertex_face @ face_point
            + _diag(2 / (k * k)) @ vertex_edge @ (_diag(np.full(m, 0.5)) @ ends)
            + _diag((k - 3) / k) @ eye
        )
        # Border: 1/2 v + 1/4 (mid_a + mid_b) = 6/8 v + 1/8 a + 1/8 b.
        rim = _diag(np.full(n, 0.5)) @ eye + vertex_edge @ _diag(0.25 * (1 - inner)) @ (_diag(np.full(m, 0.5)) @ ends)
        vertex_point = _diag((~on_rim).astype(float)) @ interior + _diag(on_rim.astype(float)) @ rim
        self.stencil = vstack([vertex_point, edge_point, face_point]).tocsr()
        face_ids = n + m + np.arange(f)
        self.quads = np.concatenate(
            [np.stack([quads[:, k], n + edge_of[:, k], face_ids, n + edge_of[:, k - 1]], 1) for k in range(4)]
        )
        self.edge_of = edge_of


def subdivide_uv(face_uv: np.ndarray) -> np.ndarray:
    """Linear subdivision of per-corner coordinates (f x 4 x d), in the face order of `Subdivision.quads`."""
    centre = face_uv.mean(1)
    return np.concatenate(
        [
            np.stack(
                [
                    face_uv[:, k],
                    (face_uv[:, k] + face_uv[:, (k + 1) % 4]) / 2,
                    centre,
                    (face_uv[:, k] + face_uv[:, k - 1]) / 2,
                ],
                1,
            )
            for k in range(4)
        ]
    )


def _diag(values: np.ndarray) -> csr_matrix:
    n = len(values)
    return csr_matrix((values, (np.arange(n), np.arange(n))), (n, n))


def write_obj(
    path: Path, vertices: np.ndarray, uv: np.ndarray, groups: list[tuple[str, list, list]], title: str
) -> None:
    """Writes `v`, `vt`, then `g NAME` with `f v/vt` lines; groups hold faces and their uv indices, from 0."""
    lines = [f"# {title}"]
    lines += [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in vertices + 0.0]
    lines += [f"vt {u:.5f} {v:.5f}" for u, v in uv]
    for name, faces, face_uvs in groups:
        lines.append(f"g {name}")
        for face, corner in zip(faces, face_uvs):
            lines.append("f " + " ".join(f"{a + 1}/{b + 1}" for a, b in zip(face, corner)))
    path.write_text("\n".join(lines) + "\n")


def read_obj(path: Path):
    """Vertices, uv, and groups name -> (faces, face_uvs) of an OBJ written by `write_obj`."""
    v, vt, groups, name = [], [], {}, ""
    for line in path.read_text().splitlines():
        word = line.split()
        if not word or word[0] == "#":
            continue
        if word[0] == "v":
            v.append([float(x) for x in word[1:4]])
        elif word[0] == "vt":
            vt.append([float(x) for x in word[1:3]])
        elif word[0] == "g":
            name = word[1]
            groups.setdefault(name, ([], []))
        elif word[0] == "f":
            corners = [[int(x) - 1 for x in c.split("/")] for c in word[1:]]
            groups[name][0].append([c[0] for c in corners])
            groups[name][1].append([c[1] for c in corners])
    return np.array(v), np.array(vt), groups
