"""What a recording of a hand does not tell is said in one sentence, and nothing goes on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from allegro_twin.app.config import load_config
from allegro_twin.app.rig import assemble
from allegro_twin.app.session import Outputs, perform
from allegro_twin.errors import ConfigError
from allegro_twin.recording.reader import load
from allegro_twin.recording.recorder import record
from allegro_twin.twin.branch.result import BranchOptions
from allegro_twin.twin.branch.what_if import branch_recording
from allegro_twin.twin.mirror.on_recording import recorded_samples
from allegro_twin.types import Sample
from tests.twin.branch.hands import AT, MRAD, after, as_real, rms


def test_what_a_recording_does_not_tell_is_one_sentence(made: Path, own: str, tmp_path: Path) -> None:
    real = as_real(made, tmp_path / "real.arrow")
    for at in (0.9, 2.4):
        with pytest.raises(ConfigError, match=rf"--at {at} s: .* from 0 to 2.4 s, and a mirror needs the first 1 s"):
            branch_recording(real, at, {}, options=BranchOptions(own))
    with pytest.raises(ConfigError, match="--at 3 s: .* goes from 0 to 2.4 s"):
        branch_recording(real, 3.0, {}, options=BranchOptions(own))
    with pytest.raises(ConfigError, match="--set friction is that of contacts, and nobody knows what the hand"):
        branch_recording(real, AT, {"friction": 0.5}, options=BranchOptions(own))
    with pytest.raises(ConfigError, match="--set controller.gains: only commands of .*: as --open-loop says"):
        branch_recording(real, AT, {"controller.gains": "v4"}, options=BranchOptions(own, open_loop=True))
    with pytest.raises(ConfigError, match="does not say with which torque constant its counts became"):
        branch_recording(as_real(made, tmp_path / "old.arrow", calibration=None), AT, {}, options=BranchOptions(own))
    down = np.array([0.0, 0.0, -9.81])
    for asked, names in (
        (BranchOptions(open_loop=True), "--open-loop"), (BranchOptions(gravity=down), "--gravity"),
        (BranchOptions(disturbance="hold", gravity=down), "--disturbance and --gravity"),
    ):  # fmt: skip
        with pytest.raises(ConfigError, match=f"is of a simulation, .*: leave out {names}, or give --hand to go on"):
            branch_recording(made, AT, {}, options=asked)


@pytest.mark.slow
def test_a_calibration_without_limits_has_those_of_its_version(made: Path, own: str, tmp_path: Path) -> None:
    table = load(made).meta["calibration"]
    bare = {"version": table["version"], "torque_constant": table["torque_constant"]} | {
        key: table[key] for key in ("encoder_offset", "encoder_direction", "motor_direction")
    }
    changed = {"frictionloss": 0.05}
    found, same = (
        branch_recording(as_real(made, tmp_path / f"{name}.arrow", calibration=each), AT, changed,
                         options=BranchOptions(own))
        for name, each in (("bare", bare), ("whole", table))
    )  # fmt: skip
    np.testing.assert_array_equal(found.branched, same.branched)


def test_a_hand_that_is_not_this_one_is_refused(made: Path, own: str, tmp_path: Path) -> None:
    content = yaml.safe_load(Path(own).read_text())
    for key, value, said in (("side", "left", "is a left hand; hand.side is right"), ("version", "v3", "of a v3 hand")):
        other = tmp_path / f"{key}.yaml"
        other.write_text(yaml.safe_dump(content | {"wire": content["wire"] | {key: value}}))
        with pytest.raises(ConfigError, match=said):
            branch_recording(made, AT, {}, options=BranchOptions(str(other)))
    simulated = load_config("sim_right").changed(seconds=1.2)
    perform(assemble(simulated), simulated, Outputs(record=tmp_path / "sim.arrow"))
    with pytest.raises(ConfigError, match="is of a simulation, which is repeated as it was: leave out --hand"):
        branch_recording(tmp_path / "sim.arrow", AT, {}, options=BranchOptions(own))
    with pytest.raises(ConfigError, match="is of a simulation, .* its controller: leave out --gravity$"):
        branch_recording(tmp_path / "sim.arrow", AT, {}, options=BranchOptions(gravity=np.array([0.0, 0.0, -9.81])))


def test_a_hand_that_does_not_say_where_down_is_or_what_its_motors_gave_is_refused(
    made: Path, own: str, tmp_path: Path
) -> None:
    origin, path = load(made), {name: tmp_path / f"{name}.arrow" for name in ("gravity", "torque")}
    states = [sample.state for sample in recorded_samples(origin)]
    for name, lost in (
        ("gravity", [replace(state, gravity=np.full(3, np.nan)) for state in states]),
        ("torque", [replace(state, torque=np.full(16, np.nan)) for state in states]),
    ):
        samples = (Sample(state, sample.command) for state, sample in zip(lost, recorded_samples(origin), strict=True))
        meta = {key: value for key, value in origin.meta.items() if key != "engine"}
        for _ in record(samples, path[name], origin.spec, origin.period, meta=meta):
            pass
    with pytest.raises(ConfigError, match="must know where down is: --gravity"):
        branch_recording(path["gravity"], AT, {}, options=BranchOptions(own))
    down = origin.columns["gravity"][-1]
    told = branch_recording(path["gravity"], AT, {}, options=BranchOptions(own, gravity=down))
    assert rms((told.branched - told.recorded)[after(told)]) < 0.5 * MRAD
    with pytest.raises(ConfigError, match="holds positions without torques"):
        branch_recording(path["torque"], AT, {}, options=BranchOptions(own))


def test_a_log_that_begins_before_the_first_torque_is_branched(made: Path, own: str, tmp_path: Path) -> None:
    origin, path = load(made), tmp_path / "log.arrow"
    samples = (
        Sample(replace(sample.state, torque=np.full(16, np.nan)) if k < 2 else sample.state, sample.command)
        for k, sample in enumerate(recorded_samples(origin))
    )
    meta = {key: value for key, value in origin.meta.items() if key != "engine"}
    for _ in record(samples, path, origin.spec, origin.period, meta=meta):
        pass
    found = branch_recording(path, AT, {}, options=BranchOptions(own))
    assert rms((found.branched - found.recorded)[after(found)]) < 0.5 * MRAD
