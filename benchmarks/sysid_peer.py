"""`python -m benchmarks.sysid_peer SEED …`: MuJoCo's own identification toolbox and `identify`, side by side.

Both get the same recordings of a hidden hand of `benchmarks.twins`, whose physics is in the class of both: three poses,
masses known. The toolbox is told more: encoder offsets, delay, and where friction's solver has to be stiff. It fits
torque constant, armature, damping and dry friction of 16 joints in windows of 0.3 s, from positions and speeds that a
Savitzky-Golay filter finds. It needs the packages of `mujoco[sysid]` on the path, which this project does not install.
"""

from __future__ import annotations

import argparse
import json
import logging
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mujoco
import numpy as np
import yaml
from scipy.signal import savgol_filter  # type: ignore[import-untyped]  # Its types are a package of its own.

from allegro_twin.files.assets import data_root
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.sim.open_loop import OpenLoopPlayer
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.motions.motion import RecordedMotion, read_motion
from allegro_twin.twin.identify.pipeline import identify_hand, measure_gaps
from allegro_twin.twin.identify.results.gap import gap_errors
from allegro_twin.twin.identify.results.hand_file import write_hand_file
from allegro_twin.types import Array
from benchmarks.hidden_hands import POSES, TIMESTEP, UNSEEN, drawn, excited, true_parameters

STEP = 0.001
"""s, of the toolbox's physics: that of `identify`."""
WINDOW = 100
"""Periods."""
FIRST = {"k": (1.0, 0.5, 1.6), "armature": (0.003, 0.0005, 0.01), "damping": (0.0735, 0.01, 0.3),
         "friction": (0.02, 0.0, 0.1)}  # fmt: skip
