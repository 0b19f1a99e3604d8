"""Skins: MakeHuman's whole-body skins brought into the head UV, with lips, lashes, brows, hair and fine detail painted in.

All colours here are sRGB in [0, 1]. Painting is a chain of small steps, each a function of the texels and a `Look`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter

import makehuman
import raster
from head import SEGMENTS, smoothstep
from texels import Noise, Texels

HAIR = {
    "black": (0.055, 0.048, 0.045),
    "dark_brown": (0.135, 0.095, 0.07),
    "brown": (0.225, 0.15, 0.1),
    "dark_blond": (0.37, 0.28, 0.18),
    "blond": (0.53, 0.42, 0.27),
    "red": (0.4, 0.19, 0.09),
    "grey": (0.42, 0.41, 0.4),
    "white": (0.66, 0.65, 0.63),
}


@dataclass
class Look:
    """How one skin is painted."""

    name: str
    source: str  # folder and texture under `skins`
    sex: str
    ancestry: str
    age: str
    hair: str
    brow: int  # number of the MakeHuman eyebrow card
    cover: float = 0.9  # how much of the scalp the hair hides
    lift: float = 0.0
    recess: float = 0.0
    peak: float = 0.0
    beard: float = 0.0
    lips: float = 0.0  # extra redness of the lips
    lashes: float = 0.6
    tone: tuple[float, float, float] | None = None  # wanted mean colour of the cheeks, sRGB
    freckles: float = 0.0
    seed: int = 0
    extra: dict = field(default_factory=dict)

    def eye_colours(self) -> tuple[str, ...]:
        """Eye textures that suit."""
        if self.ancestry != "caucasian" or self.hair == "black":
            return ("brown",)
        return (
            ("blue", "green", "brown")
            if self.hair in ("blond", "dark_blond", "red", "white")
            else ("brown", "green", "blue")
        )


def load_base(look: Look, texels: Texels) -> np.ndarray:
    """The MakeHuman skin, enlarged with a Lanczos filter and resampled into the head UV; without a source, their mean."""
    sources = [look.source] if look.source else [other.source for other in LOOKS]
    total = np.zeros(texels.body_uv.shape[:2] + (3,))
    for source in sources:
        image = Image.open(makehuman.npm_root() / "skins" / source).convert("RGB").resize((2048, 2048), Image.LANCZOS)
        total += raster.to_linear(raster.sample(np.asarray(image, float) / 255.0, texels.body_uv))
    return raster.to_srgb(total / len(sources))


def cheeks(texels: Texels) -> np.ndarray:
    """Texels of the cheeks, where a skin's tone is measured."""
    x, y, z = np.moveaxis(texels.position, -1, 0)
    return texels.known & (np.abs(np.abs(x) - 42) < 14) & (np.abs(y + 42) < 16) & (z > 20)


def set_tone(image: np.ndarray, texels: Texels, look: Look) -> np.ndarray:
    """Scales linear colour so that the cheeks' mean is the wanted tone."""
    if look.tone is None:
        return image
    linear = raster.to_linear(image)
    mean = linear[cheeks(texels)].mean(0)
    gain = raster.to_linear(np.array(look.tone)) / mean
    return raster.to_srgb(np.clip(linear * gain, 0, 1))


