"""Draws docs/registration.jpg: scans, the reference head registered to them, and both in alternate squares.

Where the squares join without a step, the registered head lies on the scan. Needs NumPy, Pillow, trimesh. The scans given
come first, then five of the built-in subjects, faces sampled from MakeHuman. The picture in the docs is made by

    python bench/peers/ict_scans.py --out OUT --count 5
    python docs/build/overlays.py SCANS/james/james.obj SCANS/fran/fran.obj OUT/scan_{0,1,2,3,4}.obj

    python docs/build/overlays.py [SCAN...] [--facile target/release/facile] [-o docs/registration.jpg]
"""

import argparse
import json
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

TILE, SQUARE = 240, 24
SUBJECTS = Path(__file__).resolve().parents[2] / "assets" / "subjects"
SAMPLED = [SUBJECTS / f"{name}.glb" for name in ("amara", "bjorn", "emi", "greta", "kwang")]
SCENE = """
[image]
size = [{tile}, {tile}]
samples = "adaptive"
[camera]
position = [230, 10, 640]
target = [0, -25, 20]
fov_y_deg = 25
[[light]]
kind = "point"
position = [-260, 300, 620]
intensity = 0.5
[[light]]
kind = "ambient"
intensity = 0.35
"""
MESH = """
[[mesh]]
file = "{name}.obj"
{texture}
specular = 0.03
shininess = 20
"""


def write_obj(path, mesh, positions):
    """One mesh with its texture beside it, in millimetres."""
    uv = getattr(mesh.visual, "uv", None)
    lines = [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in positions]
    lines += [f"vn {x:.4f} {y:.4f} {z:.4f}" for x, y, z in trimesh.Trimesh(positions, mesh.faces, process=False).vertex_normals]
    lines += [f"vt {u:.6f} {v:.6f}" for u, v in uv] if uv is not None else []
    corner = "{0}/{0}/{0}" if uv is not None else "{0}//{0}"
    lines += ["f " + " ".join(corner.format(i + 1) for i in f) for f in mesh.faces]
    path.write_text("\n".join(lines) + "\n")
    material = getattr(mesh.visual, "material", None)
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    if uv is None or image is None:
        return ""
    image.convert("RGB").save(path.with_suffix(".png"))
    return f'texture = "{path.with_suffix(".png").name}"'


def render(program, folder, name, parts):
    """The picture of some meshes with their positions."""
    text = SCENE.format(tile=TILE)
    for k, (mesh, positions) in enumerate(parts):
        part = f"{name}_{k}"
        text += MESH.format(name=part, texture=write_obj(folder / f"{part}.obj", mesh, positions))
    scene = folder / f"{name}.toml"
    scene.write_text(text)
    subprocess.run([program, "render", scene, "-o", folder / name], check=True, stderr=subprocess.DEVNULL)
    return np.asarray(Image.open(folder / name / "color.png").convert("RGB"))


def row(program, scan_file, folder):
    """Scan, registered head, both in squares."""
    glb, report = folder / "head.glb", folder / "report.json"
    subprocess.run([program, "register", scan_file, "-o", glb, "--report", report], check=True)
    head_from_scan = np.array(json.loads(report.read_text())["head_from_scan"])
    scan = trimesh.load(scan_file, process=False, force="mesh")
    beside = scan_file.with_suffix(".jpg")
    if scan_file.suffix == ".obj" and beside.exists():
        scan.visual.material = trimesh.visual.material.SimpleMaterial(image=Image.open(beside))
    head = trimesh.load(glb, process=False).geometry
    parts = [(head[name], np.asarray(head[name].vertices)) for name in ("head", "left_eye", "right_eye")]
    placed = np.asarray(scan.vertices) @ head_from_scan[:, :3].T + head_from_scan[:, 3]
    a = render(program, folder, "scan", [(scan, placed)])
    b = render(program, folder, "registered", parts)
    y, x = np.mgrid[:TILE, :TILE] // SQUARE
    return np.hstack([a, b, np.where(((x + y) % 2 == 0)[..., None], a, b)])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scans", type=Path, nargs="*")
    parser.add_argument("--facile", default="target/release/facile")
    parser.add_argument("-o", "--output", type=Path, default=Path(__file__).resolve().parents[1] / "registration.jpg")
    args = parser.parse_args()
    rows = []
    for scan in args.scans + SAMPLED:
        with tempfile.TemporaryDirectory() as folder:
            rows.append(row(args.facile, scan, Path(folder)))
    if len(rows) % 2:
        rows.append(np.zeros_like(rows[0]))
    half = len(rows) // 2
    Image.fromarray(np.vstack([np.hstack([rows[i], rows[half + i]]) for i in range(half)])).save(args.output, quality=88)


if __name__ == "__main__":
    main()
