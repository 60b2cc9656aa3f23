"""Which grasp for what: by shape and size, turned with the thing, and nothing for what is unlike all."""

from __future__ import annotations

import numpy as np
import pytest

from allegro_twin.cell.perception.fits.model import Solid
from allegro_twin.cell.planning.stored_grasps import grasp_candidates, stored_grasps, table_object
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.arm import rotation_between
from allegro_twin.sim.contact.obstacle_clearance import TableObject
from allegro_twin.sim.objects.catalogue import object_catalogue


def test_every_thing_of_the_catalogue_has_a_grasp_that_is_found_by_its_size() -> None:
    names = {card.name for card in stored_grasps("allegro")}
    assert names == set(object_catalogue())
    for card in stored_grasps("allegro"):
        nearest = grasp_candidates(card.body, "allegro")[0].card
        assert nearest.body.kind == card.body.kind
        np.testing.assert_allclose(nearest.body.extents, card.body.extents, rtol=0.04)


def test_a_grasp_that_leaves_room_for_an_arm_comes_before_another_of_the_same_thing() -> None:
    grasps = {card.name: card.grasp.name for card in stored_grasps("sih")}
    assert grasps["apple"] == "sih_apple_on_arm"
    assert grasps["lemon"] == "sih_lemon"
    assert len(grasps) == 12


def test_a_grasp_turns_with_the_thing() -> None:
    box = next(card for card in stored_grasps("allegro") if card.name == "sugar_box").body
    there = TableObject(box.kind, box.extents, 0.0, np.zeros(3))
    turned = TableObject(box.kind, box.extents, np.pi / 2.0, np.array([0.1, 0.0, 0.0]))
    before, after = grasp_candidates(there, "allegro")[0].palm, grasp_candidates(turned, "allegro")[0].palm
    x, y, z = before.position
    np.testing.assert_allclose(after.position, [0.1 - y, x, z], atol=1e-12)


@pytest.mark.parametrize(("kind", "extents", "count"), [
    ("sphere", (0.065, 0.065, 0.065), 24), ("box", (0.11, 0.035, 0.089), 2), ("box", (0.057, 0.057, 0.057), 4),
])  # fmt: skip
def test_there_are_as_many_ways_as_symmetry_leaves_open(
    kind: str, extents: tuple[float, float, float], count: int
) -> None:
    assert len(grasp_candidates(TableObject(kind, extents, 0.3, np.zeros(3)), "allegro")) == count


def test_the_grasp_of_what_is_nearly_round_may_be_turned_a_little_and_no_other() -> None:
    lemon, pear = (
        TableObject("lying ellipsoid", extents, 0.3, np.zeros(3))
        for extents in ((0.068, 0.054, 0.054), (0.1, 0.066, 0.066))
    )
    plain, askew = grasp_candidates(lemon, "allegro"), grasp_candidates(lemon, "allegro", askew=True)
    assert (len(plain), len(askew)) == (2, 8)
    off = [
        min(np.linalg.norm(rotation_between(own.palm.rotation, one.palm.rotation)) for own in plain) for one in askew
    ]
    np.testing.assert_allclose(sorted(off), np.radians([10.0] * 4 + [20.0] * 4), atol=1e-9)
    for other in (pear, TableObject("box", (0.057, 0.057, 0.057), 0.3, np.zeros(3))):
        assert grasp_candidates(other, "allegro", askew=True) == []


def test_what_is_unlike_everything_is_refused_with_its_size() -> None:
    with pytest.raises(ConfigError, match="no grasp of allegro is for a box of 400 x 300 x 20 mm at"):
        grasp_candidates(TableObject("box", (0.4, 0.3, 0.02), 0.0, np.zeros(3)), "allegro")
    with pytest.raises(ConfigError, match="a lying cylinder"):
        grasp_candidates(TableObject("lying cylinder", (0.1, 0.066, 0.066), 0.0, np.zeros(3)), "allegro")


def test_a_solid_is_read_by_its_level_and_its_upright_extents() -> None:
    axes = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # Its x is up, its y along the world's x.
    body = table_object(Solid("box", np.zeros(3), axes, (0.2, 0.09, 0.04), 0.0))
    assert (body.kind, body.extents) == ("box", (0.09, 0.04, 0.2))
    assert body.yaw == pytest.approx(0.0)
    lying = table_object(Solid("cylinder", np.zeros(3), np.eye(3), (0.1, 0.06, 0.06), 0.0))
    assert lying.kind == "lying cylinder"
