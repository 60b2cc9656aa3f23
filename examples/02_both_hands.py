"""One posture, two hands: what is stored for the right is the exact mirror image on the left."""

import numpy as np

from allegro_twin import Hand
from allegro_twin.hands import load_posture, load_spec, posture_names

print("postures:", ", ".join(posture_names()))
right, left = load_spec(side="right"), load_spec(side="left")
print("index on the right", load_posture("scissors", right)[:4])
print("index on the left ", load_posture("scissors", left)[:4])
tips = {}
for side in ("right", "left"):
    with Hand.open(f"sim_{side}") as hand:
        hand.move_to("scissors")
        tips[side] = hand.fingertips()["index"].position
        print(side, "index tip", tips[side].round(4))
assert (right.mirror_posture(load_posture("scissors", right)) == load_posture("scissors", left)).all()
assert np.allclose(tips["right"], tips["left"] * (1, -1, 1), atol=1e-3)  # m
