"""From a config to a rig: a simulated hand, a hand on a bus, or a recording."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from allegro_twin.app.backends.simulated import simulated, trial_of
from allegro_twin.app.config import (
    CanSettings,
    DynamixelSettings,
    PolledSettings,
    ReplaySettings,
    RunConfig,
    SimSettings,
)
from allegro_twin.app.controllers import make_controller
from allegro_twin.app.rig import Rig, guarded
from allegro_twin.backend import HandBackend
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import find
from allegro_twin.hands.description.hands import load_spec
from allegro_twin.hands.limits import check_period
from allegro_twin.spec import HandSpec

if TYPE_CHECKING:
    from allegro_twin.app.backends.can import Scene
    from allegro_twin.recording.reader import Recording

STAY = 0.5
"""s that a hand in another program is held on after its scenario: on a busy computer its time may lag behind ours."""


def make_backend(config: RunConfig) -> HandBackend:
    """The hand that the config describes, behind its guard. Raises HandError."""
    return assemble(config).backend


def assemble(config: RunConfig) -> Rig:
    """The hand, its controller and the scenario. Raises ConfigError, LinkError or RecordingError."""
    match config.backend:
        case SimSettings() as settings:
            return _simulated(config, settings)
        case CanSettings() as settings:
            return _wired(config, settings)
        case DynamixelSettings() | PolledSettings() as settings:
            return _served(config, settings)
        case ReplaySettings() as settings:
            return _replayed(config, settings)


def _simulated(config: RunConfig, settings: SimSettings) -> Rig:
    spec = load_spec(config.hand.model, config.hand.side, config.hand.serial)
    check_period(config.period, spec, config.controller.kind)
    sim, trial = simulated(settings, config.task, spec, config.period)
    controller, motion = make_controller(config, spec, trial)
    seconds = motion if trial is None else trial.seconds
    return Rig(spec, guarded(config, spec, sim), controller, config.seconds or seconds, trial, sim)


def _wired(config: RunConfig, settings: CanSettings) -> Rig:
    from allegro_twin.app.backends.can import Scene, make_can, spec_of

    spec = spec_of(config)
    check_period(config.period, spec, config.controller.kind)
    scene = Scene()
    backend = make_can(config, settings, spec, scene)
    return replace(_at_work(config, spec, backend, scene), wire=backend)


def _served(config: RunConfig, settings: DynamixelSettings | PolledSettings) -> Rig:
    from allegro_twin.app.backends.can import Scene
    from allegro_twin.app.backends.dynamixel import make_servos
    from allegro_twin.app.backends.polled import make_polled

    spec = load_spec(config.hand.model, config.hand.side, config.hand.serial)
    if "torque" not in spec.commands:  # One that takes torques is refused by what its line is for.
        check_period(config.period, spec, config.controller.kind)
    scene = Scene()
    if isinstance(settings, PolledSettings):
        polled = make_polled(config, settings, spec, scene)
        return replace(_at_work(config, spec, polled, scene), polled=polled)
    backend = make_servos(config, settings, spec, scene)
    return replace(_at_work(config, spec, backend, scene), servos=backend)


def _at_work(config: RunConfig, spec: HandSpec, backend: HandBackend, scene: Scene) -> Rig:
    """A hand on a wire, with what is behind it where it is virtual."""
    trial = scene.trial or trial_of(config.task, spec, config.period)
    controller, motion = make_controller(config, spec, trial)
    after = 0.0 if scene.trial is not None else STAY
    seconds = config.seconds or (motion if trial is None else trial.seconds + after)
    return Rig(spec, guarded(config, spec, backend), controller, seconds, scene.trial, scene.sim)


def _recording(config: RunConfig, settings: ReplaySettings) -> Recording:
    """Of a .arrow file, or of a bag."""
    from allegro_twin.recording.exchange.from_rosbag import from_bag, is_bag
    from allegro_twin.recording.reader import load

    if is_bag(settings.file):
        spec = load_spec(config.hand.model, config.hand.side, config.hand.serial)
        return from_bag(settings.file, spec, config.period)
    path = find(settings.file, "recording", "out", ".arrow")
    return load(path, partial=settings.partial, track=settings.track)


def _replayed(config: RunConfig, settings: ReplaySettings) -> Rig:
    from allegro_twin.recording.replay import ReplayBackend

    recording = _recording(config, settings)
    path, backend = recording.path, ReplayBackend(recording)
    if backend.spec.side != config.hand.side or backend.spec.model != config.hand.model:
        wanted = f"{config.hand.model}_{config.hand.side}"
        raise ConfigError(f"{path} is of the hand {backend.spec.name}; the config says {wanted}: change `hand`")
    if abs(backend.period - config.period) > 1e-9:
        raise ConfigError(f"{path} has a period of {backend.period} s; the config says {config.period} s")
    controller, _ = make_controller(config, backend.spec, trial_of(config.task, backend.spec, config.period))
    # A recording is not limited: what happened, happened.
    return Rig(backend.spec, backend, controller, config.seconds)
