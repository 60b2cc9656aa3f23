"""A backend or controller of an installed package may do anything: whoever drives it is told in one line."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from allegro_twin.app.controllers import with_speed_check
from allegro_twin.backend import limp_of
from allegro_twin.control.controllers import PD, ConstantCommand
from allegro_twin.control.trajectory import Hold, Moves, Waypoint
from allegro_twin.device import device_of
from allegro_twin.errors import ConfigError, HandFault, LinkError
from allegro_twin.files.first_error import message_of
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.plugin_faults import is_own
from allegro_twin.plugins import (
    ControllerKind,
    ControllerSettings,
    MadeController,
    PluginBackend,
    PluginController,
    reference_of,
)
from allegro_twin.types import HandState, Vector
from tests.contract.test_rules import Good, changed


class Broken(Good):
    """A hand whose SDK raises."""

    def read(self) -> HandState:
        raise RuntimeError("my SDK exploded\nin two lines")

    def write(self, command: object) -> None:
        np.linalg.inv(np.zeros((2, 2)))  # Raises in another package.

    def reset(self) -> HandState:
        if self.closed:
            raise KeyError("port")
        return super().reset()


def returning(make: Callable[[Good], object]) -> Good:
    """A hand whose `read` returns something else."""
    return changed(read=make)()


def test_what_a_backend_raises_is_a_fault_that_names_its_class_the_call_and_the_line() -> None:
    backend = PluginBackend(Broken(), "mine")
    backend.reset()
    with pytest.raises(HandFault) as read:
        backend.read()
    line = Broken.read.__code__.co_firstlineno + 1
    said = rf"backend mine: Broken.read raises RuntimeError: my SDK exploded in two lines \({__file__}:{line}\); "
    assert re.match(said, str(read.value))
    assert isinstance(read.value.__cause__, RuntimeError)
    line = Broken.write.__code__.co_firstlineno + 1
    with pytest.raises(HandFault, match=rf"Broken.write raises LinAlgError: Singular matrix \({__file__}:{line}\)"):
        backend.write(limp_of(backend.spec))
    backend.close()
    with pytest.raises(HandFault, match="Broken.reset raises KeyError: 'port'"):
        backend.reset()


@pytest.mark.parametrize(
    ("state", "said"),
    [
        (lambda hand: None, "None, no HandState"),
        (lambda hand: (0.1, 2), r"\(0.1, 2\), no HandState"),
        (lambda hand: replace(hand.state(), position=np.zeros(12)),
         r"a state whose position is float64 of shape \(12,\), not float64 of shape \(16,\)"),
        (lambda hand: replace(hand.state(), torque=[None] * 16), r"a state whose torque is list of shape \(16,\), not"),
        (lambda hand: replace(hand.state(), gravity=np.zeros((3, 1))),
         r"a state whose gravity is float64 of shape \(3, 1\), not"),
        (lambda hand: replace(hand.state(), t=None), "t None and tick 0, no numbers"),
    ],
)  # fmt: skip
def test_a_state_that_is_none_of_the_hand_is_a_fault_that_says_what_came(state: Any, said: str) -> None:
    backend = PluginBackend(returning(state), "mine")
    backend.reset()
    with pytest.raises(HandFault, match=rf"^backend mine: Bad.read returns {said}.* \({__file__}:\d+\); "):
        backend.read()


def test_an_error_of_its_own_tree_passes_as_it_is() -> None:
    def cut(hand: Good) -> HandState:
        raise LinkError("cable out")

    backend = PluginBackend(returning(cut), "mine")
    with pytest.raises(LinkError, match="^cable out$"):
        backend.read()


def test_a_close_that_raises_is_a_fault_and_the_note_of_an_error_that_is_on_its_way() -> None:
    def lost(hand: Good) -> None:
        raise OSError("no such port")

    backend = PluginBackend(changed(close=lost)(), "mine")
    for _ in range(2):
        with pytest.raises(HandFault, match="backend mine: Bad.close raises OSError: no such port"):
            backend.close()
    with pytest.raises(HandFault) as caught, closing(backend), closing(backend):
        raise HandFault("too hot")
    assert message_of(caught.value).startswith("too hot; backend mine: Bad.close raises OSError: no such port (")
    assert message_of(caught.value).count("no such port") == 1


class Following:
    """A controller that answers as it is told to."""

    def __init__(self, answer: Callable[[HandState], object]) -> None:
        self.answer = answer

    def start(self, state: HandState) -> int:
        return int(state.tick / (state.tick - 1))

    def __call__(self, state: HandState, memory: int) -> Any:
        return self.answer(state)


def test_a_controller_that_raises_is_a_fault_that_names_the_call_and_the_line() -> None:
    controller = PluginController(Following(lambda state: dict[str, object]()["gain"]), "mine")
    state = Good().reset()
    line = Following.start.__code__.co_firstlineno + 1
    with pytest.raises(
        HandFault, match=rf"^controller mine: Following.start raises ZeroDivisionError: .* \({__file__}:{line}\); a con"
    ):
        controller.start(replace(state, tick=1))
    with pytest.raises(HandFault, match=r"^controller mine: Following.__call__ raises KeyError: 'gain' \("):
        controller(state, 0)


@pytest.mark.parametrize("answer", [None, [], limp_of(load_spec()), (None, 0), (np.zeros(16), 0)])
def test_an_answer_that_is_no_command_with_a_memory_is_a_fault_that_says_what_came(answer: object) -> None:
    controller = PluginController(Following(lambda state: answer), "mine")
    said = re.escape(" ".join(repr(answer).split())[:60])
    with pytest.raises(HandFault, match=f"^controller mine: Following.__call__ returns {said}; it returns a command"):
        controller(Good().reset(), 0)


def test_a_controller_of_this_package_that_a_package_makes_stays_as_it_is() -> None:
    def make(answer: Any) -> MadeController:
        context: Any = None
        kind = ControllerKind(ControllerSettings, lambda settings, context: answer)
        return PluginController.make(kind, ControllerSettings(kind="mine"), context, "mine")

    own = ConstantCommand(limp_of(load_spec()))
    assert make(MadeController(own)).controller is own
    theirs = make(MadeController(Following(lambda state: None), 2.0))
    assert (type(theirs.controller), theirs.seconds) == (PluginController, 2.0)
    with pytest.raises(HandFault, match="returns ConstantCommand.*, no MadeController"):
        make(own)


class TheirPD(PD):
    """A package's controller on the base of this one's."""


@dataclass(frozen=True)
class Around:
    """A package's controller that uses one of this package."""

    reach: PD

    def start(self, state: HandState) -> Any:
        return self.reach.start(state)

    def __call__(self, state: HandState, memory: Any) -> Any:
        return self.reach(state, memory)


