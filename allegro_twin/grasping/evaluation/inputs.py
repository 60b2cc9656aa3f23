"""What a trial is made of, by name and fingerprint: the hand, its gains, grasp, objects, scenario, rules and scene."""

from __future__ import annotations

from pathlib import Path

from allegro_twin.files.fingerprints import fingerprint
from allegro_twin.grasping.batch.trials import Case
from allegro_twin.grasping.scenario import ObjectSettings, Scenario
from allegro_twin.grasping.timeline import stage
from allegro_twin.hands.library.gains import load_gains, protocol_gains
from allegro_twin.sim.model.fingerprint import hand_fingerprint, model_fingerprint
from allegro_twin.sim.model.scene import compile_scene
from allegro_twin.sim.objects.catalogue import named
from allegro_twin.spec import HandSpec

Inputs = dict[str, str]
"""Fingerprints by name."""


SCENE = "scene of"
"""How the name of a compiled scene begins: what changes one is mostly named by another input, too."""


class InputsOf:
    """The inputs of many trials: what they share is looked at once."""

    def __init__(self) -> None:
        self._scenes: dict[str, str] = {}

    def __call__(self, case: Case, spec: HandSpec, name: str, file: Path | None = None) -> Inputs:
        """Of the trial of that name. `file`: of many grasps, of which its grasp and the palm's place are; those of one
        file share their scene. Raises ConfigError for a scene that cannot be built."""
        scenario, protocol = case.scenario, case.ruled
        gains = protocol_gains(protocol.gains, spec)
        found = {
            f"hand {spec.serial or spec.name}": hand_fingerprint(spec),
            f"gains {gains} of {spec.model}": fingerprint(load_gains(gains, spec)),
            f"protocol {Path(case.rules or scenario.protocol).stem}": fingerprint(protocol),
        }
        found |= {f"object {each.name}": object_fingerprint(each, case.folder) for each in scenario.objects}
        if file is None:
            found |= {
                f"scenario {name}": scenario_fingerprint(scenario),
                f"grasp {case.grasp.name}": fingerprint(case.grasp),
            }
        else:
            found |= {f"grasps {file.name}": fingerprint(file, scenario_fingerprint(scenario), case.grasp)}
        where = name if file is None else file.name
        alike = {key: digest for key, digest in found.items() if file is None or not key.startswith("grasps")}
        return found | {f"{SCENE} {spec.name} at {where}": self._scene(case, spec, fingerprint(alike, file))}

    def _scene(self, case: Case, spec: HandSpec, parts: str) -> str:
        """The compiled model: the net under the list above, for what a description includes."""
        if parts not in self._scenes:
            scene = stage(case.scenario, case.ruled, spec.side, case.folder)
            self._scenes[parts] = model_fingerprint(compile_scene(spec, scene))
        return self._scenes[parts]


def scenario_fingerprint(scenario: Scenario) -> str:
    """Of what a scenario says; where its files lie does not count, nor its description."""
    objects = [each.model_copy(update={"file": None}) for each in scenario.objects]
    named_by = {"grasp": Path(scenario.grasp).stem, "hand": Path(scenario.hand).stem, "objects": tuple(objects)}
    return fingerprint(scenario.model_copy(update=named_by | {"description": ""}))


def object_fingerprint(settings: ObjectSettings, folder: Path) -> str:
    """Of one object: its file, or what the catalogue says of that name. Raises ConfigError."""
    if settings.file is not None:
        return fingerprint(folder / settings.file, settings.model_copy(update={"file": None}))
    return fingerprint(settings, named(settings.name) if settings.shape is None else None)
