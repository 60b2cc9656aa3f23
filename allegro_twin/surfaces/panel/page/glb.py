"""Triangles with colours as a binary glTF, whose materials are matt: a metal without surroundings is black.

Khronos Group, "glTF 2.0 Specification", 2021; the numbers below are its enumerations.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

from allegro_twin.viewing.surfaces import TriangleSurface

_FLOAT, _BYTE = 5126, 5121
_JSON, _BIN = 0x4E4F534A, 0x004E4942
_GAMMA = 2.2  # Vertex colours are linear.
_ROUGH = 0.65


def glb(surface: TriangleSurface) -> bytes:
    """One mesh."""
    colors = surface.colors.copy()
    colors[:, :3] = np.round(255.0 * (colors[:, :3] / 255.0) ** _GAMMA)
    parts = [surface.vertices.astype("<f4"), surface.normals.astype("<f4"), colors.astype("u1")]
    lengths = [part.nbytes for part in parts]
    count, places = len(parts[0]), [sum(lengths[:k]) for k in range(3)]
    ends = {"min": parts[0].min(axis=0).tolist(), "max": parts[0].max(axis=0).tolist()}
    accessors: list[dict[str, Any]] = [
        {"bufferView": 0, "componentType": _FLOAT, "count": count, "type": "VEC3", **ends},
        {"bufferView": 1, "componentType": _FLOAT, "count": count, "type": "VEC3"},
        {"bufferView": 2, "componentType": _BYTE, "count": count, "type": "VEC4", "normalized": True},
    ]
    content = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2}, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": _ROUGH}}],
        "buffers": [{"byteLength": sum(lengths)}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": place, "byteLength": length}
            for place, length in zip(places, lengths, strict=True)
        ],
        "accessors": accessors,
    }
    text = json.dumps(content, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    binary = b"".join(part.tobytes() for part in parts)
    chunks = struct.pack("<II", len(text), _JSON) + text + struct.pack("<II", len(binary), _BIN) + binary
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks
