"""How each hand takes each object, planned by the lab's cell once, before any trial."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from allegro_twin import ConfigError
from allegro_twin.cell import LabSettings, make_cell
from allegro_twin.cell.perception import Solid
from allegro_twin.cell.planning import GraspAdapter, GraspPlan, plan_grasp
from allegro_twin.files import data_root, parse_settings, read_yaml
from studies.preemption.arm.grasps import PreparedGrasp, placed_content, read_prepared, write_prepared
from studies.preemption.protocol import ArmStudy, StudyObject


def prepare(study: ArmStudy, hand: str, folder: Path, tell: Callable[[str], None]) -> Path:
    """Plan all objects of a hand that are not in its file yet. `tell` hears of each. Raises ConfigError where there is
    no grasp for one: a study that leaves objects out has chosen them by what the hand can do."""
    path = folder / f"{hand}.json"
    found = read_prepared(hand) if path.exists() else {}
    for name in study.objects:
        if name not in found:
            found[name] = planned(study, hand, name)
            tell(f"{hand}, {name}: {found[name].grasp}")
            write_prepared(folder, hand, found)
    return path


def solid_of(one: StudyObject) -> Solid:
    """As perception would see it, without an error: its first axis is that of revolution, or of the longest edge."""
    extents = one.extents
    if one.shape == "sphere" or one.shape == "box":
        order = sorted(range(3), key=lambda k: -extents[k])
    else:
        alone = next(k for k in range(3) if extents[(k + 1) % 3] == extents[(k + 2) % 3])
        order = [alone, (alone + 1) % 3, (alone + 2) % 3]
    axes = np.eye(3)[:, order]
    if np.linalg.det(axes) < 0.0:
        axes[:, 2] *= -1.0
    middle = np.array([0.0, 0.0, extents[2] / 2.0])
    return Solid(one.shape, middle, axes, (extents[order[0]], extents[order[1]], extents[order[2]]), 0.0)


def planned(study: ArmStudy, hand: str, name: str) -> PreparedGrasp:
    """What the cell plans for an object. Raises ConfigError where it finds no grasp."""
    one = study.objects[name]
    path = data_root() / "conf" / f"{study.hands[hand]}.yaml"
    content = read_yaml(path) | {"objects": [placed_content(name, one)]}
    lab = parse_settings(LabSettings, content, str(path))
    if lab.planning is None:
        raise ConfigError(f"{study.hands[hand]}: this cell does not plan; give it `planning`")
    cell = make_cell(lab)
    try:
        adapter = GraspAdapter(cell.hand.spec, lab.planning, lab.hand.gains, study.seed % 1000)
        plan: GraspPlan = plan_grasp(solid_of(one), cell, adapter=adapter)
    finally:
        cell.close()
    card, palm = plan.candidate.card, plan.candidate.palm
    grasp = card.grasp
    return PreparedGrasp(
        card.name, plan.through[-1], (palm.position, palm.rotation), grasp.preshape, grasp.close, grasp.squeeze
    )
