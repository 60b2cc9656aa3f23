"""A whole trial: pick an object off the table, turn it over, shake it, and ask whether it was held."""

from contextlib import closing

from allegro_twin import run, until
from allegro_twin.app import assemble, scenario_config

rig = assemble(scenario_config("tennis_ball", side="left"))
assert rig.trial is not None  # Of a scenario.
with closing(rig.backend):
    for _ in rig.trial.watched(until(rig.trial.seconds, run(rig.backend, rig.controller))):
        pass
report = rig.trial.report()
print("held" if report.held else f"not held: {report.reason}")
for phase in report.phases:
    print(f"{phase.name:6s} drift {phase.drift * 1000:4.1f} mm {phase.rotation:4.1f}°", phase.contact_force)
assert report.held
