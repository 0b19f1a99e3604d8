"""MeshMonk, trimesh's `nricp_amberg`, OpenCV's DIS flow and Facile on the same scans in one run; prints one table.

The scans are those of `ict_scans.py`; the measure is the transfer error of `transfer_error.py`. Every method fits the same
reference head: Facile the whole of it from the file alone, the others its face, from the pose that an ICP with scale
finds when it begins at the true position. CPU seconds hold what a method does for a scan, file reading included for Facile.

    pip install -r bench/peers/requirements-registration.txt
    python bench/peers/ict_scans.py --out OUT --count 5
    python bench/peers/registration.py OUT [--facile target/release/facile] [--methods icp,meshmonk,amberg,dis,facile]
"""

import argparse
import json
import os
import resource
import subprocess
import time
from pathlib import Path

import cv2
import numpy as np
import trimesh
from scipy.spatial import cKDTree
from transfer_error import border_points, head_of, nearest_on_mesh, read_obj

REFERENCE = Path(__file__).resolve().parents[2] / "assets" / "reference" / "head.obj"
HIDDEN = {"inner_mouth", "eye_socket", "left_ear", "right_ear", "scalp"}


def reference_face():
    """The front of the reference head's outer skin, once subdivided: positions (mm) and triangles."""
    positions, quads, group = [], [], ""
    for line in REFERENCE.read_text().splitlines():
        words = line.split()
        if not words:
            continue
        if words[0] == "v":
            positions.append([float(x) for x in words[1:4]])
        elif words[0] == "g":
            group = words[1]
        elif words[0] == "f" and group not in HIDDEN:
            quads.append([int(w.split("/")[0]) - 1 for w in words[1:]])
    positions, quads = np.array(positions), np.array(quads)
    middle = positions[quads].mean(axis=1)
    front = (np.abs(np.arctan2(middle[:, 0], middle[:, 2])) < 1.35) & (middle[:, 1] > -120)
    quads = quads[front]
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    used, local = np.unique(triangles, return_inverse=True)
    return trimesh.remesh.subdivide(positions[used], local.reshape(-1, 3))


def similarity(source, target):
    """Umeyama's: scale, rotation, translation."""
    a, b = source.mean(axis=0), target.mean(axis=0)
    u, s, vt = np.linalg.svd((target - b).T @ (source - a))
    sign = np.array([1, 1, np.sign(np.linalg.det(u @ vt))])
    scale = (s * sign).sum() / ((source - a) ** 2).sum()
    turn = u @ np.diag(sign) @ vt
    return scale, turn, b - scale * turn @ a


def icp(face, scan, rounds=60):
    """The face laid on the scan by turning, moving and scaling it; the nearest 70 % of the points count."""
    points = face[0] + scan[0][np.argmax(scan[0][:, 2])] - face[0][np.argmax(face[0][:, 2])]
    tree = cKDTree(scan[0])
    for _ in range(rounds):
        distance, nearest = tree.query(points)
        keep = distance <= np.quantile(distance, 0.7)
        scale, turn, shift = similarity(points[keep], scan[0][nearest[keep]])
        points = scale * points @ turn.T + shift
    return points


def meshmonk(face, scan):
    import meshmonk as peer

    result = peer.pyramid_register(
        trimesh.Trimesh(icp(face, scan), face[1], process=False), trimesh.Trimesh(*scan, process=False)
    )
    return np.asarray(result.aligned_vertices, float)


def amberg(face, scan):
    return trimesh.registration.nricp_amberg(
        trimesh.Trimesh(icp(face, scan), face[1], process=False), trimesh.Trimesh(*scan, process=False), use_faces=True
    )


def cylinder(mesh, size=512, reach=1.5, low=-130.0, high=90.0):
    """Radius of the outermost surface by height and angle (0 where there is none), seen from outside."""
    phi, h = np.meshgrid(np.linspace(-reach, reach, size), np.linspace(high, low, size))
    outwards = np.stack([np.sin(phi), np.zeros_like(phi), np.cos(phi)], axis=-1).reshape(-1, 3)
    origins = outwards * 300.0
    origins[:, 1] = h.ravel()
    hits, rays, _ = mesh.ray.intersects_location(origins, -outwards, multiple_hits=False)
    radius = np.zeros(size * size, np.float32)
    radius[rays] = np.hypot(hits[:, 0], hits[:, 2])
    return radius.reshape(size, size)


