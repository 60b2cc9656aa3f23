"""Hidden hands as hands that are rehearsed: how a host's session with one is opened, and who knows the truth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mujoco
import numpy as np

from allegro_twin import HandBackend, HandSpec
from allegro_twin.app import RunConfig
from allegro_twin.files import find_file, load_settings
from allegro_twin.grasping import (
    Perturbation,
    PhysicsSettings,
    Trial,
    TrialProtocol,
    TrialReport,
    load_scenario,
    make_stage,
)
from allegro_twin.hands import load_grasp, load_spec
from allegro_twin.kinematics import matrix_from_quaternion, quaternion_from_matrix
from allegro_twin.sim import SimBackend
from allegro_twin.sim.model import Stage, compile_scene
from allegro_twin.twin.identify import ExcitationPose
from allegro_twin.twin.rehearsal import RehearsedHand, grasp_trial
from studies.rehearsal.hidden_hand import STEP, HiddenBackend, HiddenHand
from studies.rehearsal.motor_laws import Row

_AS_MADE = {"wire": {"encoder_offset": 0, "torque_constant": 1.0}}
"""What the hand's own electronics go by, whatever its host has found."""


@contextmanager
def learnt_file(row: Mapping[str, Any]) -> Iterator[Path]:
    """The hand's file that a result has, written for a while."""
    with TemporaryDirectory() as name:
        file = Path(name) / "hand.yaml"
        file.write_text(row["file"])
        yield file


class RehearsedHiddenHand(RehearsedHand):
    """A hidden hand behind the virtual bus. `draws`: what a host is not told of the objects of its grasps."""

    def __init__(self, hand: HiddenHand, draws: Mapping[str, Perturbation] | None = None) -> None:
        super().__init__(hidden_config(hand))
        self.hand, self._draws = hand, dict(draws or {})
        self.hidden: HiddenBackend | None = None
        """The hand of the last session."""

    def check_link(self) -> str:
        return "hidden hands have no faults of the link"

    def placed(self, pose: ExcitationPose) -> tuple[RunConfig, Any]:
        config = self.config.changed(backend={"gravity": list(pose.gravity)})
        return config, self.behind(alone(self.hand, pose), None)

    def behind(self, inner: SimBackend, trial: Trial | None) -> Any:
        """What puts the hidden hand in the scene of a simulation behind the bus."""

        def physics(spec: HandSpec, step: float) -> tuple[HandBackend, Trial | None]:
            self.hidden = HiddenBackend(inner, self.hand)
            return self.hidden, trial

        return physics

    def true_position(self) -> Row | None:
        return None if self.hidden is None else self.hidden.true_position

    def trial(self, scenario: str, serial: str, film: Path | None = None) -> TrialReport:
        """Judged as every trial is, with the hand's own contacts."""
        settings, path = load_scenario(scenario)
        own, spec = self.hand, nominal_spec(self.hand)
        protocol = load_settings(TrialProtocol, find_file(settings.protocol, "protocol", "conf/protocols"))
        known = protocol.physics.model_dump(exclude_none=True)
        known |= {"timestep": STEP, "softness": own.softness, "torsional": own.torsional, "impratio": own.impratio}
        physics = PhysicsSettings(**known | {"friction": protocol.physics.friction * own.friction})
        grasp = load_grasp(settings.grasp, spec)
        trial = Trial(
            settings, spec, grasp, folder=path.parent,
            protocol=protocol.model_copy(update={"physics": physics}), draw=self._draws.get(scenario, Perturbation()),
        )  # fmt: skip
        feels = own.version == "v4"  # The others' IMU, if they have one, is not published.
        stage = make_stage(settings, protocol, spec.side, path.parent)
        down = matrix_from_quaternion(stage.quaternion).T @ (0.0, 0.0, -9.81)
        # Who controls force carries the hand's weight: without an IMU, that of the palm as the trial begins.
        control = {"kind": "pd"} | ({} if feels or grasp.grip is not None else {"compensate": False})
        bus = {"imu": 0.1} if feels else {"gravity": down.tolist()}
        config = self.config.changed(
            hand={"serial": serial}, backend=bus, task={"scenario": str(path)}, controller=control
        )
        return grasp_trial(config, self.behind(trial.backend, trial), film)


def hidden_config(hand: HiddenHand) -> RunConfig:
    """What a host is told of a hidden hand."""
    scene = {"kind": "sim", "truth": _AS_MADE}
    backend = {"kind": "can", "version": hand.version, "interface": "allegro-virtual", "scene": scene}
    return RunConfig.model_validate({"hand": {"side": hand.side}, "backend": backend, "controller": {"kind": "pd"}})


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
