"""The spec names things, and refuses what does not fit the hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from allegro_twin.errors import ConfigError
from allegro_twin.hands.description.specs import load_actuation, load_spec
from allegro_twin.spec import HandSpec, Side
from allegro_twin.types import Array

SPEC = load_spec()


def test_the_hand_has_the_official_joint_names_and_readable_ones(spec: HandSpec) -> None:
    assert spec.joints == tuple(f"joint_{k}.0" for k in range(16))
    assert spec.aliases[:4] == ("index_0", "index_1", "index_2", "index_3")
    assert spec.aliases[12:] == ("thumb_0", "thumb_1", "thumb_2", "thumb_3")
    assert [finger.tip for finger in spec.fingers] == [f"link_{k}.0_tip" for k in (3, 7, 11, 15)]


def test_a_joint_is_found_by_either_name(spec: HandSpec) -> None:
    assert spec.joint("joint_13.0") == spec.joint("thumb_1") == 13
    with pytest.raises(ConfigError, match="did you mean 'thumb_1'"):
        spec.joint("thumb1")
    with pytest.raises(ConfigError, match="no finger named 'pinky'"):
        spec.finger("pinky")


def test_the_torque_clip_is_the_manufacturers(spec: HandSpec) -> None:
    counts = np.array([375, 675, 450, 285] * 3 + [525, 405, 270, 270])
    np.testing.assert_allclose(spec.actuation.torque_limit, counts / 1200, atol=1e-12)


def test_limits_map_onto_themselves_under_the_mirror(side: Side) -> None:
    spec, other = load_spec(side=side), load_spec(side="left" if side == "right" else "right")
    np.testing.assert_array_equal(spec.lower, other.lower)
    np.testing.assert_array_equal(spec.upper, other.upper)


@given(arrays(float, (3, 16), elements=st.floats(-2, 2)))
def test_mirroring_twice_is_nothing(positions: Array) -> None:
    np.testing.assert_array_equal(SPEC.mirror_posture(SPEC.mirror_posture(positions)), positions)


@given(st.integers(0, 15), st.floats(1e-3, 3.0), st.booleans())
def test_a_posture_outside_the_limits_names_the_joint_and_the_excess(joint: int, excess: float, above: bool) -> None:
    posture = (SPEC.lower + SPEC.upper) / 2
    posture[joint] = SPEC.upper[joint] + excess if above else SPEC.lower[joint] - excess
    with pytest.raises(ConfigError, match=rf"{SPEC.aliases[joint]} = .*{excess:.4f} rad outside its limits"):
        SPEC.posture(posture)


@pytest.mark.parametrize("values", [np.zeros(15), np.zeros((16, 1)), [np.nan] * 16])
def test_a_vector_needs_one_finite_value_per_joint(values: Array) -> None:
    with pytest.raises(ConfigError, match=r"one value or 16|must be finite"):
        SPEC.vector(values, "posture")


@pytest.mark.parametrize("side", ["both", "RIGHT", "", 1])
def test_what_is_no_side_of_a_hand_is_refused_by_what_there_is(side: Any) -> None:
    with pytest.raises(ConfigError, match=f"^side is right or left, not {side!r}$"):
        load_spec(side=side)


def test_an_unknown_model_or_hand_is_named_with_what_there_is() -> None:
    with pytest.raises(ConfigError, match="no hand named 'allegr'; did you mean 'allegro'"):
        load_actuation("allegro", 16, "allegr")
    with pytest.raises(ConfigError, match="no hand named 'leep'; did you mean 'leap'"):
        load_spec("leep")


@pytest.mark.parametrize("model", ["model_o", "qb_softhand", "sih", "leap"])
def test_what_follows_is_where_numpy_finds_it_in_its_table_to_the_bit(model: str) -> None:
    spec = load_spec(model)
    draws = np.random.default_rng(5).uniform(-0.1, 1.1, (40, 5, spec.n_joints))
    posture = spec.lower + (spec.upper - spec.lower) * draws
    posture[0, 0], posture[1, 1], posture[2, 2] = spec.lower, spec.upper, np.nan
    part = (posture - spec.lower) / (spec.upper - spec.lower)
    found = spec.coupled_positions(posture)
    assert found.shape == (40, 5, len(spec.followers))
    for k, each in enumerate(spec.followers):
        table = np.linspace(0.0, 1.0, len(each.positions)), each.positions
        np.testing.assert_array_equal(found[..., k], np.interp(part[..., each.driven], *table))
        np.testing.assert_array_equal(spec.coupled_positions(posture[3, 3])[k], found[3, 3, k])


def test_a_joint_knows_its_finger_and_one_of_none_is_refused() -> None:
    spec = load_spec()
    assert [spec.finger_of(joint) for joint in range(16)] == [k for k in range(4) for _ in range(4)]
    with pytest.raises(ConfigError, match="joint 16 of allegro_right moves no finger"):
        spec.finger_of(16)


def test_an_unknown_hand_is_told_the_models_and_not_every_serial_number() -> None:
    with pytest.raises(
        ConfigError, match=r"no hand named 'shadow'; there are: allegro, .*sih; or the path of a card"
    ) as said:
        load_spec("shadow")
    assert "SAH0" not in str(said.value)
