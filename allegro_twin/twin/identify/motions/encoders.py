"""Encoder offsets with which a hand's positions are right: the same shift in counts, on a hand of any version."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from allegro_twin.drivers.can.codec.codec import Codec
from allegro_twin.drivers.can.codec.versions import make_codec
from allegro_twin.errors import ConfigError
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.motions.limits import BEYOND, FoundLimits, centring_offsets
from allegro_twin.types import frozen

_MET = 0.03  # rad. Nearer to where the sweep ends than this, a joint did not stop at its stop, but where it was sent.
_NOTHING = bytes(32)  # A report of sixteen positions; which, does not matter.


class Centred(NamedTuple):
    """What follows from the ends of the joints."""

    offset: tuple[int, ...]
    """Encoder offsets, counts, n values."""
    limits: FoundLimits
    """What was found, as the hand reads it with these offsets."""


def centred(found: FoundLimits, model: HandSpec, codec: Codec) -> Centred:
    """The offsets that put the middle of each found range where the model has it, beginning with the codec's own.

    `model` has the joint limits of the description, not those that were measured. Raises ConfigError for a joint that
    was not brought to both its ends.
    """
    _check(found, model)
    old = codec.calibration.encoder_offset
    more = replace(codec.calibration, encoder_offset=tuple(count + 1 for count in old))
    # What one more count of offset does to a position, rad; each version has its own.
    step = make_codec(codec.version, more).positions.values(_NOTHING) - codec.positions.values(_NOTHING)
    counts = np.rint(-centring_offsets(found, model) / step)
    shift = counts * step
    limits = FoundLimits(frozen(found.lower + shift), frozen(found.upper + shift))
    return Centred(tuple(count + int(more) for count, more in zip(old, counts, strict=True)), limits)


def _check(found: FoundLimits, model: HandSpec) -> None:
    for k, name in enumerate(model.readable):
        low, high = found.lower[k], found.upper[k]
        short = model.upper[k] - model.lower[k] - (high - low)
        if short > BEYOND or min(low - model.lower[k], model.upper[k] - high) < _MET - BEYOND:
            raise ConfigError(
                f"no encoder offsets: {name} was seen from {low:+.3f} to {high:+.3f} rad, which are not both its ends "
                f"(the model's are {model.lower[k]:+.3f} and {model.upper[k]:+.3f}); bring it there: --by-hand SECONDS"
            )
