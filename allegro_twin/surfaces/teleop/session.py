"""A hand and what leads it, opened together."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from allegro_twin.app.config import RunConfig
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.spec import Side
from allegro_twin.surfaces.hand import Hand
from allegro_twin.surfaces.teleop.dex import Retargeting
from allegro_twin.surfaces.teleop.follower import Follower, Told
from allegro_twin.surfaces.teleop.process import Apart
from allegro_twin.surfaces.teleop.targets import Targets


@contextmanager
def open_follower(
    config: RunConfig, side: Side, told: Told, *, speed: float = 2.0, patience: float = 0.3, background: bool = True
) -> Iterator[tuple[Hand, Follower]]:
    """Open a hand and what leads it after one of a person's hands, by dex-retargeting in a process of its own. `told`
    hears when a hand is lost and seen again; `speed`: rad/s; `patience`: s. Raises HandError."""
    spec = load_spec(config.hand.model, config.hand.side, config.hand.serial)
    targets = Targets(spec, side)
    # The hand comes last: it is not kept waiting, motors on, for what takes seconds or is not installed.
    with (
        Apart(Retargeting(spec, targets.vectors)) as retarget,
        Hand.open(config, background=background) as hand,
    ):
        yield hand, Follower(hand, targets, retarget, told, speed=speed, patience=patience)
