"""One posture, two hands: what is stored for the right is the exact mirror image on the left."""

from allegro_twin.description.hands import load_spec
from allegro_twin.hand import Hand
from allegro_twin.library.named import load_posture, posture_names

print("postures:", ", ".join(posture_names()))
right, left = load_spec(side="right"), load_spec(side="left")
print("index on the right", load_posture("scissors", right)[:4])
print("index on the left ", load_posture("scissors", left)[:4])
for side in ("right", "left"):
    with Hand.open(f"sim_{side}") as hand:
        hand.move_to("scissors")
        print(side, "index tip", hand.fingertips()["index"].position.round(4))
