"""The commands for an open hand ask it for what they say, and tables and pages show what was found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from rich.console import Console
from rich.table import Table

import allegro_twin.surfaces.hand
from allegro_twin.app.config import RunConfig, load_config
from allegro_twin.errors import ConfigError, HandError, HandFault, ProtocolError
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import load_settings
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.entries import GraspFile, TrajectoryFile
from allegro_twin.hands.library.library import Library
from allegro_twin.hands.library.taxonomy import GRASP_TYPES, ObservedType
from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.cli import console
from allegro_twin.surfaces.cli.grasps import gallery
from allegro_twin.surfaces.cli.start.keys import press
from allegro_twin.surfaces.hand.grasps import GraspOutcome
from allegro_twin.twin.identify import joint_ends as calibration
from allegro_twin.twin.identify.joint_ends import find_limits
from allegro_twin.twin.identify.motions.limits import TORQUE, FoundLimits
from tests.surfaces.cli.conftest import Run
from tests.test_safety import state


def text(table: Table) -> str:
    shown = Console(width=200)
    with shown.capture() as capture:
        shown.print(table)
    return " ".join(capture.get().replace("│", " ").split())


class Spy:
    """In the place of `Hand`: keeps what it was asked for, or refuses."""

    def __init__(self, refusal: HandError | None = None) -> None:
        self.asked, self.refusal, self.spec, self.state = list[Any](), refusal, load_spec(), state(3)

    controllers = ("torque", "gravity", "pd", "pid")

    def __enter__(self) -> Spy:
        return self

    def __exit__(self, *ended: object) -> None:
        self.asked.append("closed")

    @property
    def direct(self) -> Spy:
        return self

    def usual_speed(self, usual: float) -> float:
        return usual

    def move_to(self, *how: object, **more: object) -> None:
        self._keep("move_to", *how, more)

    def grasp(self, *how: object, **more: object) -> GraspOutcome:
        self._keep("grasp", *how, more)
        return GraspOutcome("quadpod", ("index", "thumb"), {"index": 1.25, "thumb": 2.5}, 0.042)

    def set_controller(self, kind: str) -> None:
        self._keep("set_controller", kind)

    def _keep(self, *what: object) -> None:
        if self.refusal is not None:
            raise self.refusal
        self.asked.append(what)


def test_posture_and_grasp_hand_their_options_on_and_let_go(command: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    spy, opened = Spy(), list[str]()

    def open_(config: RunConfig) -> Spy:
        opened.append(config.hand.side)
        return spy

    monkeypatch.setattr(allegro_twin.surfaces.hand.Hand, "open", open_)
    assert command("posture", "home", "--speed", "0.5", "-c", "sim_left")[0] == 0
    code, shown, _ = command("grasp", "quadpod", "--width", "0.04", "--force", "2")
    assert code == 0
    assert "pads 42 mm apart" in shown
    assert opened == ["left", "right"]
    assert spy.asked == [
        ("move_to", "home", 0.5, {}),
        "closed",
        ("grasp", "quadpod", {"object_width": 0.04, "force": 2.0}),
        "closed",
    ]


@pytest.mark.parametrize(
    ("key", "asked"),
    [
        *((key, ("move_to", name, 1.0, {"wait": False})) for key, name in
          zip("hr123", ("home", "ready", "rock", "scissors", "paper"), strict=True)),
        *((key, ("grasp", name, {"wait": False})) for key, name in
          zip("gkpme", ("grasp_3", "grasp_4", "pinch_index", "pinch_middle", "envelop"), strict=True)),
        ("a", ("set_controller", "gravity")),
        ("o", ("set_controller", "torque")),
    ],
)  # fmt: skip
def test_a_key_asks_the_hand_for_what_it_stands_for(key: str, asked: tuple[object, ...]) -> None:
    spy = Spy()
    press(spy, key)  # type: ignore[arg-type]  # In its place.
    assert spy.asked == [asked]


def test_what_a_key_cannot_have_is_entries_and_a_fault_ends_the_session() -> None:
    assert press(Spy(ConfigError("too near")), "h") == "too near"  # type: ignore[arg-type]  # In its place.
    for fault in (HandFault("too fast"), ProtocolError("noise")):
        with pytest.raises(type(fault)):
            press(Spy(fault), "h")  # type: ignore[arg-type]  # In its place.


def test_a_motion_is_stored_as_the_way_that_the_fingers_went(command: Run, tmp_path: Path) -> None:
    """Nobody moves them: they go as far as gravity compensation lets them drift."""
    code, shown, _ = command("teach", "wave", "--motion", "--seconds", "0.3", "--into", tmp_path / "t.yaml")
    assert code == 0
    assert "Move the fingers; 0.3 s from now on." in shown
    (listed,) = [entry for entry in Library(tmp_path / "t.yaml").list("trajectory") if entry.name == "wave"]
    assert isinstance(listed.entry, TrajectoryFile)
    assert len(listed.entry.times) >= 2
    assert listed.entry.times[-1] <= 0.3


def test_a_negative_margin_is_refused_where_a_hand_is_entries(command: Run, tmp_path: Path) -> None:
    (tmp_path / "c.yaml").write_text("backend: {kind: sim}\ncontroller: {kind: pd}\nlimits: {margin: -0.1}\n")
    code, _, errors = command("hand", "show", "-c", tmp_path / "c.yaml")
    assert code == 2
    assert "limits.margin is negative: only calibration may go beyond the limits" in errors


def test_tables_show_the_numbers_of_their_columns(spec: HandSpec) -> None:
    row = np.arange(16) / 10
    shown = text(console.final_state(spec, state(3, position=row)))
    assert "index 0.0000 0.1000 0.2000 0.3000 middle 0.4000" in shown
    assert "joint positions, rad" in shown
    tendons = load_spec("model_o")
    assert "positions of the motors, in their own units" in text(console.final_state(tendons, state(3, position=row)))
    mine = replace(spec, lower=spec.lower + 0.01, upper=spec.upper - 0.02)
    shown = text(console.identity(spec, mine, 0.1))
    low, high = spec.lower[0], spec.upper[0]
    assert f"index_0 {low:+.3f} {high:+.3f} {low + 0.11:+.3f} {high - 0.12:+.3f}" in shown
    found = FoundLimits(spec.lower - 0.03, spec.upper + 0.05)
    shown = text(console.limits(spec, found))
    assert f"index_0 {low - 0.03:+.3f} {low:+.3f} {high + 0.05:+.3f} {high:+.3f}" in shown


def test_calibration_may_go_beyond_the_limits_and_pushes_gently() -> None:
    config = load_config("sim_right")
    limits = calibration._searching(config).limits
    assert limits.margin < 0 <= config.limits.margin
    assert limits.torque == TORQUE < load_spec().actuation.torque_limit.max()
    assert limits.velocity == config.limits.velocity


def test_calibration_by_hand_pushes_no_joint_and_lasts_as_long_as_it_was_told() -> None:
    told: list[tuple[float, float]] = []
    spec, found = find_limits(load_config("sim_right"), 0.3, lambda t, total: told.append((t, total)))
    assert spec.name == load_config("sim_right").hand.model + "_right"
    assert told[-1][0] == pytest.approx(0.3)
    assert told[-1][1] == 0.3
    assert (found.upper - found.lower).max() < 0.05


def test_the_page_of_grasps_is_in_the_order_of_the_taxonomy_with_a_picture_each(
    command: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = {"prismatic_3_finger": 7, "ring": 31}
    stored = {
        name: load_settings(GraspFile, data_root() / "conf" / "grasps" / f"{name}.yaml").model_copy(
            update={"observed": ObservedType(number=number, name=GRASP_TYPES[number].name)}
        )
        for name, number in seen.items()
    }
    names = sorted(stored, key=lambda name: seen[name], reverse=True)
    verdicts = {
        names[0]: "[lemon](../../scenarios): held, 1.0 mm of drift",
        names[1]: "[mug](../../scenarios): not held: it fell",
    }
    picture = np.full((40, 40, 3), 200, dtype=np.uint8)
    monkeypatch.setattr(
        gallery,
        "_entries",
        lambda draws: (
            (gallery.GalleryEntry(n, stored[n], verdicts[n], f"3 of {draws} (9–61 %)"), picture) for n in names
        ),
    )
    code, shown, _ = command("gallery", tmp_path, "--draws", 9)
    page = (tmp_path / "grasps.md").read_text()
    assert (code, shown) == (0, f"2 grasps in {tmp_path}/grasps.md\n")
    assert page.index(f"**{names[1]}**") < page.index(f"**{names[0]}**")
    assert "2 grasps, 1 of which hold an object" in page
    assert "They are of 1 of the 33 types" in page
    assert "31 Ring" in page
    assert "not known" in page  # Nothing is said of the type of what was lost.
    assert page.count("| 3 of 9 (9–61 %) |") == 2
    assert "--uncertainty 9`" in page
    for name in names:
        assert verdicts[name] in page
        with Image.open(tmp_path / "images" / "grasps" / f"{name}.jpg") as made:
            assert made.size == (300, 300)
