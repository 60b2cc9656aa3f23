"""Sessions of a host with a hidden hand on a virtual bus: ends of joints, excitation, postures, grasps."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from allegro_twin import HandBackend, HandSpec, run, until
from allegro_twin.app import Rig, RunConfig, assemble
from allegro_twin.control import PD, GravityFeedforward
from allegro_twin.drivers import CanBackend
from allegro_twin.files import find_file, load_settings
from allegro_twin.grasping import Perturbation, PhysicsSettings, Trial, TrialProtocol, TrialReport, load_scenario
from allegro_twin.hands import load_gains, load_grasp, load_posture, load_spec
from allegro_twin.kinematics import hand_kinematics, quaternion_from_matrix
from allegro_twin.recording import record
from allegro_twin.sim import SimBackend
from allegro_twin.sim.model import Stage, compile_scene
from allegro_twin.twin.identify import (
    ExcitationPose,
    encoder_offsets,
    find_pose,
    limit_sweep,
    limits_in_samples,
    rehearse,
)
from studies.rehearsal.hidden_hand import STEP, HiddenBackend, HiddenHand
from studies.rehearsal.motor_laws import Row

GENTLE, BEYOND = 0.25, 0.6
"""N·m, and rad beyond the model's limits: of the guard while joints are led to their ends."""
_AS_MADE = {"wire": {"encoder_offset": 0, "torque_constant": 1.0}}
"""What the hand's own electronics go by, whatever its host has found."""


@dataclass(slots=True)
class Session:
    """A host at a hidden hand."""

    rig: Rig
    hidden: HiddenBackend
    config: RunConfig


@contextmanager
def session(
    hand: HiddenHand, serial: str, inner: SimBackend, controller: dict[str, Any], task: dict[str, Any],
    gravity: tuple[float, float, float] | None, trial: Trial | None = None, limits: dict[str, Any] | None = None,
) -> Iterator[Session]:  # fmt: skip
    """Open a session: `serial` is the hand's file, or empty; `inner`, the scene with the hand in it; `gravity`, what
    the host is told of it in the palm's frame, m/s², None: the hand's own IMU tells."""
    scene = {"kind": "sim", "truth": _AS_MADE}
    backend: dict[str, Any] = {"kind": "can", "version": hand.version, "interface": "allegro-virtual", "scene": scene}
    backend |= {"imu": 0.1} if gravity is None else {"gravity": list(gravity)}
    who = {"side": hand.side} | ({"serial": serial} if serial else {})
    blocks = {"hand": who, "backend": backend, "task": task, "controller": controller, "limits": limits or {}}
    config, hidden = RunConfig.model_validate(blocks), HiddenBackend(inner, hand)

    def physics(spec: HandSpec, step: float) -> tuple[HandBackend, Trial | None]:
        return hidden, trial

    rig = assemble(config, physics)
    try:
        yield Session(rig, hidden, config)
    finally:
        rig.backend.close()


def nominal_spec(hand: HiddenHand) -> HandSpec:
    """What the model says of such a hand."""
    return load_spec("allegro", hand.side, "", hand.version)  # type: ignore[arg-type]  # One of the versions.


def alone(hand: HiddenHand, pose: ExcitationPose) -> SimBackend:
    """The hand in the open, in a pose of `excite`."""
    spec, x, z = nominal_spec(hand), np.array(pose.facing), np.array(pose.fingers)
    stage = Stage(np.zeros(3), quaternion_from_matrix(np.stack([x, np.cross(z, x), z], axis=1)))
    model = compile_scene(spec, stage)
    model.opt.timestep = STEP
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    return SimBackend(spec, model, posture=(spec.lower + spec.upper) / 2.0)


def excited(hand: HiddenHand, pose_name: str, number: int, seconds: float, folder: Path, serial: str) -> Path:
    """Record one motion of `excite`, by a host that has the hand's file."""
    pose, path = find_pose(pose_name, hand.side), folder / f"{pose_name}_{number}.arrow"
    with session(hand, serial, alone(hand, pose), {"kind": "torque"}, {}, pose.gravity) as host:
        spec, driver = host.rig.spec, host.rig.driver
        assert isinstance(driver, CanBackend)
        motion = rehearse(spec, pose, 100 * hand.number + number, seconds).excitation
        meta = {"calibration": dict(driver.calibration), "config": host.config.model_dump(mode="json")}
        for _ in record(until(seconds, run(host.rig.backend, motion)), path, spec, host.config.period, meta=meta):
            pass
    return path


def offsets_by_ends(hand: HiddenHand, pose_name: str) -> tuple[list[int], float]:
    """Lead every joint to both its ends, as `calibrate limits --offsets` does. Returns the encoder offsets, counts, and
    the time that it took, s."""
    pose, limits = find_pose(pose_name, hand.side), {"margin": -BEYOND, "torque": GENTLE}
    with session(hand, "", alone(hand, pose), {"kind": "torque"}, {}, pose.gravity, limits=limits) as host:
        spec, driver = host.rig.spec, host.rig.driver
        assert isinstance(driver, CanBackend)
        rest = load_posture("calibrate", spec)
        moves = limit_sweep(spec, rest)
        seconds = moves.begin(rest).seconds + 5.0
        controller: Any = PD(
            moves, load_gains("default", spec), GravityFeedforward(hand_kinematics(spec).gravity_torque)
        )
        found = limits_in_samples(until(seconds, run(host.rig.backend, controller)))
        return list(encoder_offsets(found, nominal_spec(hand), driver.codec).offset), seconds


def posture_errors(hand: HiddenHand, serial: str, posture: str, pose_name: str, kind: str) -> Row:
    """Go to a posture and stay: how far the joints are from it in the last half second on average, (n,), rad."""
    pose, last = find_pose(pose_name, hand.side), []
    with session(hand, serial, alone(hand, pose), {"kind": kind}, {"posture": posture}, pose.gravity) as host:
        seconds = host.rig.seconds or 0.0
        for sample in until(seconds + 2.0, run(host.rig.backend, host.rig.controller)):
            if sample.state.t > seconds + 1.5:
                last.append(np.array(host.hidden.true_position))
        wanted = load_posture(posture, host.rig.spec)
    error: Row = np.mean(last, axis=0) - wanted
    return error


def grasp_trial(hand: HiddenHand, serial: str, scenario: str, draw: Perturbation) -> TrialReport:
    """A scenario with its library grasp, judged as every trial is."""
    settings, path = load_scenario(scenario)
    protocol = load_settings(TrialProtocol, find_file(settings.protocol, "protocol", "conf/protocols"))
    known = protocol.physics.model_dump(exclude_none=True)
    own = {"timestep": STEP, "softness": hand.softness, "torsional": hand.torsional, "impratio": hand.impratio}
    physics = PhysicsSettings(**known | own | {"friction": protocol.physics.friction * hand.friction})
    spec = nominal_spec(hand)
    trial = Trial(
        settings, spec, load_grasp(settings.grasp, spec), folder=path.parent,
        protocol=protocol.model_copy(update={"physics": physics}), draw=draw,
    )  # fmt: skip
    feels = hand.version == "v4"  # The others' IMU, if they have one, is not published.
    control = {"kind": "pd"} | ({} if feels else {"compensate": False})
    gravity = None if feels else (0.0, 0.0, -9.81)
    with session(hand, serial, trial.backend, control, {"scenario": str(path)}, gravity, trial) as host:
        for _ in trial.watched(until(trial.seconds, run(host.rig.backend, host.rig.controller))):
            pass
    return trial.report()
