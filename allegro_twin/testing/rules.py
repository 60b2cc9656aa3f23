"""Rules of the backend contract, one function each, without pytest.

A rule takes `make`, which opens a backend anew at each call, and closes what it has opened. It returns nothing when the
backend keeps it, raises `ContractViolation` with what is wrong, or `DoesNotApply` with the reason. Commands are small:
0.05 N·m, or a tenth of each joint's range about its middle.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import pairwise
from typing import Any

import numpy as np

from allegro_twin.backend import HandBackend, limp_of
from allegro_twin.device import device_of, innermost
from allegro_twin.errors import CommandError, EndOfRecording, HandError, HandFault
from allegro_twin.spec import HandSpec
from allegro_twin.types import Command, HandState, PositionCommand, TorqueCommand

Make = Callable[[], HandBackend]
Rule = Callable[[Make], None]
_ARRAYS = ("position", "velocity", "torque", "temperature")


class ContractViolation(AssertionError):
    """A backend breaks a rule of the contract; the message says how."""


class DoesNotApply(Exception):
    """A rule has nothing to say of this backend; the message says why."""


def require(condition: object, what: str) -> None:
    """Raise `ContractViolation` unless the condition holds."""
    if not condition:
        raise ContractViolation(what)


@contextmanager
def opened(make: Make) -> Iterator[HandBackend]:
    """A backend for a while."""
    backend = make()
    try:
        yield backend
    finally:
        backend.close()


def small_command(spec: HandSpec, k: int) -> Command:
    """Number k of a row of commands that move a hand a little."""
    wave = np.sin(0.1 * k + np.arange(spec.n_actuators))
    if "torque" in spec.commands:
        return TorqueCommand(0.05 * wave)
    return PositionCommand((spec.lower + spec.upper) / 2 + 0.1 * (spec.upper - spec.lower) * wave)


def drive(backend: HandBackend, periods: int) -> list[HandState]:
    """The states of a new session, as many periods long, under small commands."""
    states = [backend.reset()]
    for k in range(periods):
        backend.write(small_command(backend.spec, k))
        states.append(backend.read())
    return states


def _is_recording(backend: HandBackend) -> bool:
    """Whether commands change nothing, because what happened has happened."""
    return hasattr(innermost(backend), "recording")


def says_which_hand_it_is(make: Make) -> None:
    """`spec` is a HandSpec and `period` a number of seconds above 0, before and after `reset`."""
    with opened(make) as backend:
        require(isinstance(backend.spec, HandSpec), f"spec is a {type(backend.spec).__name__}, not a HandSpec")
        period = backend.period
        require(
            isinstance(period, float) and 0.0 < period < math.inf, f"period is {period!r}, not a number of s above 0"
        )
        backend.reset()
        require(backend.period == period, f"period changed from {period} s to {backend.period} s with reset")


def says_whether_it_is_live(make: Make) -> None:
    """`live` is True or False; a backend without it is taken for live."""
    with opened(make) as backend:
        inner = innermost(backend)
        if not hasattr(inner, "live"):
            raise DoesNotApply("it has no `live`, so it is taken for live: driven by a thread, in real time")
        require(isinstance(inner.live, bool), f"live is {inner.live!r}, not True or False")


def reset_begins_at_zero(make: Make) -> None:
    """`reset` gives t = 0 and tick = 0, at first and again after a session."""
    with opened(make) as backend:
        for when in ("the first", "a second"):
            state = backend.reset()
            require((state.t, state.tick) == (0.0, 0), f"{when} reset gives t {state.t} s, tick {state.tick}, not 0, 0")
            drive(backend, 3)


def time_increases(make: Make) -> None:
    """For half a second t and tick only go forward, and t is tick periods, to half a period."""
    with opened(make) as backend:
        states, period = drive(backend, 20), backend.period
        with suppress(EndOfRecording):
            while len(states) < 0.5 / period:
                states.append(backend.read())
    for before, after in pairwise(states):
        require(after.t > before.t, f"t went from {before.t} s to {after.t} s")
        require(after.tick > before.tick, f"tick went from {before.tick} to {after.tick}")
    for state in states:
        require(
            abs(state.t - state.tick * period) <= period / 2 + 1e-9,
            f"t is {state.t} s at tick {state.tick}, whose time is {state.tick * period:g} s",
        )


def a_state_is_whole(make: Make) -> None:
    """A state has the spec's shapes in float64; positions and velocities are finite; unknown is NaN, not zero."""
    with opened(make) as backend:
        states, n = drive(backend, 2), backend.spec.n_joints
    for state in states:
        for name in _ARRAYS:
            array = getattr(state, name)
            require(
                isinstance(array, np.ndarray) and array.shape == (n,) and array.dtype == np.float64,
                f"{name} is {_kind(array)}, not float64 of shape ({n},)",
            )
        require(np.shape(state.gravity) == (3,), f"gravity is {_kind(state.gravity)}, not float64 of shape (3,)")
        for name in ("position", "velocity"):
            require(np.isfinite(getattr(state, name)).all(), f"{name} is {getattr(state, name)}: not finite")


