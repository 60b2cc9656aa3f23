"""Time passes, frames come, a follower is told: from a recorded track, or from a camera."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from allegro_twin.surfaces.hand import Hand
from allegro_twin.surfaces.teleop.follower import Follower
from allegro_twin.surfaces.teleop.tracks import Track
from allegro_twin.types import Array

_BEAT = 0.02  # s between two looks at whether a frame is due.
_ARRIVE = 1.0  # s after the last frame of a track.


class Camera(Protocol):
    """What watches a person, elsewhere: asked for a frame, it has one some time later."""

    def ask(self, question: None) -> None: ...
    def ready(self, seconds: float = 0.0) -> bool: ...
    def answer(self) -> Array: ...


def replay(hand: Hand, track: Track, follower: Follower) -> None:
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


def live(hand: Hand, camera: Camera, follower: Follower, until: Callable[[], bool] = lambda: False) -> None:
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


def _pass(hand: Hand, follower: Follower, t: float) -> None:
    """Until a time of the hand, s."""
    while (left := t - hand.state.t) > 1e-9:
        hand.wait(min(left, _BEAT))
        follower.look(hand.state.t)
