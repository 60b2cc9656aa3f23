"""A tip that is dragged takes its finger along; where it cannot be, that is said and the joints' goals stay."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.hands.description.specs import load_spec
from allegro_twin.spec import Side
from allegro_twin.surfaces.panel.tip_ik import TipIK


@pytest.mark.parametrize("finger", ["index", "middle", "ring", "thumb"])
def test_a_tip_that_is_dragged_a_centimetre_is_there_and_no_other_finger_moves(finger: str, side: Side) -> None:
    spec = load_spec(side=side)
    reach, near = TipIK(spec), (spec.lower + spec.upper) / 2
    wish = reach.tip(finger, near) + np.array([0.004, 0.002, -0.006])
    found = reach.drag(finger, wish, near)
    assert found.posture is not None
    assert list(found.posture) == list(spec.finger(finger).joints)
    near[list(found.posture)] = list(found.posture.values())
    np.testing.assert_allclose(reach.tip(finger, near), wish, atol=1e-6)
    assert (near >= spec.lower).all()
    assert (near <= spec.upper).all()


def test_a_tip_out_of_reach_has_no_posture_and_the_nearest_place_is_as_far_as_it_says() -> None:
    spec = load_spec()
    reach, near = TipIK(spec), (spec.lower + spec.upper) / 2
    wish = np.array([0.0, 0.05, 0.5])
    found = reach.drag("index", wish, near)
    assert found.posture is None
    assert found.distance > 0.2
    assert float(np.linalg.norm(found.nearest - wish)) == pytest.approx(found.distance, abs=1e-6)
