"""What every texel of the head's texture shows: its place on the head, its rings, its share of lips and hair."""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

import mesh
import raster
from annotate import HAIRLINE
from head import SEGMENTS, mask

WHORL = np.array([0.0, 96.0, -52.0])  # crown whorl, from which the hair flows
SKULL_CENTRE = np.array([0.0, 20.0, -8.0])


class Texels:
    """Per-texel fields of the reference head, size x size; `known` marks the texels that some face covers."""

    def __init__(self, ref, size: int) -> None:
        s = ref.subdivision
        fine = s.stencil @ ref.v
        tri = mesh.triangles(s.quads)
        corner_uv = mesh.subdivide_uv(ref.uv[ref.uv_quads])
        self.uv_triangles = np.concatenate([corner_uv[:, [0, 1, 2]], corner_uv[:, [0, 2, 3]]])
        face, bary = raster.bake_uv(self.uv_triangles, size)
        self.size, self.known = size, face >= 0
        # Texels outside every island copy their nearest neighbour, so that bilinear look-ups never meet a hole.
        face, bary = raster.dilate(face, self.known), raster.dilate(bary, self.known)
        self.face, self.bary, self.tri = face, bary, tri
        self.position = self.spread(fine)
        normal = raster.vertex_normals(fine, tri)
        self.normal = self.spread(normal)
        self.eye_ring = self.spread(s.stencil @ np.minimum(ref.regions.eye_ring, 16).astype(float))
        self.mouth_ring = self.spread(s.stencil @ np.minimum(ref.regions.mouth_ring, 14).astype(float))
        names = np.tile(ref.segment, 8)
        ids = np.array([SEGMENTS[n] for n in names])
        self.segment = ids[face]
        body = mesh.subdivide_uv(ref.crop.body_uv[ref.crop.body_uv_quads])
        body_tri = np.concatenate([body[:, [0, 1, 2]], body[:, [0, 2, 3]]])
        self.body_uv = np.einsum("hwk,hwkd->hwd", bary, body_tri[face])
        self.phi = np.arctan2(self.position[..., 0], self.position[..., 2])
        self.lips = mask("lips", self.body_uv) * (self.segment != SEGMENTS["inner_mouth"])
        self.ears = mask("ears", self.body_uv)

    def spread(self, values: np.ndarray) -> np.ndarray:
        """Fine-vertex values at every texel."""
        if values.ndim == 1:
            return np.einsum("hwk,hwk->hw", self.bary, values[self.tri[self.face]])
        return np.einsum("hwk,hwkd->hwd", self.bary, values[self.tri[self.face]])

    def hairline_distance(
        self, lift: float = 0.0, recess: float = 0.0, peak: float = 0.0, sideburn: bool = True
    ) -> np.ndarray:
        """Signed distance to the hairline on the cylinder, mm, positive within the hair.

        `lift` raises the front, `recess` the temples, `peak` lowers the middle of the front; without `sideburn` the
        line turns up in front of the ear.
        """
        degrees = np.linspace(0, 180, 1441)
        line = np.interp(degrees, HAIRLINE[:, 0], HAIRLINE[:, 1])
        front = np.clip(1 - degrees / 62, 0, 1)
        line = line + lift * front**0.5 + recess * np.exp(-(((degrees - 36) / 14) ** 2))
        line -= peak * np.exp(-((degrees / 9) ** 2))
        if not sideburn:
            line = np.where(degrees < 84, np.maximum(line, 22), line)
        # Densify the near-vertical parts.
        curve = np.stack([np.radians(degrees) * 84.0, line], 1)
        dense = [curve[:1]]
        for a, b in zip(curve[:-1], curve[1:]):
            k = max(1, int(np.linalg.norm(b - a) / 0.5))
            dense.append(a + (b - a) * (np.arange(1, k + 1) / k)[:, None])
        tree = cKDTree(np.concatenate(dense))
        here = np.stack([np.abs(self.phi) * 84.0, self.position[..., 1]], -1)
        distance = tree.query(here.reshape(-1, 2), workers=1)[0].reshape(self.phi.shape)
        inside = self.position[..., 1] > np.interp(np.degrees(np.abs(self.phi)), degrees, line)
        return np.where(inside, distance, -distance)

    def hair_flow(self) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates across and along the hair, mm: around the whorl, and away from it."""
        axis = (WHORL - SKULL_CENTRE) / np.linalg.norm(WHORL - SKULL_CENTRE)
        side = np.array([1.0, 0.0, 0.0])
        ahead = np.cross(side, axis)
        d = self.position - SKULL_CENTRE
        d /= np.linalg.norm(d, axis=-1, keepdims=True)
        polar = np.arccos(np.clip(d @ axis, -1, 1))
        around = np.arctan2(d @ side, -(d @ ahead))
        return around * np.maximum(np.sin(polar), 0.08) * 95.0, polar * 95.0


@njit(cache=True)
def _hash(i: int, j: int, k: int, seed: int) -> float:
    """A number in [-1, 1] for a lattice point (integer mixing, 32 bits)."""
    h = (i * 374761393 + j * 668265263 + k * 2147483647 + seed * 974634777) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1274126177) & 0xFFFFFFFF
    h = ((h ^ (h >> 16)) * 2246822519) & 0xFFFFFFFF
    h = h ^ (h >> 15)
    return h / 2147483647.5 - 1.0


@njit(cache=True)
def _value_noise(points, seed, out):
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
        fx, fy, fz = x - i, y - j, z - k
        fx, fy, fz = fx * fx * (3 - 2 * fx), fy * fy * (3 - 2 * fy), fz * fz * (3 - 2 * fz)
        total = 0.0
        for a in range(2):
            for b in range(2):
                for c in range(2):
                    w = (fx if a else 1 - fx) * (fy if b else 1 - fy) * (fz if c else 1 - fz)
                    total += w * _hash(i + a, j + b, k + c, seed)
        out[n] = total


class Noise:
    """Smooth random fields, zero mean and unit deviation, the same for the same seed on every machine."""

    def __init__(self, seed: int) -> None:
        self.seed = seed

    def at(self, points: np.ndarray, wavelength: float | np.ndarray) -> np.ndarray:
        """Value at points (... x 2 or 3) of a field whose features are about `wavelength` mm (one per axis if an array)."""
        self.seed += 7919
        scaled = points / np.asarray(wavelength, float) * 1.6 + (self.seed % 89)
        flat = np.zeros((points[..., 0].size, 3))
        flat[:, : points.shape[-1]] = scaled.reshape(-1, points.shape[-1])
        out = np.zeros(len(flat))
        _value_noise(flat, self.seed, out)
        out = out.reshape(points.shape[:-1])
        return (out - out.mean()) / out.std()

    def layered(self, points: np.ndarray, wavelength: float, octaves: int) -> np.ndarray:
        """Sum of octaves, halving wavelength and amplitude."""
        total = sum(self.at(points, wavelength / 2**k) * 0.5**k for k in range(octaves))
        return total / total.std()
