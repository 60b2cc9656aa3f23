"""Sentences that say what a branch of a hand's recording rests on."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from allegro_twin.recording.reader import Recording
from allegro_twin.sim.contact.self_clearance import SelfClearance
from allegro_twin.spec import HandSpec
from allegro_twin.twin.branch.recover_controller import BranchController
from allegro_twin.twin.branch.result import BranchOptions
from allegro_twin.twin.mirror.faults import fault_text
from allegro_twin.twin.mirror.on_recording import MirrorResult
from allegro_twin.types import Array, Vector

_EVERY = 0.03  # s between two postures that are checked. Ours: at 2 rad/s a fingertip moves by 6 mm.
_DEEPER = 0.001  # m. Ours: the shapes are not known more precisely.


def list_assumptions(
    recording: Recording, at: float, mirrored: MirrorResult, driver: BranchController, options: BranchOptions
) -> Iterator[str]:
    """What is known of the instant, what is estimated, and what is assumed."""
    row = int(np.searchsorted(mirrored.t, at - 1e-9))
    push, names = mirrored.disturbance[row], recording.spec.joint_labels
    most = int(np.abs(push).argmax())
    yield (
        f"Known at {at:g} s: the joints' positions and commands. Estimated by a mirror that has seen all before it: "
        f"speeds, and what pushes the joints, at most {1000.0 * push[most]:+.1f} mN·m ({names[most]})."
    )
    kept = "is held as it is" if options.disturbance == "hold" else "is forgotten (--disturbance hold keeps it)"
    yield (
        f"Assumed: nothing is held or touched, what pushes the joints {kept}, fingers pass through each "
        "other and the palm."
    )
    if driver.config is None:
        yield f"The recorded commands go on, open loop: {driver.reason}."
    else:
        kind = driver.config.controller.kind
        yield (
            f"Its config's {kind} goes on, closed loop: it computes every recorded command again, so what it remembers "
            "is known."
        )
    yield from _touches(at, mirrored, options)
    for each in mirrored.faults:
        if each.ended == np.inf:
            fault = fault_text(each.fault, recording.spec)
            yield f"Its mirror says that something is wrong: {fault}. Is that its file?"


def _touches(at: float, mirrored: MirrorResult, options: BranchOptions) -> Iterator[str]:
    """Contacts of the recording's hand that the branch does not know."""
    goes = "as a torque that stays" if options.disturbance == "hold" else "without it"
    for each in mirrored.contacts:
        how = f"by up to {1000.0 * each.torque:.0f} mN·m"
        if each.begin <= at <= each.end:
            yield f"{each.finger} is touched then, {how}: the branch does not know that object and goes on {goes}."
        elif each.begin > at:
            yield (
                f"{each.finger} is touched from {each.begin:.3f} to {each.end:.3f} s, {how}: the branch does not know "
                "that object, and what its model is off by from there on is not only the model's error."
            )


def first_touch(at: float, mirrored: MirrorResult) -> float:
    """When the recording's hand was first touched after `at`, s; infinite where it was not."""
    return min((each.begin for each in mirrored.contacts if each.begin > at), default=np.inf)


def list_collisions(spec: HandSpec, t: Vector, recorded: Array, branched: Array) -> Iterator[tuple[float, str]]:
    """Parts of the hand that would penetrate each other in the branch, (k, n), rad, and did not in the recording: since
    when, s, and a sentence."""
    step = max(round(_EVERY * (len(t) - 1) / max(float(t[-1] - t[0]), 1e-9)), 1)
    rows, clear = slice(0, len(branched), step), SelfClearance(spec)
    was, would = (clear(np.clip(each[rows], spec.lower, spec.upper)) for each in (recorded, branched))
    deep = (would < 0.0) & (would < was - _DEEPER)
    for column in np.flatnonzero(deep.any(axis=0)):
        one, other = clear.pairs[column]
        first = int(deep[:, column].argmax())
        begin = float(t[rows][first])
        yield (
            begin,
            f"From {begin:.2f} s on {one} and {other} would meet ({-1000.0 * would[:, column].min():.1f} mm "
            "deep): the branch lets them pass through each other, so believe it until then.",
        )
