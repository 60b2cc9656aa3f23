"""A circle in Cartesian space with the tip of the index finger."""

import numpy as np

from allegro_twin import Hand

with Hand.open("sim_right") as hand:
    hand.move_to("home")
    center = hand.fingertips()["index"].position
    radius = 0.012
    hand.move_fingertips({"index": center + (radius, 0, 0)}, speed=0.1)
    worst = 0.0
    for angle in np.linspace(0, 2 * np.pi, 25)[1:]:
        goal = center + radius * np.array([np.cos(angle), 0.0, np.sin(angle)])
        hand.move_fingertips({"index": goal}, speed=0.1)
        worst = max(worst, float(np.linalg.norm(hand.fingertips()["index"].position - goal)))
print(f"a circle of {radius * 1000:.0f} mm, never more than {worst * 1000:.1f} mm off at its 24 points")
assert worst < 0.001  # m
