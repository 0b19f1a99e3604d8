"""Builds assets/clothes/shirt.obj: neck, shoulders and chest of MakeHuman's body as a round-necked shirt on the reference head.

Run: python build_clothes.py   (see requirements.txt)
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import mesh
import raster
from build_reference import Reference

OUT = Path(__file__).resolve().parent.parent / "clothes"
# How far the collar rises over the rim of the head's neck, and how far the cloth lies off the skin, mm.
COLLAR, OFFSET = 16.0, 5.0
# What no portrait shows is left out: below the chest, and the arms, mm in the base mesh.
BOTTOM, HALF_WIDTH = 330.0, 285.0


def shirt(ref: Reference) -> tuple[np.ndarray, np.ndarray]:
    """Vertices, mm, head frame, and quads."""
    quads = np.array(ref.base.groups["body"])[..., 0]
    p = ref.mean[quads]
    # The plane of the neck cut, see head.Crop
    plane = 566.0 + 0.3 * (30.0 - p[..., 2]) + 1.6 * np.maximum(0.0, np.abs(p[..., 0]) - 46.0)
    keep = (p[..., 1] < plane + COLLAR).all(1) & (p[..., 1] > BOTTOM).all(1)
    keep &= (np.abs(p[..., 0]) < HALF_WIDTH).all(1)
    index, faces = np.unique(quads[keep], return_inverse=True)
    faces = faces.reshape(-1, 4)
    v = ref.body[index]
    v = mesh_smooth(v, faces, 14)
    normal = raster.vertex_normals(v, mesh.triangles(faces))
    v = v + normal * OFFSET
    fine = mesh.Subdivision(faces, len(v))
    v = fine.stencil @ v
    return mesh_smooth(v, fine.quads, 3), fine.quads


def mesh_smooth(v: np.ndarray, quads: np.ndarray, rounds: int) -> np.ndarray:
    """Evens out the body under the cloth; the border keeps its place along itself."""
    near = mesh.neighbours(quads, len(v))
    rim = np.zeros(len(v), bool)
    edge = np.sort(np.concatenate([quads[:, [k, (k + 1) % 4]] for k in range(4)]), axis=1)
    unique, count = np.unique(edge, axis=0, return_counts=True)
    rim[unique[count == 1]] = True
    out = v.copy()
    for _ in range(rounds):
        mean = np.array([out[[j for j in near[i] if rim[j]]].mean(0) if rim[i] else out[near[i]].mean(0) for i in range(len(v))])
        out = 0.5 * out + 0.5 * mean
    return out


def main() -> None:
    OUT.mkdir(parents=True, exist_ok=True)
    ref = Reference()
    v, quads = shirt(ref)
    lines = ["# Shirt, mm, head frame. CC0 1.0, from MakeHuman. Built by build_clothes.py"]
    lines += [f"v {x:.2f} {y:.2f} {z:.2f}" for x, y, z in v + 0.0]
    lines += ["f " + " ".join(str(a + 1) for a in t) for t in mesh.triangles(quads)]
    (OUT / "shirt.obj").write_text("\n".join(lines) + "\n")
    print(f"shirt: {len(v)} vertices, {2 * len(quads)} triangles, {v.min(0).round(1)} to {v.max(0).round(1)}")


if __name__ == "__main__":
    main()
