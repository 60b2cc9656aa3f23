"""Teleoperation of a hand: it is opened with its follower, and led by a recorded track or a camera."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

from allegro_twin.app.config import RunConfig
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.spec import Side
from allegro_twin.surfaces.hand import Hand
from allegro_twin.surfaces.teleop.follower import HandFollower, StatusCallback
from allegro_twin.surfaces.teleop.retargeting import Retargeting
from allegro_twin.surfaces.teleop.targets import FingertipTargets
from allegro_twin.surfaces.teleop.tracks import HandTrack
from allegro_twin.surfaces.worker_process import WorkerProcess
from allegro_twin.types import Array


@contextmanager
def open_follower(
    config: RunConfig,
    side: Side,
    on_status: StatusCallback,
    *,
    speed: float = 2.0,
    patience: float = 0.3,
    background: bool = True,
) -> Iterator[tuple[Hand, HandFollower]]:
    """Open a hand and what leads it after one of a person's hands, by dex-retargeting in a process of its own.
    `on_status` is called when a hand is lost and seen again; `speed`: rad/s; `patience`: s. Raises HandError."""
    spec = load_spec(config.hand.model, config.hand.side, config.hand.serial)
    targets = FingertipTargets(spec, side)
    # The hand comes last: it is not kept waiting, motors on, for what takes seconds or is not installed.
    with (
        WorkerProcess(Retargeting(spec, targets.vectors)) as retarget,
        Hand.open(config, background=background) as hand,
    ):
        yield hand, HandFollower(hand, targets, retarget, on_status, speed=speed, patience=patience)


_BEAT = 0.02  # s between two looks at whether a frame is due.
_ARRIVE = 1.0  # s after the last frame of a track.


class FrameSource(Protocol):
    """Tracker of a person in another process: asked for a frame, it has one some time later."""

    def ask(self, question: None) -> None: ...
    def ready(self, seconds: float = 0.0) -> bool: ...
    def answer(self) -> Array: ...


def replay(hand: Hand, track: HandTrack, follower: HandFollower) -> None:
    """Every frame of a track at its time, from now on, on the hand's clock. A frame that the next one has overtaken is
    left out. Raises what ended the hand."""
    begin = hand.state.t - float(track.times[0])
    for number, points in enumerate(track.landmarks):
        _pass(hand, follower, begin + float(track.times[number]))
        if number + 1 < len(track.times) and begin + track.times[number + 1] <= hand.state.t:
            follower.tally.late += 1
            continue
        follower.see(hand.state.t, points)
    hand.wait(_ARRIVE)


def live(hand: Hand, camera: FrameSource, follower: HandFollower, until: Callable[[], bool] = lambda: False) -> None:
    """Every frame of a camera as it comes, until that is so. Raises what ended the hand or the camera."""
    camera.ask(None)
    while not until():
        hand.wait(_BEAT)
        if camera.ready():
            points = camera.answer()
            camera.ask(None)
            follower.see(hand.state.t, points)
        else:
            follower.look(hand.state.t)


def _pass(hand: Hand, follower: HandFollower, t: float) -> None:
    """Until a time of the hand, s."""
    while (left := t - hand.state.t) > 1e-9:
        hand.wait(min(left, _BEAT))
        follower.look(hand.state.t)
