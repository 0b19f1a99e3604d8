"""Per-face segments and per-vertex annotations of the cage, from its topology and from a few anatomical curves.

All lengths are head-frame millimetres on the reference head: y = 0 at the eyes, crown near 111, chin near -112,
nose tip near z = 105, ears near z = -10.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

import mesh
from head import Crop, Regions, mask, smoothstep

# Hairline height h (mm) over |phi| (degrees): forehead, temple recess, sideburn, ear, nape.
HAIRLINE = np.array(
    [
        [0, 69],
        [12, 70],
        [25, 72],
        [38, 68],
        [48, 60],
        [58, 44],
        [66, 30],
        [72, 14],
        [77, -6],
        [82, -20],
        [90, -30],
        [100, -34],
        [112, -46],
        [130, -58],
        [150, -66],
        [180, -68],
    ],
    float,
)
# Border of the jaw in profile: y over z, from behind the ear to the chin.
JAWLINE = np.array([[-120, -60], [-30, -60], [-8, -62], [6, -84], [16, -96], [40, -106], [62, -112], [80, -114]], float)


def hairline(phi: np.ndarray) -> np.ndarray:
    """Height of the hairline at cylinder angle phi (radians)."""
    return np.interp(np.degrees(np.abs(phi)), HAIRLINE[:, 0], HAIRLINE[:, 1])


def jawline(z: np.ndarray) -> np.ndarray:
    """Height of the lower border of the jaw at depth z."""
    return np.interp(z, JAWLINE[:, 0], JAWLINE[:, 1])


def segments(crop: Crop, regions: Regions, v: np.ndarray, brow_points: np.ndarray) -> np.ndarray:
    """Segment name of every cage face; later lines win."""
    c = v[crop.quads].mean(1)
    x, y, z = c.T
    uv = crop.body_uv[crop.body_uv_quads].mean(1)
    left = x > 0
    phi = np.arctan2(x, z)
    out = np.full(len(c), "skin", dtype="<U14")
    out[y > hairline(phi)] = "scalp"
    behind = np.abs(phi) > np.radians(95)
    out[(out == "skin") & ((y < jawline(z)) | (behind & (y < -50)))] = "neck"
    half = np.interp(y, [-50, -44, -38, -28, -8, 6], [10, 15, 20, 17, 10, 8])
    nose = (np.abs(x) < half) & (y > -50) & (y < 4) & (z > 66) & ~crop.is_mouth
    lip = (mask("lips", uv) > 0.5) | (regions.mouth_ring[crop.quads].max(1) <= 5)
    out[nose & ~lip] = "nose"
    near = cKDTree(brow_points).query(c)[0] < 3.2
    brow = near & (np.abs(phi) < 1.2) & (out == "skin")
    out[brow & left], out[brow & ~left] = "left_brow", "right_brow"
    lid = regions.eye_ring[crop.quads].max(1) <= 8
    out[lid & left], out[lid & ~left] = "left_eyelid", "right_eyelid"
    upper = regions.upper_side[crop.quads].mean(1) > 0.5
    lip &= ~crop.is_mouth
    out[lip & upper], out[lip & ~upper] = "upper_lip", "lower_lip"
    ear = mask("ears", uv) > 0.5
    out[ear & left], out[ear & ~left] = "left_ear", "right_ear"
    out[crop.is_socket] = "eye_socket"
    out[crop.is_mouth] = "inner_mouth"
    return mirrored(crop, out, c)


def mirrored(crop: Crop, names: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Copies the segment of every face with x > 0 to its mirror image, left for right."""
    key = {tuple(sorted(q)): i for i, q in enumerate(crop.quads.tolist())}
    out = names.copy()
    for i, q in enumerate(crop.mirror[crop.quads].tolist()):
        if centre[i, 0] > 0:
            out[key[tuple(sorted(q))]] = str(names[i]).replace("left_", "right_")
    return out


def touching(crop: Crop, seg: np.ndarray, names: tuple[str, ...], n: int) -> np.ndarray:
    """Vertices of faces of the named segments."""
    hit = np.zeros(n, bool)
    hit[crop.quads[np.isin(seg, names)]] = True
    return hit