def _kind(array: Any) -> str:
    return f"{getattr(array, 'dtype', type(array).__name__)} of shape {np.shape(array)}"


def a_state_cannot_be_changed(make: Make) -> None:
    """The arrays of a state are read-only."""
    with opened(make) as backend:
        state = drive(backend, 1)[-1]
    for name in (*_ARRAYS, "gravity"):
        require(not getattr(state, name).flags.writeable, f"{name} can be written to; give `types.frozen(values)`")


def a_state_does_not_change(make: Make) -> None:
    """A state stays what it was while time goes on."""
    names = ("position", "velocity", "torque", "gravity")
    with opened(make) as backend:
        states = drive(backend, 5)
        copies = [{name: getattr(state, name).copy() for name in names} for state in states]
        for _ in range(5):
            backend.read()
    for state, copy in zip(states, copies, strict=True):
        for name in names:
            same = np.array_equal(getattr(state, name), copy[name], equal_nan=True)
            require(same, f"{name} of tick {state.tick} changed afterwards: give every state arrays of its own")


def reading_holds_the_last_command(make: Make) -> None:
    """`read` without `write` lets time pass under the last command."""
    with opened(make) as backend:
        backend.reset()
        backend.write(limp_of(backend.spec))
        ticks = [backend.read().tick for _ in range(4)]
    require(ticks == sorted(set(ticks)), f"ticks are {ticks}")


def a_session_is_repeatable(make: Make) -> None:
    """Where only `read` lets time pass, a second session is the first one, bit for bit."""
    with opened(make) as backend:
        if device_of(backend).live:
            raise DoesNotApply("it is live")
        first, second = drive(backend, 30), drive(backend, 30)
    _require_equal(first, second, "a second session")


def an_instance_repeats_another(make: Make) -> None:
    """Where only `read` lets time pass, a second backend does what the first one did, bit for bit."""
    runs = []
    for _ in range(2):
        with opened(make) as backend:
            if device_of(backend).live:
                raise DoesNotApply("it is live")
            runs.append(drive(backend, 30))
    _require_equal(runs[0], runs[1], "a second backend")


def _require_equal(first: list[HandState], second: list[HandState], what: str) -> None:
    for before, after in zip(first, second, strict=True):
        for name in ("position", "velocity", "torque"):
            same = np.array_equal(getattr(before, name), getattr(after, name), equal_nan=True)
            require(same, f"{what} has another {name} at tick {after.tick}, though it is not live")


def wrong_commands_are_refused(make: Make) -> None:
    """A command of the wrong kind or length is a CommandError at `write`."""
    with opened(make) as backend:
        spec = backend.spec
        kinds = [TorqueCommand, PositionCommand] if "torque" in spec.commands else [PositionCommand, TorqueCommand]
        n = spec.n_actuators
        for kind, count in ((kinds[0], n - 1), (kinds[0], n + 1), (kinds[1], n)):
            backend.reset()
            what = f"a {kind.__name__} of {count} values, for {n} actuators that take {', '.join(spec.commands)},"
            try:
                backend.write(kind(np.zeros(count)))
            except CommandError:
                continue
            except Exception as error:
                raise ContractViolation(f"{what} raises {type(error).__name__}, not CommandError") from error
            raise ContractViolation(f"{what} is taken; call `backend.torque_of` or `position_of`")


