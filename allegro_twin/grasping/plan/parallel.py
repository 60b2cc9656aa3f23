"""Searches with a seed each, side by side: in processes of this computer or on a Ray cluster."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from allegro_twin.errors import HandError
from allegro_twin.grasping.plan.candidate import Candidate
from allegro_twin.grasping.plan.region import GraspRegion
from allegro_twin.grasping.plan.search import GraspSearch, RoundSize, SearchBudget, search_symmetry
from allegro_twin.grasping.plan.templates import grasp_templates
from allegro_twin.grasping.plan.validate import PlannedGrasp, best_grasps
from allegro_twin.grasping.scenario import Scenario
from allegro_twin.grasping.uncertainty import Uncertainty
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.entries import LatchGrip
from allegro_twin.hands.library.grasps import Grasp
from allegro_twin.hands.library.taxonomy import ObservedType
from allegro_twin.sweep.jobs import Sweep
from allegro_twin.sweep.local import SweepEngine
from allegro_twin.sweep.runner import run

SEARCH = "allegro_twin.grasping.plan.parallel:run_searches"


def search_in_parallel(
    search: GraspSearch,
    n: int,
    budget: SearchBudget,
    seeds: int,
    engine: SweepEngine,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[PlannedGrasp]:
    """The best `n` of searches like `search` with so many seeds from its own on, each with the whole budget and on
    one processor. `progress`: how many have ended. Raises HandError when one of them fails."""
    shared = {
        "scenario": search.scenario.model_dump(mode="json"), "folder": str(search.folder.resolve()),
        "hand": search.spec.model_reference, "side": search.spec.side, "kind": search.kind, "n": n,
        "twin": search.spec.serial, "uncertainty": search.uncertainty.model_dump(mode="json"),
        "budget": {key: value for key, value in asdict(budget).items() if math.isfinite(value)},
        "effort": None if search.effort is None else asdict(search.effort),
        "region": None if search.region is None else asdict(search.region),
    }  # fmt: skip
    items = [{"seed": search.seed + number} for number in range(seeds)]
    table = run(Sweep(SEARCH, items, shared, unit=1), engine=engine, progress=progress).to_pylist()
    failed = next((row["error"] for row in table if row["error"]), None)
    if failed is not None:
        raise HandError(failed)
    for number, row in enumerate(table):
        search.counts[search.seed + number] = row["closed"]
        search.ends.update(json.loads(row["ends"]))
        search.drawn.update(json.loads(row["drawn"]))
        search.cut |= row["cut"]
        search.closed, search.cpu = search.closed + row["closed"], search.cpu + row["cpu"]
    found = [planned_from_json(data, search.templates) for row in table for data in json.loads(row["found"])]
    return best_grasps(found, n, search_symmetry(search))


def run_searches(shared: Mapping[str, Any], items: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Units of a sweep: one search for each item's `seed`. A row has `found`, `ends` and `drawn` as JSON, how many
    candidates were `closed`, the `cpu` seconds that it took, and whether its first round was `cut` short."""
    spec, asked = replace(load_spec(shared["hand"], shared["side"], shared["twin"]), drive=None), shared["region"]
    rows = []
    for item in items:
        search = GraspSearch(
            Scenario.model_validate(shared["scenario"]), spec, grasp_templates(spec, shared["kind"]),
            Path(shared["folder"]), seed=item["seed"],
            effort=None if shared["effort"] is None else RoundSize(**shared["effort"]),
            region=None if asked is None else GraspRegion(**asked), kind=shared["kind"], threads=1,
            uncertainty=Uncertainty.model_validate(shared["uncertainty"]),
        )  # fmt: skip
        found = search.run(shared["n"], SearchBudget(**shared["budget"]))
        if search.interrupted:
            raise KeyboardInterrupt  # The row would be taken for that of a whole search.
        rows.append(
            {
                "found": json.dumps([planned_to_json(each) for each in found]), "ends": json.dumps(search.ends),
                "drawn": json.dumps(search.drawn),
                "closed": search.closed, "cpu": search.cpu, "cut": search.cut,
            }
        )  # fmt: skip
    return rows


def planned_to_json(planned: PlannedGrasp) -> dict[str, Any]:
    """As JSON has it."""
    fields = {key: getattr(planned, key) for key in _FIELDS}
    observed = planned.grasp.observed
    candidate = {key: np.asarray(getattr(planned.candidate, key)).tolist() for key in Candidate.__slots__}
    grip = planned.grasp.grip
    grasp = {key: getattr(planned.grasp, key).tolist() for key in _POSTURES}
    grasp |= {} if grip is None else {"grip": grip.model_dump()}
    return fields | {"observed": None if observed is None else observed.model_dump(), "candidate": candidate,
                     "grasp": grasp, "scenario": planned.scenario.model_dump(mode="json")}  # fmt: skip


def planned_from_json(data: Any, known: Sequence[Grasp]) -> PlannedGrasp:
    """What `planned_to_json` has made plain; `known`: the templates of the search."""
    values: Any = {
        key: np.array(value) if isinstance(value, list) else value for key, value in data["candidate"].items()
    }
    candidate = Candidate(**values)
    template = next(grasp for grasp in known if grasp.name == candidate.template)
    preshape, close, squeeze = (np.array(data["grasp"][key]) for key in _POSTURES)
    grip = LatchGrip(**data["grasp"]["grip"]) if "grip" in data["grasp"] else None
    grasp = replace(template, grip=grip, observed=None, preshape=preshape, close=close, squeeze=squeeze)
    planned = PlannedGrasp(
        candidate, Scenario.model_validate(data["scenario"]), grasp, **{key: data[key] for key in _FIELDS}
    )
    planned.show(None if data["observed"] is None else ObservedType(**data["observed"]))
    return planned


_FIELDS = (
    "tried",
    "held",
    "judged",
    "judged_held",
    "seed",
    "candidates",
    "confirmed",
    "sure",
    "margin",
    "stall",
    "sustained",
)
_POSTURES = ("preshape", "close", "squeeze")
