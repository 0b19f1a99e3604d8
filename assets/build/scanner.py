"""Turns a head into what a scanner would have seen: one outer surface, own triangles, holes, noise, own texture."""

from __future__ import annotations

import fast_simplification
import numpy as np
from numba import njit
from scipy.spatial import cKDTree

import mesh
import parts
import raster
from head import smoothstep
from texels import Noise

# Directions (yaw, pitch in degrees) from which the scanner looked.
VIEWS = [(yaw, pitch) for pitch in (-22, 12, 48) for yaw in range(-180, 180, 30)]


class Source:
    """The full head, subdivided twice, with both eyeballs: vertices, triangles, uv per corner, texture per triangle."""

    def __init__(self, ref, v: np.ndarray, eyes: np.ndarray, radius: float) -> None:
        once = ref.subdivision
        twice = mesh.Subdivision(once.quads, once.stencil.shape[0])
        fine = twice.stencil @ (once.stencil @ v)
        corner = mesh.subdivide_uv(mesh.subdivide_uv(ref.uv[ref.uv_quads]))
        seen = ~np.tile(np.isin(ref.segment, ("inner_mouth", "eye_socket")), 16)
        quads, corner = twice.quads[seen], corner[seen]
        ball, ball_uv, faces = parts.eyeball(radius)
        tri_ball = np.array([[f[0], f[k], f[k + 1]] for f in faces for k in range(1, len(f) - 1)])
        front = (ball[tri_ball][:, :, 2] > 0.2 * radius).all(1)
        tri_ball = tri_ball[front]
        self.vertices = np.concatenate([fine, parts.place_eye(ball, 1, eyes[0]), parts.place_eye(ball, -1, eyes[1])])
        n = len(fine)
        self.triangles = np.concatenate([mesh.triangles(quads), tri_ball + n, tri_ball + n + len(ball)])
        self.uv = np.concatenate([corner[:, [0, 1, 2]], corner[:, [0, 2, 3]], ball_uv[tri_ball], ball_uv[tri_ball]])
        self.is_eye = np.arange(len(self.triangles)) >= 2 * len(quads)


def visible(source: Source) -> np.ndarray:
    """Triangles whose three corners some view sees."""
    v, tri = source.vertices, source.triangles
    normal = raster.vertex_normals(v, tri)
    seen = np.zeros(len(v), bool)
    used = np.zeros(len(v), bool)
    used[tri] = True
    for yaw, pitch in VIEWS:
        camera = raster.Camera(700, yaw, pitch, 1500.0, 14.0, (0.0, -20.0, 0.0))
        xy, depth = camera.project(v)
        _, _, z = raster.fill(xy[tri], depth[tri], camera.size, camera.size)
        i = np.clip(xy.astype(int), 0, camera.size - 1)
        # The farthest of the neighbouring pixels: slopes must not hide their own vertices.
        around = np.full(len(v), -np.inf)
        for dx in (-1, 0, 1):
            for dy in (-1, 0, 1):
                zz = z[np.clip(i[:, 1] + dy, 0, camera.size - 1), np.clip(i[:, 0] + dx, 0, camera.size - 1)]
                around = np.maximum(around, np.where(np.isfinite(zz), zz, -np.inf))
        toward = camera.position - v
        toward /= np.linalg.norm(toward, axis=1, keepdims=True)
        facing = np.einsum("ij,ij->i", toward, normal) > 0.2
        seen |= used & facing & (depth < around + 0.25)
    return seen[tri].all(1)


def ragged_cut(points: np.ndarray, noise: Noise, height: float) -> np.ndarray:
    """True for points above a torn edge around the neck."""
    phi = np.arctan2(points[:, 0], points[:, 2])
    ring = np.stack([np.cos(phi), np.sin(phi), np.zeros(len(phi))], 1) * 60
    edge = height - 0.22 * points[:, 2] + 5.0 * noise.at(ring, 45.0) + 2.0 * noise.at(ring, 9.0)
    return points[:, 1] > edge