@pytest.mark.parametrize("theirs", [TheirPD, lambda *given: Around(PD(*given))])
def test_a_motion_that_a_packages_controller_follows_is_looked_at_before_it_begins(
    theirs: Callable[..., Any],
) -> None:
    spec, state = load_spec(), Good().reset()
    goal = state.position + 0.5
    reference, gains = Moves([Waypoint(goal, seconds=0.1)]), load_gains("default", spec)
    looked = list[str]()

    def check(peak: Vector, what: str) -> None:
        looked.append(what)
        if peak.max() > 6.0:
            raise ConfigError("too fast, rad/s")

    for inner in (PD(reference, gains), theirs(reference, gains)):
        controller = inner if is_own(type(inner)) else PluginController(inner, "mine")
        with pytest.raises(ConfigError, match="rad/s"):
            with_speed_check(controller, check).start(state)
    assert len(looked) == 2
    slow = PluginController(theirs(Moves([Waypoint(goal, seconds=5.0)]), gains), "mine")
    with_speed_check(slow, check).start(state)
    assert len(looked) == 3


class OwnGoal(Moves):
    """A package's motion, with arguments of its own."""

    def __init__(self, seconds: float) -> None:
        super().__init__([Waypoint(np.full(16, 0.5), seconds=seconds)])


class Once(OwnGoal):
    begun = False

    def begin(self, position: Vector) -> Any:
        if self.begun:
            raise KeyError("begun")
        object.__setattr__(self, "begun", True)
        return super().begin(position)


class Late:
    """A package's controller that has a reference once it has started."""

    def __init__(self, reference: Moves | None) -> None:
        self._later, self._started = reference, False

    @property
    def reference(self) -> Moves:
        if not self._started or self._later is None:
            raise RuntimeError("not started")
        return self._later

    reach = reference

    def start(self, state: HandState) -> Any:
        self._started = True

    def __call__(self, state: HandState, memory: Any) -> Any:
        return limp_of(load_spec()), memory


def test_a_property_of_a_packages_controller_may_raise_until_it_has_started_or_always() -> None:
    state = Good().reset()

    def check(peak: Vector, what: str) -> None:
        if peak.max() > 6.0:
            raise ConfigError(f"{what} is too fast")

    for reference in (OwnGoal(5.0), None):
        controller = PluginController(Late(reference), "mine")
        assert reference_of(controller) is None
        memory = with_speed_check(controller, check).start(state)
        controller(state, memory)
    with pytest.raises(ConfigError, match="the motion is too fast"):
        with_speed_check(PluginController(Late(OwnGoal(0.05)), "mine"), check).start(state)


def test_a_packages_motion_may_be_made_and_fail_in_its_own_way() -> None:
    """One that begins only once is told as what its package raises."""
    state, gains = Good().reset(), load_gains("default", load_spec())
    looked = list[float]()

    def check(peak: Vector, what: str) -> None:
        looked.append(float(peak.max()))

    with_speed_check(PluginController(TheirPD(OwnGoal(5.0), gains), "mine"), check).start(state)
    assert len(looked) == 1
    with pytest.raises(
        HandFault, match=r"controller mine: Once.begin raises KeyError: 'begun' \(.*test_plugin_backend"
    ):
        with_speed_check(PluginController(TheirPD(Once(5.0), gains), "mine"), check).start(state)


def test_a_reference_of_a_packages_controller_counts_where_it_is_one_of_this_package() -> None:
    reference = Hold(np.zeros(16))
    assert reference_of(PluginController(TheirPD(reference, load_gains("default", load_spec())), "mine")) is reference
    other: Any = Following(lambda state: None)
    other.reference = "what a package calls so"
    assert reference_of(PluginController(other, "mine")) is None


def test_the_optional_members_of_a_device_are_told_in_one_line_too() -> None:
    def lost(hand: Good, *given: object) -> None:
        raise OSError("no such port")

    device = device_of(PluginBackend(changed(warnings=lost, listen=lost)(), "mine"))
    with pytest.raises(HandFault, match="^Bad.warnings raises OSError: no such port"):
        device.warnings()
    with pytest.raises(HandFault, match="^Bad.listen raises OSError: no such port"):
        device.listen(print)