"""Start and bounds of a joint's parameters: the nominal drive's. N·m, kg·m², N·m·s/rad, N·m."""
OURS = {"k": "torque_constant", "armature": "armature", "damping": "damping", "friction": "frictionloss"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("seeds", type=int, nargs="+")
    parser.add_argument("--seconds", type=float, default=16.0, help="in each of three poses")
    parser.add_argument("--iterations", type=int, default=15, help="of the toolbox, at most")
    chosen = parser.parse_args()
    logging.disable(logging.INFO)
    for seed in chosen.seeds:
        for row in side_by_side(seed, chosen.seconds, chosen.iterations):
            print(json.dumps(row), flush=True)


def side_by_side(seed: int, seconds: float, iterations: int) -> list[dict[str, Any]]:
    """A row of each program: its errors, the share of its 95 % intervals that hold the truth, its prediction of a
    motion of 5 s in a pose that it has not seen, and its processor time."""
    truth, item = drawn(seed, "matched"), {"seed": seed, "side": "right"}
    truth["drive"] |= {"backlash": 0.0}
    with TemporaryDirectory() as name:
        folder = Path(name)
        paths = [excited(truth, item, pose, seconds, folder, k) for k, pose in enumerate((*POSES, UNSEEN))]
        motions, unseen = [read_motion(path) for path in paths[:-1]], read_motion(paths[-1])
        file = folder / "hand.yaml"
        file.write_text(yaml.safe_dump({"drive": {"mass_scale": truth["drive"]["mass_scale"]}}))
        began = time.process_time()
        ours = identify_hand(paths[:-1], (), masses_known=True, hand=str(file))
        cost = time.process_time() - began
        write_hand_file(file, ours.fit, ours.values, ours.motions, "")
        (gap,) = measure_gaps(paths[-1:], str(file))
    found = {name: ours.values[known] for name, known in OURS.items()}
    drive = truth["wire"] | truth["actuation"]
    true = {name: np.array(drive[known]) for name, known in OURS.items()}
    per_k = {name: values if name == "k" else values / true["k"] for name, values in true.items()}
    rows = [{"program": "identify", "seed": seed, "cpu_s": cost, "open_loop_mrad": _mrad(gap.after.joint[-1])}
            | _errors({name: value.value for name, value in found.items()}, per_k)
            | {"covered": _covered({n: (v.value, v.half) for n, v in found.items()}, per_k)}]  # fmt: skip
    began = time.process_time()
    value, half = toolbox(motions, truth, iterations)
    cost = time.process_time() - began
    mine = load_spec(unseen.spec.model, unseen.spec.side)
    player = OpenLoopPlayer(mine, unseen.period)
    fitted = truth | {"wire": {"torque_constant": value["k"].tolist()}, "actuation": {
        "armature": value["armature"].tolist(), "damping": value["damping"].tolist(),
        "frictionloss": value["friction"].tolist()}}  # fmt: skip
    ends = [gap_errors(unseen, player, true_parameters(each)).joint[-1] for each in (fitted, truth)]
    by_k = {name: each if name == "k" else each / value["k"] for name, each in value.items()}
    rows.append({"program": "mujoco.sysid", "seed": seed, "cpu_s": cost, "open_loop_mrad": _mrad(ends[0]),
                 "true_drive_mrad": _mrad(ends[1])} | _errors(by_k, per_k)
                | {"covered": _covered({n: (value[n], half[n]) for n in value}, true)})  # fmt: skip
    return rows


def toolbox(
    motions: Sequence[RecordedMotion], truth: dict[str, Any], iterations: int
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Values and half intervals by `mujoco.sysid`, (16,) each, in SI units."""
    from mujoco import sysid

    spec, parameters, groups = motions[0].spec, sysid.ParameterDict(), []
    for name, (first, low, high) in FIRST.items():
        row = np.ones(spec.n_joints)
        parameters.add(sysid.Parameter(name, first * row, low * row, high * row, modifier=_modifier(name, spec)))
    for number, motion in enumerate(motions):
        groups.append(_sequences(sysid, str(number), motion, truth))
    columns = [int(groups[0].gt_model.sensor(f"{joint}_position").adr[0]) for joint in spec.joints]
    noise = np.mean([motion.noise for motion in motions], axis=0)

    def difference(_: Any, predicted: Any, measured: Any, *__: Any, **___: Any) -> Any:
        """In units of the noise; the toolbox's own divides by each window's positions."""
        shown = predicted.resample(measured.times)
        return (measured.data - shown.data[:, columns]) / noise, measured, measured

    residual = sysid.build_residual_fn(models_sequences=groups, modify_residual=difference, n_threads=1)
    fitted, result = sysid.optimize(parameters, residual, verbose=False, max_iters=iterations, x_scale="jac")
    _, half = sysid.calculate_intervals(residual(result.x, fitted)[0], result.jac)
    cut = np.arange(1, len(FIRST)) * spec.n_joints
    values, halves = np.split(np.asarray(result.x).ravel(), cut), np.split(half, cut)
    return dict(zip(FIRST, values, strict=True)), dict(zip(FIRST, halves, strict=True))


def _modifier(name: str, hand: HandSpec) -> Any:
    def modify(spec: mujoco.MjSpec, parameter: Any) -> None:
        for label, value in zip(hand.joints, parameter.value.tolist(), strict=True):
            if name == "k":
                spec.actuator(label).gainprm[0] = value
            elif name == "armature":
                spec.joint(label).armature = value
            elif name == "damping":
                spec.joint(label).damping[0] = value
            else:
                spec.joint(label).frictionloss = value

    return modify


def _sequences(sysid: Any, name: str, motion: RecordedMotion, truth: dict[str, Any]) -> Any:
    """The windows of one recording, which begin where filtered positions and speeds are."""
    hand, spec = motion.spec, mujoco.MjSpec.from_file(str(data_root() / "models" / "mjcf" / f"{motion.spec.name}.xml"))
    spec.option.timestep, spec.option.gravity = STEP, motion.gravity
    for parts in (spec.geoms, spec.excludes, spec.meshes, spec.materials):  # Nothing touches, and compiling is quick.
        for part in list(parts):
            spec.delete(part)
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    for joint, scale in zip(hand.joints, truth["drive"]["mass_scale"], strict=True):
        spec.joint(joint).solimp_friction[:2] = 0.999
        motor, link = spec.actuator(joint), spec.joint(joint).parent
        motor.ctrllimited = motor.forcelimited = False
        link.mass *= scale
        link.inertia *= scale
        link.fullinertia *= scale
    model = spec.compile()
    offset = np.array(truth["drive"]["encoder_offset"])
    delay = round(truth["drive"]["delay"] / TIMESTEP) * TIMESTEP  # What the hidden hand obeys.
    position = motion.position - offset
    smooth, speed = (savgol_filter(position, 9, 3, deriv=k, delta=motion.period, axis=0) for k in (0, 1))
    starts, controls, measured = [], [], []
    for first in range(10, len(position) - WINDOW - 1, WINDOW):
        rows = slice(first + 1, first + WINDOW + 1)
        if motion.good[first : first + WINDOW + 1].min() < 1.0:
            continue
        now = motion.period * np.arange(1, WINDOW + 1)
        t = STEP * np.arange(round(motion.period * WINDOW / STEP))
        # The duty of row i acts over the period that ends there, and a delay later.
        acted = np.floor((t + STEP / 2 - delay) / motion.period).astype(int) + first + 1
        starts.append(sysid.create_initial_state(model, smooth[first], speed[first]))
        controls.append(sysid.TimeSeries(t, motion.duty[acted]))
        names = [f"{joint}_position" for joint in hand.joints]
        measured.append(sysid.TimeSeries.from_names(now, position[rows], model, names))
    labels = [f"{name}_{k}" for k in range(len(starts))]
    return sysid.ModelSequences(name, spec, labels, starts, controls, measured, allow_missing_sensors=True)


def _errors(found: dict[str, Array], true: dict[str, Array]) -> dict[str, Any]:
    """Median and worst joint: k, damping and armature in %, the latter per k as friction, in mN·m."""
    result = {}
    for name, values in found.items():
        error = np.abs(values - true[name]) / (1e-3 if name == "friction" else 0.01 * true[name])
        result[name] = [float(f"{float(each):.3g}") for each in (np.median(error), error.max())]
    return result


def _covered(found: dict[str, tuple[Array, Array]], true: dict[str, Array]) -> float:
    inside = [np.abs(value - true[name]) <= half for name, (value, half) in found.items()]
    return float(np.mean(inside))


def _mrad(error: Array) -> float:
    return float(f"{1000 * float(np.sqrt((np.asarray(error) ** 2).mean())):.3g}")


if __name__ == "__main__":
    main()
