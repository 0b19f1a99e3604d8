"""Eyes, teeth and tongue: rigid parts in the head frame, with their own small textures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image
from scipy.optimize import least_squares
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

import makehuman
import mesh
import raster
from head import smoothstep

IRIS_RADIUS = 6.0
CORNEA_BULGE = 0.45
# Half angle of the eye texture: uv radius 0.5 at this angle from the optical axis; behind it the white goes on.
EYE_TEXTURE_ANGLE = np.radians(108.0)
RINGS, SECTORS = 40, 48
# The optical axis of an eye that looks straight ahead points this much outward (angle kappa, about 5 degrees).
KAPPA = np.radians(4.5)


def optical_axis(side: int) -> np.ndarray:
    """Unit vector from the eye's centre through the middle of the iris at rest; side: 1 left, -1 right."""
    return np.array([side * np.sin(KAPPA), 0.0, np.cos(KAPPA)])


def place_eye(points: np.ndarray, side: int, centre: np.ndarray) -> np.ndarray:
    """Turns the eyeball's pole from +z to the optical axis and moves it to its centre."""
    c, s = np.cos(KAPPA), side * np.sin(KAPPA)
    return points @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T + centre


class EyeFit:
    """The sphere that fills the lid slit: it passes between the inner lid margin and the border of the socket."""

    def __init__(self, ref) -> None:
        self._solve(ref.v, ref.regions.eye_ring, 1, ref.eyes[0])

    @classmethod
    def of(cls, v: np.ndarray, ring: np.ndarray, side: int, guess: np.ndarray) -> EyeFit:
        """The eye on one side (1 left, -1 right) of any head on the cage; `guess`: the middle of its eye helper."""
        self = cls.__new__(cls)
        self._solve(v, ring, side, guess)
        return self

    def _solve(self, v: np.ndarray, ring: np.ndarray, side: int, guess: np.ndarray) -> None:
        here = v[:, 0] * side > 0
        margin, border = v[(ring == 1) & here], v[(ring == 0) & here]

        # Together with the optical axis this puts the iris at rest a little to the nasal side of the middle of the slit,
        # and as high as the lids show it on a calm face: whatever the slit's shape, nobody squints or looks down.
        width = np.ptp(margin[:, 0])
        aim = guess.copy()
        aim[0] = margin[:, 0].min() + (0.5 - 0.075 * side) * width
        middle = margin[np.abs(margin[:, 0] - aim[0]) < 0.2 * width]
        split = (middle[:, 1].max() + middle[:, 1].min()) / 2
        upper, lower = middle[middle[:, 1] > split, 1].mean(), middle[middle[:, 1] <= split, 1].mean()
        aim[1] = (upper + lower) / 2 + 0.05 * (upper - lower)
        pull = np.array([12.0, 12.0, 0.3])

        def residual(s: np.ndarray) -> np.ndarray:
            inner = np.linalg.norm(margin - s[:3], axis=1) - s[3]
            behind = np.linalg.norm(border - s[:3], axis=1) - s[3]
            # Touch the margin from behind; stay in front of the socket's border; stay near the given eye.
            return np.concatenate(
                [2.0 * (inner + 0.12), 6.0 * np.maximum(0, behind + 0.7), pull * (s[:3] - aim), [0.5 * (s[3] - 14.9)]]
            )

        s = least_squares(residual, np.append(guess, 15.0)).x
        self.centre, self.radius = s[:3], float(s[3])
        self.margin_gap = np.linalg.norm(margin - s[:3], axis=1) - self.radius
        self.border_gap = np.linalg.norm(border - s[:3], axis=1) - self.radius


