"""Builds everything in assets/ that is generated, in order: reference, landmarks, identity model, subjects.

Run: python build_all.py [PYTHON_WITH_MEDIAPIPE]

The landmark step needs requirements-landmarks.txt, which does not go together with requirements.txt: give the interpreter of
its environment as the argument. Without it the committed landmarks.toml stays.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent


def main() -> None:
    def run(python: str, script: str) -> None:
        print(f"== {script}", flush=True)
        subprocess.run([python, str(HERE / script)], check=True)

    run(sys.executable, "build_reference.py")
    if len(sys.argv) > 1:
        run(sys.argv[1], "build_landmarks.py")
        run(sys.argv[1], "build_mesh478.py")
    run(sys.executable, "build_identity.py")
    run(sys.executable, "build_subjects.py")


if __name__ == "__main__":
    main()
