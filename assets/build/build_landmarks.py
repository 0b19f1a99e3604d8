"""Places the ibug-68 landmarks on the reference head where annotators put them on photographs.

Renders the finished reference head from many sides, runs MediaPipe's face mesh on the pictures, picks the 68 of its 468
points that correspond, intersects the rays of all views that see a point, and snaps the result onto the outer skin, the
same on both sides. What a face mesh cannot know well is then set from the geometry, see `correct`.

Needs requirements-landmarks.txt (an environment of its own: MediaPipe pins an older NumPy). Run after build_reference.py.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial import cKDTree

import mesh
import raster

REFERENCE = Path(__file__).resolve().parent.parent / "reference"
SIZE = 640
YAWS, PITCHES = (-40, -30, -20, -10, 0, 10, 20, 30, 40), (-15, 0, 15)
# Indices of MediaPipe's face mesh that lie where ibug-68 has its points, in the order of ibug-68.
FACE_MESH = [
    162,
    234,
    93,
    58,
    172,
    136,
    149,
    148,
    152,
    377,
    378,
    365,
    397,
    288,
    323,
    454,
    389,
    70,
    63,
    105,
    66,
    107,
    336,
    296,
    334,
    293,
    300,
    168,
    197,
    5,
    4,
    75,
    97,
    2,
    326,
    305,
    33,
    160,
    158,
    133,
    153,
    144,
    362,
    385,
    387,
    263,
    373,
    380,
    61,
    39,
    37,
    0,
    267,
    269,
    291,
    405,
    314,
    17,
    84,
    181,
    78,
    82,
    13,
    312,
    308,
    317,
    14,
    87,
]
MIRROR = [
    *range(16, -1, -1),
    *range(26, 16, -1),
    27,
    28,
    29,
    30,
    35,
    34,
    33,
    32,
    31,
    45,
    44,
    43,
    42,
    47,
    46,
    39,
    38,
    37,
    36,
    41,
    40,
    54,
    53,
    52,
    51,
    50,
    49,
    48,
    59,
    58,
    57,
    56,
    55,
    64,
    63,
    62,
    61,
    60,
    67,
    66,
    65,
]
HIDDEN = ("inner_mouth", "eye_socket")


class Head:
    """The subdivided reference head with its parts, ready to be drawn."""

    def __init__(self) -> None:
        v, vt, groups = mesh.read_obj(REFERENCE / "head.obj")
        quads = np.array([f for faces, _ in groups.values() for f in faces])
        uvs = np.array([t for _, ft in groups.values() for t in ft])
        names = np.array([n for n, (faces, _) in groups.items() for _ in faces])
        s = mesh.Subdivision(quads, len(v))
        self.v, self.tri = s.stencil @ v, mesh.triangles(s.quads)
        self.names = np.tile(names, 8)
        corner = mesh.subdivide_uv(vt[uvs])
        self.parts = [
            dict(
                vertices=self.v,
                triangles=self.tri,
                normals=raster.vertex_normals(self.v, self.tri),
                uv_triangles=np.concatenate([corner[:, [0, 1, 2]], corner[:, [0, 2, 3]]]),
                texture=np.array(Image.open(REFERENCE / "skin.jpg")),
            )
        ]
        pv, pt, pgroups = mesh.read_obj(REFERENCE / "parts.obj")
        for name, (faces, face_uvs) in pgroups.items():
            if not name.endswith("eye"):
                continue
            tri = np.array([[f[0], f[k], f[k + 1]] for f in faces for k in range(1, len(f) - 1)])
            tuv = np.array([[f[0], f[k], f[k + 1]] for f in face_uvs for k in range(1, len(f) - 1)])
            used, local = np.unique(tri, return_inverse=True)
            self.parts.append(
                dict(
                    vertices=pv[used],
                    triangles=local.reshape(-1, 3),
                    uv_triangles=pt[tuv],
                    texture=np.array(Image.open(REFERENCE / "eye_brown.png").convert("RGB")),
                )
            )

    def outer(self) -> Surface:
        return Surface(self.v, self.tri[~np.isin(self.names, HIDDEN)])

    def only(self, *names: str) -> Surface:
        return Surface(self.v, self.tri[np.isin(self.names, names)])


class Surface:
    """Nearest points and rays on a triangle soup, by dense sampling: 0.05 mm is plenty for a landmark."""

    def __init__(self, v: np.ndarray, tri: np.ndarray) -> None:
        p = v[tri]
        self.normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        self.normal /= np.maximum(np.linalg.norm(self.normal, axis=1, keepdims=True), 1e-12)
        weights = np.array([[i, j, 9 - i - j] for i in range(10) for j in range(10 - i)]) / 9.0
        self.points = np.einsum("kc,tcd->tkd", weights, p).reshape(-1, 3)
        self.face = np.repeat(np.arange(len(tri)), len(weights))
        self.tree = cKDTree(self.points)

    def nearest(self, q: np.ndarray) -> np.ndarray:
        return self.points[self.tree.query(q)[1]]

    def front(self, x: float, y: float) -> np.ndarray:
        """The foremost point at (x, y)."""
        near = np.hypot(self.points[:, 0] - x, self.points[:, 1] - y) < 0.5
        p = self.points[near]
        return p[np.argmax(p[:, 2] - 0.5 * np.hypot(p[:, 0] - x, p[:, 1] - y))]

    def contour(self, y: float, slope: float) -> np.ndarray:
        """The point of the right cheek or jaw at height y where the surface has turned away: its normal's z is `slope`."""
        p, n = self.points, self.normal[self.face]
        near = (np.abs(p[:, 1] - y) < 0.6) & (p[:, 0] < 0) & (p[:, 2] > 2)
        k = np.flatnonzero(near)
        return p[k[np.argmin(np.abs(n[k, 2] - slope) + 0.002 * np.abs(p[k, 1] - y))]]


