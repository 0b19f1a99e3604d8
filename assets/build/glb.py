"""Writes a textured triangle mesh as binary glTF 2.0: one mesh, one material, one embedded JPEG."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np

ARRAY, ELEMENTS = 34962, 34963
FLOAT, UINT16, UINT32 = 5126, 5123, 5125


def write(
    path: Path, vertices: np.ndarray, uv: np.ndarray, triangles: np.ndarray, jpeg: bytes, copyright_note: str
) -> None:
    """`vertices` n x 3, `uv` n x 2 with v up (glTF has it down: flipped here), `triangles` m x 3."""
    index_type, dtype = (UINT16, "<u2") if len(vertices) < 65536 else (UINT32, "<u4")
    position = vertices.astype("<f4")
    coords = np.stack([uv[:, 0], 1.0 - uv[:, 1]], 1).astype("<f4")
    blobs = [
        (position.tobytes(), ARRAY),
        (coords.tobytes(), ARRAY),
        (triangles.astype(dtype).tobytes(), ELEMENTS),
        (jpeg, None),
    ]
    views, binary = [], b""
    for blob, target in blobs:
        view = {"buffer": 0, "byteOffset": len(binary), "byteLength": len(blob)}
        if target:
            view["target"] = target
        views.append(view)
        binary += blob + b"\0" * (-len(blob) % 4)
    document = {
        "asset": {"version": "2.0", "generator": "assets/build/build_subjects.py", "copyright": copyright_note},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": path.stem}],
        "meshes": [
            {
                "name": path.stem,
                "primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}, "indices": 2, "material": 0}],
            }
        ],
        "materials": [
            {
                "name": "skin",
                "pbrMetallicRoughness": {
                    "baseColorTexture": {"index": 0},
                    "metallicFactor": 0.0,
                    "roughnessFactor": 0.7,
                },
            }
        ],
        "textures": [{"source": 0, "sampler": 0}],
        "samplers": [{"wrapS": 33071, "wrapT": 33071}],
        "images": [{"bufferView": 3, "mimeType": "image/jpeg"}],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": FLOAT,
                "count": len(vertices),
                "type": "VEC3",
                "min": [float(x) for x in position.min(0)],
                "max": [float(x) for x in position.max(0)],
            },
            {"bufferView": 1, "componentType": FLOAT, "count": len(vertices), "type": "VEC2"},
            {"bufferView": 2, "componentType": index_type, "count": 3 * len(triangles), "type": "SCALAR"},
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + len(binary)
    path.write_bytes(
        struct.pack("<4sII", b"glTF", 2, total)
        + struct.pack("<I4s", len(text), b"JSON")
        + text
        + struct.pack("<I4s", len(binary), b"BIN\0")
        + binary
    )
