"""Draws docs/muscles_1.jpg, docs/muscles_2.jpg and docs/expressions.jpg: what each muscle does, alone.

Each row is a muscle: a subject at rest, at half and at full contraction, then a second subject. Shaded as clay under the
subject's own colours, so that folds show. Needs NumPy, Pillow, trimesh, embreex.

    python docs/build/muscles.py [--facile target/release/facile] [--only NAME ...] [-o docs]
"""

import argparse
import subprocess
import tempfile
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image, ImageDraw

TILE, BAND = 200, 14
SUBJECTS = ("emi", "bjorn")
LIGHT = np.array([-0.1, 0.6, 0.8])
AMBIENT, DIFFUSE = 0.28, 0.85


class Head:
    """Meshes of one GLB as one ray-traced scene with colours."""

    def __init__(self, path):
        scene = trimesh.load(path)
        vertices, faces, normals, colors = [], [], [], []
        count = 0
        for name, part in scene.geometry.items():
            if name in ("tongue",):
                continue
            picture = part.visual.material.baseColorTexture
            picture = np.asarray(picture.convert("RGB"), float) / 255
            uv = np.clip(part.visual.uv, 0, 1)
            row = ((1 - uv[:, 1]) * (picture.shape[0] - 1)).astype(int)
            column = (uv[:, 0] * (picture.shape[1] - 1)).astype(int)
            color = picture[row, column] ** 2.2
            if name == "head":
                color = 0.45 * color + 0.55 * np.array([0.42, 0.36, 0.33])
            vertices.append(part.vertices)
            # Seams of the texture double vertices: normals are those of the welded surface.
            normals.append(welded_normals(part))
            colors.append(color)
            faces.append(part.faces + count)
            count += len(part.vertices)
        self.vertices = np.concatenate(vertices)
        self.normals = np.concatenate(normals)
        self.colors = np.concatenate(colors)
        self.mesh = trimesh.Trimesh(self.vertices, np.concatenate(faces), process=False)

    def picture(self, size):
        """The head from a little to its left."""
        eye, target = np.array([170.0, 0.0, 620.0]), np.array([4.0, -42.0, 40.0])
        forward = (target - eye) / np.linalg.norm(target - eye)
        right = np.cross(forward, [0, 1, 0])
        right /= np.linalg.norm(right)
        up = np.cross(right, forward)
        reach = np.tan(np.radians(8.6))
        places = (np.arange(size) + 0.5) / size * 2 - 1
        x, y = np.meshgrid(places * reach, -places * reach)
        rays = forward + x[..., None] * right + y[..., None] * up
        rays = rays.reshape(-1, 3)
        rays /= np.linalg.norm(rays, axis=1)[:, None]
        triangles, ray, points = self.mesh.ray.intersects_id(
            np.tile(eye, (len(rays), 1)), rays, multiple_hits=False, return_locations=True
        )
        corners = self.mesh.faces[triangles]
        weights = trimesh.triangles.points_to_barycentric(self.vertices[corners], points)
        normal = (self.normals[corners] * weights[..., None]).sum(1)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        color = (self.colors[corners] * weights[..., None]).sum(1)
        light = LIGHT / np.linalg.norm(LIGHT)
        shade = AMBIENT + DIFFUSE * np.clip(normal @ light, 0, 1)
        image = np.full((size * size, 3), 0.9)
        image[ray] = np.clip(color * shade[:, None] * 1.5, 0, 1) ** (1 / 2.2)
        return Image.fromarray((255 * image.reshape(size, size, 3)).astype(np.uint8))


def welded_normals(part):
    keys, index = np.unique(np.round(part.vertices, 4), axis=0, return_inverse=True)
    index = index.ravel()
    corners = part.vertices[part.faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sums = np.zeros((len(keys), 3))
    for k in range(3):
        np.add.at(sums, index[part.faces[:, k]], area)
    return (sums / np.maximum(np.linalg.norm(sums, axis=1), 1e-12)[:, None])[index]


def posed(facile, folder, subject, options):
    path = Path(folder) / (subject + "".join(options).replace("/", "") + ".glb")
    command = [facile, "pose", f"builtin:{subject}", *options, "-o", path]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        print(subject, options, done.stderr.strip())
        return Image.new("RGB", (TILE, TILE), "white")
    return Head(path).picture(2 * TILE).resize((TILE, TILE), Image.LANCZOS)


def sheet(facile, rows, path):
    """Rows of (label, options of each of the columns of a subject)."""
    columns = len(rows[0][1]) * len(SUBJECTS)
    out = Image.new("RGB", (columns * TILE, len(rows) * (TILE + BAND)), "white")
    pen = ImageDraw.Draw(out)
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(2) as pool:
        jobs = {}
        for i, (label, poses) in enumerate(rows):
            pen.text((4, i * (TILE + BAND) + 1), label, "black")
            for s, subject in enumerate(SUBJECTS):
                for k, options in enumerate(poses):
                    key = (subject, tuple(options))
                    if key not in jobs:
                        jobs[key] = pool.submit(posed, facile, folder, subject, options)
                    place = ((s * len(poses) + k) * TILE, i * (TILE + BAND) + BAND)
                    jobs.setdefault("places", []).append((place, key))
        for place, key in jobs.pop("places"):
            out.paste(jobs[key].result(), place)
    out.save(path, quality=85)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--facile", default="target/release/facile")
    parser.add_argument("--only", nargs="*")
    parser.add_argument("-o", "--output", default="docs", type=Path)
    arguments = parser.parse_args()
    file = tomllib.loads(Path("assets/muscles.toml").read_text())
    names = [m["name"] for m in file["muscle"]]
    rows = [
        (name, [[], ["--muscle", f"{name}=0.5"], ["--muscle", f"{name}=1"]]) for name in names
    ]
    if arguments.only:
        rows = [r for r in rows if r[0] in arguments.only]
        sheet(arguments.facile, rows, arguments.output / "muscles_only.png")
        return
    half = (len(rows) + 1) // 2
    sheet(arguments.facile, rows[:half], arguments.output / "muscles_1.jpg")
    sheet(arguments.facile, rows[half:], arguments.output / "muscles_2.jpg")
    file = tomllib.loads(Path("assets/expressions.toml").read_text())
    expressions = [e["name"] for e in file["expression"] if e["name"] != "neutral"]
    rows = [(name, [[], ["--expression", name]]) for name in expressions]
    sheet(arguments.facile, rows, arguments.output / "expressions.jpg")


if __name__ == "__main__":
    main()