def observe(head: Head) -> tuple[np.ndarray, list[raster.Camera], np.ndarray]:
    """Face-mesh points (views x 468 x 2, pixels), cameras, and which views found a face."""
    import mediapipe

    finder = mediapipe.solutions.face_mesh.FaceMesh(static_image_mode=True, refine_landmarks=True, max_num_faces=1)
    cameras, points, found = [], [], []
    for pitch in PITCHES:
        for yaw in YAWS:
            camera = raster.Camera(SIZE, yaw, pitch, 900.0, 22.0, (0.0, -10.0, 20.0))
            image = raster.render(head.parts, camera)
            faces = finder.process(image).multi_face_landmarks
            cameras.append(camera)
            found.append(bool(faces))
            points.append([[p.x * SIZE, p.y * SIZE] for p in faces[0].landmark] if faces else np.zeros((478, 2)))
    return np.array(points), cameras, np.array(found)


def triangulate(points: np.ndarray, cameras: list[raster.Camera], found: np.ndarray) -> np.ndarray:
    """Robust intersection of the rays of every view that sees a point (n x 3)."""
    yaw = np.array([y for _ in PITCHES for y in YAWS])
    out = np.zeros((len(FACE_MESH), 3))
    for i, index in enumerate(FACE_MESH):
        # A point of the subject's right side (x < 0, lower index) is hidden from far left, and the other way round.
        side = _side(i)
        use = found & ((side == 0) | (yaw * side >= -22))
        rays = [cameras[k].rays(points[k, index][None])[0] for k in np.flatnonzero(use)]
        origins = [cameras[k].position for k in np.flatnonzero(use)]
        weight = np.ones(len(rays))
        for _ in range(20):
            a, b = np.zeros((3, 3)), np.zeros(3)
            for d, o, w in zip(rays, origins, weight):
                m = w * (np.eye(3) - np.outer(d, d))
                a, b = a + m, b + m @ o
            x = np.linalg.solve(a, b)
            miss = np.array([np.linalg.norm((np.eye(3) - np.outer(d, d)) @ (x - o)) for d, o in zip(rays, origins)])
            weight = 1.0 / np.maximum(miss, 0.5)
        out[i] = x
    return out


def _side(i: int) -> int:
    """-1 for points of the subject's right, 1 for the left, 0 for the middle."""
    if MIRROR[i] == i:
        return 0
    right = {*range(8), *range(17, 22), 31, 32, *range(36, 42), 48, 49, 50, 58, 59, 60, 61, 67}
    return -1 if i in right else 1


def symmetric(p: np.ndarray) -> np.ndarray:
    """Mean of the points and their mirror images."""
    return (p + p[MIRROR] * [-1.0, 1.0, 1.0]) / 2


def even(curve: np.ndarray) -> np.ndarray:
    """The same number of points, spread evenly by arc length along the polyline."""
    t = np.r_[0, np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))]
    return np.stack([np.interp(np.linspace(0, t[-1], len(curve)), t, c) for c in curve.T], 1)


