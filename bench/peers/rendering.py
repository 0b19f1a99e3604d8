"""Renders one scene with Facile and with other ray tracers, and prints time and error of each in one table.

    python bench/peers/rendering.py --data ../shared/data/trace_scene --facile target/release/facile [--repeats 9]

DATA holds head_36k.obj, tex.png, scene.json and reference_256.png. Every tracer gives the same image: first hits,
smooth normals, bilinear texture, one point light with hard shadows, ambient light and a Phong highlight, in linear light.
Shadow rays start 0.2 mm above the triangle along the shading normal: with that start, and with no other, the images of all
tracers come to the reference as samples grow. (Facile by itself starts them on the smooth surface; the scene says
`smooth_shadows = false`.) embreex and Open3D trace, NumPy shades; Mitsuba traces and shades by Dr.Jit (LLVM). 16 samples are a
grid of 4 x 4 in each pixel. Times are CPU ms of a frame on one thread without building the tree, but for the rows "moved",
where each frame has new vertices: the median of the repeats, for Facile the mean, with depth, normals, ids and the encoding of
the image. All are taken in one run, one after the other. The error is the root mean square over all channels of the 8-bit
image.

Each tracer runs in a process of its own; one that is not installed, or does not run, is left out with a note. Needs numpy and pillow; embreex, open3d and
mitsuba as you like. Mitsuba's Dr.Jit needs LLVM 16 or newer on processors with AVX-512: DRJIT_LIBLLVM_PATH names its library.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ[name] = "1"

import numpy as np
from PIL import Image


SHADOW_START_MM = 0.2


class Scene:
    """The scene's arrays, and its camera's rays."""

    def __init__(self, folder: Path):
        self.settings = json.loads((folder / "scene.json").read_text())
        corners: dict[str, list] = {"v": [], "vt": [], "vn": []}
        faces = []
        for line in (folder / "head_36k.obj").read_text().splitlines():
            word, *rest = line.split()
            if word in corners:
                corners[word].append([float(x) for x in rest])
            elif word == "f":
                faces.append([[int(i) - 1 for i in corner.split("/")] for corner in rest])
        faces = np.array(faces)
        self.positions = np.array(corners["v"], np.float32)
        self.triangles = np.ascontiguousarray(faces[:, :, 0]).astype(np.uint32)
        self.uv = np.array(corners["vt"], np.float32)[:, :2][faces[:, :, 1]]
        self.normals = np.array(corners["vn"], np.float32)[faces[:, :, 2]]
        code = np.asarray(Image.open(folder / "tex.png").convert("RGB")).astype(np.float32) / 255
        self.texture = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4).astype(np.float32)

    def rays(self, size: int):
        """Origin and unit directions of the pixels' centres, row by row."""
        s = self.settings
        origin = np.array(s["cam_pos"], np.float32)
        forward = np.array(s["cam_target"], np.float32) - origin
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, np.array(s["cam_up"], np.float32))
        right /= np.linalg.norm(right)
        half = math.tan(math.radians(s["fov_deg"]) / 2)
        at = ((np.arange(size, dtype=np.float32) + 0.5) / size * 2 - 1) * half
        x, y = np.meshgrid(at, -at)
        directions = forward + x[..., None] * right + y[..., None] * np.cross(right, forward)
        directions = directions.reshape(-1, 3).astype(np.float32)
        return origin, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def srgb8(linear: np.ndarray) -> np.ndarray:
    linear = np.clip(linear, 0, 1)
    code = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)
    return (code * 255 + 0.5).astype(np.uint8)


