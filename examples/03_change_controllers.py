"""Change the controller of a moving hand; the torque never jumps."""

import numpy as np

from allegro_twin import Hand, Sample, TorqueCommand
from allegro_twin.types import Vector

sent: list[Vector] = []


def keep(sample: Sample) -> None:
    assert isinstance(sample.command, TorqueCommand)  # What this hand takes.
    sent.append(sample.command.torque)


with Hand.open("sim_right") as hand:
    hand.listen(keep)
    hand.move_to("home")
    limit = hand.spec.actuation.torque_limit
    for kind in hand.controllers:
        before = len(sent)
        hand.set_controller(kind)
        hand.wait(0.5)
        jump = np.abs(sent[before] - sent[before - 1]) / limit
        print(f"to {kind:8s} largest change of torque {jump.max():.2%} of the clip")
        assert jump.max() < 0.02