def fine_detail(image: np.ndarray, texels: Texels, look: Look) -> np.ndarray:
    """Mottling, pores and redness: what a 512-pixel body texture cannot hold."""
    noise = Noise(1000 + look.seed)
    p = texels.position
    x, y, z = np.moveaxis(p, -1, 0)
    skin = texels.segment != SEGMENTS["inner_mouth"]
    blotch = noise.layered(p, 14.0, 3)
    pores = noise.at(p, 0.9) + 0.7 * noise.at(p, 1.7)
    patch = noise.layered(p, 5.0, 2)
    old = {"young": 0.8, "middleage": 1.1, "old": 1.5}[look.age]
    oily = np.exp(-((x / 26) ** 2)) * smoothstep(-105, -60, y) * smoothstep(60, 20, y) + 0.45
    gain = 1 + 0.011 * old * blotch + 0.011 * old * patch + 0.013 * oily * pores
    out = image * np.where(skin, gain, 1.0)[..., None]
    # Blood: cheeks, nose tip, ears and chin are redder, the forehead and the bridge paler.
    ax = np.abs(x)
    red = 0.9 * np.exp(-(((ax - 40) / 17) ** 2 + ((y + 34) / 15) ** 2)) * (z > 10)
    red += 0.8 * np.exp(-((x / 13) ** 2 + ((y + 38) / 9) ** 2)) * (z > 80)
    red += 0.5 * np.exp(-((x / 14) ** 2 + ((y + 101) / 9) ** 2)) * (z > 50)
    red += 0.6 * texels.ears - 0.25 * np.exp(-((x / 40) ** 2 + ((y - 42) / 20) ** 2)) * (z > 20)
    red = np.clip(red, -1, 1.2) * (1 + 0.35 * blotch)
    strength = 0.05 if look.ancestry == "african" else 0.075
    shift = red[..., None] * strength * np.array([0.25, -0.75, -0.65])
    out = out * (1 + np.where(skin, 1.0, 0.0)[..., None] * shift)
    if look.freckles:
        spots = (
            smoothstep(1.5, 2.3, noise.at(p, 2.2)) * np.exp(-(((ax - 26) / 26) ** 2 + ((y + 26) / 18) ** 2)) * (z > 20)
        )
        out = out * (1 - look.freckles * spots[..., None] * np.array([0.12, 0.22, 0.3]))
    if look.age == "old":
        spots = smoothstep(1.9, 2.5, noise.at(p, 6.0)) * (y > -60)
        out = out * (1 - spots[..., None] * np.array([0.07, 0.11, 0.14]))
    return out


def paint_lips(image: np.ndarray, texels: Texels, look: Look) -> np.ndarray:
    """Vermilion with a soft border, fine vertical wrinkles, and a dark line where the lips meet."""
    noise = Noise(2000 + look.seed)
    p = texels.position
    soft = gaussian_filter(texels.lips, 1.5)
    wrinkles = noise.at(np.stack([p[..., 0], p[..., 1]], -1), np.array([1.1, 7.0]))
    tint = np.array([0.98, 0.88, 0.89]) if look.ancestry != "african" else np.array([1.0, 0.93, 0.94])
    tint = tint ** (0.4 + look.lips)
    grey = image.mean(-1, keepdims=True)
    image = image + soft[..., None] * (0.0 if look.ancestry == "african" else 0.18) * (grey - image)
    if look.ancestry == "african":
        image = image * (1 + soft[..., None] * np.array([0.1, -0.02, -0.06]))
    out = image * (1 + soft[..., None] * (tint - 1))
    out *= 1 + (soft * 0.02 * wrinkles)[..., None]
    # The line of contact: rings 1 to 2 lie in shadow between the lips, towards the corners too.
    line = np.exp(-(((texels.mouth_ring - 1.0) / 1.0) ** 2)) * (texels.mouth_ring > -1)
    return out * (1 - line[..., None] * np.array([0.42, 0.5, 0.5]))


