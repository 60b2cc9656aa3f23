"""Somebody else's MJCF of the hand under our names: a file that maps its joints, its palm and its fingertips."""

from pathlib import Path

import yaml

from allegro_twin import Hand
from allegro_twin.app import RunConfig
from allegro_twin.files import data_root

# Here the other file is our own; put the path of, say, MuJoCo Menagerie's wonik_allegro/right_hand.xml.
theirs = data_root() / "models" / "mjcf" / "allegro_right.xml"
names = [f"joint_{k}.0" for k in range(16)]
ends = {"index": 3, "middle": 7, "ring": 11, "thumb": 15}
tips = {finger: [f"link_{k}.0", [0, 0, 0.0423 if finger == "thumb" else 0.0267]] for finger, k in ends.items()}
table = {"mjcf": str(theirs), "root": "palm_link", "joints": names, "tips": tips}
Path("theirs.yaml").write_text(yaml.safe_dump(table))

config = {"hand": {"serial": "theirs.yaml"}, "backend": {"kind": "sim"}, "controller": {"kind": "pid"}}
with Hand.open(RunConfig.model_validate(config)) as hand:
    hand.move_to("home")
    assert hand.spec.foreign is not None  # The other file.
    print(f"{hand.spec.foreign.mjcf.rsplit('/', 1)[-1]} is home within {abs(hand.errors).max() * 1000:.1f} mrad")
    assert abs(hand.errors).max() < 0.005  # rad
