"""A scenario of your own, with an object that is in no catalogue."""

from pathlib import Path

from allegro_twin.surfaces.cli import app

Path("bottle.yaml").write_text("""
description: A half-full bottle, lifted by its neck side
objects: [{name: bottle, shape: cylinder, size: [0.066, 0.11], mass: 0.25}]
friction: 0.8
grasp: medium_wrap
wrist: {position: [-0.0466, 0.0237, 0.0194], facing: [0.995, -0.0998, 0], fingers: [-0.0998, -0.995, 0],
        retreat: [-0.1, 0, 0]}
""")
code = app(["run", "bottle.yaml"], standalone_mode=False)
assert not code, f"the bottle was not held: exit code {code}"
