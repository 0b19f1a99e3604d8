"""Builds assets/identity: a linear model of head shapes on the reference cage, and the skins that go with it.

Heads are sampled from MakeHuman's macro and local targets, brought into the head frame, their lips closed as on the
reference, and decomposed into principal modes. With every mode go: the motion of the eyes and of what the skull carries
(teeth, tongue, hinge), and what it says about sex, ancestry and age, in both directions.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import makehuman
import parts
import skins
import texels
from build_reference import Reference, close_lips
from head import SCALE, eye_centres, smooth_rim

OUT = Path(__file__).resolve().parent.parent / "identity"
SAMPLES = 320
SEED = 4001
MODES = 40
ASYMMETRY = 0.05  # deviation of the difference between left and right local targets
ATTRIBUTES = ("male", "african", "asian", "caucasian", "age_decades")


class Sample:
    """One head on the cage with its eyes and its teeth, in the head frame."""

    def __init__(self, ref: Reference, seed: list[int]) -> None:
        rng = np.random.default_rng(seed)
        person = makehuman.Person(rng, asymmetry=ASYMMETRY)
        shape = person.shape(ref.base)
        self.attributes = np.array([person.male, *person.race, person.years / 10.0])
        self.v, self.body = in_head_frame(ref, shape)
        self.v = close_both(ref, self.v)
        eye_left = parts.EyeFit.of(self.v, ref.regions.eye_ring, 1, self.eye_guess(ref, shape, 0))
        eye_right = parts.EyeFit.of(self.v, ref.regions.eye_ring, -1, self.eye_guess(ref, shape, 1))
        self.eyes = np.array([eye_left.centre, eye_right.centre])
        self.radius = (eye_left.radius + eye_right.radius) / 2
        self.teeth = self.body[teeth_vertices(ref)]

    def eye_guess(self, ref: Reference, shape: np.ndarray, side: int) -> np.ndarray:
        helper = np.unique([c[0] for f in ref.base.groups[("helper-l-eye", "helper-r-eye")[side]] for c in f])
        p = self.body[helper]
        return (p.min(0) + p.max(0)) / 2


def close_both(ref: Reference, v: np.ndarray) -> np.ndarray:
    """Closes the lips of an asymmetric head: the closing of its symmetric part is added to it."""
    even = (v + v[ref.crop.mirror] * [-1, 1, 1]) / 2
    return v + close_lips(ref, even)[0] - even


def in_head_frame(ref: Reference, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cage and whole body in the head frame: eyes at y = 0 and mid-plane, back of the skull where the mean has it."""
    eyes = eye_centres(ref.base, shape).mean(0)
    origin = np.array([eyes[0], eyes[1], 0.0])
    body = (shape - origin) * SCALE
    skull = ref.role == "fixed"
    skull &= ref.v[:, 1] > -40
    body[:, 2] += (ref.v[skull, 2] - body[ref.crop.index][skull, 2]).mean()
    return smooth_rim(ref.quads, body[ref.crop.index]), body


def teeth_vertices(ref: Reference) -> np.ndarray:
    """Base-mesh vertices of the teeth helpers, which the teeth's proxy hangs on."""
    return np.unique(
        [c[0] for name in ("helper-upper-teeth", "helper-lower-teeth") for f in ref.base.groups[name] for c in f]
    )