def paint_lids(image: np.ndarray, texels: Texels, look: Look) -> np.ndarray:
    """A lash line on the outer margin, a pink wet rim inside it, a caruncle in the inner corner."""
    noise = Noise(3000 + look.seed)
    ring, p = texels.eye_ring, texels.position
    x, y = np.abs(p[..., 0]), p[..., 1]
    upper = smoothstep(-3.4, -1.4, y - np.interp(x, [16, 30, 42], [-2.6, -1.4, -0.6]))
    strokes = 1 + 0.35 * noise.at(np.stack([x, y], -1), np.array([0.9, 3.0]))
    # Lashes grow from the outer edge of the margin: strongest at ring 3, shading the lid a little above.
    out = image.copy()
    rim = np.exp(-(((ring - 1.2) / 0.8) ** 2)) * (ring < 3)
    pink = np.array([1.04, 0.86, 0.84])
    out *= 1 + rim[..., None] * (pink - 1)
    dark = upper * np.exp(-(((ring - 2.9) / 0.75) ** 2)) + 0.38 * (1 - upper) * np.exp(-(((ring - 2.8) / 0.6) ** 2))
    dark += 0.25 * upper * np.exp(-(((ring - 4.2) / 1.0) ** 2))
    inner = smoothstep(15.0, 20.0, x)
    amount = np.clip(dark * look.lashes * strokes * inner * 1.25, 0, 0.92)
    lash = np.array(HAIR["black"]) if look.hair in ("black", "dark_brown") else np.array([0.13, 0.09, 0.07])
    out = out * (1 - amount[..., None]) + lash * amount[..., None]
    # The crease above the lid and a slight shade below the eye.
    crease = (
        upper * np.exp(-(((ring - 7.6) / 0.8) ** 2)) * 0.14 + (1 - upper) * np.exp(-(((ring - 8.5) / 2.0) ** 2)) * 0.05
    )
    return out * (1 - (crease * inner)[..., None] * np.array([0.8, 1.0, 1.0]))


def brow_card(ref, number: int) -> tuple[np.ndarray, tuple[float, float, float]]:
    """Opacity of a MakeHuman eyebrow card on the cylinder: an image over (phi, h) and its window (phi, h_min, step)."""
    proxy = makehuman.Proxy("eyebrows", f"eyebrow{number:03d}")
    p = ref.to_head(proxy.fit(ref.mean))
    alpha = np.asarray(Image.open(proxy.texture).convert("RGBA"), float)[..., 3:] / 255
    step, reach, low, high = 0.15, 1.05, -6.0, 46.0
    phi = np.arctan2(p[:, 0], p[:, 2])
    width, height = int(2 * reach * 90 / step), int((high - low) / step)
    xy = np.stack([(phi + reach) * 90 / step, (high - p[:, 1]) / step], 1)
    faces, uvs = np.array(proxy.faces), np.array(proxy.face_uvs)
    tri = np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])
    tuv = np.concatenate([uvs[:, [0, 1, 2]], uvs[:, [0, 2, 3]]])
    face, bary, _ = raster.fill(xy[tri], -p[tri][..., 2], width, height)
    hit = face >= 0
    out = np.zeros((height, width))
    uv = np.einsum("nk,nkd->nd", bary[hit], proxy.uv[tuv[face[hit]]])
    out[hit] = raster.sample(alpha, uv)[:, 0]
    return gaussian_filter(out, 0.7), (reach, high, step)


def paint_brows(image: np.ndarray, texels: Texels, look: Look, ref) -> np.ndarray:
    """Brow hairs of a card, projected along the cylinder's rays, over a soft shade of the same shape."""
    card, (reach, high, step) = brow_card(ref, look.brow)
    u = (texels.phi + reach) * 90 / step / card.shape[1]
    # MakeHuman's cards frown: a tilt lifts their inner ends and lowers the outer ones.
    along = np.clip((np.abs(texels.position[..., 0]) - 10.0) / 44.0, 0, 1)
    tilt = look.extra.get("tilt", 1.6 if look.sex == "female" else 0.6)
    v = 1 - (high - texels.position[..., 1] + tilt * (1 - 2 * along)) / step / card.shape[0]
    inside = (u > 0) & (u < 1) & (v > 0) & (v < 1) & (texels.position[..., 2] > 20)
    inside &= np.isin(
        texels.segment,
        [SEGMENTS[s] for s in ("skin", "left_brow", "right_brow", "nose", "left_eyelid", "right_eyelid")],
    )
    uv = np.stack([u, v], -1)
    hairs = raster.sample(card[..., None], uv)[..., 0] * inside
    shade = raster.sample(gaussian_filter(card, 5.0)[..., None], uv)[..., 0] * inside
    # Brows are darker than the hair of the head, most of all on grey heads.
    colour = np.array(HAIR[look.hair]) * {"black": 1.0, "grey": 0.5, "white": 0.58}.get(look.hair, 0.85)
    opacity = np.clip(0.88 * hairs + 0.42 * shade, 0, 0.92) * look.extra.get("brow", 1.0)
    return image * (1 - opacity[..., None]) + colour * opacity[..., None]


