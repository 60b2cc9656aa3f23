"""A grasp that is not told the object's size: the same centroid grasp on a small, a nominal and a large ball."""

from allegro_twin import run, until
from allegro_twin.app import assemble, scenario_config
from allegro_twin.grasping import Trial, load_scenario
from allegro_twin.hands import load_grasp

rig = assemble(scenario_config("grasp_3"))  # The palm so high above the table as the object needs.
held = []
for diameter in (0.050, 0.065, 0.080):
    scenario, _where = load_scenario("grasp_3")
    ball = scenario.objects[0].model_copy(update={"name": "ball", "shape": "sphere", "size": (diameter,), "mass": 0.06})
    trial = Trial(scenario.model_copy(update={"objects": (ball,)}), rig.spec, load_grasp("grasp_3", rig.spec))
    for _ in trial.watched(until(trial.seconds, run(trial.backend, rig.controller))):
        pass
    report = trial.report()
    print(f"{diameter * 1000:.0f} mm: {'held' if report.held else report.reason}")
    held.append(report.held)
assert all(held)