def a_refused_command_has_no_effect(make: Make) -> None:
    """After a CommandError the hand goes on under its last command, and takes the next one; a guard in front of it
    leaves it limp until `reset`."""
    runs: list[list[HandState]] = []
    for refused in (True, False):
        with opened(make) as backend:
            states = drive(backend, 5)
            if refused:
                try:
                    backend.write(TorqueCommand(np.zeros(backend.spec.n_actuators + 1)))
                except CommandError:
                    pass
                else:
                    raise ContractViolation("a command of another length is taken")
            try:
                states += [backend.read() for _ in range(5)]
                backend.write(small_command(backend.spec, 5))
                states.append(backend.read())
            except HandError as error:
                guarded = innermost(backend) is not backend
                require(
                    guarded and refused, f"after a refused command it raises {type(error).__name__}: {error}; it must "
                    "hold the last one"
                )  # fmt: skip
                return
            runs.append(states)
            if device_of(backend).live:
                return
    _require_equal(runs[1], runs[0], "a hand that has refused a command")


def parts_that_it_does_not_take_are_refused(make: Make) -> None:
    """A duration or an effort that the spec's `commands` do not have is a CommandError."""
    with opened(make) as backend:
        spec = backend.spec
        if "torque" in spec.commands:
            raise DoesNotApply("it takes torques")
        parts = {
            "timed_position": PositionCommand(spec.lower, duration=0.5),
            "limited_position": PositionCommand(spec.lower, np.full(spec.n_actuators, 0.1)),
        }
        for kind, command in parts.items():
            backend.reset()
            try:
                backend.write(command)
            except CommandError:
                require(kind not in spec.commands, f"it refuses a {kind}, which its spec takes")
            else:
                require(kind in spec.commands, f"it takes a {kind}, which its spec does not")


def the_limp_command_ends_all_torque(make: Make) -> None:
    """Five periods after the limp command the motors give nothing; what is not measured may be NaN."""
    with opened(make) as backend:
        if _is_recording(backend):
            raise DoesNotApply("what was recorded has happened")
        drive(backend, 20)
        backend.write(limp_of(backend.spec))
        for _ in range(5):
            state = backend.read()
    known = state.torque[~np.isnan(state.torque)]
    worst = int(np.nanargmax(np.abs(state.torque))) if len(known) else 0
    joint = backend.spec.joint_labels[worst]
    what = f"torque of {joint} is {state.torque[worst]:g} N·m five periods after the limp command"
    require(not known.any(), what)


def closing_twice_is_harmless(make: Make) -> None:
    """`close` may be called again, and `spec` may be asked afterwards."""
    backend = make()
    backend.reset()
    try:
        backend.close()
        backend.close()
    except Exception as error:
        raise ContractViolation(f"close raises {type(error).__name__}: {error}") from error
    require(isinstance(backend.spec, HandSpec), "spec is gone after close")


def reset_leads_out(make: Make) -> None:
    """A closed hand goes on as it was, for it only exists here, or takes nothing until `reset` opens it again."""
    with opened(make) as backend:
        backend.reset()
        backend.close()
        if device_of(backend).live:
            try:
                backend.write(limp_of(backend.spec))
            except HandFault:
                pass
            except Exception as error:
                what = f"write after close raises {type(error).__name__}, not HandFault"
                raise ContractViolation(what) from error
            else:
                raise ContractViolation("write after close is taken: a closed hand raises HandFault until reset")
        try:
            state = backend.reset()
        except HandError as error:
            raise ContractViolation(f"reset after close raises {type(error).__name__}: {error}") from error
        require(state.tick == 0, f"reset after close gives tick {state.tick}")


def only_a_recording_ends(make: Make) -> None:
    """A hand goes on for as long as somebody reads; a recording ends with EndOfRecording."""
    with opened(make) as backend:
        recording = _is_recording(backend)
        if device_of(backend).live:
            raise DoesNotApply("it is live, and this takes a second and more")
        backend.reset()
        try:
            for _ in range(300):
                backend.read()
        except EndOfRecording:
            require(recording, "it ends with EndOfRecording, though it is no recording")


RULES: tuple[Rule, ...] = (
    says_which_hand_it_is,
    says_whether_it_is_live,
    reset_begins_at_zero,
    time_increases,
    a_state_is_whole,
    a_state_cannot_be_changed,
    a_state_does_not_change,
    reading_holds_the_last_command,
    a_session_is_repeatable,
    an_instance_repeats_another,
    wrong_commands_are_refused,
    a_refused_command_has_no_effect,
    parts_that_it_does_not_take_are_refused,
    the_limp_command_ends_all_torque,
    closing_twice_is_harmless,
    reset_leads_out,
    only_a_recording_ends,
)
