"""The cage of the reference head: the crop of the base mesh, its frame, its segments and its per-vertex annotations."""

from __future__ import annotations

import numpy as np
from PIL import Image
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

import makehuman
import mesh
import raster

# The base mesh without its height targets is a small adult; 1.04 brings the mean of the samples to adult norms
# (mean of the sexes: 225 mm from chin to crown, 62 mm between the pupils).
SCALE = 1.04
SEGMENTS = {
    "skin": 1,
    "left_brow": 2,
    "right_brow": 3,
    "left_eyelid": 4,
    "right_eyelid": 5,
    "eye_socket": 6,
    "nose": 7,
    "upper_lip": 8,
    "lower_lip": 9,
    "inner_mouth": 10,
    "upper_teeth": 11,
    "lower_teeth": 12,
    "tongue": 13,
    "left_ear": 14,
    "right_ear": 15,
    "neck": 16,
    "scalp": 17,
    "left_eye": 18,
    "right_eye": 19,
    "left_iris": 20,
    "right_iris": 21,
    "lashes": 22,
    "glasses_frame": 30,
    "glasses_lens": 31,
    "other_occluder": 40,
}


def smoothstep(lo: float, hi: float, x: np.ndarray) -> np.ndarray:
    """0 below lo, 1 above hi, smooth between."""
    t = np.clip((x - lo) / (hi - lo), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


class Crop:
    """Which vertices and faces of the base mesh make the head, decided on the mean shape once for all heads."""

    def __init__(self, base: makehuman.Base, mean: np.ndarray) -> None:
        body = np.array(base.groups["body"])
        quads, uv_quads = body[..., 0], body[..., 1]
        p = mean[quads]
        # A neck cut that rises to the back and to the sides, above the shoulders.
        plane = 566.0 + 0.3 * (30.0 - p[..., 2]) + 1.6 * np.maximum(0.0, np.abs(p[..., 0]) - 46.0)
        keep = (p[..., 1] > plane).all(1) & (np.abs(p[..., 0]) < 200.0).all(1)
        keep = _largest(quads, keep)
        self.body_quads, self.body_uv_quads = quads[keep], uv_quads[keep]
        self.index = np.unique(self.body_quads)
        lookup = np.full(len(base.vertices), -1)
        lookup[self.index] = np.arange(len(self.index))
        self.quads = lookup[self.body_quads]
        self.mirror = lookup[base.mirror[self.index]]
        assert (self.mirror >= 0).all(), "the crop must be symmetric"
        self.body_uv = base.uv
        uv = base.uv[self.body_uv_quads]
        # Islands of the base mesh's UV that hold the eye sockets and the inner mouth.
        self.is_socket = (uv[..., 0].max(1) < 0.16) & (uv[..., 1].min(1) > 0.5) & (uv[..., 1].max(1) < 0.68)
        self.is_mouth = (uv[..., 1].max(1) < 0.14) & (uv[..., 0].min(1) > 0.72)


def _largest(quads: np.ndarray, keep: np.ndarray) -> np.ndarray:
    """Restricts `keep` to its largest edge-connected component."""
    ids = np.flatnonzero(keep)
    e = np.concatenate([quads[ids][:, [k, (k + 1) % 4]] for k in range(4)])
    n = quads.max() + 1
    label = connected_components(coo_matrix((np.ones(len(e)), (e[:, 0], e[:, 1])), (n, n)), directed=False)[1]
    face_label = label[quads[ids][:, 0]]
    best = np.bincount(face_label).argmax()
    out = np.zeros_like(keep)
    out[ids[face_label == best]] = True
    return out


def eye_centres(base: makehuman.Base, shape: np.ndarray) -> np.ndarray:
    """Middle of the left and the right eye helper's box, 2 x 3."""
    out = []
    for name in ("helper-l-eye", "helper-r-eye"):
        index = np.unique([c[0] for f in base.groups[name] for c in f])
        out.append((shape[index].min(0) + shape[index].max(0)) / 2)
    return np.array(out)


def frame_origin(base: makehuman.Base, shape: np.ndarray) -> np.ndarray:
    """Origin of the head frame in base-mesh coordinates: mid-plane, eye height, 10 mm in front of the ear canals."""
    eyes = eye_centres(base, shape)
    return np.array([0.0, eyes[:, 1].mean(), EAR_CANAL_Z + 10.0])


# z of the ear canals on the mean shape, base-mesh mm (the bottom of the concha, read off a profile view).
EAR_CANAL_Z = 53.0


def mask(name: str, uv: np.ndarray) -> np.ndarray:
    """Value in [0, 1] of one of the package's body masks at base-mesh UV."""
    image = np.asarray(Image.open(makehuman.mpfb_root() / "textures" / f"mpfb_{name}.jpg").convert("L"), float) / 255
    return raster.sample(image[..., None], uv)[..., 0]


def smooth_rim(quads: np.ndarray, v: np.ndarray, rounds: int = 12) -> np.ndarray:
    """Evens out the neck cut: every vertex of the open border goes towards the middle of its two border neighbours.

    Linear in `v` and the same for every shape on this topology, so that it commutes with means and modes.
    """
    rim = mesh.border(quads)
    out = v.copy()
    for _ in range(rounds):
        out[rim] = 0.5 * out[rim] + 0.25 * (out[np.roll(rim, 1)] + out[np.roll(rim, -1)])
    return out


class Regions:
    """Topology of the mouth and of the eyes: rims and rings that every annotation is measured from."""

    def __init__(self, crop: Crop, v: np.ndarray) -> None:
        n, quads = len(v), crop.quads
        self.adjacent = mesh.neighbours(quads, n)
        inside = np.zeros(n, bool)
        inside[quads[crop.is_mouth]] = True
        outside = np.zeros(n, bool)
        outside[quads[~crop.is_mouth]] = True
        self.mouth_inside = inside
        self.mouth_rim = np.flatnonzero(inside & outside)
        socket = np.zeros(n, bool)
        socket[quads[crop.is_socket]] = True
        not_socket = np.zeros(n, bool)
        not_socket[quads[~crop.is_socket]] = True
        self.socket = socket
        # Rings around each eye: ring 0 = border of the socket behind the lid, 1 and 3 = inner and outer lid margin.
        self.eye_ring = np.full(n, 99)
        current = np.flatnonzero(socket & not_socket)
        seen = socket.copy()
        for ring in range(16):
            self.eye_ring[current] = ring
            seen[current] = True
            nxt = np.unique(np.concatenate([self.adjacent[i] for i in current]))
            current = nxt[~seen[nxt]]
        # Upper or lower side of the mouth slit: rim vertices by their normals, the rest by the nearer rim half.
        normal = raster.vertex_normals(v, mesh.triangles(quads))
        self.normal = normal
        corner = np.abs(v[self.mouth_rim, 0]).max()
        rim = self.mouth_rim
        up = rim[(normal[rim, 1] < -0.05) & (np.abs(v[rim, 0]) < corner - 1.0)]
        low = rim[(normal[rim, 1] > 0.05) & (np.abs(v[rim, 0]) < corner - 1.0)]
        self.to_upper_rim = mesh.geodesic(v, quads, up)
        self.to_lower_rim = mesh.geodesic(v, quads, low)
        self.corner = np.array(
            [
                corner,
                v[rim[np.abs(v[rim, 0]) > corner - 0.6], 1].mean(),
                v[rim[np.abs(v[rim, 0]) > corner - 0.6], 2].mean(),
            ]
        )
        self.mouth_ring = self._mouth_rings()
        # On the rings of the slit the normals tell the sides apart, elsewhere outside the height over the contact.
        contact = np.interp(np.abs(v[:, 0]), *_contact_line(v[self.mouth_ring == 2]))
        slit = (self.mouth_ring >= 0) & (self.mouth_ring <= 3)
        slit &= np.abs(v[:, 0]) < np.abs(v[self.mouth_ring == 2, 0]).max() - 0.8
        outer = np.where(slit, normal[:, 1] < 0, v[:, 1] > contact)
        self.upper_side = np.where(inside & ~slit, self.to_upper_rim < self.to_lower_rim, outer)

    def _mouth_rings(self) -> np.ndarray:
        """Edge rings around the inner rim of the lips: 0 on it, positive outward over the lips, negative inward."""
        ring = np.full(len(self.adjacent), 99)
        ring[self.mouth_rim] = 0
        for sign, region in ((1, ~self.mouth_inside), (-1, self.mouth_inside)):
            current = self.mouth_rim
            for k in range(1, 12):
                nxt = np.unique(np.concatenate([self.adjacent[i] for i in current]))
                current = nxt[region[nxt] & (ring[nxt] == 99)]
                ring[current] = sign * k
        return ring


def _contact_line(rim: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean height of the rim over |x|."""
    x = np.linspace(0.0, np.abs(rim[:, 0]).max(), 12)
    y = [rim[np.argsort(np.abs(np.abs(rim[:, 0]) - t))[:4], 1].mean() for t in x]
    return x, np.array(y)
