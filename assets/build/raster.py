"""Triangle rasterisation: texture baking in UV space, and small preview pictures to check the assets by eye."""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.ndimage import distance_transform_edt


@njit(cache=True)
def _fill(xy, depth, width, height, face_out, bary_out, z_out):
    for f in range(xy.shape[0]):
        x0, y0 = xy[f, 0, 0], xy[f, 0, 1]
        x1, y1 = xy[f, 1, 0], xy[f, 1, 1]
        x2, y2 = xy[f, 2, 0], xy[f, 2, 1]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if abs(area) < 1e-12:
            continue
        lo_x = max(0, int(np.floor(min(x0, x1, x2) - 0.5)))
        hi_x = min(width - 1, int(np.ceil(max(x0, x1, x2))))
        lo_y = max(0, int(np.floor(min(y0, y1, y2) - 0.5)))
        hi_y = min(height - 1, int(np.ceil(max(y0, y1, y2))))
        for j in range(lo_y, hi_y + 1):
            for i in range(lo_x, hi_x + 1):
                px, py = i + 0.5, j + 0.5
                b1 = ((px - x0) * (y2 - y0) - (x2 - x0) * (py - y0)) / area
                b2 = ((x1 - x0) * (py - y0) - (px - x0) * (y1 - y0)) / area
                b0 = 1.0 - b1 - b2
                if b0 < -1e-9 or b1 < -1e-9 or b2 < -1e-9:
                    continue
                z = b0 * depth[f, 0] + b1 * depth[f, 1] + b2 * depth[f, 2]
                if z < z_out[j, i]:
                    z_out[j, i] = z
                    face_out[j, i] = f
                    bary_out[j, i, 0] = b0
                    bary_out[j, i, 1] = b1
                    bary_out[j, i, 2] = b2


def fill(xy: np.ndarray, depth: np.ndarray, width: int, height: int):
    """Rasterises triangles `xy` (n x 3 x 2, pixels, y down): face index (-1 = none), barycentrics, depth per pixel."""
    face = np.full((height, width), -1, np.int32)
    bary = np.zeros((height, width, 3))
    z = np.full((height, width), np.inf)
    _fill(np.ascontiguousarray(xy, float), np.ascontiguousarray(depth, float), width, height, face, bary, z)
    return face, bary, z


def bake_uv(uv_triangles: np.ndarray, size: int, depth: np.ndarray | None = None):
    """Face index and barycentrics of every texel of a size x size texture (row 0 = top, v up); least `depth` wins."""
    xy = uv_triangles * size
    xy = np.stack([xy[..., 0], size - xy[..., 1]], axis=-1)
    face, bary, _ = fill(xy, np.zeros(xy.shape[:2]) if depth is None else depth, size, size)
    return face, bary


def sample(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Bilinear look-up of `image` (h x w x c) at `uv` (... x 2, v up), clamped at the border."""
    h, w = image.shape[:2]
    x = np.clip(uv[..., 0] * w - 0.5, 0, w - 1)
    y = np.clip((1.0 - uv[..., 1]) * h - 0.5, 0, h - 1)
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    x1, y1 = np.minimum(x0 + 1, w - 1), np.minimum(y0 + 1, h - 1)
    fx, fy = (x - x0)[..., None], (y - y0)[..., None]
    top = image[y0, x0] * (1 - fx) + image[y0, x1] * fx
    bottom = image[y1, x0] * (1 - fx) + image[y1, x1] * fx
    return top * (1 - fy) + bottom * fy


def dilate(image: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Fills unknown texels with the nearest known one, so that bilinear look-ups never meet the background."""
    index = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return image[index[0], index[1]]


def vertex_normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Area-weighted unit normals."""
    p = vertices[triangles]
    n = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    out = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(out, triangles[:, k], n)
    return out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-12)


class Camera:
    """A pinhole that looks at `target` from `distance` mm, turned by yaw (to the subject's left) and pitch (up)."""

    def __init__(self, size: int, yaw_deg=0.0, pitch_deg=0.0, distance=900.0, fov_deg=20.0, target=(0.0, 0.0, 80.0)):
        yaw, pitch = np.radians(yaw_deg), np.radians(pitch_deg)
        back = np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
        right = np.cross([0.0, 1.0, 0.0], back)
        right /= np.linalg.norm(right)
        self.rotation = np.stack([right, np.cross(back, right), back])
        self.position = np.asarray(target, float) + back * distance
        self.size, self.focal = size, 0.5 * size / np.tan(np.radians(fov_deg) / 2)

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (y down, pixel centres at .5) and depth along the axis, mm."""
        p = (points - self.position) @ self.rotation.T
        z = -p[..., 2]
        xy = np.stack([self.size / 2 + self.focal * p[..., 0] / z, self.size / 2 - self.focal * p[..., 1] / z], -1)
        return xy, z

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """Unit directions through pixels (n x 2)."""
        d = (
            np.stack(
                [
                    (pixels[:, 0] - self.size / 2) / self.focal,
                    (self.size / 2 - pixels[:, 1]) / self.focal,
                    -np.ones(len(pixels)),
                ],
                -1,
            )
            @ self.rotation
        )
        return d / np.linalg.norm(d, axis=1, keepdims=True)


def to_linear(srgb: np.ndarray) -> np.ndarray:
    """sRGB in [0, 1] to linear."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def to_srgb(linear: np.ndarray) -> np.ndarray:
    """Linear to sRGB in [0, 1]."""
    linear = np.clip(linear, 0, 1)
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)


def render(parts: list[dict], camera: Camera, supersample: int = 2, background=(0.55, 0.57, 0.6)) -> np.ndarray:
    """A diffuse preview (h x w x 3, uint8). A part: vertices, triangles, and one of uv_triangles +
    texture (uint8), colour, or face_colours; normals if they are not to be computed.
    """
    n = camera.size * supersample
    big = Camera.__new__(Camera)
    big.__dict__.update(camera.__dict__, size=n, focal=camera.focal * supersample)
    light = big.rotation.T @ np.array([0.35, 0.45, 0.82])
    fill_light = big.rotation.T @ np.array([-0.7, 0.1, 0.7])
    out, z_all = np.ones((n, n, 3)) * to_linear(np.array(background)), np.full((n, n), np.inf)
    for part in parts:
        v, t = part["vertices"], part["triangles"]
        xy, z = big.project(v)
        face, bary, depth = fill(xy[t], z[t], n, n)
        hit = (face >= 0) & (depth < z_all)
        f, b = face[hit], bary[hit]
        normal = np.einsum("nk,nkd->nd", b, part.get("normals", vertex_normals(v, t))[t[f]])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
        if "face_colours" in part:
            colour = part["face_colours"][f]
        elif "texture" in part:
            uv = np.einsum("nk,nkd->nd", b, part["uv_triangles"][f])
            colour = to_linear(sample(part["texture"][..., :3] / 255.0, uv))
        else:
            colour = np.broadcast_to(np.asarray(part["colour"], float), (len(f), 3))
        shade = 0.28 + 0.62 * np.clip(normal @ light, 0, 1) + 0.2 * np.clip(normal @ fill_light, 0, 1)
        out[hit] = colour * shade[:, None]
        z_all[hit] = depth[hit]
    s = supersample
    out = out.reshape(camera.size, s, camera.size, s, 3).mean((1, 3))
    return (to_srgb(out) * 255 + 0.5).astype(np.uint8)
