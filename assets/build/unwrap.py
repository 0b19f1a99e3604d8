"""Texture coordinates of the reference head: one large island for the outer skin, cut along the back of the head.

The base mesh's own UV gives the face an eighth of a whole-body texture and cuts the scalp from the forehead on. Here the
outer skin is unwrapped anew: Tutte's embedding (no flips), then the symmetric Dirichlet energy, minimised by scalable
locally injective mappings (Rabinovich, Poranne, Panozzo, Sorkine-Hornung 2017), against a target metric in which the
face counts for more than the scalp and the neck. Eye sockets and inner mouth keep their islands.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import bmat, coo_matrix, csr_matrix, diags
from scipy.sparse.linalg import factorized, spsolve

import mesh
from head import smoothstep

CROWN_Z = -45.0  # the seam runs from the neck up the back of the head to this depth on the mid-plane, mm


def importance(v: np.ndarray) -> np.ndarray:
    """Texel density wanted at head-frame points, relative."""
    x, y, z = v.T
    face = smoothstep(-118, -100, y) * smoothstep(78, 52, y) * smoothstep(8, 50, z)
    features = smoothstep(-96, -84, y) * smoothstep(38, 22, y) * smoothstep(60, 40, np.abs(x)) * smoothstep(40, 60, z)
    return 0.34 + 0.5 * face + 0.45 * features


def cut_open(quads: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Doubles the seam's vertices: faces with new indices, and the old index of each new vertex."""
    mid = np.abs(v[:, 0]) < 1e-6
    back = mid & (v[:, 2] < 0) & ~((v[:, 2] > CROWN_Z) & (v[:, 1] > 0))
    used = np.unique(quads)
    inner = back[quads]
    top = used[back[used]][np.argmax(v[used[back[used]], 1] + v[used[back[used]], 2])]
    source = list(range(len(v)))
    copy = {}
    for i in used[back[used]]:
        if i != top:
            copy[i] = len(source)
            source.append(i)
    out = quads.copy()
    right = v[quads][:, :, 0].mean(1) < 0
    for f in np.flatnonzero(right & inner.any(1)):
        out[f] = [copy.get(i, i) for i in quads[f]]
    return out, np.array(source)


def loops(tri: np.ndarray) -> list[list[int]]:
    """Boundary loops of a triangle mesh, in order, longest first."""
    directed = np.concatenate([tri[:, [0, 1]], tri[:, [1, 2]], tri[:, [2, 0]]])
    have = {(a, b) for a, b in directed.tolist()}
    nxt = {a: b for a, b in have if (b, a) not in have}
    out, seen = [], set()
    for start in sorted(nxt):
        if start in seen:
            continue
        loop, i = [], start
        while i not in seen:
            seen.add(i)
            loop.append(i)
            i = nxt[i]
        out.append(loop)
    return sorted(out, key=len, reverse=True)


def tutte(tri: np.ndarray, p: np.ndarray, outer: list[int], n: int) -> np.ndarray:
    """Embeds the disc with `outer` on a circle (by arc length), symmetric about the vertical axis."""
    length = np.linalg.norm(p[np.roll(outer, -1)] - p[outer], axis=1)
    t = np.concatenate([[0], np.cumsum(length)[:-1]]) / length.sum()
    # The loop's middle of the neck's front (largest z) is at the bottom.
    start = t[int(np.argmax(p[outer][:, 2] - 0.2 * p[outer][:, 1] - 10 * np.abs(p[outer][:, 0])))]
    angle = -np.pi / 2 + 2 * np.pi * (t - start)
    circle = np.stack([np.cos(angle), np.sin(angle)], 1)
    e = np.unique(np.sort(np.concatenate([tri[:, [0, 1]], tri[:, [1, 2]], tri[:, [2, 0]]]), axis=1), axis=0)
    w = np.ones(len(e))
    adj = coo_matrix((np.r_[w, w], (np.r_[e[:, 0], e[:, 1]], np.r_[e[:, 1], e[:, 0]])), (n, n)).tocsr()
    lap = diags(np.asarray(adj.sum(1)).ravel()) - adj
    fixed = np.zeros(n, bool)
    fixed[outer] = True
    free = ~fixed & (np.asarray(adj.sum(1)).ravel() > 0)
    uv = np.zeros((n, 2))
    uv[outer] = circle
    solve = factorized(lap[free][:, free].tocsc())
    rhs = -lap[free][:, fixed] @ uv[fixed]
    uv[free] = np.stack([solve(rhs[:, 0]), solve(rhs[:, 1])], 1)
    return uv