def shade(scene: Scene, size: int, closest, occluded) -> np.ndarray:
    """The linear image by NumPy. `closest(origins, directions)` gives triangle (-1 for none), u and v; `occluded(origins,
    towards)` whether anything lies between."""
    s = scene.settings
    origin, directions = scene.rays(size)
    triangle, u, v = closest(np.broadcast_to(origin, directions.shape), directions)
    hit = np.flatnonzero(triangle >= 0)
    triangle, view = triangle[hit], -directions[hit]
    weights = np.stack([1 - u[hit] - v[hit], u[hit], v[hit]], axis=1)[:, :, None].astype(np.float32)
    point = (scene.positions[scene.triangles[triangle]] * weights).sum(1)
    normal = (scene.normals[triangle] * weights).sum(1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    height, width, _ = scene.texture.shape
    at = (scene.uv[triangle] * weights).sum(1) * [1, -1] + [0, 1]
    at = at * [width, height] - 0.5
    low = np.floor(at).astype(int)
    fraction = (at - low).astype(np.float32)[:, :, None]
    albedo = np.zeros_like(point)
    for dx in (0, 1):
        for dy in (0, 1):
            x, y = np.clip(low[:, 0] + dx, 0, width - 1), np.clip(low[:, 1] + dy, 0, height - 1)
            wx = fraction[:, 0] if dx else 1 - fraction[:, 0]
            wy = fraction[:, 1] if dy else 1 - fraction[:, 1]
            albedo += scene.texture[y, x] * wx * wy
    to_light = np.array(s["light_pos"], np.float32) - point
    squared = (to_light**2).sum(1, keepdims=True)
    towards = to_light / np.sqrt(squared)
    cosine = (normal * towards).sum(1, keepdims=True)
    start = point + normal * SHADOW_START_MM
    lit = np.flatnonzero(cosine[:, 0] > 0)
    arrives = np.zeros_like(cosine)
    arrives[lit, 0] = ~occluded(start[lit], np.array(s["light_pos"], np.float32) - start[lit])
    power = arrives * np.maximum(cosine, 0) * s["light_I"] / squared
    mirrored = 2 * cosine * normal - towards
    lobe = np.maximum((mirrored * view).sum(1, keepdims=True), 0) ** s["shininess"]
    glow = s["ks"] * (s["shininess"] + 2) / (2 * math.pi) * lobe
    image = np.zeros((size * size, 3), np.float32)
    image[hit] = albedo * (s["ambient"] + power / math.pi) + glow * power
    return image.reshape(size, size, 3)


def embreex_tracer(scene: Scene):
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    tree = rtcore_scene.EmbreeScene()
    TriangleMesh(tree, scene.positions, scene.triangles.astype(np.int32))

    def closest(origins, directions):
        found = tree.run(np.ascontiguousarray(origins), np.ascontiguousarray(directions), output=1)
        return found["primID"].astype(np.int64), found["u"], found["v"]

    def occluded(origins, towards):
        length = np.linalg.norm(towards, axis=1).astype(np.float32)
        directions = np.ascontiguousarray(towards / length[:, None], np.float32)
        return tree.run(np.ascontiguousarray(origins), directions, dists=length, query="OCCLUDED") == 0

    return lambda size: shade(scene, size, closest, occluded)


def open3d_tracer(scene: Scene):
    import open3d as o3d

    tree = o3d.t.geometry.RaycastingScene(nthreads=1)
    tree.add_triangles(o3d.core.Tensor(scene.positions), o3d.core.Tensor(scene.triangles))

    def rays(origins, directions):
        return o3d.core.Tensor(np.concatenate([origins, directions], axis=1).astype(np.float32))

    def closest(origins, directions):
        found = tree.cast_rays(rays(origins, directions), nthreads=1)
        triangle = found["primitive_ids"].numpy().astype(np.int64)
        uv = found["primitive_uvs"].numpy()
        return np.where(triangle == tree.INVALID_ID, -1, triangle), uv[:, 0], uv[:, 1]

    def occluded(origins, towards):
        return tree.test_occlusions(rays(origins, towards), tnear=0.0, tfar=1.0, nthreads=1).numpy()

    return lambda size: shade(scene, size, closest, occluded)


def mitsuba_tracer(scene: Scene):
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    import drjit as dr

    dr.set_thread_count(1)
    s = scene.settings
    mesh = mi.Mesh("head", 3 * len(scene.triangles), len(scene.triangles), has_vertex_normals=True,
                   has_vertex_texcoords=True)
    values = mi.traverse(mesh)
    values["vertex_positions"] = scene.positions[scene.triangles].ravel()
    values["vertex_normals"] = scene.normals.ravel()
    values["vertex_texcoords"] = (scene.uv * [1, -1] + [0, 1]).astype(np.float32).ravel()
    values["faces"] = np.arange(3 * len(scene.triangles), dtype=np.uint32)
    values.update()
    world = mi.load_dict({"type": "scene", "head": mesh})
    texture = mi.Texture2f(mi.TensorXf(scene.texture), wrap_mode=dr.WrapMode.Clamp)
    lamp = mi.Point3f(*s["light_pos"])

    def render(size):
        origin, directions = scene.rays(size)
        ray = mi.Ray3f(mi.Point3f(*origin.tolist()), mi.Vector3f(directions.T))
        found = world.ray_intersect(ray, mi.RayFlags.All, True)
        normal = found.sh_frame.n
        to_light = lamp - found.p
        squared = dr.squared_norm(to_light)
        towards = to_light * dr.rsqrt(squared)
        cosine = dr.dot(normal, towards)
        start = found.p + normal * SHADOW_START_MM
        shadow = mi.Ray3f(start, lamp - start, 1.0, 0.0, [])
        lit = found.is_valid() & (cosine > 0)
        lit &= ~world.ray_test(shadow, lit)
        power = dr.select(lit, cosine * s["light_I"] / squared, 0.0)
        mirrored = 2 * cosine * normal - towards
        lobe = dr.power(dr.maximum(dr.dot(mirrored, -ray.d), 0), s["shininess"])
        glow = s["ks"] * (s["shininess"] + 2) / (2 * math.pi) * lobe
        albedo = mi.Color3f(texture.eval(found.uv))
        color = albedo * (s["ambient"] + power / math.pi) + glow * power
        color = dr.select(found.is_valid(), color, 0.0)
        return np.array(color).T.reshape(size, size, 3)

    return render


SCENE_TOML = """frames = {frames}
{jitter}
[image]
size = [{size}, {size}]
samples = {samples}
truth = [{truth}]
offset_mm = {offset}
smooth_shadows = false
[camera]
position = {cam_pos}
target = {cam_target}
up = {cam_up}
fov_y_deg = {fov_deg}
[[mesh]]
file = "{data}/head_36k.obj"
texture = "{data}/tex.png"
specular = {ks}
shininess = {shininess}
[[light]]
kind = "point"
position = {light_pos}
intensity = {intensity}
[[light]]
kind = "ambient"
intensity = {ambient}
"""


LABELS = '"depth", "normals", "segments"'


def facile_row(scene: Scene, folder: Path, program: str, size: int, repeats: int, samples="1", jitter=0.0, truth=LABELS):
    """CPU ms of a frame with depth, normals and ids, and the image."""
    s = scene.settings
    # Enough that loading and building are told apart
    frames = repeats * (6 if samples == "1" else 2)
    text = SCENE_TOML.format(
        **{k: s[k] for k in ("cam_pos", "cam_target", "cam_up", "fov_deg", "ks", "shininess", "light_pos", "ambient")},
        frames=frames, size=size, samples=samples, truth=truth, offset=SHADOW_START_MM, data=folder.resolve(),
        intensity=s["light_I"] / 1e6 / math.pi, jitter=f"jitter_mm = {jitter}" if jitter else "")

    def cpu(text):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        file.write_text(text)
        subprocess.run([program, "render", file, "-o", out], check=True, stdout=subprocess.DEVNULL)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    with tempfile.TemporaryDirectory() as out:
        file = Path(out) / "scene.toml"
        # One frame alone is what loading and building take
        alone = cpu(text.replace(f"frames = {frames}", "frames = 1"))
        ms = (cpu(text) - alone) / (frames - 1) * 1e3
        return ms, np.asarray(Image.open(Path(out, "color.png")).convert("RGB"))


PEERS = {"embreex": embreex_tracer, "open3d": open3d_tracer, "mitsuba": mitsuba_tracer}


def peer_rows(name: str, scene: Scene, reference: np.ndarray, repeats: int):
    """Name, ms and error of each way to render."""
    render = PEERS[name](scene)

    def frame(size, side=1):
        """A frame of `side` x `side` samples a pixel."""
        linear = render(size * side)
        return srgb8(linear.reshape(size, side, size, side, 3).mean((1, 3)) if side > 1 else linear)

    def timed(work, count):
        times = []
        for _ in range(count):
            start = time.process_time()
            work()
            times.append((time.process_time() - start) * 1e3)
        return sorted(times)[count // 2]

    for label, size, side in (("256 x 256", 256, 1), ("512 x 512", 512, 1), ("256 x 256, 16 samples", 256, 4)):
        image = frame(size, side)
        ms = timed(lambda: frame(size, side), repeats if side == 1 else max(3, repeats // 3))
        yield f"{name}, {label}", ms, error(image, reference)
    rest, random = scene.positions.copy(), np.random.default_rng(0)

    def moved():
        scene.positions = (rest + random.uniform(-0.2, 0.2, rest.shape)).astype(np.float32)
        srgb8(PEERS[name](scene)(256))

    moved()
    yield f"{name}, 256 x 256, moved", timed(moved, max(3, repeats // 3)), ""


def error(image: np.ndarray, reference: np.ndarray) -> str:
    if image.shape != reference.shape:
        return ""
    return f"{np.sqrt(((image - reference) ** 2).mean()):.3f}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--facile", default="facile")
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--only", choices=PEERS, help="rows of one peer as JSON")
    options = parser.parse_args()
    scene = Scene(options.data)
    reference = np.asarray(Image.open(options.data / "reference_256.png").convert("RGB")).astype(float)
    if options.only:
        print(json.dumps(list(peer_rows(options.only, scene, reference, options.repeats))))
        return
    rows = []
    for name in PEERS:
        command = [sys.executable, __file__, "--data", options.data, "--repeats", str(options.repeats), "--only", name]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode == 0:
            rows += json.loads(done.stdout.splitlines()[-1])
        else:
            reason = (done.stderr.strip().splitlines() or [""])[-1]
            rows.append((f"{name}: left out, exit code {done.returncode}, {reason[:80]}", None, ""))
    layers = LABELS + ', "occlusion", "layers"'
    ways = (("256 x 256", 256, "1", 0.0, LABELS), ("256 x 256, moved", 256, "1", 0.2, LABELS),
            ("256 x 256, four layers, amodal masks", 256, "1", 0.0, layers), ("512 x 512", 512, "1", 0.0, LABELS),
            ("256 x 256, 16 samples", 256, "16", 0.0, LABELS), ("256 x 256, adaptive", 256, '"adaptive"', 0.0, LABELS))
    for name, size, samples, jitter, truth in ways:
        ms, image = facile_row(scene, options.data, options.facile, size, options.repeats, samples, jitter, truth)
        rows.append((f"facile, {name}", ms, "" if jitter else error(image, reference)))
    print("| tracer | ms | RMSE |\n|---|---|---|")
    for name, ms, rmse in rows:
        print(f"| {name} | {'' if ms is None else f'{ms:.1f}'} | {rmse} |")


if __name__ == "__main__":
    main()