def paint_beard(image: np.ndarray, texels: Texels, look: Look) -> np.ndarray:
    """Stubble: a cool shade with dots over moustache, chin and jaw."""
    if look.beard <= 0:
        return image
    noise = Noise(4000 + look.seed)
    p = texels.position
    x, y, z = np.moveaxis(p, -1, 0)
    ax = np.abs(x)
    moustache = np.exp(-(((ax - 9) / 15) ** 2 + ((y + 57) / 6.5) ** 2)) * (z > 50)
    chin = np.exp(-((ax / 26) ** 2 + ((y + 101) / 17) ** 2)) * (z > 20)
    line = np.interp(z, [-5, 10, 40, 70], [-22, -46, -72, -80])
    jaw = smoothstep(2, -20, y - line) * smoothstep(-142, -112, y) * smoothstep(-6, 6, z)
    area = np.clip(moustache + chin + jaw, 0, 1) * (1 - gaussian_filter(texels.lips, 2.0))
    area *= 1 - np.exp(-(((ax - 21) / 5) ** 2) - ((y + 71) / 6) ** 2)  # the corners of the mouth stay bare
    area[texels.segment == SEGMENTS["inner_mouth"]] = 0
    dots = smoothstep(0.1, 1.6, noise.at(p, 0.8))
    amount = look.beard * area * (0.35 + 0.65 * dots)
    colour = 0.55 * np.array(HAIR[look.hair]) + 0.12
    return image * (1 - amount[..., None]) + colour * amount[..., None]


def paint_hair(image: np.ndarray, texels: Texels, look: Look) -> np.ndarray:
    """Short hair on the scalp: strands that flow from the whorl, and a soft ragged hairline."""
    if look.cover <= 0:
        return image
    noise = Noise(5000 + look.seed)
    across, along = texels.hair_flow()
    flow = np.stack([across, along], -1)
    strands = noise.at(flow, np.array([0.9, 9.0])) + 0.8 * noise.at(flow, np.array([2.2, 16.0]))
    strands += 0.5 * noise.at(texels.position, 1.0)
    strands /= strands.std()
    clumps = noise.layered(texels.position, 22.0, 2)
    distance = texels.hairline_distance(look.lift, look.recess, look.peak, look.sex == "male" or look.cover < 0.85)
    ragged = distance + 1.3 * strands + 1.5 * noise.at(texels.position, 7.0)
    edge = smoothstep(-4.0, 11.0, ragged)
    allowed = np.isin(texels.segment, [SEGMENTS[s] for s in ("skin", "scalp", "neck")])
    edge *= gaussian_filter(allowed.astype(float), 1.5) * smoothstep(0.75, 0.35, texels.ears)
    opacity = edge * np.clip(look.cover + 0.10 * strands, 0, 1)
    colour = np.array(HAIR[look.hair])
    shine = 1 + 0.2 * strands + 0.10 * clumps
    hair = np.clip(colour * shine[..., None] + 0.012 * strands[..., None], 0.01, 1)
    return image * (1 - opacity[..., None]) + hair * opacity[..., None]


def paint_cavities(image: np.ndarray, texels: Texels) -> np.ndarray:
    """Inner mouth: dark red, darker with depth. Eye sockets: a neutral pink, mostly unseen."""
    mouth = texels.segment == SEGMENTS["inner_mouth"]
    depth = smoothstep(88.0, 45.0, texels.position[..., 2])
    red = np.array([0.52, 0.22, 0.2]) * (1 - 0.72 * depth[..., None])
    out = np.where(mouth[..., None], red, image)
    socket = texels.segment == SEGMENTS["eye_socket"]
    return np.where(socket[..., None], np.array([0.55, 0.3, 0.28]), out)


