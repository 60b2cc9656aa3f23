"""What a step of the physics costs with each hand, alone: `python -m benchmarks.hand_steps [HAND …]`.

Its motors go half of their way and back within 4 s, and all of it, where fingers meet palm and thumb. Of every 20 steps
the fastest of 25 runs is taken, so that what else the computer does is left out.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import mujoco
import numpy as np

from allegro_twin.files.assets import data_root

HANDS = ("leap", "model_o", "sih", "qb_softhand")
STEPS, PIECE, RUNS = 4000, 20, 25
LEFT_OUT: dict[str, Callable[[mujoco.MjModel], None]] = {
    "all": lambda model: None,
    "no contacts": lambda model: _off(model, mujoco.mjtDisableBit.mjDSBL_CONTACT),
    "no constraints": lambda model: _off(model, mujoco.mjtDisableBit.mjDSBL_CONSTRAINT),
}


def _off(model: mujoco.MjModel, what: mujoco.mjtDisableBit) -> None:
    model.opt.disableflags |= int(what)


def cost(model: mujoco.MjModel, share: float) -> float:
    """Of a step, µs, while the motors go a share of their way and back."""
    data, (lower, upper) = mujoco.MjData(model), model.actuator_ctrlrange.T
    fastest = np.full(STEPS // PIECE, np.inf)
    for _ in range(RUNS):
        mujoco.mj_resetData(model, data)
        for piece in range(len(fastest)):
            part = share * (0.5 - 0.5 * np.cos(2.0 * np.pi * piece / len(fastest)))
            data.ctrl[:] = lower + part * (upper - lower)
            began = time.perf_counter()
            mujoco.mj_step(model, data, PIECE)
            fastest[piece] = min(fastest[piece], time.perf_counter() - began)
    return float(1e6 * fastest.sum() / STEPS)


def main(hands: list[str]) -> None:
    """Print the table."""
    print("| hand | hinges | " + " | ".join(f"{what}, half / whole way" for what in LEFT_OUT) + " |")
    print("|" + "---|" * (2 + len(LEFT_OUT)))
    for hand in hands or HANDS:
        path, cells = data_root() / "models" / "mjcf" / f"{hand}_right.xml", []
        for leave_out in LEFT_OUT.values():
            model = mujoco.MjModel.from_xml_path(str(path))
            leave_out(model)
            cells.append(f"{cost(model, 0.5):.1f} / {cost(model, 1.0):.1f}")
        print(f"| {hand} | {model.nv} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
