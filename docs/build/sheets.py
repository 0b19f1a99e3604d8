"""Makes the contact sheets of docs/looks.md from recipes: lights, materials close up, occluders, hair, cameras, and docs/sheet.jpg.

Run: python docs/build/sheets.py [FACILE [SHEET...]]   (default: target/release/facile, all sheets; needs numpy and pillow; some
five minutes on two cores)
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

DOCS = Path(__file__).resolve().parent.parent
FACILE = sys.argv[1] if len(sys.argv) > 1 else str(DOCS.parent / "target/release/facile")

STUDIO = """
[[light]]
name = "studio"
sources = [
    { kind = "area", position = [420, 480, 760], target = [0, 0, 0], size = [320, 320], samples = 16, intensity = 0.85 },
    { kind = "point", position = [-700, 150, 300], intensity = 0.2, color = [0.85, 0.92, 1.0] },
    { kind = "hemisphere", intensity = 0.34 },
]
"""
ROOM = '[subjects]\nsampled = {n}\n[[background]]\nkind = "room"\n'
BUST = "[[view]]\nyaw_deg = {yaw}\nfov_y_deg = 22\ntarget_mm = [0, -35, 0]\n"
OCCLUDERS = [
    'kind = "glasses"', 'kind = "glasses"\nshape = "round"\ndiopters = -6', 'kind = "sunglasses"', 'kind = "surgical_mask"',
    'kind = "scarf"', 'kind = "cap"', 'kind = "hat"', 'kind = "head_band"', 'kind = "headphones"',
    'kind = "hand"\nx_mm = 20\ny_mm = -20\nturn_deg = 15', 'kind = "bar"\nturn_deg = 20', 'kind = "fringe"',
]  # fmt: skip
STYLES = "afro01 bob01 bob02 braid01 long01 ponytail01 short01 short02 short03 short04 none".split()
COLORS = [[36, 28, 24], [92, 60, 38], [176, 142, 96], [132, 62, 30], [170, 168, 164], [60, 90, 150]]


def generate(folder: Path, name: str, body: str, size: int) -> list[Image.Image]:
    """The images of a recipe, in order."""
    recipe = folder / f"{name}.toml"
    head = f'[dataset]\nname = "{name}"\nseed = 21\noutput = "{name}"\n[image]\nsize = [{size}, {size}]\ntruth = []\nlandmarks = []\n'
    recipe.write_text(head + body)
    subprocess.run([FACILE, "gen", str(recipe), "--quiet", "--output", str(folder / name)], check=True)
    return [Image.open(f).convert("RGB") for f in sorted((folder / name / "images").glob("*.png"))]


def tile(images: list[Image.Image], columns: int, file: str, quality: int = 86) -> None:
    """Lays images out in rows and writes a JPEG."""
    side = images[0].width
    rows = -(-len(images) // columns)
    sheet = Image.new("RGB", (columns * side, rows * side))
    for i, image in enumerate(images):
        sheet.paste(image, (i % columns * side, i // columns * side))
    sheet.save(DOCS / file, quality=quality, optimize=True)
    print(file, sheet.size, (DOCS / file).stat().st_size // 1024, "KB", flush=True)


def write_hdr(path: Path) -> None:
    """A sky with a low sun over grass, as a flat Radiance HDR of 256 x 128."""
    y, x = np.mgrid[:128, :256]
    polar, turn = (y + 0.5) / 128 * np.pi, ((x + 0.5) / 256 - 0.5) * 2 * np.pi
    d = np.stack([np.sin(polar) * np.sin(turn), np.cos(polar), -np.sin(polar) * np.cos(turn)], -1)
    up = d[..., 1:2]
    sky = np.array([0.35, 0.55, 0.95]) * (0.35 + 0.65 * np.clip(up, 0, 1)) + np.array([0.5, 0.4, 0.3]) * np.exp(-8 * np.abs(up))
    ground = np.array([0.16, 0.2, 0.09]) * (1 + 0.25 * np.sin(31 * d[..., :1]) * np.cos(23 * d[..., 2:]))
    sun = np.array([0.55, 0.35, 0.76])
    image = np.where(up > 0, sky, ground) + 60 * np.array([1.0, 0.85, 0.6]) * (d @ (sun / np.linalg.norm(sun)) > 0.992)[..., None]
    largest = image.max(-1)
    exponent = np.ceil(np.log2(largest)).astype(int)
    rgb = np.clip(image / np.exp2(exponent)[..., None] * 256, 0, 255).astype(np.uint8)
    rgbe = np.concatenate([rgb, (exponent + 128)[..., None].astype(np.uint8)], -1)
    path.write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 128 +X 256\n" + rgbe.tobytes())


def lights(folder: Path) -> None:
    write_hdr(folder / "sky.hdr")
    sources = [
        '{ kind = "point", position = [350, 420, 800], intensity = 0.9 }, { kind = "ambient", intensity = 0.12 }',
        '{ kind = "directional", direction = [1, -0.4, -0.5], intensity = 1.0 }, { kind = "ambient", intensity = 0.1 }',
        '{ kind = "spot", position = [0, 500, 700], target = [0, 0, 60], angle_deg = 9, softness = 0.6, intensity = 1.0 }',
        '{ kind = "area", position = [-500, 300, 600], target = [0, 0, 0], size = [500, 500], samples = 64, intensity = 1.0 }',
        '{ kind = "hemisphere", intensity = 0.9, color = [0.85, 0.92, 1.0] }',
        '{ kind = "point", position = [-300, 200, -700], intensity = 1.2 }, { kind = "ambient", intensity = 0.15 }',
        '{ kind = "environment", file = "sky.hdr", samples = 128, intensity = 0.8 }',
        '{ kind = "environment", file = "sky.hdr", samples = 0, intensity = 0.8, turn_deg = 120 }',
    ]
    tables = "".join(f'[[light]]\nname = "l{i}"\nsources = [{text}]\n' for i, text in enumerate(sources))
    body = '[subjects]\nsampled = 2\n[hair]\nstyles = ["bob02", "short02"]\n[[background]]\nkind = "environment"\n'
    tile(generate(folder, "lights", body + tables + BUST.format(yaw=[18]), 240), 8, "lights.jpg")


def occluders(folder: Path) -> None:
    body = ROOM.format(n=4) + BUST.format(yaw=[22])
    tables = "".join(f"[[occluder]]\n{text}\n" for text in OCCLUDERS)
    tile(generate(folder, "occluders", body + STUDIO + tables, 180), len(OCCLUDERS), "occluders.jpg")


def hair(folder: Path) -> None:
    columns = []
    for i, style in enumerate(STYLES):
        chosen = f'[hair]\nstyles = ["{style}"]\ncolors = [{COLORS[i % len(COLORS)]}]\n'
        images = generate(folder, f"hair_{style}", ROOM.format(n=2) + chosen + STUDIO + BUST.format(yaw=[25, 150]), 200)
        columns.append(images)
    tile([column[k] for k in (0, 1, 2) for column in columns], len(STYLES), "hair.jpg")


def materials(folder: Path) -> None:
    close = "[[view]]\nyaw_deg = [12]\nfov_y_deg = {fov}\ntarget_mm = {target}\n"
    faces = generate(folder, "faces", ROOM.format(n=3) + STUDIO + close.format(fov=13, target=[0, -22, 40]), 1024)
    eyes = generate(folder, "eyes", ROOM.format(n=3) + STUDIO + close.format(fov=3.4, target=[31, 0, 70]), 512)
    grin = '[[expression]]\nname = "grin"\naction_units = { AU12 = 0.9, AU25 = 1.0 }\njaw_deg = 6\n'
    mouths = generate(folder, "mouths", ROOM.format(n=1) + STUDIO + grin + close.format(fov=4.5, target=[0, -68, 75]), 512)
    parts = Image.new("RGB", (1024, 1024))
    for i, image in enumerate(eyes + mouths):
        parts.paste(image, (i % 2 * 512, i // 2 * 512))
    tile([faces[0], faces[1], parts], 3, "materials.jpg", 82)


def cameras(folder: Path) -> None:
    view = "[[view]]\nyaw_deg = [35]\nfov_y_deg = 22\ntarget_mm = [0, -35, 0]\n{more}\n"
    kinds = ["", 'projection = "orthographic"', "aperture_mm = 35", "aperture_mm = 70\nfocus_mm = 960"]
    views = "".join(view.format(more=more) for more in kinds)
    body = "samples = 64\n" + ROOM.format(n=1) + '[hair]\nstyles = ["bob01"]\n' + STUDIO + views
    tile(generate(folder, "cameras", body, 360), 4, "cameras.jpg")


def sheet(folder: Path) -> None:
    body = (
        '[subjects]\nbuiltin = ["all"]\nsampled = 6\n[[background]]\nkind = "room"\n[[expression]]\nname = "neutral"\n[[expression]]\n'
        'name = "smile"\n[[expression]]\nname = "surprise"\n' + STUDIO + BUST.format(yaw=[-15])
    )
    tile(generate(folder, "sheet", body, 168), 9, "sheet.jpg", 84)


def main() -> None:
    sheets = {f.__name__: f for f in (lights, occluders, hair, materials, cameras, sheet)}
    for name in sys.argv[2:] or sheets:
        with tempfile.TemporaryDirectory() as folder:
            sheets[name](Path(folder))


if __name__ == "__main__":
    main()