def roles(crop: Crop, regions: Regions, seg: np.ndarray, v: np.ndarray) -> np.ndarray:
    """`free`, `fixed` or `passive` per vertex."""
    x, y, z = v.T
    n = len(v)
    phi = np.degrees(np.abs(np.arctan2(x, z)))
    free = (phi < 78) & (y < hairline(np.arctan2(x, z)) + 4) & (y > -150)
    free &= ~touching(crop, seg, ("left_ear", "right_ear"), n)
    # The front of the throat follows the platysma down to the middle of the neck.
    role = np.where(free, "free", "fixed").astype("<U7")
    rim = np.zeros(n, bool)
    rim[regions.mouth_rim] = True
    role[regions.mouth_inside & ~rim] = "passive"
    role[regions.socket | (regions.eye_ring == 0)] = "passive"
    return role


def jaw_weight(crop: Crop, regions: Regions, seg: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Weight of the mandible's rigid motion, 0 to 1."""
    x, y, z = v.T
    n = len(v)
    corner = regions.corner
    ax = np.abs(x)
    # The border between skull and mandible runs from the lip contact through the mouth corner to the condyle.
    border = np.interp(z, [-20, 5, 40, corner[2] - 6], [-8, -12, -52, corner[1]])
    in_mouth = smoothstep(corner[0] + 10, corner[0] - 4, ax)
    # Far from the slit a soft band, at the slit a sharp side: distances to the two halves of the rim decide.
    band = 13.0
    soft = smoothstep(-band / 2, band / 2, border - y)
    du, dl = regions.to_upper_rim, regions.to_lower_rim
    side = smoothstep(-1.0, 1.0, (du - dl) / np.maximum(np.minimum(du + dl, 14.0) * 0.25, 0.35))
    near = np.exp(-((np.minimum(du, dl) / 16.0) ** 2)) * in_mouth
    lips = 0.5 + (side - 0.5) * smoothstep(corner[0] + 1.0, corner[0] - 7.0, ax)
    weight = near * lips + (1 - near) * soft
    # Inside the mouth the cheek lining blends over the whole depth of the bag.
    inside = regions.mouth_inside
    weight[inside] = smoothstep(0.15, 0.85, du[inside] / np.maximum(du + dl, 1e-6)[inside])
    # Below the jaw the throat takes over, over 45 mm.
    below = np.maximum(0.0, jawline(z) - y)
    back = smoothstep(-6.0, 14.0, z)
    weight *= smoothstep(45.0, 4.0, below) * back
    keep = np.zeros(n, bool)
    keep[regions.mouth_rim] = True
    keep |= (np.minimum(du, dl) < 9) & (ax < corner[0] - 2)
    weight = mesh.smooth(weight, regions.adjacent, keep, 6)
    weight[touching(crop, seg, ("left_ear", "right_ear"), n)] = 0.0
    return np.clip(weight, 0, 1)


def lid_weight(regions: Regions, v: np.ndarray, eyes: np.ndarray) -> tuple[np.ndarray, float]:
    """Weight of the tarsal plate's motion, -1 to 1: largest at the margins, fading out over the rings up to the crease.

    Along the margin the weight follows the opening between the lids, as an angle about the eye's axis from side to side:
    turning every vertex by weight times one angle per lid closes the whole slit at once, corners included. The second
    value is that angle, summed over upper and lower lid, radians.
    """
    out = np.zeros(len(v))
    opening = 0.0
    ring = regions.eye_ring
    fade = np.interp(ring, [0, 3, 4, 5, 6, 7, 8, 9, 10, 11], [1, 1, 0.97, 0.88, 0.72, 0.5, 0.28, 0.12, 0.03, 0])
    for centre, sign in ((eyes[0], 1.0), (eyes[1], -1.0)):
        side = v[:, 0] * sign > 0
        margin = np.flatnonzero((ring == 2) & side)
        p = v[margin]
        inner, outer = p[np.argmin(p[:, 0] * sign)], p[np.argmax(p[:, 0] * sign)]

        def along(q: np.ndarray) -> np.ndarray:
            return (q[:, 0] - inner[0]) / (outer[0] - inner[0])

        def above(q: np.ndarray) -> np.ndarray:
            return q[:, 1] - (inner[1] + along(q) * (outer[1] - inner[1]))

        angle = np.arctan2(p[:, 1] - centre[1], p[:, 2] - centre[2])
        t = np.linspace(0, 1, 41)
        curves = []
        for pick in (above(p) > 0, above(p) <= 0):
            pick |= np.isin(p[:, 0], (inner[0], outer[0]))
            order = np.argsort(along(p[pick]))
            curves.append(np.interp(t, along(p[pick])[order], angle[pick][order]))
        gap = np.maximum(curves[0] - curves[1], 0.0)
        # A little more than the opening, so that the closed lids overlap instead of leaving a hair's breadth.
        gap = np.where((t > 0.02) & (t < 0.98), gap + 0.05 * gap.max(), gap)
        opening = float(gap.max())
        gap = np.convolve(np.pad(gap, 1), [0.25, 0.5, 0.25], "valid") / opening
        mine = (ring < 12) & side
        q = v[mine]
        amount = np.clip(above(q) / 0.5, -1, 1) * np.interp(along(q), t, gap, left=0, right=0)
        out[mine] = amount * fade[mine]
    return np.clip(mesh.smooth(out, regions.adjacent, (ring >= 12) | (ring <= 3), 2), -1, 1), opening


def thickness(regions: Regions, v: np.ndarray) -> np.ndarray:
    """Tissue thickness skin to skull, mm."""
    x, y, z = v.T
    ax = np.abs(x)
    out = np.full(len(v), 5.0)
    forehead = smoothstep(12.0, 26.0, y)
    out += forehead * (4.0 - out)
    bridge = np.exp(-((ax / 10) ** 2 + ((y + 8) / 14) ** 2))
    out += bridge * (3.5 - out)
    cheek = np.exp(-(((ax - 44) / 18) ** 2 + ((y + 55) / 24) ** 2)) * (z > 10)
    out += cheek * (9.0 - out)
    chin = np.exp(-((ax / 18) ** 2 + ((y + 104) / 10) ** 2)) * (z > 50)
    out += chin * (8.0 - out)
    lips = np.exp(-((np.minimum(regions.to_upper_rim, regions.to_lower_rim) / 12.0) ** 2))
    out += lips * (7.0 - out)
    tip = np.exp(-((ax / 14) ** 2 + ((y + 38) / 12) ** 2)) * (z > 82)
    out += tip * (6.0 - out)
    lid = np.interp(regions.eye_ring, [0, 8, 13], [1, 1, 0])
    out += lid * (1.5 - out)
    return mesh.smooth(out, regions.adjacent, np.zeros(len(v), bool), 3)


def attached(regions: Regions, v: np.ndarray, role: np.ndarray) -> np.ndarray:
    """1 where the fascia is bound to the bone: forehead rim, nose bridge, zygoma, temple, jaw border, chin."""
    x, y, z = v.T
    ax = np.abs(x)
    out = np.zeros(len(v), int)
    out[role == "fixed"] = 1
    out[(y > 40)] = 1
    out[(ax < 9) & (y > -14) & (y < 12) & (z > 60)] = 1
    out[(np.abs(y - np.interp(ax, [26, 60, 72], [-24, -18, -10])) < 7) & (ax > 30) & (z > 10)] = 1
    out[(ax > 56) & (y > -4)] = 1
    border = np.abs(y - jawline(z)) < 7
    out[border & (z > 0)] = 1
    out[(ax < 14) & (y < -96) & (y > -114) & (z > 60)] = 1
    free = (np.minimum(regions.to_upper_rim, regions.to_lower_rim) < 22) | (regions.eye_ring < 10)
    free |= (np.abs(ax - 14) < 9) & (y < -24) & (y > -48) & (z > 72)
    out[free & (role != "fixed")] = 0
    return out
