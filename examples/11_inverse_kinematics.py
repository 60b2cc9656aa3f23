"""Closed-form inverse kinematics: all branches, a whole batch at once, and what is out of reach."""

import numpy as np

from allegro_twin.hands import load_spec
from allegro_twin.kinematics import hand_kinematics

thumb = hand_kinematics(load_spec(side="right")).finger("thumb")
posture = np.array([1.0, 0.4, 0.5, 0.6])
tip = thumb.fk(posture)
solutions = thumb.ik(tip.position, q0=posture[0])
print(f"{int(solutions.exists.sum())} branches, {int(solutions.within.sum())} inside the limits")
print("nearest to where we were", solutions.best(near=posture).posture.round(6))
assert np.allclose(solutions.best(near=posture).posture, posture)
targets = thumb.fk(np.random.default_rng(0).uniform(thumb.lower, thumb.upper, (10000, 4))).position
found = thumb.ik(targets[:1000]).best()
print(f"{found.reached.mean():.0%} of 1000 random tip positions solved in one call")
assert found.reached.all()
assert np.allclose(thumb.fk(found.posture).position, targets[:1000])
far = thumb.ik(np.array([0.5, 0.0, 0.0])).best()
print(f"[0.5 0 0] is out of reach by {float(far.distance) * 1000:.0f} mm")
assert not far.reached
