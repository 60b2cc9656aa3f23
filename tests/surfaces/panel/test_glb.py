"""A surface is a file that glTF's readers understand, with every triangle, and matt."""

from __future__ import annotations

import json
import struct

import numpy as np

from allegro_twin.hands.description.appearance import VisualShape
from allegro_twin.surfaces.panel.page.glb import glb
from allegro_twin.viewing.surfaces import surface_of


def test_a_box_is_twelve_triangles_that_are_matt_in_its_colour() -> None:
    whole = surface_of(VisualShape("box", (0.01, 0.02, 0.03), color=(1.0, 0.5, 0.0, 1.0)))
    content = glb(whole)
    magic, version, length = struct.unpack("<4sII", content[:12])
    assert (magic, version, length) == (b"glTF", 2, len(content))
    size, kind = struct.unpack("<I4s", content[12:20])
    assert kind == b"JSON"
    head = json.loads(content[20 : 20 + size])
    binary = content[28 + size :]
    assert head["accessors"][0]["count"] == 36
    assert head["accessors"][0]["max"] == np.array([0.01, 0.02, 0.03], "f4").tolist()
    assert head["materials"][0]["pbrMetallicRoughness"]["metallicFactor"] == 0.0
    np.testing.assert_allclose(np.frombuffer(binary, "<f4", 108).reshape(-1, 3), whole.vertices, atol=1e-9)
    assert len(binary) == head["buffers"][0]["byteLength"] == 36 * 28
    assert tuple(binary[-4:]) == (255, 56, 0, 255)
