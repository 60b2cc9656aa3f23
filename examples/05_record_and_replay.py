"""Record a run, read it back, and put the same controller over it: every command comes out bit for bit."""

from pathlib import Path

import numpy as np

from allegro_twin import TorqueCommand, load_config, run, until
from allegro_twin.app import assemble
from allegro_twin.loop import to_the_end
from allegro_twin.recording import ReplayBackend, load, record

path = Path("home.arrow")
rig = assemble(load_config("sim_right"))
for _ in record(until(1.0, run(rig.backend, rig.controller)), path, rig.spec, rig.backend.period):
    pass
recording = load(path)
samples = to_the_end(run(ReplayBackend(recording), rig.controller))
again = [s.command.torque for s in samples if isinstance(s.command, TorqueCommand)]
same = np.array_equal(np.array(again), recording.columns["command_torque"])
print(f"{len(recording)} rows of {', '.join(recording.columns)}; commands repeated exactly: {same}")
assert same