def compact(vertices: np.ndarray, tri: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    used, local = np.unique(tri, return_inverse=True)
    return vertices[used], local.reshape(-1, 3)


def drop_crumbs(vertices: np.ndarray, tri: np.ndarray, least: int) -> np.ndarray:
    """Removes connected pieces of fewer than `least` triangles."""
    label = parts.components(tri, len(vertices))[tri[:, 0]]
    return tri[np.bincount(label)[label] >= least]


def remesh(
    source: Source, keep: np.ndarray, target: int, seed: int, cut_height: float
) -> tuple[np.ndarray, np.ndarray]:
    """The scanned surface: jittered, decimated to about `target` triangles, torn at the neck, with measuring noise."""
    rng = np.random.default_rng([seed, 1])
    noise = Noise(9000 + seed)
    v, tri = compact(source.vertices, source.triangles[keep])
    tri = tri[ragged_cut(v[tri].mean(1), noise, cut_height)]
    v, tri = compact(v, drop_crumbs(v, tri, 60))
    # Slide vertices within the surface first, so that decimation does not follow the lines of the cage.
    normal = raster.vertex_normals(v, tri)
    edge = np.linalg.norm(v[tri[:, 0]] - v[tri[:, 1]], axis=1)
    size = np.zeros(len(v))
    np.maximum.at(size, tri[:, 0], edge)
    slide = rng.normal(0, 1, v.shape) * 0.12 * size[:, None]
    slide -= np.einsum("ij,ij->i", slide, normal)[:, None] * normal
    v, tri = fast_simplification.simplify(
        (v + slide).astype(np.float64), tri.astype(np.int64), target_count=target, agg=4
    )
    v, tri = compact(np.asarray(v, float), np.asarray(tri))
    tri = drop_crumbs(v, tri, 30)
    v, tri = compact(v, tri)
    normal = raster.vertex_normals(v, tri)
    v = v + normal * (0.08 * rng.normal(0, 1, len(v)) + 0.06 * noise.at(v, 9.0))[:, None]
    return v, tri


def own_uv(v: np.ndarray, tri: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A cylinder-like atlas: angle around the head, wider in front, and height with the crown unrolled.

    Returns vertices, triangles and uv with the seam at the back doubled.
    """
    azimuth = np.arctan2(v[:, 0], v[:, 2])
    r = np.hypot(v[:, 0], v[:, 2])
    # Below the brow: height, plus a share of the radius so that the underside of chin and nose unrolls; above: latitude.
    share = 0.3 * smoothstep(20.0, -10.0, v[:, 1])
    latitude = np.where(v[:, 1] > 20, 20 + 95 * np.arctan2(v[:, 1] - 20, np.maximum(r, 1e-9)), v[:, 1])
    t = np.interp(latitude + share * (r - 85), [-175, -116, -96, 32, 170], [0.01, 0.13, 0.2, 0.78, 0.99])

    def wide(a: np.ndarray) -> np.ndarray:
        return 0.5 + 0.47 * np.sign(a) * np.interp(
            np.abs(a), [0, 0.87, np.pi / 2, np.pi, 1.15 * np.pi], [0, 0.5, 0.76, 1.0, 1.06]
        )

    crossing = np.abs(azimuth[tri]).min(1) > np.pi / 2
    crossing &= (azimuth[tri].max(1) - azimuth[tri].min(1)) > np.pi
    out_v, out_tri = v, tri.copy()
    uv = np.stack([wide(azimuth), t], 1)
    for side in (1, -1):
        mine = crossing & ((azimuth[tri] > 0).sum(1) >= 2) if side == 1 else crossing & ((azimuth[tri] > 0).sum(1) < 2)
        flip = azimuth * side < 0
        ids = np.unique(tri[mine][flip[tri[mine]]])
        lookup = np.arange(len(v))
        lookup[ids] = len(out_v) + np.arange(len(ids))
        out_tri[mine] = lookup[tri[mine]]
        uv = np.concatenate([uv, np.stack([wide(azimuth[ids] + side * 2 * np.pi), t[ids]], 1)])
        out_v = np.concatenate([out_v, v[ids]])
    return out_v, out_tri, uv


@njit(cache=True)
def _closest(points, start, table, tri, vert, near, face_out, bary_out):
    for n in range(points.shape[0]):
        best = 1e30
        for c in range(near.shape[1]):
            k0, k1 = start[near[n, c]], start[near[n, c] + 1]
            for k in range(k0, k1):
                f = table[k]
                a, b, d = vert[tri[f, 0]], vert[tri[f, 1]], vert[tri[f, 2]]
                e1, e2, q = b - a, d - a, points[n] - a
                d11, d12, d22 = (e1 * e1).sum(), (e1 * e2).sum(), (e2 * e2).sum()
                p1, p2 = (q * e1).sum(), (q * e2).sum()
                det = d11 * d22 - d12 * d12
                if det < 1e-18:
                    continue
                u, w = (d22 * p1 - d12 * p2) / det, (d11 * p2 - d12 * p1) / det
                u, w = max(u, 0.0), max(w, 0.0)
                if u + w > 1.0:
                    s = u + w
                    u, w = u / s, w / s
                r = q - u * e1 - w * e2
                dist = (r * r).sum()
                if dist < best:
                    best = dist
                    face_out[n] = f
                    bary_out[n, 0], bary_out[n, 1], bary_out[n, 2] = 1 - u - w, u, w


def bake(
    source: Source,
    keep: np.ndarray,
    v: np.ndarray,
    tri: np.ndarray,
    uv: np.ndarray,
    skin: np.ndarray,
    eye: np.ndarray,
    size: int,
) -> np.ndarray:
    """Texture of the scan: every texel takes the colour of the nearest point of the seen source surface."""
    # Where the atlas folds (ears over scalp, nose over lip) the outer surface wins.
    face, bary = raster.bake_uv(uv[tri], size, -np.linalg.norm(v[tri], axis=2))
    known = face >= 0
    points = np.einsum("nk,nkd->nd", bary[known], v[tri[face[known]]])
    src_tri, src_uv, src_eye = source.triangles[keep], source.uv[keep], source.is_eye[keep]
    order = np.argsort(src_tri.ravel(), kind="stable")
    start = np.searchsorted(src_tri.ravel()[order], np.arange(len(source.vertices) + 1))
    used = np.unique(src_tri)
    near = used[cKDTree(source.vertices[used]).query(points, k=2)[1]]
    f, b = np.zeros(len(points), np.int64), np.zeros((len(points), 3))
    _closest(points, start, order // 3, src_tri, source.vertices, near, f, b)
    at = np.einsum("nk,nkd->nd", b, src_uv[f])
    colour = np.where(src_eye[f][:, None], raster.sample(eye.astype(float), at), raster.sample(skin.astype(float), at))
    out = np.zeros((size, size, 3))
    out[known] = colour
    return raster.dilate(out, known)
