"""A swap is a swap: what is to be done stands outside the backend, and whatever nobody would read is refused."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest
import yaml

from allegro_twin.app import Rig, assemble
from allegro_twin.app.config import RunConfig, load_config
from allegro_twin.app.session import Outputs
from allegro_twin.control.force_grasp import CentroidGrasp
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.grasping.batch.trials import run_cases
from allegro_twin.grasping.verdict import TrialReport
from allegro_twin.loop import run, to_the_end, until
from allegro_twin.surfaces.cli.start.jobs import RunOptions as Options
from allegro_twin.surfaces.cli.start.jobs import check_folder_outputs, configs_of, outputs_in
from allegro_twin.surfaces.cli.start.run import _run
from tests.drivers.can.test_two_processes import program
from tests.patience import wait_for

SIM = "{kind: sim}"
VIRTUAL = "{kind: can, version: v4, interface: allegro-virtual, imu: 0.1}"
DEMO = sorted(path.stem for path in (data_root() / "scenarios" / "demo").glob("*.yaml"))


def written(folder: Path, backend: str, task: str, controller: str = "{kind: pd}") -> Path:
    path = folder / "mine.yaml"
    path.write_text(f"backend: {backend}\ntask: {task}\ncontroller: {controller}\n")
    return path


def performed(config: RunConfig) -> tuple[Rig, TrialReport]:
    rig = assemble(config)
    assert rig.trial is not None
    assert rig.seconds is not None
    for _ in rig.trial.watched(until(rig.seconds, to_the_end(run(rig.backend, rig.controller)))):
        pass
    rig.backend.close()
    return rig, rig.trial.report()


@pytest.mark.parametrize(
    "task", ["{scenario: lemon}", "{scenario: tennis_ball, grasp: grasp_3}", "{scenario: lemon, object: golf_ball}"]
)
def test_another_backend_does_the_same_with_the_same_object(task: str, tmp_path: Path) -> None:
    seen = []
    for backend in (SIM, VIRTUAL):
        rig = assemble(load_config(written(tmp_path, backend, task)))
        assert rig.trial is not None
        last = list(until(1.5, run(rig.backend, rig.controller)))[-1]
        seen.append((rig.trial.grasp.name, rig.trial.mass, rig.seconds, last.state.position))
        rig.backend.close()
    assert seen[0][:3] == seen[1][:3]
    assert abs(seen[0][3] - seen[1][3]).max() < 0.02


def test_a_hand_that_is_not_simulated_here_follows_the_scenarios_timeline(tmp_path: Path, recording_path: Path) -> None:
    task = "{scenario: tennis_ball, grasp: grasp_3}"
    here = assemble(load_config(written(tmp_path, SIM, task)))
    there = assemble(load_config(written(tmp_path, f"{{kind: replay, file: {recording_path}}}", task)))
    assert isinstance(here.controller, CentroidGrasp)
    assert isinstance(there.controller, CentroidGrasp)
    assert there.controller.squeeze_at == here.controller.squeeze_at > 0.0


def test_a_grasp_in_the_open_is_a_task_of_any_hand(tmp_path: Path) -> None:
    ends = []
    for backend in (SIM, VIRTUAL):
        rig = assemble(load_config(written(tmp_path, backend, "{grasp: grasp_3}")))
        assert rig.trial is None
        assert rig.seconds is not None
        ends.append(list(until(rig.seconds, run(rig.backend, rig.controller)))[-1].state.position)
        rig.backend.close()
    assert abs(ends[0] - ends[1]).max() < 0.02


def test_the_readmes_block_runs_with_the_line_for_a_real_hand(tmp_path: Path) -> None:
    """Its adapter replaced by the virtual one."""
    text = (Path(__file__).parents[1] / "README.md").read_text()
    block = next(part for part in text.split("```yaml\n")[1:] if "# after" in part).partition("```")[0]
    lines = [line.removeprefix("# ") for line in block.splitlines() if not line.startswith("backend")]
    path = tmp_path / "readme.yaml"
    path.write_text("\n".join(lines).replace("interface: socketcan, channel: can0", "interface: allegro-virtual"))
    rig = assemble(load_config(path))
    assert list(until(0.3, run(rig.backend, rig.controller)))
    rig.backend.close()


def test_outputs_that_a_backend_never_has_are_refused_before_anything_is_computed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def assembled(config: RunConfig) -> Rig:
        raise AssertionError("it began")

    monkeypatch.setattr("allegro_twin.app.assemble", assembled)
    sim, replay = written(tmp_path, SIM, "{scenario: lemon}"), tmp_path / "replay.yaml"
    replay.write_text("backend: {kind: replay, file: a.arrow}\ncontroller: {kind: limp}\n")
    for config, out, wanted, said in (
        (sim, tmp_path / "f", Outputs(record=tmp_path / "x.arrow"), "leave out --record"),
        (sim, None, Outputs(wire_log=tmp_path / "x.log"), "only a hand on a CAN bus has frames to log"),
        (replay, None, Outputs(image=tmp_path / "x.png"), "only a simulation can be rendered"),
    ):
        with pytest.raises(ConfigError, match=said):
            _run([str(config)], Options(), wanted, out, 1)
    assert not (tmp_path / "f").exists()


def test_a_data_set_is_no_recording_and_the_way_to_one_is_named(tmp_path: Path) -> None:
    (tmp_path / "set" / "meta").mkdir(parents=True)
    config = written(tmp_path, f"{{kind: replay, file: {tmp_path / 'set'}}}", "{posture: home}")
    with pytest.raises(ConfigError, match=r"export .*set one.arrow --episode 0` makes a recording of one episode"):
        assemble(load_config(config))


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("task: {object: lemon}", "task.object takes the place of a scenario's first object: name task.scenario, too"),
        ("task: {posture: home, scenario: lemon}", "task.posture and task.scenario are two motions"),
        ("task: {posture: home, grasp: quadpod}", "task.posture and task.grasp are two motions"),
        ("task: {posture: home}\ncontroller: {kind: torque}", "task.posture is not for the torque controller"),
        ("task: {grasp: quadpod}\ncontroller: {kind: gravity}", "task.grasp is not for the gravity controller"),
        ("task: {scenario: lemon}\ncontroller: {kind: pd, speed: 2}", "controller.speed is for postures"),
        ("task: {grasp: quadpod}\ncontroller: {kind: pd, profile: linear}", "controller.profile is for postures"),
        ("task: {scenario: lemon}\nbackend: {kind: sim, facing: [0, 0, 1]}", "facing of a simulated hand is where"),
        ("backend: {kind: can, version: v4, interface: allegro-virtual, channel: can0}", "has none: leave it out"),
        ("backend: {kind: sim, scenario: lemon}", r"backend.scenario: unknown key"),
        ("controller: {kind: pd, posture: home}", r"controller.posture: unknown key"),
        ("task: {scenari: lemon}", r"task.scenari: unknown key; did you mean 'scenario'"),
    ],
)  # fmt: skip
def test_what_nobody_would_read_is_refused(text: str, line: str, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    blocks = {"backend": "{kind: sim}", "controller": "{kind: pd}"}
    path.write_text("\n".join([text, *(f"{k}: {v}" for k, v in blocks.items() if f"{k}:" not in text)]) + "\n")
    with pytest.raises(ConfigError, match=line) as caught:
        load_config(path)
    assert "\n" not in str(caught.value)


LEMON = data_root() / "scenarios" / "demo" / "lemon.yaml"


def of_side(folder: Path, side: str) -> Path:
    """The lemon's scenario, with its side said."""
    path = folder / f"lemon_{side}.yaml"
    path.write_text(f"side: {side}\n{LEMON.read_text()}")
    return path


