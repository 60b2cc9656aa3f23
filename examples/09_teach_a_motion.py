"""Teach by hand: gravity compensation while a person moves the fingers, here a scripted one; then repeat and store."""

import numpy as np

from allegro_twin import Hand, Library
from allegro_twin.control import Moves, Waypoint
from allegro_twin.hands.library import trajectory_entry
from allegro_twin.sim import HandGuide

with Hand.open("sim_right") as hand:
    hand.move_to("open")
    start, began = hand.state.position, hand.state.t
    bend = np.clip(start + np.tile([0.0, 0.6, 0.5, 0.3], 4), *hand.limits)
    shown = Moves([Waypoint(bend, seconds=1.0), Waypoint(start, seconds=1.0)]).begin(start)
    assert hand.sim is not None  # A person needs none.
    person = HandGuide(hand.sim, lambda t: shown(t - began).position)
    with hand.listening(person), hand.teach() as demonstration:
        hand.wait(2.5)
    person.let_go()
    motion = demonstration.motion()
    print(f"taught {motion.times[-1]:.2f} s with {len(motion.times)} knots")
    hand.play(motion, speed=2.0)
    library = Library()
    library.add("wave", trajectory_entry(motion.times, motion.positions, hand.spec), hand.spec)
    library.store("wave", "library/taught.yaml")
    hand.play("wave")  # From now on by its name, on either hand: allegro-twin play wave.
    assert abs(hand.state.position - motion.positions[-1]).max() < 0.01  # rad
    assert (library.trajectory("wave", hand.spec).positions == motion.positions).all()
print("stored in library/taught.yaml, for the right and the left hand")
