"""What works with which hand: docs/reference/hand_verbs.md, filled by trying it.

Our own hands are tried here; public ones where HAND_MODELS names the folder with their files. `SNAPSHOTS=write` writes
what came out into the page, to be looked at.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import gymnasium
import numpy as np
import pytest
import yaml

import allegro_twin.gym  # noqa: F401  # Registers the ids.
from allegro_twin import Hand
from allegro_twin.app import assemble
from allegro_twin.app.config import RunConfig
from allegro_twin.errors import ConfigError, HandError
from allegro_twin.grasping.batch.trials import TrialRunner, load_case
from allegro_twin.grasping.plan.candidate import check_efforts, object_symmetry
from allegro_twin.grasping.plan.close_in_simulation import FingerGains, close_candidates
from allegro_twin.grasping.plan.proposals.propose import Proposer
from allegro_twin.grasping.plan.save import save_grasps
from allegro_twin.grasping.plan.templates import grasp_templates
from allegro_twin.grasping.plan.validate import AS_IT_IS, GraspValidator, PlannedGrasp
from allegro_twin.grasping.scenario import load_protocol
from allegro_twin.grasping.timeline import make_stage
from allegro_twin.grasping.uncertainty import Uncertainty
from allegro_twin.grasping.verdict import TrialReport
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.hands.library.library import load_posture, posture_names
from allegro_twin.kinematics.hand import hand_kinematics
from allegro_twin.recording.messages.frames import LinkFrames, urdf_text
from allegro_twin.recording.messages.message_types import ros_types
from allegro_twin.recording.reader import load
from allegro_twin.sim.contact.grasp_scene import GraspScene
from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.cli.grasps.plan import scenario_of
from allegro_twin.surfaces.panel.description import describe_hand, library_contents
from allegro_twin.twin import mirror_recording
from tests.hands.test_public_models import FILES, FOLDER
from tests.surfaces.cli.wrong import built

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "hand_verbs.md"
OURS = ("allegro", "leap", "model_o", "qb_softhand", "sih")
PUBLIC = tuple(name for name in FILES if name != "menagerie_leap")
"""Its page says that no whole copy of that one was at hand."""
THING = "tennis_ball"
BEGIN, END = "<!-- written by tests/hands/test_verbs.py -->", "<!-- end -->"


@dataclass
class Tried:
    """A hand in a folder of its own."""

    reference: str
    folder: Path
    scenario: Path | None = None
    record: Path | None = None
    spec: HandSpec = field(init=False)

    def __post_init__(self) -> None:
        self.spec = load_spec(self.reference)

    def config(self, **blocks: Any) -> RunConfig:
        kind = "pd" if "torque" in self.spec.commands else "position"
        content = {"hand": {"model": self.reference}, "backend": {"kind": "sim"}, "controller": {"kind": kind}}
        return RunConfig.model_validate(content | blocks)


def move(tried: Tried) -> None:
    """To half of the way from `flat` to `home`, and back to `open`."""
    spec = tried.spec
    home, opened, flat = (load_posture(name, spec) for name in ("home", "open", "flat"))
    with Hand.open(tried.config(task={"posture": "flat"})) as hand:
        for goal in ((flat + home) / 2.0, opened):
            hand.move_to(goal, speed=float((spec.upper - spec.lower).max()))
            hand.wait(0.5)
            assert np.median(np.abs(hand.state.position - goal) / (spec.upper - spec.lower)) < 0.1


def postures(tried: Tried) -> None:
    names = {name.removeprefix(f"{tried.spec.model}_") for name in posture_names(tried.spec)}
    if missing := [name for name in ("home", "open", "flat") if name not in names]:
        raise ConfigError(f"no posture {', '.join(missing)} in the library")
    for name in ("home", "open", "flat"):
        load_posture(name, tried.spec)


def inverse(tried: Tried) -> None:
    for finger in tried.spec.fingers:
        solver = hand_kinematics(tried.spec).finger(finger.name)
        middle = (tried.spec.lower + tried.spec.upper)[list(finger.joints)] / 2.0
        found = solver.ik(solver.fk(middle).position, near=middle)
        assert bool(found.reachable), finger.name


def record(tried: Tried) -> None:
    config = tried.folder / "run.yaml"
    kind = "pd" if "torque" in tried.spec.commands else "position"
    block = {"hand": {"model": tried.reference}, "controller": {"kind": kind}, "seconds": 1.0}
    config.write_text(yaml.safe_dump(block | {"backend": {"kind": "sim"}}))
    first, again = (tried.folder / f"{name}.arrow" for name in ("first", "again"))
    built()(["run", str(config), "--record", str(first)], standalone_mode=False)
    config.write_text(yaml.safe_dump(block | {"backend": {"kind": "replay", "file": str(first)}}))
    built()(["run", str(config), "--record", str(again)], standalone_mode=False)
    one, two = load(first).columns, load(again).columns
    for name in ("position", "velocity"):
        assert np.array_equal(one[name][: len(two[name])], two[name][: len(one[name])])
    tried.record = first
    if "torque" in tried.spec.commands and not tried.spec.card:  # Its mirror knows torques by the counts of its bus.
        tried.record = tried.folder / "bus.arrow"
        built()(["run", "can_virtual", "--record", str(tried.record)], standalone_mode=False)


def plan(tried: Tried) -> None:
    """A candidate that physics closes, lifts and turns, and that holds in the whole trial, as files; the whole search
    is in tests/hands/test_planning.py."""
    spec = tried.spec
    check_efforts(spec)
    scenario = scenario_of(THING, "z", None, None, 0.8).model_copy(update={"hand": tried.reference})
    bench = GraspScene(spec, make_stage(scenario, load_protocol("table_pick"), spec.side, Path()))
    templates, random = grasp_templates(spec), np.random.default_rng(0)
    performer = FingerGains(load_gains("default", spec), hand_kinematics(spec).gravity_torque)
    proposed = filter(None, Proposer(bench, templates, 0.8, (0.0, np.pi / 2, np.pi), random).fresh(tries=50_000))
    for _ in range(4):
        some = [candidate for candidate, _ in zip(proposed, range(16), strict=False)]
        if passed := [each for each in close_candidates(bench, some, performer, 0.8, random) if each.passed]:
            break
    else:
        raise ConfigError("none of 64 candidates holds")
    prover = GraspValidator(bench, scenario, spec, templates, Path(), 0, Uncertainty(), object_symmetry(bench.placed))
    for number, each in enumerate(passed[:8]):
        planned = PlannedGrasp(each.candidate, *prover.as_files(each.candidate, AS_IT_IS))
        (tried.scenario,) = save_grasps([planned], THING, tried.folder / f"plans_{number}", spec)
        if _judged(tried).held:
            return
    raise ConfigError("none of the candidates that physics closed holds in the whole trial")


def evaluate(tried: Tried) -> None:
    built()(["evaluate", str(_scenario(tried)), "--uncertainty", "2"], standalone_mode=False)


def _judged(tried: Tried) -> TrialReport:
    (verdict,) = TrialRunner(tried.spec).verdicts([load_case({"scenario": _scenario(tried)}, tried.spec)])
    if verdict.report is None:
        raise ConfigError(verdict.stopped)
    return verdict.report


def environment(task: str, tried: Tried) -> None:
    other: dict[str, Any] = {} if task == "Reach" else {"objects": (str(_scenario(tried)),)}
    env = gymnasium.make(f"AllegroTwin/{task}-v0", hand=tried.reference, **other)
    try:
        observation, _ = env.reset(seed=0)
        for _ in range(3):
            observation, reward, *_ = env.step(env.action_space.sample())
        assert np.isfinite(float(reward))
        assert env.observation_space.contains(observation)
    finally:
        env.close()


def panel(tried: Tried) -> None:
    told = describe_hand(1, assemble(tried.config()), tried.config(), ("position",))
    assert told.spec.joints == tried.spec.joints
    assert set(library_contents(tried.spec).postures) >= set(tried.spec.postures)


def mirror(tried: Tried) -> None:
    assert tried.record is not None
    mirror_recording(tried.record, tried.reference if tried.spec.card else "", None)


def left(tried: Tried) -> None:
    load_spec(tried.reference, "left")


def ros(tried: Tried) -> None:
    """Frames, joints and the description, as the bridge and bags tell them."""
    frames, words = LinkFrames(tried.spec), ros_types()
    posture = load_posture("home", tried.spec)
    assert len(frames.transforms_at(words, 0, posture).transforms) >= len(tried.spec.fingers)
    described = {joint.get("name") for joint in ElementTree.fromstring(urdf_text(tried.spec)).iter("joint")}
    assert {each.name for each in tried.spec.followers} <= described


def _scenario(tried: Tried) -> Path:
    if tried.scenario is None:
        raise ConfigError("as `plan`")
    return tried.scenario


VERBS: dict[str, Callable[[Tried], None]] = {
    "move": move, "home, open, flat": postures, "inverse kinematics": inverse, "record, replay": record,
    "mirror": mirror, "panel": panel, "ROS 2": ros, "`Reach`": partial(environment, "Reach"), "plan": plan,
    "evaluate": evaluate,
    "`Grasp`": partial(environment, "Grasp"), "`Lift`": partial(environment, "Lift"),
    "`HoldDisturbed`": partial(environment, "HoldDisturbed"), "left side": left,
}  # fmt: skip


def answers(tried: Tried) -> list[str]:
    """For each verb `yes`, or the sentence."""
    found = []
    for verb in VERBS.values():
        try:
            verb(tried)
        except HandError as error:
            name = Path(tried.reference).stem
            text = re.sub(r"\S*/", "", str(error)).replace("|", "or")
            found.append(re.sub(rf"\b{re.escape(name)}(\.yaml|_right)?\b", "the hand", text))
        else:
            found.append("yes")
    return found


@pytest.fixture
def tried(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Tried:
    """One of ours; or a public one, imported, with an effort of 1 N·m where its file says none."""
    name: str = request.param
    monkeypatch.chdir(tmp_path)
    if name in OURS:
        return Tried(name, tmp_path)
    model = Path(FOLDER).resolve() / FILES[name]
    if not FOLDER or not model.is_file():
        pytest.skip(f"HAND_MODELS has no {FILES[name]}")
    built()(["hand", "new", str(model), "--name", name, "--no-film"], standalone_mode=False)
    card = tmp_path / "mine" / f"{name}.yaml"
    card.write_text(card.read_text().replace("effort: unknown", "effort: 1.0"))
    return Tried(str(card), tmp_path)


def row(name: str) -> list[str]:
    """What the page says of a hand: `yes`, or the sentence that a number stands for."""
    text = PAGE.read_text()
    (cells,) = re.findall(rf"^\| {re.escape(name)} \| (.*) \|$", text, re.MULTILINE)
    notes = dict(re.findall(r"^(\d+)\. (.*)$", text, re.MULTILINE))
    return [notes.get(cell, cell) for cell in cells.split(" | ")]


def written(rows: dict[str, list[str]]) -> str:
    """The table, and the sentences below it by number."""
    sentences = list(dict.fromkeys(cell for cells in rows.values() for cell in cells if cell != "yes"))
    lines = ["| hand | " + " | ".join(VERBS) + " |", "|---" * (len(VERBS) + 1) + "|"]
    for name, cells in rows.items():
        short = [cell if cell == "yes" else str(sentences.index(cell) + 1) for cell in cells]
        lines.append(f"| {name} | " + " | ".join(short) + " |")
    return "\n".join([*lines, "", *(f"{k}. {sentence}" for k, sentence in enumerate(sentences, 1))])


@pytest.mark.slow
@pytest.mark.parametrize("tried", [*OURS, *PUBLIC], indirect=True)
def test_a_hand_does_what_the_page_says_and_says_why_not(tried: Tried) -> None:
    name = Path(tried.reference).stem
    found = answers(tried)
    if os.environ.get("SNAPSHOTS") == "write":
        rows = {each: row(each) for each in re.findall(r"^\| (\w+) \| (?:yes|\d)", PAGE.read_text(), re.MULTILINE)}
        rows[name] = found
        ordered = {each: rows[each] for each in [*OURS, *PUBLIC] if each in rows}
        head, rest = PAGE.read_text().split(BEGIN)
        PAGE.write_text(f"{head}{BEGIN}\n\n{written(ordered)}\n\n{END}{rest.split(END)[1]}")
    assert row(name) == found


def test_the_page_has_a_row_for_each_hand_and_an_answer_to_each_verb() -> None:
    for name in (*OURS, *PUBLIC):
        cells = row(name)
        assert len(cells) == len(VERBS)
        assert all(cell == "yes" or len(cell) > 5 for cell in cells)