def paint(look: Look, texels: Texels, ref) -> np.ndarray:
    """The finished skin, size x size x 3, sRGB uint8."""
    image = set_tone(load_base(look, texels), texels, look)
    image = fine_detail(image, texels, look)
    image = paint_lips(image, texels, look)
    image = paint_lids(image, texels, look)
    image = paint_beard(image, texels, look)
    image = paint_brows(image, texels, look, ref)
    image = paint_hair(image, texels, look)
    image = paint_cavities(image, texels)
    return (np.clip(image, 0, 1) * 255 + 0.5).astype(np.uint8)


def _source(sex: str, ancestry: str, age: str, suffix: str = "") -> str:
    shade = "darkskinned" if ancestry == "african" else "lightskinned"
    return f"{age}_{ancestry}_{sex}/textures/{age}_{shade}_{sex}_diffuse{suffix}.png"


LOOKS = [
    Look(
        "african_female_young",
        _source("female", "african", "young"),
        "female",
        "african",
        "young",
        "black",
        1,
        0.96,
        lips=0.5,
        lashes=0.85,
        tone=(0.46, 0.31, 0.24),
        seed=1,
    ),
    Look(
        "african_female_middle",
        _source("female", "african", "middleage"),
        "female",
        "african",
        "middleage",
        "black",
        8,
        0.95,
        lips=0.3,
        lashes=0.75,
        tone=(0.52, 0.36, 0.28),
        seed=2,
    ),
    Look(
        "african_female_old",
        _source("female", "african", "old"),
        "female",
        "african",
        "old",
        "grey",
        3,
        0.8,
        lift=4,
        lashes=0.5,
        tone=(0.43, 0.29, 0.225),
        seed=3,
    ),
    Look(
        "african_male_young",
        _source("male", "african", "young"),
        "male",
        "african",
        "young",
        "black",
        10,
        0.93,
        beard=0.3,
        lashes=0.6,
        tone=(0.36, 0.25, 0.19),
        seed=4,
    ),
    Look(
        "african_male_middle",
        _source("male", "african", "middleage"),
        "male",
        "african",
        "middleage",
        "black",
        9,
        0.86,
        lift=4,
        recess=10,
        beard=0.5,
        lashes=0.5,
        tone=(0.45, 0.315, 0.245),
        seed=5,
    ),
    Look(
        "african_male_old",
        _source("male", "african", "old"),
        "male",
        "african",
        "old",
        "grey",
        9,
        0.6,
        lift=10,
        recess=14,
        beard=0.35,
        lashes=0.4,
        tone=(0.4, 0.28, 0.22),
        seed=6,
    ),
    Look(
        "asian_female_young",
        _source("female", "asian", "young", "3"),
        "female",
        "asian",
        "young",
        "black",
        5,
        0.97,
        lips=0.7,
        lashes=0.8,
        tone=(0.84, 0.68, 0.57),
        seed=7,
    ),
    Look(
        "asian_female_middle",
        _source("female", "asian", "middleage", "2"),
        "female",
        "asian",
        "middleage",
        "black",
        1,
        0.95,
        lips=0.5,
        lashes=0.65,
        tone=(0.79, 0.61, 0.5),
        seed=8,
    ),
    Look(
        "asian_female_old",
        _source("female", "asian", "old", "2"),
        "female",
        "asian",
        "old",
        "grey",
        3,
        0.85,
        lift=3,
        lashes=0.45,
        tone=(0.76, 0.58, 0.47),
        seed=9,
    ),
    Look(
        "asian_male_young",
        _source("male", "asian", "young", "3"),
        "male",
        "asian",
        "young",
        "black",
        9,
        0.95,
        beard=0.12,
        lashes=0.5,
        tone=(0.77, 0.6, 0.49),
        seed=10,
    ),
    Look(
        "asian_male_middle",
        _source("male", "asian", "middleage", "2"),
        "male",
        "asian",
        "middleage",
        "black",
        12,
        0.9,
        recess=6,
        beard=0.22,
        lashes=0.45,
        tone=(0.73, 0.56, 0.45),
        seed=11,
    ),
    Look(
        "asian_male_old",
        _source("male", "asian", "old", "2"),
        "male",
        "asian",
        "old",
        "grey",
        9,
        0.6,
        lift=10,
        recess=12,
        beard=0.2,
        lashes=0.35,
        tone=(0.71, 0.52, 0.41),
        seed=12,
    ),
    Look(
        "caucasian_female_young",
        _source("female", "caucasian", "young"),
        "female",
        "caucasian",
        "young",
        "dark_blond",
        2,
        0.95,
        lips=0.7,
        lashes=0.75,
        tone=(0.87, 0.7, 0.62),
        freckles=0.7,
        seed=13,
    ),
    Look(
        "caucasian_female_young2",
        _source("female", "caucasian", "young", "2"),
        "female",
        "caucasian",
        "young",
        "red",
        5,
        0.95,
        lips=0.4,
        lashes=0.55,
        tone=(0.88, 0.71, 0.64),
        freckles=1.0,
        seed=14,
    ),
    Look(
        "caucasian_female_middle",
        _source("female", "caucasian", "middleage"),
        "female",
        "caucasian",
        "middleage",
        "brown",
        11,
        0.95,
        lips=0.5,
        lashes=0.65,
        tone=(0.82, 0.64, 0.56),
        seed=15,
    ),
    Look(
        "caucasian_female_old",
        _source("female", "caucasian", "old"),
        "female",
        "caucasian",
        "old",
        "white",
        6,
        0.88,
        lift=3,
        lashes=0.35,
        tone=(0.8, 0.64, 0.57),
        seed=16,
    ),
    Look(
        "caucasian_male_young",
        _source("male", "caucasian", "young"),
        "male",
        "caucasian",
        "young",
        "brown",
        9,
        0.93,
        peak=3,
        beard=0.28,
        lashes=0.5,
        tone=(0.82, 0.64, 0.54),
        seed=17,
    ),
    Look(
        "caucasian_male_young2",
        _source("male", "caucasian", "young", "2"),
        "male",
        "caucasian",
        "young",
        "blond",
        12,
        0.9,
        beard=0.15,
        lashes=0.4,
        tone=(0.85, 0.68, 0.59),
        freckles=0.4,
        seed=18,
    ),
    Look(
        "caucasian_male_middle",
        _source("male", "caucasian", "middleage"),
        "male",
        "caucasian",
        "middleage",
        "dark_brown",
        10,
        0.88,
        lift=5,
        recess=12,
        beard=0.42,
        lashes=0.5,
        tone=(0.79, 0.6, 0.5),
        seed=19,
    ),
    Look(
        "caucasian_male_old",
        _source("male", "caucasian", "old"),
        "male",
        "caucasian",
        "old",
        "white",
        9,
        0.55,
        lift=12,
        recess=16,
        beard=0.25,
        lashes=0.35,
        tone=(0.8, 0.62, 0.53),
        seed=20,
    ),
]


# The reference head's own skin: the mean of all, with ordinary brows and short hair.
MEAN_LOOK = Look(
    "mean",
    "",
    "male",
    "mixed",
    "middleage",
    "dark_brown",
    1,
    0.85,
    lips=0.4,
    lashes=0.6,
    tone=(0.72, 0.55, 0.45),
    seed=99,
)


def save(image: np.ndarray, path: Path, quality: int) -> None:
    """JPEG, chroma at full resolution (brows and lash lines are thin)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(image).save(path, quality=quality, subsampling=1, optimize=True)
