"""What a branch of a hand's recording rests on, in sentences."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from allegro_twin.recording.reader import Recording
from allegro_twin.sim.contact.self_clearance import Clearance
from allegro_twin.spec import HandSpec
from allegro_twin.twin.branch.recover_controller import Driver
from allegro_twin.twin.branch.result import Wanted
from allegro_twin.twin.mirror.faults import words
from allegro_twin.twin.mirror.for_hand import Mirrored
from allegro_twin.types import Array, Vector

_EVERY = 0.03  # s between two postures that are looked at. Ours: at 2 rad/s a fingertip goes by 6 mm.
_DEEPER = 0.001  # m. Ours: the shapes are not known better.


def knowledge(recording: Recording, at: float, seen: Mirrored, driver: Driver, wanted: Wanted) -> Iterator[str]:
    """What is known of the instant, what is estimated, and what assumed."""
    row = int(np.searchsorted(seen.t, at - 1e-9))
    push, names = seen.disturbance[row], recording.spec.joint_labels
    most = int(np.abs(push).argmax())
    yield (
        f"Known at {at:g} s: the joints' positions and commands. Estimated by a mirror that has seen all before it: "
        f"speeds, and what pushes the joints, at most {1000.0 * push[most]:+.1f} mN·m ({names[most]})."
    )
    kept = "is held as it is" if wanted.disturbance == "hold" else "is forgotten (--disturbance hold keeps it)"
    yield (
        f"Assumed: nothing is held or touched, what pushes the joints {kept}, fingers pass through each "
        "other and the palm."
    )
    if driver.config is None:
        yield f"The recorded commands go on, open loop: {driver.why}."
    else:
        kind = driver.config.controller.kind
        yield (
            f"Its config's {kind} goes on, closed loop: it computes every recorded command again, so what it remembers "
            "is known."
        )
    yield from _touches(at, seen, wanted)
    if seen.anomaly is not None:
        yield f"Its mirror says that something is wrong: {words(seen.anomaly, recording.spec)}. Is that its file?"


def _touches(at: float, seen: Mirrored, wanted: Wanted) -> Iterator[str]:
    """What the recording's hand met and the branch does not know."""
    goes = "as a torque that stays" if wanted.disturbance == "hold" else "without it"
    for each in seen.contacts:
        how = f"by up to {1000.0 * each.torque:.0f} mN·m"
        if each.begin <= at <= each.end:
            yield f"{each.finger} is touched then, {how}: the branch does not know that object and goes on {goes}."
        elif each.begin > at:
            yield (
                f"{each.finger} is touched from {each.begin:.3f} to {each.end:.3f} s, {how}: the branch does not know "
                "that object, and what its model is off by from there on is not only the model's error."
            )


def meetings(spec: HandSpec, t: Vector, recorded: Array, branched: Array) -> Iterator[str]:
    """Parts of the hand that would be in each other in the branch, (k, n), rad, and were not in the recording."""
    step = max(round(_EVERY * (len(t) - 1) / max(float(t[-1] - t[0]), 1e-9)), 1)
    rows, clear = slice(0, len(branched), step), Clearance(spec)
    was, would = (clear(np.clip(each[rows], spec.lower, spec.upper)) for each in (recorded, branched))
    deep = (would < 0.0) & (would < was - _DEEPER)
    for column in np.flatnonzero(deep.any(axis=0)):
        one, other = clear.pairs[column]
        first = int(deep[:, column].argmax())
        yield (
            f"From {t[rows][first]:.2f} s on {one} and {other} would meet ({-1000.0 * would[:, column].min():.1f} mm "
            "deep): the branch lets them pass through each other, so believe it until then."
        )