def correct(p: np.ndarray, head: Head) -> np.ndarray:
    """Sets from the geometry what the face mesh knows badly. `p`: symmetric and snapped; right side and middle matter."""
    skin = head.outer()
    out = p.copy()
    # Jaw 0-8: from the height of the eyes in front of the ear along the contour to the chin, evenly spaced.
    jaw = out[:9].copy()
    jaw[0], jaw[1] = skin.contour(-1.0, 0.2), 0.5 * (jaw[1] + skin.contour(-18.0, 0.2))
    out[:9] = skin.nearest(even(skin.nearest(jaw)))
    out[8] = skin.front(0.0, out[8, 1])
    # Brow 17-21: at the upper edge of the hairs, where annotators put it. The segment follows the painted brow.
    brow = head.only("right_brow").points
    for i, x in zip(range(17, 22), np.linspace(brow[:, 0].min() + 2.5, brow[:, 0].max() - 8.0, 5)):
        column = brow[np.abs(brow[:, 0] - x) < 0.6]
        low, high = np.quantile(column[:, 1], [0.05, 0.95])
        out[i] = skin.front(x, low + 0.9 * (high - low))
    # Bridge 27-30: the ridge from the height of the eyes to the foremost point of the nose, evenly spaced.
    nose = head.only("nose").points
    tip = nose[np.argmax(nose[:, 2] - 2 * np.abs(nose[:, 0]))]
    for i, y in zip(range(27, 31), np.linspace(out[27, 1], tip[1], 4)):
        out[i] = skin.front(0.0, y)
    # Base of the nose 31-33: where nose and upper lip meet, from the foot of the wing to the middle. The face mesh finds the
    # columella and the nostrils' upper rims, which lie 7 mm before it.
    profile = np.array([skin.front(0.0, y) for y in np.arange(tip[1] - 4.0, out[51, 1], -0.1)])
    chord = (out[51] - tip) / np.linalg.norm(out[51] - tip)
    behind = np.cross(profile - tip, chord)[:, 0]
    out[33] = profile[np.argmax(np.abs(behind))]
    for i in (31, 32):
        out[i] = skin.front(out[i, 0], out[33, 1] + 0.6)
    # Eyes 36-41: on the lid margin, where the skin meets the eyeball in the front view.
    lid = head.only("right_eyelid").points
    eye = head.parts[2]["vertices"]
    centre = (eye.min(0) + eye.max(0)) / 2
    radius = (eye[:, 0].max() - eye[:, 0].min()) / 2
    gap = np.linalg.norm(lid - centre, axis=1) - radius
    margin = lid[(gap > 0.9) & (gap < 2.6) & (lid[:, 2] > centre[2])]
    for i in range(36, 42):
        near = margin[np.argmin(np.hypot(*(margin - out[i])[:, :2].T))]
        out[i] = 0.5 * (out[i] + near)
        out[i] = lid[np.argmin(np.linalg.norm(lid - out[i], axis=1))]
    # Inner lips 60-67: on the line of contact as it is seen from the front.
    upper, lower = head.only("upper_lip").points, head.only("lower_lip").points
    for i, j, x in ((60, None, out[48, 0] + 2.0), (61, 67, -8.0), (62, 66, 0.0)):
        u, w = (s[np.abs(s[:, 0] - x) < 0.5] for s in (upper, lower))
        heights = np.arange(out[48, 1] - 4, out[48, 1] + 5, 0.1)

        def ahead(s: np.ndarray, y: float) -> float:
            near = s[np.abs(s[:, 1] - y) < 0.15]
            return near[:, 2].max() if len(near) else -1e9

        seam = max((y for y in heights if ahead(w, y) > ahead(u, y)), default=out[48, 1])
        out[i] = _foremost(u, seam + 0.2)
        if j is not None:
            out[j] = _foremost(w, seam - 0.2)
    for i in range(27):
        out[MIRROR[i]] = out[i] * [-1, 1, 1] if MIRROR[i] > i else out[MIRROR[i]]
    for i in (31, 32, *range(36, 42), 48, 49, 50, 58, 59, 60, 61, 67):
        out[MIRROR[i]] = out[i] * [-1, 1, 1]
    out[[8, 27, 28, 29, 30, 33, 51, 57, 62, 66], 0] = 0.0
    return out


def _foremost(points: np.ndarray, y: float) -> np.ndarray:
    """The point near height y that lies farthest forward."""
    near = points[np.argsort(np.abs(points[:, 1] - y))[:40]]
    return near[np.argmax(near[:, 2])]


def write(p: np.ndarray, path: Path) -> None:
    """Both schemes in TOML."""

    def row(q: np.ndarray) -> str:
        return "  [" + ", ".join(f"{x + 0.0:.3f}" for x in q) + "],"

    right, left = p[36:42].mean(0), p[42:48].mean(0)
    lines = [
        "# Landmark schemes on the reference head, mm, head frame. Built by assets/build/build_landmarks.py.",
        "[ibug68]",
        "points = [",
        *map(row, p),
        "]",
        "",
        "[ibug68.on]",
        "upper_lip = [48, 49, 50, 51, 52, 53, 54, 60, 61, 62, 63, 64]",
        "lower_lip = [55, 56, 57, 58, 59, 65, 66, 67]",
        "",
        "[five]",
        "# right eye, left eye, nose tip, right mouth corner, left mouth corner",
        "points = [",
        *map(row, [right, left, p[30], p[48], p[54]]),
        "]",
    ]
    path.write_text("\n".join(lines) + "\n")


def main() -> None:
    head = Head()
    points, cameras, found = observe(head)
    print(f"face found in {found.sum()} of {len(found)} views")
    seen = symmetric(triangulate(points, cameras, found))
    snapped = head.outer().nearest(seen)
    write(correct(snapped, head), REFERENCE / "landmarks.toml")


if __name__ == "__main__":
    main()