def dis(face, scan, size=512, reach=1.5, low=-130.0, high=90.0):
    """OpenCV's DIS flow between the radial maps of the aligned face and the scan, as a user would first try."""
    placed = icp(face, scan)
    # Back to the frame of the reference, where the cylinder stands.
    scale, turn, shift = similarity(placed, face[0])
    there = scale * scan[0] @ turn.T + shift
    maps = [cylinder(trimesh.Trimesh(v, t, process=False)) for v, t in (face, (there, scan[1]))]
    images = [np.uint8(np.clip((m - 30.0) * 2.5, 0, 255)) for m in maps]
    flow = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(*images, None)
    phi, h = np.arctan2(face[0][:, 0], face[0][:, 2]), face[0][:, 1]
    x = (phi + reach) / (2 * reach) * (size - 1)
    y = (high - h) / (high - low) * (size - 1)
    at = np.stack([x, y], axis=-1).astype(np.float32)[None]
    move = cv2.remap(flow, at[..., 0], at[..., 1], cv2.INTER_LINEAR)[0]
    ends = at[0] + move
    radius = cv2.remap(maps[1], ends[None, :, 0], ends[None, :, 1], cv2.INTER_LINEAR)[0]
    phi = ends[:, 0] / (size - 1) * 2 * reach - reach
    h = high - ends[:, 1] / (size - 1) * (high - low)
    points = np.stack([radius * np.sin(phi), h, radius * np.cos(phi)], axis=-1)
    points = np.where(radius[:, None] > 0, points, face[0])
    scale, turn, shift = similarity(face[0], placed)
    return scale * points @ turn.T + shift


def facile(program, scan_file, folder):
    """The whole registered head in the scan's coordinates."""
    glb, report = folder / "peer_head.glb", folder / "peer_report.json"
    # An empty cache, or the second run would measure reading.
    environment = {**os.environ, "XDG_CACHE_HOME": str(folder / "no_cache"), "RAYON_NUM_THREADS": "1"}
    subprocess.run(["rm", "-rf", str(folder / "no_cache")], check=True)
    command = [program, "register", scan_file, "-o", glb, "--report", report]
    subprocess.run(command, check=True, env=environment, stderr=subprocess.DEVNULL)
    head_from_scan = np.array(json.loads(report.read_text())["head_from_scan"])
    return (head_of(glb) - head_from_scan[:, 3]) @ np.linalg.inv(head_from_scan[:, :3]).T


def cpu_seconds():
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def transfer_errors(people):
    """Errors over all ordered pairs; a person is (registered points, truth, landmarks)."""
    known = []
    for points, (positions, triangles), landmarks in people:
        triangle, weights, distance = nearest_on_mesh(points, positions, triangles)
        counts = cKDTree(positions[landmarks]).query(points)[0] < 25
        counts &= cKDTree(border_points(positions, triangles)).query(points)[0] > 8
        known.append((triangle, weights, counts & (distance < 4)))
    errors = []
    for i, (triangle, weights, counts) in enumerate(known):
        for j, (points, (positions, triangles), _) in enumerate(people):
            if i != j:
                carried = np.einsum("nk,nkx->nx", weights, positions[triangles[triangle]])
                errors.append(np.linalg.norm(carried - points, axis=1)[counts])
    return np.concatenate(errors)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dir", type=Path)
    parser.add_argument("--facile", default="target/release/facile")
    parser.add_argument("--count", type=int, default=5)
    parser.add_argument("--methods", default="icp,meshmonk,amberg,dis,facile")
    args = parser.parse_args()
    face = reference_face()
    scans = [read_obj(args.dir / f"scan_{k}.obj") for k in range(args.count)]
    truths = [read_obj(args.dir / f"truth_{k}.obj") for k in range(args.count)]
    landmarks = np.loadtxt(args.dir / "landmarks.txt", dtype=int)
    others = {"icp": icp, "meshmonk": meshmonk, "amberg": amberg, "dis": dis}
    print(f"{args.count} identities, {args.count * (args.count - 1)} pairs, reference of {len(face[0])} vertices")
    print("| method | mean mm | median | p95 | CPU s per scan |\n|---|---|---|---|---|", flush=True)
    for name in args.methods.split(","):
        people, seconds = [], []
        for k, (scan, truth) in enumerate(zip(scans, truths)):
            start = cpu_seconds()
            if name == "facile":
                points = facile(args.facile, args.dir / f"scan_{k}.obj", args.dir)
            else:
                points = others[name](face, scan)
            seconds.append(cpu_seconds() - start)
            people.append((points, truth, landmarks))
        e = transfer_errors(people)
        row = f"| {name} | {e.mean():.2f} | {np.median(e):.2f} | {np.quantile(e, 0.95):.2f} | {np.median(seconds):.2f} |"
        print(row, flush=True)


if __name__ == "__main__":
    main()