def test_a_scenario_that_says_its_side_decides_where_the_config_says_none(tmp_path: Path) -> None:
    left = of_side(tmp_path, "left")
    for backend in (SIM, VIRTUAL):
        assert load_config(written(tmp_path, backend, f"{{scenario: {left}}}")).hand.side == "left"
    (job,) = configs_of([str(left)], Options(config="can_virtual"))
    assert job.config.hand.side == "left"
    (job,) = configs_of([str(left)], Options(config="can_virtual", side="right"))
    assert job.config.hand.side == "right"
    episode = f"{{episode: {{task: Grasp, environment: {{objects: [{left}]}}}}}}"
    assert load_config(written(tmp_path, SIM, episode)).hand.side == "left"
    assert load_config(written(tmp_path, SIM, "{scenario: lemon}")).hand.side == "right"


def test_a_config_and_a_scenario_of_two_sides_are_refused_with_both_names(tmp_path: Path) -> None:
    right, own = of_side(tmp_path, "right"), tmp_path / "own.yaml"
    own.write_text(f"hand: {{side: left}}\nbackend: {SIM}\ncontroller: {{kind: pd}}\ntask: {{scenario: {right}}}\n")
    with pytest.raises(ConfigError, match=r"lemon_right.yaml is for the right hand .*own.yaml has the left one"):
        load_config(own)
    with pytest.raises(ConfigError, match=r"lemon_right.yaml is for the right hand .* sim_left has the left one"):
        configs_of([str(right)], Options(config="sim_left"))


