"""Builds a population for `facile reference build`: adults sampled from MakeHuman as a scanner would have delivered them.

Run: python build_population.py DIR [COUNT]   (120 scans in about five minutes; nothing of it is committed)

The same people as in build_reference.py, and more drawn on, slightly asymmetric, in one of the painted skins, each scanned
like the built-in subjects: own triangles, noise, a torn neck, a pose that is a little off.
"""

from __future__ import annotations

import io
import sys
from pathlib import Path

import numpy as np
from PIL import Image

import glb
import makehuman
import parts
import scanner
import skins
from build_identity import ASYMMETRY, close_both, in_head_frame
from build_reference import SEED, Reference
from build_subjects import pose

SKINS = Path(__file__).resolve().parent.parent / "identity" / "skins"
COUNT = 120
TRIANGLES = 16000
TEXELS = 512
SEXES = ("female", "male")


def look_of(person: makehuman.Person) -> skins.Look:
    """The painted skin nearest in sex, ancestry and age."""
    sex, race = SEXES[int(person.male > 0.5)], makehuman.RACES[int(np.argmax(person.race))]
    years = {"young": 25, "middleage": 48, "old": 70}
    fitting = [look for look in skins.LOOKS if look.sex == sex and look.ancestry == race]
    return min(fitting, key=lambda look: abs(years[look.age] - person.years))


def eyes_of(ref: Reference, cage: np.ndarray, full: np.ndarray) -> tuple[np.ndarray, float]:
    """Eye centres and radius behind the lids of a cage."""
    fits = []
    for side, group in ((1, "helper-l-eye"), (-1, "helper-r-eye")):
        p = full[np.unique([c[0] for f in ref.base.groups[group] for c in f])]
        fits.append(parts.EyeFit.of(cage, ref.regions.eye_ring, side, (p.min(0) + p.max(0)) / 2))
    return np.array([f.centre for f in fits]), float(np.mean([f.radius for f in fits]))


def scan(ref: Reference, number: int, keep: np.ndarray | None, out: Path) -> np.ndarray:
    """Writes one scan; returns which triangles of the source the scanner saw, which hardly depends on the person."""
    person = makehuman.Person(np.random.default_rng([SEED, number]), asymmetry=ASYMMETRY)
    rng = np.random.default_rng([SEED, number, 1])
    cage, full = in_head_frame(ref, person.shape(ref.base))
    cage = close_both(ref, cage)
    eyes, radius = eyes_of(ref, cage, full)
    source = scanner.Source(ref, cage, eyes, radius)
    keep = scanner.visible(source) if keep is None else keep
    v, tri = scanner.remesh(source, keep, TRIANGLES, SEED + number, -128.0 + rng.normal(0, 6))
    v, tri, uv = scanner.own_uv(v, tri)
    look = look_of(person)
    skin = np.asarray(Image.open(SKINS / f"{look.name}.jpg").convert("RGB"))
    eye = parts.eye_texture(look.eye_colours()[0], 512, radius)
    texture = scanner.bake(source, keep, v, tri, uv, skin, eye, TEXELS)
    jpeg = io.BytesIO()
    Image.fromarray(np.clip(texture + 0.5, 0, 255).astype(np.uint8)).save(jpeg, "JPEG", quality=86)
    turn, shift = pose(rng)
    glb.write(out / f"{number:04}.glb", v @ turn.T + shift, uv, tri, jpeg.getvalue(), "CC0 1.0, from MakeHuman")
    return keep


def main() -> None:
    out = Path(sys.argv[1])
    count = int(sys.argv[2]) if len(sys.argv) > 2 else COUNT
    out.mkdir(parents=True, exist_ok=True)
    ref = Reference()
    keep = None
    for number in range(count):
        keep = scan(ref, number, keep, out)


if __name__ == "__main__":
    main()
