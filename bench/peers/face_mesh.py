"""The scheme `mesh478` against what MediaPipe's face mesh finds on the images of a dataset.

    facile gen bench/peers/face_mesh.toml --output out/face_mesh
    python bench/peers/face_mesh.py out/face_mesh

Needs mediapipe 0.10 (assets/build/requirements-landmarks.txt). Distances are in per cent of that between the eyes' middles.
"""

import json
import sys
from pathlib import Path

import mediapipe
import numpy as np
from PIL import Image


def main() -> None:
    folder = Path(sys.argv[1])
    finder = mediapipe.solutions.face_mesh.FaceMesh(static_image_mode=True, refine_landmarks=True, max_num_faces=1)
    errors, missed = {}, 0
    for line in (folder / "annotations.jsonl").read_text().splitlines():
        record = json.loads(line)
        image = np.array(Image.open(folder / record["image"]).convert("RGB"))
        faces = finder.process(image).multi_face_landmarks
        if not faces:
            missed += 1
            continue
        height, width = image.shape[:2]
        found = np.array([[p.x * width, p.y * height] for p in faces[0].landmark])
        placed = record["landmarks"]["mesh478"]
        truth, seen = np.array(placed["px"]), np.array(placed["visibility"]) == "visible"
        eyes = np.linalg.norm(truth[468] - truth[473])
        error = 100 * np.linalg.norm(found - truth, axis=1) / eyes
        key = (record["expression"]["name"], abs(round(record["head_pose"]["yaw_deg"])))
        errors.setdefault(key, []).append((error[:468][seen[:468]], error[468:]))
    print("expression, yaw: median and 95 % of the visible points; median of the irises; per cent of the distance of the eyes")
    for key, lists in sorted(errors.items()):
        skin, iris = (np.concatenate([pair[k] for pair in lists]) for k in (0, 1))
        print(f"{key[0]}, {key[1]}: {np.median(skin):.1f} {np.quantile(skin, 0.95):.1f}; {np.median(iris):.1f}")
    print(f"no face found in {missed} images")


if __name__ == "__main__":
    main()
