"""Projects the landmarks of a dataset with OpenCV and compares with its records.

    python bench/peers/projection.py DATASET

Every landmark's place in mm goes through `cv2.projectPoints` with the record's K, R and t; the largest distance to the
record's pixel must stay below 0.01 px. Landmarks at or behind the camera are left out. Needs numpy and opencv-python.
"""

import json
import sys
from pathlib import Path

import cv2
import numpy as np

LIMIT_PX = 0.01


def main():
    worst, count = 0.0, 0
    with Path(sys.argv[1], "annotations.jsonl").open() as lines:
        for record in map(json.loads, lines):
            camera = record["camera"]
            k, r, t = (np.array(camera[name], float) for name in ("K", "R", "t_mm"))
            for scheme in record["landmarks"].values():
                points, found = np.array(scheme["mm"]), np.array(scheme["px"])
                in_front = (points @ r.T + t)[:, 2] > 1.0
                expected, _ = cv2.projectPoints(points[in_front], cv2.Rodrigues(r)[0], t, k, None)
                distance = np.linalg.norm(expected[:, 0] - found[in_front], axis=1)
                worst, count = max(worst, distance.max(initial=0.0)), count + len(distance)
    print(f"{count} landmarks, largest distance {worst:.6f} px")
    if not count or worst > LIMIT_PX:
        sys.exit(f"more than {LIMIT_PX} px, or nothing to compare")


if __name__ == "__main__":
    main()
