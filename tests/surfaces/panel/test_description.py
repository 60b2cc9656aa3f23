"""Which hands' fingertips can be dragged on the page, and why not."""

from __future__ import annotations

import pytest

from allegro_twin.hands.description.specs import load_spec
from allegro_twin.surfaces.panel.description import _no_tips


@pytest.mark.parametrize("model", ["allegro", "leap"])
def test_fingertips_of_fingers_with_motors_of_their_own_can_be_dragged(model: str) -> None:
    assert not _no_tips(load_spec(model))


def test_fingertips_that_share_a_motor_cannot() -> None:
    assert _no_tips(load_spec("qb_softhand")) == "the motors of index move middle, ring, little, thumb as well"