def similarity(source: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Scale and translation about the origin that take source to goal (least squares, no rotation): s, tx, ty, tz."""
    a, b = source - source.mean(0), goal - goal.mean(0)
    s = (a * b).sum() / (a * a).sum()
    return np.r_[s, goal.mean(0) - s * source.mean(0)]


def regress(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Least-squares coefficients of y (n x m) on standardised, uncorrelated x (n x k): k x m."""
    return np.linalg.lstsq(x, y - y.mean(0), rcond=None)[0]


def build(ref: Reference) -> dict:
    """Samples, decomposes and regresses; all arrays of the model."""
    samples = [Sample(ref, [SEED, i]) for i in range(SAMPLES)]
    v = np.array([s.v for s in samples])
    centre = v.mean(0)
    flat = (v - centre).reshape(len(v), -1)
    # Passive inside parts must not steal modes from the face: weight them down while finding the modes.
    weight = np.repeat(np.where(ref.role == "free", 1.4, np.where(ref.role == "fixed", 0.8, 0.4)), 3)
    u, s, _ = np.linalg.svd(flat * weight, full_matrices=False)
    scores = u[:, :MODES] * np.sqrt(len(v))
    modes = np.linalg.lstsq(scores, flat, rcond=None)[0].reshape(MODES, -1, 3)
    left = flat - scores @ modes.reshape(MODES, -1)
    face = np.repeat(ref.role == "free", 3)
    explained = 1 - (left[:, face] ** 2).sum() / (flat[:, face] ** 2).sum()
    residual_mm = np.sqrt((left[:, face].reshape(len(v), -1, 3) ** 2).sum(2).mean())
    attributes = np.array([s.attributes for s in samples])
    design = np.c_[np.ones(len(v)), attributes[:, [0, 1, 2, 4]]]
    to_modes = np.linalg.lstsq(design, scores, rcond=None)[0]
    spread = (scores - design @ to_modes).std(0)
    eyes = np.array([s.eyes for s in samples])
    radius = np.array([[s.radius] for s in samples])
    base_teeth = ref.body[teeth_vertices(ref)]
    skull = np.array([similarity(base_teeth, s.teeth) for s in samples])
    return dict(
        modes=modes,
        explained=explained,
        residual_mm=residual_mm,
        rms=np.sqrt((modes**2).sum(2).mean(1)),
        rms_face=np.sqrt((modes[:, ref.role == "free"] ** 2).sum(2).mean(1)),
        attribute_mean=attributes.mean(0),
        attribute_slope=regress(scores, attributes),
        mode_offset=to_modes[0],
        mode_slope=to_modes[1:],
        mode_spread=spread,
        eyes=regress(scores, eyes.reshape(len(v), -1)).reshape(MODES, 2, 3),
        radius=regress(scores, radius)[:, 0],
        skull=regress(scores, skull),
        skull_left=(skull - skull.mean(0) - scores @ regress(scores, skull)).std(0),
    )


def row(values: np.ndarray, digits: int = 4) -> str:
    return "[" + ", ".join(f"{x + 0.0:.{digits}f}" for x in np.ravel(values)) + "]"


def write(model: dict, ref: Reference, out: Path = OUT) -> None:
    """modes.npy (i16), identity.toml."""
    out.mkdir(parents=True, exist_ok=True)
    scale = np.abs(model["modes"]).max() / 32767.0
    np.save(out / "modes.npy", np.round(model["modes"] / scale).astype("<i2"))
    lines = [
        "# Facile identity model. Built by assets/build/build_identity.py.",
        "# A head = reference cage + sum over modes of coefficient * modes[k] * scale, mm, head frame; a coefficient of 1",
        "# is one standard deviation of the population. Draw coefficients from N(0, 1); or, for wanted attributes, from",
        "# N(offset + slope * (male, african, asian, age_decades), spread), see [from_attributes]; clamp them at +-2.5.",
        f"modes = {MODES}",
        f"vertices = {len(ref.v)}",
        f"samples = {SAMPLES}",
        f"seed = {SEED}",
        f"scale = {scale:.10f}",
        f"explained = {model['explained']:.5f}  # share of the face's variance",
        f"residual_mm = {model['residual_mm']:.3f}  # RMS of what the modes leave, face",
        "",
        "# Root mean square displacement of +1 sigma, all of the cage and its free vertices, mm.",
        f"rms_mm = {row(model['rms'], 3)}",
        f"face_rms_mm = {row(model['rms_face'], 3)}",
        "",
        "[eyes]  # motion per +1 sigma, mm: centres [left, right] and common radius",
        "center = [",
    ]
    lines += [f"  [{row(e[0])}, {row(e[1])}]," for e in model["eyes"]]
    lines += [
        "]",
        f"radius = {row(model['radius'])}",
        "",
        "[skull]  # teeth, tongue and hinge: p -> scale * p + translation; both add up over the modes",
        f"scale = {row(model['skull'][:, 0], 6)}  # added to 1",
        "translation = [",
    ]
    lines += [f"  {row(t)}," for t in model["skull"][:, 1:]]
    lines += [
        "]",
        "",
        "[attributes]  # mean, and change per +1 sigma of each mode",
        "names = [" + ", ".join(f'"{n}"' for n in ATTRIBUTES) + "]",
        f"mean = {row(model['attribute_mean'])}",
        "slope = [",
    ]
    lines += [f"  {row(a)}," for a in model["attribute_slope"]]
    lines += [
        "]",
        "",
        "[from_attributes]  # coefficients from (male, african, asian, age_decades)",
        f"offset = {row(model['mode_offset'])}",
        "slope = [",
    ]
    lines += [f"  {row(a)}," for a in model["mode_slope"].T]
    lines += [
        "]",
        f"spread = {row(model['mode_spread'])}",
        "",
        "[tint]  # linear gains of a sampled skin: all channels by N(0, brightness), red against blue by N(0, warmth)",
        "brightness = 0.06",
        "warmth = 0.035",
        "clamp = 2.0",
        "",
        "[mix]  # a sampled skin = weight * first + (1 - weight) * second of the same sex and ancestry",
        "weight = [0.7, 1.0]",
        "",
    ]
    years = {"young": 25, "middleage": 48, "old": 70}
    for look in skins.LOOKS:
        lines += [
            "[[skin]]",
            f'name = "{look.name}"',
            f'file = "skins/{look.name}.jpg"',
            f'sex = "{look.sex}"',
            f'ancestry = "{look.ancestry}"',
            f'age = "{look.age}"',
            f"years = {years[look.age]}",
            f'hair = "{look.hair}"',
            "eyes = [" + ", ".join(f'"{e}"' for e in look.eye_colours()) + "]",
            "",
        ]
    (out / "identity.toml").write_text("\n".join(lines))


def write_skins(ref: Reference, size: int = 1024, quality: int = 82) -> None:
    """All skins as JPEG in the head UV."""
    field = texels.Texels(ref, size)
    for look in skins.LOOKS:
        skins.save(skins.paint(look, field, ref), OUT / "skins" / f"{look.name}.jpg", quality)


def main() -> None:
    ref = Reference()
    model = build(ref)
    write(model, ref)
    print(
        f"{MODES} modes explain {model['explained']:.3f} of the face's variance, residual {model['residual_mm']:.2f} mm;",
        f"skull placement residual {model['skull_left'].round(4)}",
    )
    write_skins(ref)


if __name__ == "__main__":
    main()
