"""Plans for a hand that `identify` has found: its motors and friction, and draws as wide as its intervals."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from allegro_twin.errors import ConfigError
from allegro_twin.grasping.plan import parallel
from allegro_twin.grasping.plan.own_hand import WIDEST, twin_to_plan_for
from allegro_twin.grasping.plan.search import GraspSearch, SearchBudget
from allegro_twin.grasping.plan.templates import grasp_templates
from allegro_twin.grasping.plan.validate import SEARCHED
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.surfaces.cli.grasps.plan import scenario_of
from tests.hands.models import made


def own(path: Path, half: float = 0.04, side: str = "right") -> Path:
    """A file as `identify` writes it, of a hand with twice the friction and motors of 0.8."""
    content = {
        "wire": {"version": "v4", "side": side, "torque_constant": 0.8}, "actuation": {"frictionloss": 0.04},
        "drive": {"delay": 0.003}, "identified": {"interval": {"torque_constant": [half] * 16}},
    }  # fmt: skip
    path.write_text(yaml.safe_dump(content))
    return path


def test_a_plan_for_one_hand_has_its_friction_and_draws_as_wide_as_its_interval(tmp_path: Path) -> None:
    found = twin_to_plan_for("allegro", str(own(tmp_path / "mine.yaml")))
    np.testing.assert_array_equal(found.spec.actuation.frictionloss, 0.04)
    assert found.spec.drive is None
    assert found.uncertainty.torque == pytest.approx(0.05)
    assert twin_to_plan_for("allegro", str(own(tmp_path / "vague.yaml", 0.7))).uncertainty.torque == WIDEST


def test_a_plan_for_a_hand_that_nobody_has_identified_has_its_versions_limits(tmp_path: Path) -> None:
    plain = tmp_path / "plain.yaml"
    plain.write_text("wire: {version: v5}\n")
    found = twin_to_plan_for("allegro", str(plain))
    assert found.spec.actuation.torque_limit.max() < load_spec().actuation.torque_limit.min()
    assert (found.uncertainty, "was not identified" in found.note) == (SEARCHED, True)


def test_a_left_hand_is_planned_for_by_its_file(tmp_path: Path) -> None:
    path = own(tmp_path / "left.yaml", side="left")
    assert twin_to_plan_for("allegro", str(path)).spec.side == "left"
    with pytest.raises(ConfigError, match=r"left.yaml is a left hand; hand.side is right"):
        twin_to_plan_for("allegro", str(path), "right")
    path.write_text("wire: {version: v4}\n")
    assert twin_to_plan_for("allegro", str(path)).spec.side == "right"
    assert twin_to_plan_for("allegro", str(path), "left").spec.side == "left"


def test_what_is_planned_for_one_hand_is_judged_with_its_drive(tmp_path: Path) -> None:
    path = own(tmp_path / "mine.yaml")
    judged = twin_to_plan_for("allegro", str(path)).judged
    assert judged is not None
    assert judged.drive is not None
    assert judged.drive.delay == 0.003
    path.write_text("wire: {version: v4}\n")
    assert twin_to_plan_for("allegro", str(path)).judged is None


def test_a_file_without_intervals_is_refused(tmp_path: Path) -> None:
    plain = tmp_path / "plain.yaml"
    plain.write_text("wire: {version: v4}\nidentified: {noise: 0.001}\n")
    with pytest.raises(ConfigError, match="has no intervals to draw from: write it with allegro-twin identify"):
        twin_to_plan_for("allegro", str(plain))


def test_a_card_has_no_file_beside_it(tmp_path: Path) -> None:
    card = made("gripper", tmp_path)
    with pytest.raises(
        ConfigError, match=r"^--twin: .*gripper.yaml is the hand's only file: write .* leave out --twin"
    ):
        twin_to_plan_for(str(card), str(own(tmp_path / "mine.yaml")))


def test_parallel_searches_are_of_the_same_hand_with_the_same_draws(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[GraspSearch] = []

    def run(sweep: Any, **options: Any) -> Any:
        shared: Mapping[str, Any] = json.loads(json.dumps(sweep.shared))
        parallel.run_searches(shared, [{"seed": 3}])
        raise KeyboardInterrupt

    def nothing_found(search: GraspSearch, *rest: Any) -> Iterable[Any]:
        made.append(search)
        return []

    hand = twin_to_plan_for("allegro", str(own(tmp_path / "mine.yaml")))
    search = GraspSearch(
        scenario_of("lemon", "z", None, None, 0.8), hand.spec, grasp_templates(hand.spec), uncertainty=hand.uncertainty
    )
    monkeypatch.setattr(parallel, "run", run)
    monkeypatch.setattr(GraspSearch, "run", nothing_found)
    with pytest.raises(KeyboardInterrupt):
        parallel.search_in_parallel(search, 1, SearchBudget(1, 1.0), 2, None)  # type: ignore[arg-type]
    np.testing.assert_array_equal(made[0].spec.actuation.frictionloss, 0.04)
    assert made[0].uncertainty == hand.uncertainty
    assert made[0].spec.drive is None
