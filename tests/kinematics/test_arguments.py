"""What is no place, posture or orientation is refused in one line, and a list is as good as an array."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.hands.description import arms
from allegro_twin.kinematics import orientation
from allegro_twin.kinematics.arm import ArmModel
from allegro_twin.types import Array
from tests.kinematics.hands import FINGERS

INDEX, THUMB = FINGERS["right", "index"], FINGERS["right", "thumb"]
Q = [0.1, 0.5, 0.8, 0.4]
TIP, SPOT = INDEX.fk(Q).position.tolist(), THUMB.fk([0.8, 0.3, 0.3, 0.3]).position.tolist()
ARM = ArmModel(arms.load_arm_spec(arms.arm_names()[0]))
LEVEL = np.eye(3).tolist()
NO_TURN = [1.0, 0.0, 0.0, 0.0]
ASKED: dict[str, tuple[Callable[[Any], Any], Any]] = {
    "fk": (INDEX.fk, Q),
    "tip": (INDEX.tip, Q),
    "ik": (lambda x: INDEX.ik(x).best(), TIP),
    "near": (lambda x: INDEX.ik(TIP, near=x).best(), Q),
    "pitch": (lambda x: INDEX.ik([TIP] * 3, pitch=x).best(), [1.7, 1.6, 1.5]),
    "psi": (lambda x: THUMB.ik([SPOT] * 3, psi=x).best(), [0.6, 0.5, 0.4]),
    "rotation": (lambda x: INDEX.ik(TIP, rotation=x).best(), LEVEL),
    "best": (lambda x: INDEX.ik(TIP, pitch=1.7).best(near=x), Q),
    "best of many": (lambda x: INDEX.ik([TIP, TIP], pitch=1.7).best(near=x), [Q, Q]),
    "arm pose": (ARM.pose, ARM.spec.ready.tolist()),
    "arm motion": (ARM.motion, ARM.spec.ready.tolist()),
    "arm inertia": (ARM.inertia, ARM.spec.ready.tolist()),
    "arm coriolis": (lambda x: ARM.coriolis(ARM.spec.ready, x), [0.1] * 7),
    "arm reach": (lambda x: ARM.reach(ARM.pose(ARM.spec.ready), x), ARM.spec.ready.tolist()),
    "matrix_from_euler": (orientation.matrix_from_euler, [0.1, 0.2, 0.3]),
    "quaternion_from_euler": (orientation.quaternion_from_euler, [0.1, 0.2, 0.3]),
    "euler_from_matrix": (orientation.euler_from_matrix, LEVEL),
    "quaternion_from_matrix": (orientation.quaternion_from_matrix, LEVEL),
    "matrix_from_quaternion": (orientation.matrix_from_quaternion, NO_TURN),
    "vector_from_quaternion": (orientation.vector_from_quaternion, NO_TURN),
    "quaternion_from_vector": (orientation.quaternion_from_vector, [0.1, 0.2, 0.3]),
    "product": (lambda x: orientation.quaternion_product(x, NO_TURN), NO_TURN),
    "conjugate": (orientation.quaternion_conjugate, NO_TURN),
    "slerp": (lambda x: orientation.slerp(x, NO_TURN, 0.5), NO_TURN),
    "angle_between": (lambda x: orientation.angle_between(x, LEVEL), LEVEL),
    "angle_between_quaternions": (lambda x: orientation.angle_between_quaternions(x, NO_TURN), NO_TURN),
    "facing": (lambda x: orientation.matrix_facing(x, [0.0, 0.0, 1.0]), [1.0, 0.0, 0.0]),
    "gravity_from_quaternion": (orientation.gravity_from_quaternion, NO_TURN),
    "quaternion_from_gravity": (orientation.quaternion_from_gravity, [0.1, 0.0, -9.8]),
}
FINITE = (
    "fk",
    "tip",
    "ik",
    "near",
    "pitch",
    "psi",
    "rotation",
    "best",
    "best of many",
    *(n for n in ASKED if "arm " in n),
)
"""Infinity is refused as well; what is made of orientations alone gives NaN."""


def not_that(good: Array, *, finite: bool) -> list[Any]:
    wrong = [good[..., :-1], [], "abc", np.full(good.shape, "a").tolist(), [[1, 2], [3]], {}, object(), good * 1j]
    if good.ndim > 1:
        wrong.append(good[0][:2])
    return [*wrong, np.where(np.arange(good.size).reshape(good.shape) == 1, np.inf, good)] if finite else wrong


@pytest.mark.parametrize("name", ASKED)
def test_a_list_is_as_good_as_an_array_and_anything_else_is_refused_in_one_line(name: str) -> None:
    ask, good = ASKED[name]
    assert repr(ask(good)) == repr(ask(np.array(good)))
    for wrong in not_that(np.array(good), finite=name in FINITE):
        with pytest.raises(ConfigError) as refused:
            ask(wrong)
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize("margin", [float("nan"), float("inf"), -0.1, 9.0, None, "wide", [0.1], {}, object()])
def test_a_margin_that_is_none_is_refused_in_one_line(margin: Any) -> None:
    with pytest.raises(ConfigError, match="^index: margin"):
        INDEX.ik(TIP, margin=margin)


def test_a_margin_may_be_any_number() -> None:
    narrow = INDEX.ik(TIP, pitch=1.7, margin=0.25).within
    for margin in (np.float64(0.25), np.float32(0.25), np.array(0.25)):
        np.testing.assert_array_equal(INDEX.ik(TIP, pitch=1.7, margin=margin).within, narrow)  # type: ignore[arg-type]
    assert INDEX.ik(TIP, margin=0).within.any()


@pytest.mark.parametrize("near", [[float("nan"), 0.5, 0.8, 0.4], [Q, Q]])
def test_one_target_is_given_one_posture_to_be_near_to(near: Any) -> None:
    with pytest.raises(ConfigError, match="^near "):
        INDEX.ik(TIP, pitch=1.7).best(near=near)


def test_a_branch_that_does_not_exist_has_no_tip() -> None:
    """NaN goes through forward kinematics, so that all branches of a batch can be looked at in one call."""
    pose = INDEX.fk([Q, [float("nan"), 0.5, 0.8, 0.4]])
    assert np.isfinite(pose.position[0]).all()
    assert np.isnan(pose.position[1]).any()


def test_what_an_arm_says_stays_as_it_was_said() -> None:
    ready, other = ARM.spec.ready, ARM.spec.ready + 0.1
    said = [*ARM.motion(ready), ARM.coriolis(ready, np.ones(7)), ARM.inertia(ready)]
    before = [np.array(each) for each in said]
    ARM.motion(other), ARM.coriolis(other, np.ones(7)), ARM.inertia(other)
    for now, then in zip(said, before, strict=True):
        np.testing.assert_array_equal(now, then)
