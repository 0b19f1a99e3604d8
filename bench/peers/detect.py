"""Runs two detectors nobody here wrote over a generated dataset, and compares their landmarks with the annotations.

    python bench/peers/detect.py DATASET [--json OUT.json] [--limit N] [--check]

DATASET is a folder that `facile gen` wrote: images and annotations.jsonl with ibug68 landmarks. Prints

- the share of unoccluded images with |yaw| <= 30 degrees in which MediaPipe's face mesh and OpenCV's Haar cascade find
  the face, and the same for all other images;
- the distance between MediaPipe's landmarks and ours on the 51 inner points of ibug-68, in parts of the distance between
  the outer eye corners (in the image, ours);
- for every subject, how much wider or more open the mouth is in MediaPipe's mesh with `smile`, `surprise` and
  `mouth_open` than at rest, in parts of its own outer-eye distance in 3D, over pairs of images that differ in the
  expression alone; and the same between pairs of neutral images, which is the measure's noise.

`--check` ends with exit code 1 if a target is missed. The reference head's landmarks were themselves placed with
MediaPipe's mesh and then corrected, so that this comparison is blind to a bias the two share; it sees what
registration, expression, camera and occlusion do to them.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import mediapipe as mp
import numpy as np

# Points of MediaPipe's mesh where ibug-68 has its points 17 to 67.
INNER = [70, 63, 105, 66, 107, 336, 296, 334, 293, 300, 168, 197, 5, 4, 75, 97, 2, 326, 305,
         33, 160, 158, 133, 153, 144, 362, 385, 387, 263, 373, 380,
         61, 39, 37, 0, 267, 269, 291, 405, 314, 17, 84, 181, 78, 82, 13, 312, 308, 317, 14, 87]
EYE_OUTER = (33, 263)
MOUTH_CORNERS = (61, 291)
LIPS_INNER = (13, 14)
IBUG_EYE_OUTER = (36, 45)
MAX_YAW_DEG = 30.0
# Expression, what is measured, and the least change that counts, in outer-eye distances.
EFFECTS = {"smile": ("width", 0.01), "surprise": ("opening", 0.02), "mouth_open": ("opening", 0.02)}
MIN_FOUND = 0.98
MAX_ERROR = 0.06


@dataclass
class Seen:
    """What the detectors say of one image."""

    record: dict
    mesh_px: np.ndarray | None  # 468 x 3: x and y in px, z in the same unit
    haar: bool

    @property
    def frontal(self) -> bool:
        return abs(self.record["head_pose"]["yaw_deg"]) <= MAX_YAW_DEG

    @property
    def unoccluded(self) -> bool:
        return self.record["occluder"]["kind"] == "none"


@dataclass
class Figures:
    """All that is printed."""

    found: dict = field(default_factory=dict)
    error: dict = field(default_factory=dict)
    effects: dict = field(default_factory=dict)
    noise: dict = field(default_factory=dict)
    misses: list = field(default_factory=list)


def read_records(dataset: Path, limit: int | None) -> list[dict]:
    with (dataset / "annotations.jsonl").open(encoding="utf-8") as lines:
        records = [json.loads(line) for line in lines if line.strip()]
    return records[:limit]


def inside(box: np.ndarray, point: np.ndarray) -> bool:
    x, y, w, h = box
    return bool(x <= point[0] <= x + w and y <= point[1] <= y + h)


class Detectors:
    """MediaPipe's face mesh and OpenCV's frontal Haar cascade, both as they come."""

    def __init__(self) -> None:
        self.mesh = mp.solutions.face_mesh.FaceMesh(static_image_mode=True, max_num_faces=1, refine_landmarks=False,
                                                    min_detection_confidence=0.5)
        self.haar = cv2.CascadeClassifier(cv2.data.haarcascades + "haarcascade_frontalface_default.xml")

    def see(self, record: dict, dataset: Path) -> Seen:
        image = cv2.imread(str(dataset / record["image"]), cv2.IMREAD_COLOR)
        if image is None:
            raise SystemExit(f"{dataset / record['image']}: cannot be read")
        height, width = image.shape[:2]
        result = self.mesh.process(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))
        mesh = None
        nose = ours(record)[30]
        if result.multi_face_landmarks:
            points = result.multi_face_landmarks[0].landmark
            mesh = np.array([[p.x * width, p.y * height, p.z * width] for p in points])
            # A face found elsewhere is not the face.
            low, high = mesh[:, :2].min(0), mesh[:, :2].max(0)
            if not inside(np.r_[low, high - low], nose):
                mesh = None
        boxes = self.haar.detectMultiScale(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), scaleFactor=1.05, minNeighbors=3,
                                           minSize=(width // 8, width // 8))
        return Seen(record, mesh, any(inside(box, nose) for box in boxes))


def ours(record: dict) -> np.ndarray:
    return np.array(record["landmarks"]["ibug68"]["px"], float)


def landmark_error(seen: Seen) -> float:
    """Mean distance on the inner points that are seen, in outer-eye distances."""
    truth = ours(seen.record)
    visible = np.array([v == "visible" for v in seen.record["landmarks"]["ibug68"]["visibility"]])[17:]
    unit = np.linalg.norm(truth[IBUG_EYE_OUTER[0]] - truth[IBUG_EYE_OUTER[1]])
    distances = np.linalg.norm(seen.mesh_px[INNER, :2] - truth[17:], axis=1) / unit
    return float(distances[visible].mean()) if visible.any() else math.nan


def span(mesh: np.ndarray, pair: tuple[int, int]) -> float:
    return float(np.linalg.norm(mesh[pair[0]] - mesh[pair[1]]))


def mouth(mesh: np.ndarray) -> dict[str, float]:
    unit = span(mesh, EYE_OUTER)
    return {"width": span(mesh, MOUTH_CORNERS) / unit, "opening": span(mesh, LIPS_INNER) / unit}


def setting(record: dict) -> str:
    """Everything but the expression: images that share it differ in the face alone."""
    camera = {k: record["camera"][k] for k in ("K", "R", "t_mm")}
    return json.dumps([record["subject"]["id"], camera, record["light"], record["occluder"]], sort_keys=True)


def measure_effects(images: list[Seen], figures: Figures) -> None:
    """Mouths against those of the same subject at rest, under the same light and from the same side."""
    rest: dict[str, dict] = {}
    resting: dict[str, list] = defaultdict(list)
    for seen in images:
        if seen.record["expression"]["name"] == "neutral":
            rest[setting(seen.record)] = mouth(seen.mesh_px)
            resting[seen.record["subject"]["id"]].append(mouth(seen.mesh_px))
    for kind in ("width", "opening"):
        spreads = [np.std([m[kind] for m in mouths]) for mouths in resting.values() if len(mouths) > 1]
        figures.noise[kind] = float(np.mean(spreads)) if spreads else math.nan
    strongest: dict[tuple, float] = defaultdict(float)
    for seen in images:
        key = (seen.record["subject"]["id"], seen.record["expression"]["name"])
        strongest[key] = max(strongest[key], seen.record["expression"]["intensity"])
    for name, (kind, _) in EFFECTS.items():
        changes = defaultdict(list)
        for seen in images:
            expression, subject = seen.record["expression"], seen.record["subject"]["id"]
            at_rest = rest.get(setting(seen.record))
            if expression["name"] == name and at_rest and expression["intensity"] == strongest[subject, name]:
                changes[subject].append(mouth(seen.mesh_px)[kind] - at_rest[kind])
        if changes:
            figures.effects[name] = {s: float(np.median(c)) for s, c in sorted(changes.items())}


def measure(all_seen: list[Seen]) -> Figures:
    figures = Figures()
    groups = {
        f"unoccluded, |yaw| <= {MAX_YAW_DEG:.0f}": [s for s in all_seen if s.frontal and s.unoccluded],
        f"unoccluded, |yaw| > {MAX_YAW_DEG:.0f}": [s for s in all_seen if not s.frontal and s.unoccluded],
        "occluded": [s for s in all_seen if not s.unoccluded],
    }
    for name, group in groups.items():
        if group:
            figures.found[name] = {
                "images": len(group),
                "mediapipe": sum(s.mesh_px is not None for s in group) / len(group),
                "haar": sum(s.haar for s in group) / len(group),
            }
    target = next(iter(groups.values()))
    figures.misses = [s.record["image"] for s in target if s.mesh_px is None]
    found = [s for s in target if s.mesh_px is not None]
    errors = np.array([landmark_error(s) for s in found])
    errors = errors[np.isfinite(errors)]
    if len(errors):
        figures.error = {"images": len(errors), "median": float(np.median(errors)),
                         "p95": float(np.percentile(errors, 95)), "worst": float(errors.max())}
    measure_effects(found, figures)
    return figures


def targets(figures: Figures) -> list[tuple[str, bool]]:
    """Every target that the dataset can show, and whether it is met."""
    rows = []
    frontal = next(iter(figures.found.values()), None)
    if frontal:
        rows.append((f"MediaPipe finds {frontal['mediapipe']:.1%} (at least {MIN_FOUND:.0%})",
                     frontal["mediapipe"] >= MIN_FOUND))
    if figures.error:
        median = figures.error["median"]
        rows.append((f"landmarks differ by {median:.2%} of the outer-eye distance (at most {MAX_ERROR:.0%})",
                     median <= MAX_ERROR))
    for name, changes in figures.effects.items():
        kind, least = EFFECTS[name]
        subject, change = min(changes.items(), key=lambda item: item[1])
        rows.append((f"{name}: mouth {kind} grows by {change:+.3f} at least, {subject} (more than {least})", change > least))
    return rows


def show(figures: Figures) -> None:
    print(f"{'found':34s}{'images':>8s}{'MediaPipe':>11s}{'Haar':>8s}")
    for name, row in figures.found.items():
        print(f"{name:34s}{row['images']:8d}{row['mediapipe']:11.1%}{row['haar']:8.1%}")
    for image in figures.misses[:10]:
        print(f"  not found by MediaPipe: {image}")
    if figures.error:
        e = figures.error
        print(f"\nlandmarks, mean of the visible inner 51, in outer-eye distances: median {e['median']:.4f}, "
              f"95 % {e['p95']:.4f}, worst {e['worst']:.4f} ({e['images']} images)")
    for name, changes in figures.effects.items():
        kind = EFFECTS[name][0]
        print(f"\n{name}: change of mouth {kind}, outer-eye distances (spread at rest {figures.noise[kind]:.3f})")
        for subject, change in changes.items():
            print(f"  {subject:24s}{change:+8.3f}")
    print()
    for text, met in targets(figures):
        print(f"{'met   ' if met else 'MISSED'}  {text}")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--json", type=Path, help="write all figures here")
    parser.add_argument("--limit", type=int, help="look at the first N images only")
    parser.add_argument("--check", action="store_true", help="exit code 1 if a target is missed")
    options = parser.parse_args()
    records = read_records(options.dataset, options.limit)
    if not records:
        raise SystemExit(f"{options.dataset}: no images")
    detectors = Detectors()
    figures = measure([detectors.see(record, options.dataset) for record in records])
    show(figures)
    if options.json:
        options.json.write_text(json.dumps(vars(figures), indent=1), encoding="utf-8")
    missed = [text for text, met in targets(figures) if not met]
    return 1 if options.check and missed else 0


if __name__ == "__main__":
    sys.exit(main())