class SymmetricDirichlet:
    """Minimises sum of area (|J|^2 + |J^-1|^2) over a planar map of scaled triangles."""

    def __init__(self, tri: np.ndarray, p: np.ndarray, scale: np.ndarray, n: int) -> None:
        a, b, c = (p[tri[:, k]] for k in range(3))
        e1, e2 = b - a, c - a
        x = np.linalg.norm(e1, axis=1)
        u = e1 / x[:, None]
        cx = np.einsum("ij,ij->i", e2, u)
        cy = np.linalg.norm(e2 - cx[:, None] * u, axis=1)
        # Slivers of the mesh get a little height so that their gradients stay finite.
        cy = np.maximum(cy, 0.05 * np.maximum(x, np.abs(cx)))
        x, cx, cy = x * scale, cx * scale, cy * scale
        self.area = 0.5 * x * cy
        m = len(tri)
        rows = np.repeat(np.arange(m), 3)
        gx = np.stack([-1 / x, 1 / x, np.zeros(m)], 1)
        gy = np.stack([(cx / x - 1) / cy, -cx / (x * cy), 1 / cy], 1)
        self.dx = csr_matrix((gx.ravel(), (rows, tri.ravel())), (m, n))
        self.dy = csr_matrix((gy.ravel(), (rows, tri.ravel())), (m, n))
        self.tri, self.n = tri, n

    def jacobian(self, uv: np.ndarray) -> np.ndarray:
        return np.stack(
            [
                np.stack([self.dx @ uv[:, 0], self.dy @ uv[:, 0]], -1),
                np.stack([self.dx @ uv[:, 1], self.dy @ uv[:, 1]], -1),
            ],
            1,
        )

    def energy(self, uv: np.ndarray) -> float:
        j = self.jacobian(uv)
        det = np.linalg.det(j)
        if (det <= 0).any():
            return np.inf
        return float((self.area * (j**2).sum((1, 2)) * (1 + 1 / det**2)).sum())

    def step(self, uv: np.ndarray) -> np.ndarray:
        """One reweighted solve and line search."""
        u, s, vt = np.linalg.svd(self.jacobian(uv))
        flip = np.sign(np.linalg.det(u @ vt))
        u[:, :, 1] *= flip[:, None]
        s[:, 1] *= flip
        r = u @ vt
        s = np.maximum(s, 1e-6)
        ratio = np.where(np.abs(s - 1) < 1e-6, 4.0, (s - s**-3.0) / np.where(np.abs(s - 1) < 1e-6, 1.0, s - 1))
        w = np.sqrt(np.maximum(ratio, 1e-9))
        weight = u @ (w[:, :, None] * np.swapaxes(u, 1, 2))
        root = np.sqrt(self.area)
        rows, rhs = [], []
        for i in range(2):
            a, b = diags(root * weight[:, i, 0]), diags(root * weight[:, i, 1])
            for d, col in ((self.dx, 0), (self.dy, 1)):
                rows.append([a @ d, b @ d])
                rhs.append(root * (weight[:, i, 0] * r[:, 0, col] + weight[:, i, 1] * r[:, 1, col]))
        system = bmat(rows).tocsr()
        normal = (system.T @ system + 1e-8 * diags(np.ones(2 * self.n))).tocsc()
        goal = spsolve(normal, system.T @ np.concatenate(rhs) + 1e-8 * uv.T.ravel()).reshape(2, -1).T
        direction, now, t = goal - uv, self.energy(uv), 1.0
        while t > 1e-6:
            if self.energy(uv + t * direction) < now:
                break
            t *= 0.6
        return uv + t * direction if t > 1e-6 else uv


def unwrap(quads: np.ndarray, v: np.ndarray, mirror: np.ndarray, steps: int = 60):
    """uv of the outer skin in [0,1]^2 and its uv quads."""
    cut, source = cut_open(quads, v)
    used, local = np.unique(cut, return_inverse=True)
    local = local.reshape(-1, 4)
    source = source[used]
    p, n = v[source], len(used)
    tri = mesh.triangles(local)
    rims = loops(tri)
    filled, extra = [tri], n
    for hole in rims[1:]:
        ring = np.array(hole)
        filled.append(np.stack([np.roll(ring, -1), ring, np.full(len(ring), extra)], 1))
        extra += 1
    everything = np.concatenate(filled)
    points = np.concatenate([p, [p[np.array(h)].mean(0) for h in rims[1:]]])
    uv = tutte(everything, points, rims[0], extra)
    scale = importance(p[tri].mean(1))
    scale /= np.sqrt((scale**2 * 1.0).mean())
    if np.linalg.det(SymmetricDirichlet(tri, p, scale, n).jacobian(uv[:n])).mean() < 0:
        uv[:, 0] *= -1
    hole_scale = np.full(len(everything) - len(tri), 1.0)
    problem = SymmetricDirichlet(everything, points, np.r_[scale, hole_scale], extra)
    problem.area[len(tri) :] *= 1e-3
    # Start at the scale of the target.
    uv *= np.sqrt(problem.area.sum() / np.pi)
    for _k in range(steps):
        uv = problem.step(uv)
    print(f"unwrap: symmetric Dirichlet energy per area {problem.energy(uv) / problem.area.sum():.3f} (4 is isometric)")
    uv = uv[:n]
    # Make it exactly symmetric: mirror pairs of seam copies lie on opposite sides.
    lookup: dict[int, list[int]] = {}
    for i, s in enumerate(source.tolist()):
        lookup.setdefault(s, []).append(i)
    axis = uv[[lookup[s][0] for s in lookup if len(lookup[s]) == 1 and mirror[s] == s], 0].mean()
    partner = np.empty(n, int)
    for s, copies in lookup.items():
        other = lookup[int(mirror[s])]
        if len(copies) == 2:
            partner[copies[0]], partner[copies[1]] = copies[1], copies[0]
        else:
            partner[copies[0]] = other[0]
    flipped = np.stack([2 * axis - uv[partner, 0], uv[partner, 1]], 1)
    uv = (uv + flipped) / 2
    if uv[:, 0][p[:, 0] > 20].mean() < axis:  # the subject's left lies to the right of the picture
        uv[:, 0] = 2 * axis - uv[:, 0]
    if uv[p[:, 1] > 90][:, 1].mean() < uv[p[:, 1] < -100][:, 1].mean():
        raise AssertionError("the unwrapped head is upside down")
    return uv, local