def test_an_item_of_a_sweep_is_of_the_side_that_its_scenario_says(tmp_path: Path) -> None:
    protocol = tmp_path / "short.yaml"
    protocol.write_text("version: 1\nreference: a\nphases: [{name: a, seconds: 0.1}, {name: b, seconds: 0.1}]\n")
    (row,) = run_cases({}, [{"scenario": str(of_side(tmp_path, "left")), "protocol": str(protocol)}])
    assert row["side"] == "left"


def test_a_force_grasp_refuses_a_controller_that_it_would_not_use(tmp_path: Path) -> None:
    for controller, key in (("{kind: pid}", "kind: pid"), ("{kind: pd, compensate: false}", "compensate: false")):
        with pytest.raises(ConfigError, match=f"under PD and with the hand's weight carried; leave out {key}"):
            assemble(load_config(written(tmp_path, SIM, "{scenario: tennis_ball, grasp: grasp_3}", controller)))


def test_options_beside_a_config_change_its_task_or_are_refused(tmp_path: Path) -> None:
    config = str(written(tmp_path, SIM, "{scenario: lemon}"))
    (job,) = configs_of([config], Options(grasp="tripod", object="golf_ball"))
    assert (job.config.task.scenario, job.config.task.grasp, job.config.task.object) == ("lemon", "tripod", "golf_ball")
    (job,) = configs_of(["sim_right"], Options(grasp="quadpod"))
    assert (job.config.task.posture, job.config.task.grasp) == (None, "quadpod")
    with pytest.raises(ConfigError, match="task.object takes the place of a scenario's first object"):
        configs_of(["sim_right"], Options(object="golf_ball"))
    with pytest.raises(ConfigError, match="--config says which hand performs scenarios"):
        configs_of([config], Options(config="can_virtual"))
    both = configs_of([config], Options(side="both"))
    assert [job.config.hand.side for job in both] == ["right", "left"]


def test_a_recording_of_ones_own_beside_a_folder_of_them_is_refused(tmp_path: Path) -> None:
    (job,) = configs_of(["lemon"])
    rig = assemble(job.config)
    for name, wanted in (("record", Outputs(record=tmp_path / "x")), ("image", Outputs(image=tmp_path / "x"))):
        with pytest.raises(ConfigError, match=f"leave out --{name}"):
            check_folder_outputs(wanted)
    kept = outputs_in(tmp_path, job, rig, Outputs(rrd=tmp_path / "x.rrd", wire_log=tmp_path / "x.blf"))
    assert (kept.rrd, kept.wire_log) == (tmp_path / "x.rrd", tmp_path / "x.blf")


def test_scenarios_are_performed_by_the_hand_of_a_config() -> None:
    (job,) = configs_of(["lemon"], Options(config="can_virtual", side="left"))
    assert (job.name, job.config.hand.side, job.config.backend.kind) == ("lemon", "left", "can")
    assert (job.config.controller.kind, job.config.seconds) == ("pd", None)


@pytest.mark.long
@pytest.mark.parametrize("name", DEMO)
def test_every_object_is_held_by_a_hand_in_simulation_on_a_bus_and_in_another_program(
    name: str, tmp_path: Path
) -> None:
    """12 objects × {sim, virtual, pty}: only the backend changes."""
    for backend in (SIM, VIRTUAL):
        _, report = performed(load_config(written(tmp_path, backend, f"{{scenario: {name}}}")))
        assert report.held, f"{backend}: {report.reason}"
    tty, verdict = tmp_path / "hand.tty", tmp_path / "verdict.json"
    backend = (
        f"{{kind: can, version: v4, interface: slcan, channel: {tty}, imu: 0.1, timeout: 2.0, deadman: 2.0, "
        "options: {sleep_after_open: 0.0}}"
    )
    config = written(tmp_path, backend, f"{{scenario: {name}}}")
    with program("firmware", config, "--report", verdict) as hand:
        wait_for(lambda: tty.exists() or hand.poll() is not None)
        with program("run", config) as driver:
            said, _ = driver.communicate()
        assert driver.returncode == 0, said
        hand.send_signal(signal.SIGTERM)
        hand.communicate()
    (told,) = json.loads(verdict.read_text())["trials"].values()
    assert told["held"], told
    assert yaml.safe_load(config.read_text())["task"] == {"scenario": name}
