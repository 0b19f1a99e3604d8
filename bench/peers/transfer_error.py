"""Transfer error of registrations by the command line tool, on the scans that `ict_scans.py` wrote.

Registers every `scan_k.obj` in DIR with `facile register` and measures, for each vertex of the registered head, how
far the same place of two people is apart (region: within 25 mm of an ibug-68 landmark, more than 8 mm from the
scan's border, within 4 mm of its surface).

    python bench/peers/transfer_error.py DIR [--facile target/release/facile] [--count 10] [--keep]
"""

import argparse
import json
import subprocess
import time
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import cKDTree


def read_obj(path):
    lines = [line.split() for line in path.read_text().splitlines()]
    positions = np.array([s[1:4] for s in lines if s[0] == "v"], float)
    triangles = np.array([[c.split("/")[0] for c in s[1:4]] for s in lines if s[0] == "f"], int) - 1
    return positions, triangles


def closest(points, corners):
    """Barycentric weights and distance of the nearest point of one triangle each (Ericson 5.1.5, by projection)."""
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    best_w, best_d = None, np.full(points.shape[:-1], np.inf)

    def offer(weights, valid):
        nonlocal best_w, best_d
        q = np.einsum("...k,...kx->...x", weights, corners)
        d = np.where(valid, np.linalg.norm(q - points, axis=-1), np.inf)
        best_w = weights if best_w is None else np.where((d < best_d)[..., None], weights, best_w)
        best_d = np.minimum(best_d, d)

    ab, ac, ap = b - a, c - a, points - a
    d00, d01, d11 = (ab * ab).sum(-1), (ab * ac).sum(-1), (ac * ac).sum(-1)
    d20, d21 = (ap * ab).sum(-1), (ap * ac).sum(-1)
    det = np.maximum(d00 * d11 - d01 * d01, 1e-12)
    v, w = (d11 * d20 - d01 * d21) / det, (d00 * d21 - d01 * d20) / det
    offer(np.stack([1 - v - w, v, w], -1), (v >= 0) & (w >= 0) & (v + w <= 1))
    for i, j in ((0, 1), (1, 2), (2, 0)):
        p, e = corners[..., i, :], corners[..., j, :] - corners[..., i, :]
        t = np.clip(((points - p) * e).sum(-1) / np.maximum((e * e).sum(-1), 1e-12), 0, 1)
        weights = np.zeros((*points.shape[:-1], 3))
        weights[..., i], weights[..., j] = 1 - t, t
        offer(weights, True)
    return best_w, best_d


def nearest_on_mesh(points, positions, triangles, candidates=24):
    corners = positions[triangles]
    _, near = cKDTree(corners.mean(axis=1)).query(points, k=candidates)
    weights, distance = closest(np.repeat(points[:, None], candidates, 1), corners[near])
    pick = distance.argmin(axis=1)
    rows = np.arange(len(points))
    return near[rows, pick], weights[rows, pick], distance[rows, pick]


def border_points(positions, triangles):
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    return positions[np.unique(unique[count == 1])]


def head_of(glb):
    mesh = trimesh.load(glb, process=False).geometry["head"]
    vertices = np.asarray(mesh.vertices, float)
    return vertices * 1000.0 if np.abs(vertices).max() < 5 else vertices


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dir", type=Path)
    parser.add_argument("--facile", default="target/release/facile")
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--keep", action="store_true", help="measure the GLB files of the last run")
    args = parser.parse_args()
    landmarks = np.loadtxt(args.dir / "landmarks.txt", dtype=int)
    people = []
    for k in range(args.count):
        glb, report = args.dir / f"head_{k}.glb", args.dir / f"report_{k}.json"
        start = time.perf_counter()
        if not args.keep:
            subprocess.run(
                [args.facile, "register", args.dir / f"scan_{k}.obj", "-o", glb, "--report", report],
                check=True,
                stdout=subprocess.DEVNULL,
            )
        seconds = time.perf_counter() - start
        facts = json.loads(report.read_text())
        head_from_scan = np.array(facts["head_from_scan"])
        linear, shift = head_from_scan[:, :3], head_from_scan[:, 3]
        placed = (head_of(glb) - shift) @ np.linalg.inv(linear).T
        positions, triangles = read_obj(args.dir / f"truth_{k}.obj")
        triangle, weights, distance = nearest_on_mesh(placed, positions, triangles)
        near_mark = cKDTree(positions[landmarks]).query(placed)[0] < 25
        inside = cKDTree(border_points(positions, triangles)).query(placed)[0] > 8
        people.append((placed, positions, triangles, triangle, weights, near_mark & inside & (distance < 4)))
        print(
            f"{k}: {seconds:.1f} s, size {facts['size']:.3f}, rigid {facts['rigid_distance_mm']:.2f} mm,"
            f" surface {facts['surface_distance_mean_mm']:.2f} mm, folded {facts['folded_triangles']}"
        )
    errors, by_vertex, hits = [], 0, 0
    for i, (_, _, _, triangle, weights, counts) in enumerate(people):
        for j, (placed, positions, triangles, *_) in enumerate(people):
            if i != j:
                carried = np.einsum("nk,nkx->nx", weights, positions[triangles[triangle]])
                error = np.linalg.norm(carried - placed, axis=1)
                errors.append(error[counts])
                by_vertex = by_vertex + np.where(counts, error, 0)
                hits = hits + counts
    errors = np.concatenate(errors)
    print(
        f"transfer error over {len(people) * (len(people) - 1)} pairs:"
        f" mean {errors.mean():.2f} median {np.median(errors):.2f} p95 {np.quantile(errors, 0.95):.2f} mm"
    )
    np.save(args.dir / "error_by_vertex.npy", by_vertex / np.maximum(hits, 1))


if __name__ == "__main__":
    main()