def eyeball(radius: float) -> tuple[np.ndarray, np.ndarray, list[list[int]]]:
    """A sphere with a corneal bulge around +z: vertices about its centre, uv (equidistant around the axis), faces."""
    theta = np.concatenate(
        [np.linspace(0, 0.62, RINGS // 2, endpoint=False), np.linspace(0.62, np.pi, RINGS // 2 + 1)]
    )[1:-1]
    azimuth = np.arange(SECTORS) * 2 * np.pi / SECTORS
    th, az = np.meshgrid(theta, azimuth, indexing="ij")
    limbus = np.arcsin(IRIS_RADIUS * 1.06 / radius)
    bulge = CORNEA_BULGE * np.clip(1 - (th / limbus) ** 2, 0, 1) ** 2
    r = radius + bulge
    p = np.stack([np.sin(th) * np.cos(az), np.sin(th) * np.sin(az), np.cos(th)], -1) * r[..., None]
    k = 0.5 * np.minimum(th / EYE_TEXTURE_ANGLE, 0.998)
    uv = np.stack([0.5 + k * np.cos(az), 0.5 + k * np.sin(az)], -1)
    points = np.concatenate([[[0, 0, radius + CORNEA_BULGE]], p.reshape(-1, 3), [[0, 0, -radius]]])
    coords = np.concatenate([[[0.5, 0.5]], uv.reshape(-1, 2), [[0.5, 0.999]]])
    faces = []
    rows = len(theta)
    for s in range(SECTORS):
        n = (s + 1) % SECTORS
        faces.append([0, 1 + s, 1 + n])
        for i in range(rows - 1):
            a, b = 1 + i * SECTORS, 1 + (i + 1) * SECTORS
            faces.append([a + s, b + s, b + n, a + n])
        last = 1 + (rows - 1) * SECTORS
        faces.append([last + s, len(points) - 1, last + n])
    return points, coords, faces


# The MakeHuman eye texture (512 px): centre of the left disc, radii of pupil, limbus and visible sclera.
SOURCE_CENTRE = (150.0, 359.0)
SOURCE_RADII = (0.0, 15.0, 56.0, 132.0)
PUPIL_RADIUS = 1.9
# Natural irises: mixtures of the package's colours (each a list of source, weight), and a brightness.
EYE_MIX = {
    "brown": ([("brownlight", 0.6), ("brown", 0.4)], 0.72),
    "blue": ([("blue", 0.45), ("grey", 0.35), ("ice", 0.2)], 0.92),
    "green": ([("green", 0.35), ("brownlight", 0.35), ("grey", 0.3)], 0.9),
}


def eye_texture(colour: str, size: int, radius: float) -> np.ndarray:
    """Iris and sclera of MakeHuman eyes in the equidistant eye UV, with human proportions, size x size x 3."""
    folder = makehuman.npm_root() / "proxies" / "eyes" / "HighPolyEyes" / "textures"
    mix, gain = EYE_MIX[colour]
    image = sum(w * np.asarray(Image.open(folder / f"{name}_eye.png").convert("RGB"), float) for name, w in mix)
    jj, ii = np.mgrid[:size, :size] + 0.5
    x, y = 2 * ii / size - 1, 1 - 2 * jj / size
    theta = np.hypot(x, y) * EYE_TEXTURE_ANGLE
    azimuth = np.arctan2(y, x)
    limbus = np.arcsin(IRIS_RADIUS / radius)
    source = np.interp(theta, [0, np.arcsin(PUPIL_RADIUS / radius), limbus, EYE_TEXTURE_ANGLE], SOURCE_RADII)
    uv = np.stack(
        [(SOURCE_CENTRE[0] + source * np.cos(azimuth)) / 512, 1 - (SOURCE_CENTRE[1] - source * np.sin(azimuth)) / 512],
        -1,
    )
    out = raster.sample(image, uv)
    white = smoothstep(limbus * 0.97, limbus * 1.12, theta)[..., None]
    # The sclera of the source is grey: lift it, and warm it towards the corners where vessels and caruncle are.
    corner = smoothstep(0.5, 1.15, theta * np.abs(np.cos(azimuth)))[..., None]
    sclera = np.clip(out * 1.13 + 2, 0, 255) * (1 - corner * np.array([0.06, 0.24, 0.24]))
    return out * gain * (1 - white) + sclera * white


def mouth_parts(ref) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Upper and lower teeth with gums, and tongue: vertices, uv, faces, face uvs, in the head frame."""
    out = {}
    teeth = makehuman.Proxy("teeth", "Teeth_Base")
    p = ref.to_head(teeth.fit(ref.mean))
    quads, uvs = np.array(teeth.faces), np.array(teeth.face_uvs)
    label = components(quads, len(p))
    upper = np.zeros(len(quads), bool)
    for c in np.unique(label):
        pick = label[quads[:, 0]] == c
        if (label == c).sum() < 200:
            rank = p[label == c][:, 1].mean() - bite_height(p[label == c][:, 2].mean())
            upper[pick] = rank > 0
        else:
            centre = p[quads[pick]].mean(1)
            upper[pick] = centre[:, 1] > bite_height(centre[:, 2])
    for name, pick in (("upper_teeth", upper), ("lower_teeth", ~upper)):
        out[name] = compact(p, teeth.uv, quads[pick], uvs[pick])
    tongue = makehuman.Proxy("tongue", "tongue01")
    out["tongue"] = compact(
        ref.to_head(tongue.fit(ref.mean)), tongue.uv, np.array(tongue.faces), np.array(tongue.face_uvs)
    )
    return out


def bite_height(z):
    """Height of the plane between upper and lower teeth at depth z, head frame, mm."""
    return np.interp(z, [30.0, 80.0], [-63.0, -68.5])


def components(faces: np.ndarray, n: int) -> np.ndarray:
    """Connected component of every vertex."""
    e = np.concatenate([faces[:, [k, (k + 1) % faces.shape[1]]] for k in range(faces.shape[1])])
    return connected_components(coo_matrix((np.ones(len(e)), (e[:, 0], e[:, 1])), (n, n)), directed=False)[1]


def compact(p: np.ndarray, uv: np.ndarray, faces: np.ndarray, face_uvs: np.ndarray):
    """Drops unused vertices and uv."""
    vi, f = np.unique(faces, return_inverse=True)
    ti, t = np.unique(face_uvs, return_inverse=True)
    return p[vi], uv[ti], f.reshape(faces.shape), t.reshape(face_uvs.shape)


def write(ref, eye: EyeFit, out: Path) -> None:
    """Writes parts.obj and the textures of eyes, teeth and tongue."""
    points, coords, faces = eyeball(eye.radius)
    vertices, uvs, groups = [], [], []
    offset = [0, 0]

    def add(name, v, t, f, ft) -> None:
        vertices.append(v)
        uvs.append(t)
        groups.append((name, [[a + offset[0] for a in q] for q in f], [[a + offset[1] for a in q] for q in ft]))
        offset[0] += len(v)
        offset[1] += len(t)

    add("left_eye", place_eye(points, 1, eye.centre), coords, faces, faces)
    add("right_eye", place_eye(points, -1, eye.centre * [-1, 1, 1]), coords, faces, faces)
    # mouth.png: the teeth's texture in the left half, the tongue's in the right half.
    for name, (v, t, f, ft) in mouth_parts(ref).items():
        add(name, v, (t + [float(name == "tongue"), 0.0]) * [0.5, 1.0], f.tolist(), ft.tolist())
    mesh.write_obj(
        out / "parts.obj",
        np.concatenate(vertices),
        np.concatenate(uvs),
        groups,
        "Facile eyes, teeth and tongue, mm, head frame. CC0 1.0, from MakeHuman. Built by build_reference.py",
    )
    for name in ("brown", "blue", "green"):
        image = eye_texture(name, 384, eye.radius)
        Image.fromarray(np.clip(image + 0.5, 0, 255).astype(np.uint8)).save(out / f"eye_{name}.png", optimize=True)
    root = makehuman.npm_root() / "proxies"
    atlas = Image.new("RGB", (512, 256))
    for source, x in (
        ("teeth/Teeth_Base/textures/teeth.png", 0),
        ("tongue/tongue01/textures/tongue01_diffuse.png", 256),
    ):
        atlas.paste(Image.open(root / source).convert("RGB").resize((256, 256), Image.LANCZOS), (x, 0))
    atlas.save(out / "mouth.png", optimize=True)
