"""`python -m benchmarks.what_if`: hidden hands, identified and then changed: does `branch` foretell what that does?

The hand behind the bus is hidden but can be repeated, so its own future with the change is known. A recording is of a
few seconds in closed loop; from some instants on each change is made to the model and to the hand.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import yaml

from allegro_twin.app.config import RunConfig
from allegro_twin.app.rig import assemble
from allegro_twin.app.session import Outputs, perform
from allegro_twin.twin.branch.result import BranchOptions
from allegro_twin.twin.branch.what_if import branch_recording
from allegro_twin.twin.identify.pipeline import identify_hand
from allegro_twin.twin.identify.results.hand_file import write_hand_file
from allegro_twin.types import Array
from benchmarks.hidden_hands import POSES, TIMESTEP, drawn, excited

CHANGES: tuple[dict[str, Any], ...] = (
    {"controller.gains": "v4"}, {"frictionloss": 0.1}, {"damping": 0.25}, {"strength": 0.6},
)  # fmt: skip
INSTANTS = (1.05, 1.3, 1.6)
"""s. The fingers move, slow down, and rest."""
SECONDS, POSTURES = 3.0, ("home", "rock", "paper")


class Trial(NamedTuple):
    """One change of one hand at one instant; root mean squares over all joints and the rest of the recording, rad."""

    what: str
    true: float
    """What the change does to the hand."""
    off: float
    """What it does to the model, less that."""
    model: float
    """What the model is off by without the change."""
    foretold: float
    """What the change does to the model."""

    @property
    def tells(self) -> bool:
        """Whether the command says that something follows from it."""
        return self.foretold > 2.0 * self.model


def trials(seed: int, kind: str, seconds: float, folder: Path) -> Iterator[Trial]:
    """All of one hand, which is identified from three poses of so many seconds."""
    truth, item = drawn(seed, kind), {"seed": seed, "side": ("right", "left")[seed // 2 % 2]}
    file = folder / "hand.yaml"
    file.write_text(yaml.safe_dump({"drive": {"mass_scale": truth["drive"]["mass_scale"]}}))
    paths = [excited(truth, item, pose, seconds, folder, number) for number, pose in enumerate(POSES)]
    found = identify_hand(paths, (), masses_known=True, hand=str(file))
    write_hand_file(file, found.fit, found.values, found.motions, "")
    for posture in POSTURES:
        path = _run(truth, item["side"], posture, folder / f"{posture}.arrow")
        for at in INSTANTS:
            for change in CHANGES:
                yield _trial(path, at, change, str(file))


def _run(truth: Mapping[str, Any], side: object, posture: str, path: Path) -> Path:
    backend = {
        "kind": "can", "version": "v4", "interface": "allegro-virtual", "imu": 0.05,
        "scene": {"kind": "sim", "timestep": TIMESTEP, "truth": truth},
    }  # fmt: skip
    blocks = {"hand": {"side": side}, "backend": backend, "task": {"posture": posture}, "controller": {"kind": "pid"}}
    config = RunConfig.model_validate(blocks | {"seconds": SECONDS, "limits": {"velocity": 12.0}})
    perform(assemble(config), config, Outputs(record=path))
    return path


def _trial(path: Path, at: float, change: Mapping[str, Any], file: str) -> Trial:
    model, hand = branch_recording(path, at, change, options=BranchOptions(file)), branch_recording(path, at, change)
    assert model.unchanged is not None
    rows = min(len(model.branched), len(hand.branched), len(model.unchanged))
    rest = slice(int(np.searchsorted(model.t, at - 1e-9)), rows)
    true = (hand.branched[:rows] - hand.recorded[:rows])[rest]
    foretold = (model.branched[:rows] - model.unchanged[:rows])[rest]
    off = (model.unchanged[:rows] - model.recorded[:rows])[rest]
    return Trial(next(iter(change)), _rms(true), _rms(foretold - true), _rms(off), _rms(foretold))


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--kind", choices=("matched", "mismatched"), default="matched")
    options.add_argument("--hands", type=int, default=5)
    options.add_argument("--first", type=int, default=200, help="seed of the first")
    options.add_argument("--seconds", type=float, default=12.0, help="in each of three poses")
    chosen = options.parse_args()
    every: list[Trial] = []
    for seed in range(chosen.first, chosen.first + chosen.hands):
        with TemporaryDirectory() as name:
            every += trials(seed, chosen.kind, chosen.seconds, Path(name))
        print(f"hand {seed}: {len(every)} trials", flush=True)
    for what in (*(next(iter(change)) for change in CHANGES), ""):
        print(told([one for one in every if what in one.what], what or "all"))


def told(rows: list[Trial], what: str) -> str:
    """Of some trials how many tell something, and medians and 90 % of these."""
    every, rows = len(rows), [one for one in rows if one.tells]
    true, off, model, _ = 1000.0 * np.array([one[1:] for one in rows]).T
    cells = [f"{_two(values)} {unit}" for values, unit in ((true, "mrad"), (off, "mrad"), (100.0 * off / true, "%"))]
    return f"| {what} | {len(rows)} of {every} | {' | '.join(cells)} | {_two(model)} mrad |"


def _two(values: Array) -> str:
    return f"{np.median(values):.2g} / {np.quantile(values, 0.9):.2g}"


def _rms(off: Array) -> float:
    return float(np.sqrt(np.square(off).mean()))


if __name__ == "__main__":
    main()
