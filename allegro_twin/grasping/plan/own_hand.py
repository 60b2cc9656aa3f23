"""The hand of a plan as `identify` has found it: its motors and friction, and draws as wide as what is not known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import find_file, read_yaml
from allegro_twin.grasping.plan.validate import SEARCHED
from allegro_twin.grasping.uncertainty import Uncertainty
from allegro_twin.hands.description.calibration import load_wiring
from allegro_twin.hands.description.specs import card_path, hand_side, is_hand_model, load_spec
from allegro_twin.spec import HandSpec, Side

WIDEST = 0.3
"""Share that motors give less or more, at most: that of `evaluate`."""


class PlannedHand(NamedTuple):
    """A hand to plan for, and what draws of a search vary."""

    spec: HandSpec
    """Without its drive, for candidates are closed side by side."""
    uncertainty: Uncertainty
    note: str = ""
    """For a person, on what a hand's file does not say."""
    judged: HandSpec | None = None
    """With its drive, by which what was found is judged; None: it has none."""


def twin_to_plan_for(hand: str, twin: str, side: Side | None = None) -> PlannedHand:
    """A model of hand with the motors, friction and limits of a file that `identify` has written. Motors of a draw give
    more or less by up to the 95 % interval of the torque constant, of the median joint, WIDEST at most; of a hand that
    nobody has identified the file's version and limits count, and draws are those of every hand. The search leaves out
    its drive's delay, play and encoders; what it finds is judged with them. `side`: None is the file's; of a file
    without one, right. Raises ConfigError for an identified file without intervals, for another side than the file's,
    and for a hand that is described by a card."""
    if (card := card_path(hand)) is not None:
        raise ConfigError(
            f"--twin: {card} is the hand's only file: write what was measured into it, and leave out --twin"
        )
    path = find_file(twin, "hand", "conf/hands")
    if is_hand_model(path.stem):
        raise ConfigError(f"--twin {twin} is what every {path.stem} is: name one hand's own file, or leave out --twin")
    basis = read_yaml(path).get("identified")
    interval = basis.get("interval") if isinstance(basis, Mapping) else None
    known = interval.get("torque_constant") if isinstance(interval, Mapping) else None
    if basis is not None and known is None:
        raise ConfigError(f"--twin {path} has no intervals to draw from: write it with allegro-twin identify "
                          f"RECORDINGS --hand {path}")  # fmt: skip
    whole = load_spec(hand, side or hand_side(str(path)) or "right", str(path))
    spec, judged = replace(whole, drive=None), whole if whole.drive is not None else None
    if known is None:
        said = f"{path} was not identified: its version and limits count, and motors of the draws are those of any hand"
        return PlannedHand(spec, SEARCHED, said, judged)
    constant = np.array(load_wiring(hand, str(path)).calibration.torque_constant, dtype=float)
    share = float(np.median(np.array(known, dtype=float) / constant))
    uncertainty = SEARCHED.model_copy(update={"torque": min(share, WIDEST)})
    return PlannedHand(spec, uncertainty, judged=judged)
