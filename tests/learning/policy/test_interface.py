"""The environments' law, written for few operations, is the law of every hand."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.hands.library.library import load_grasp
from allegro_twin.learning.policy.interface import DecisionSetPoints, Interface, InterfaceMemory, Mode
from allegro_twin.learning.policy.script import closing_moves, sample_script, script_table


@pytest.mark.parametrize("scripted", [False, True])
@pytest.mark.parametrize("mode", ["delta", "absolute", "torque"])
def test_the_torque_without_new_arrays_is_the_torque_to_the_bit(mode: Mode, scripted: bool) -> None:
    spec = load_spec(side="left")
    gains, grasp, generator = load_gains("default", spec), load_grasp("tripod", spec), np.random.default_rng(0)
    scripts = (
        script_table([sample_script(closing_moves(grasp, 0.1, 0.1), grasp.preshape, 300, 0.003)]) if scripted else None
    )
    interface = Interface(spec, gains, mode, scripts=scripts)
    motion = generator.uniform(-1.0, 1.0, (2, 7, spec.n_joints))
    memory = interface.act(generator.uniform(-1.5, 1.5, (7, spec.n_joints)), interface.start(motion[0]))
    course, both = interface.set_points(memory), np.stack([gains.kp, gains.kd])[:, None]
    for k in range(interface.decimation):
        out = np.full((7, spec.n_joints), np.nan)
        torque = interface.torque(motion[0], motion[1], course, k)
        interface.pd_torque_into(motion[0], motion[1], course, k, both, out)
        np.testing.assert_array_equal(out, torque)
        alone = np.array(
            [interface.torque(motion[0, row], motion[1, row], one, k) for row, one in each(interface, memory)]
        )
        np.testing.assert_array_equal(out, alone)


def each(interface: Interface, memory: InterfaceMemory) -> list[tuple[int, DecisionSetPoints]]:
    """The course of every hand by itself."""
    return [(row, interface.set_points(InterfaceMemory(*(part[row] for part in memory)))) for row in range(7)]


@pytest.mark.parametrize("history", [1, 2, 5])
def test_a_memory_has_room_for_what_was_seen_at_the_decisions_before(history: int) -> None:
    spec = load_spec()
    interface = Interface(spec, load_gains("default", spec), "delta", history=history)
    memory = interface.start(np.zeros((3, spec.n_joints)))
    assert memory.past.shape == (3, interface.frame * (history - 1))
    seen = np.arange(3.0 * interface.frame, dtype=np.float32).reshape(3, -1)
    after = interface.act(np.zeros((3, spec.n_joints)), memory, seen)
    assert after.past.shape == memory.past.shape
    if history > 1:
        np.testing.assert_array_equal(after.past[:, : interface.frame], seen)
