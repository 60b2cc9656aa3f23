"""The panel's choices, and what is asked for when nothing was chosen."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("viser", reason="needs viser: extra panel")

from allegro_twin.surfaces.panel import requests as r  # Behind the check for the extra.
from allegro_twin.surfaces.panel.page.controller_view import _NONE, _OWN, ControllerView, choices


@pytest.mark.parametrize(
    ("chosen", "expected"),
    [
        (None, ("(none)", "lemon", "mug")),
        ("mug", ("(none)", "lemon", "mug")),
        ("mine/cup.yaml", ("(none)", "mine/cup.yaml", "lemon", "mug")),
    ],
)
def test_what_was_chosen_by_a_path_is_one_of_the_choices_and_none_is_there_twice(
    chosen: str | None, expected: tuple[str, ...]
) -> None:
    assert choices("(none)", ("lemon", "mug"), chosen) == expected


class Gui:
    """As viser's: what is added is kept by its label, with what a click or a change calls."""

    def __init__(self) -> None:
        self.made: dict[str, Any] = {}

    def __getattr__(self, name: str) -> Any:
        def add(label: str, *what: Any, initial_value: Any = None, **more: Any) -> Any:
            begins = what[0] if name == "add_vector3" else initial_value
            options = what[0] if name == "add_dropdown" else ()
            made = SimpleNamespace(
                value=begins, options=options, disabled=False, visible=True, icon=None, color=more.get("color")
            )
            made.on_click = made.on_update = lambda call: setattr(made, "call", call)
            self.made[label] = made
            return Folder() if name == "add_folder" else made

        return add


Made = tuple[Gui, ControllerView, list[Any]]


class Folder:
    def __enter__(self) -> None: ...

    def __exit__(self, *raised: object) -> None: ...


def chosen(gui: Gui, label: str, value: Any = None, client: int | None = 1) -> None:
    made = gui.made[label]
    made.value = made.value if value is None else value
    event = SimpleNamespace(client_id=client, target=made)
    asyncio.run(made.call(event))


@pytest.fixture
def panel() -> Made:
    asked: list[Any] = []
    info = SimpleNamespace(
        kinds=("torque", "gravity", "pd"), gains=("default", "soft"), scenarios=("lemon", "mug"),
        object_names=("apple",), scenario=None, object_name=None, no_drag="", episode="",
    )  # fmt: skip
    gui = Gui()
    view = ControllerView(SimpleNamespace(ask=asked.append, info=info, client=SimpleNamespace(gui=gui)))  # type: ignore[arg-type]  # Looks alike.
    return gui, view, asked


def test_without_a_scenario_the_scene_is_the_configs_and_has_no_object_of_another(
    panel: Made,
) -> None:
    gui, _, asked = panel
    gui.made["Object"].value = "apple"
    chosen(gui, "Set the scene")
    gui.made["Scenario"].value = "mug"
    chosen(gui, "Perform it")
    gui.made["Object"].value = _OWN
    chosen(gui, "Set the scene")
    assert asked == [
        r.OpenScene(None, None, False),
        r.OpenScene("mug", "apple", True),
        r.OpenScene("mug", None, False),
    ]
    assert gui.made["Scenario"].value != _NONE


def test_gains_and_gravity_count_at_once_and_what_the_program_itself_sets_asks_for_nothing(
    panel: Made,
) -> None:
    gui, _, asked = panel
    chosen(gui, "Gains", "soft")
    chosen(gui, "As the hand reports", False)
    assert gui.made["m/s², palm"].visible
    chosen(gui, "As the hand reports", True)
    assert not gui.made["m/s², palm"].visible
    chosen(gui, "Gains", "default", client=None)
    chosen(gui, "m/s², palm", (1.0, 2.0, 3.0), client=None)
    assert asked == [r.ChooseGains("soft"), r.SetGravity((0.0, 0.0, -9.81)), r.SetGravity(None)]


def moment(kind: str, gains: str = "default", gravity: tuple[float, float, float] | None = None) -> Any:
    """All of a frame that is looked at."""
    return SimpleNamespace(kind=kind, gains=gains, gravity=gravity)


def test_gains_and_gravity_are_those_in_use_whoever_chose_them(panel: Made) -> None:
    gui, view, asked = panel
    gains, reported, vector = (gui.made[label] for label in ("Gains", "As the hand reports", "m/s², palm"))
    view.refresh(moment("pd", "soft", (0.0, 0.0, 9.81)))
    assert (gains.value, reported.value, vector.value, vector.visible) == ("soft", False, (0.0, 0.0, 9.81), True)
    view.refresh(moment("pd"))
    assert (gains.value, reported.value, vector.visible) == ("default", True, False)
    assert asked == []


def test_a_gravity_that_was_refused_goes_back_to_the_one_in_use_once_it_is_left_alone(panel: Made) -> None:
    gui, view, _ = panel
    view.refresh(moment("pd", gravity=(0.0, 0.0, 9.81)))
    chosen(gui, "m/s², palm", (0.0, 0.0, -981.0))
    seen = []
    for _ in range(5):
        view.refresh(moment("pd", gravity=(0.0, 0.0, 9.81)))
        seen.append(gui.made["m/s², palm"].value[2])
    assert seen == [-981.0, -981.0, -981.0, 9.81, 9.81]


def test_the_active_controller_is_marked_and_a_button_changes_it(panel: Made) -> None:
    gui, view, asked = panel
    for kind in ("gravity", "pd"):
        view.refresh(moment(kind))
        marked = {name for name in ("torque", "gravity", "pd") if gui.made[name].icon is not None}
        assert marked == {name for name in ("torque", "gravity", "pd") if gui.made[name].color == "blue"} == {kind}
    view.refresh(moment("the task's own"))
    assert gui.made["pd"].icon is None
    chosen(gui, "torque")
    assert asked == [r.ChooseController("torque")]
