"""A fake of viser, as much of it as the page uses: what is added is kept, and tests click and drag."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import numpy as np


class Handle(SimpleNamespace):
    """Something on the page or in the picture."""

    def on_click(self, call: Callable[[Any], Any]) -> None:
        self.clicked = call

    def on_update(self, call: Callable[[Any], Any]) -> None:
        self.updated = call

    def on_drag(self, button: str) -> Callable[[Callable[[Any], Any]], None]:
        assert button == "left"
        return lambda call: setattr(self, "dragged", call)

    def on_drag_end(self, call: Callable[[Any], Any]) -> None:
        self.dropped = call

    def remove(self) -> None:
        self.removed = True
        if self.parent is not None:
            self.parent._children.pop(id(self), None)

    def add_tab(self, label: str) -> Handle:
        made: Handle = self.maker.made_one("tab", label)
        return made

    def __enter__(self) -> Handle:
        self.maker.inside.append(self)
        return self

    def __exit__(self, *raised: object) -> None:
        self.maker.inside.pop()


class Maker:
    """A part of viser whose `add_…` makes things."""

    def __init__(self) -> None:
        self.made: list[Handle] = []
        self.inside: list[Handle] = []

    def made_one(self, kind: str, name: str, *given: Any, **more: Any) -> Handle:
        parent = self.inside[-1] if self.inside else None
        more = {"disabled": False, "visible": True, "value": None, "icon": None, "color": None} | more
        made = Handle(kind=kind, name=name, given=given, maker=self, parent=parent, removed=False, _children={}, **more)
        self.made.append(made)
        if parent is not None:
            parent._children[id(made)] = made
        return made

    def __getattr__(self, asked: str) -> Any:
        if not asked.startswith("add_"):
            raise AttributeError(asked)
        kind = asked.removeprefix("add_")

        def add(name: Any = "", *given: Any, **more: Any) -> Handle:
            match kind:
                case "html":
                    more["content"] = name
                case "button":
                    more["label"] = name
                case "checkbox":
                    more["value"] = more["initial_value"]
                case "dropdown":
                    more["value"] = more.get("initial_value", given[0][0])
                case "slider":
                    more |= dict(zip(("min", "max", "step", "value"), given, strict=True))
                case "vector3" | "text":
                    more["value"] = given[0]
                case "transform_controls":
                    more |= {"position": np.zeros(3), "wxyz": np.array([1.0, 0.0, 0.0, 0.0])}
                case "frame":
                    more |= {"position": None, "wxyz": None}
                case "uplot":
                    more |= {"data": name, "series": given[0]}
                case "arrows":
                    more |= {"points": given[0]}
            return self.made_one(kind, name if isinstance(name, str) else "", *given, **more)

        return add

    def reset(self) -> None:
        self.made.clear()

    def named(self, name: str, kind: str = "") -> Handle:
        """The newest that has a name, or a label now."""
        return next(
            each
            for each in reversed(self.made)
            if (each.name == name or getattr(each, "label", None) == name) and kind in ("", each.kind)
        )


class Gui(Maker):
    panel = ""

    def set_panel_label(self, label: str) -> None:
        self.panel = label


class Scene(Maker):
    def add_light_hemisphere(self, *given: Any, **more: Any) -> None:
        self.made_one("light", "/sky", *given, **more)

    def at(self, name: str) -> Handle:
        return self.named(name)


class Client:
    """A browser."""

    def __init__(self, who: int) -> None:
        self.client_id, self.gui, self.scene = who, Gui(), Scene()
        self.told: list[tuple[str, str, str]] = []
        self.shown_for: list[float] = []

    def add_notification(self, title: str, text: str, *, auto_close_seconds: float, color: str) -> None:
        self.told.append((title, text, color))
        self.shown_for.append(auto_close_seconds)


class Server:
    """A page for browsers that come and go."""

    def __init__(self) -> None:
        self.scene, self.initial_camera = Scene(), SimpleNamespace(position=None, look_at=None, up=None)
        self.come: Callable[[Client], None]
        self.gone: Callable[[Client], None]
        self.together = 0

    def on_client_connect(self, call: Callable[[Client], None]) -> None:
        self.come = call

    def on_client_disconnect(self, call: Callable[[Client], None]) -> None:
        self.gone = call

    @contextmanager
    def atomic(self) -> Iterator[None]:
        self.together += 1
        yield


def click(handle: Handle, value: Any = None) -> None:
    if value is not None:
        handle.value = value
    asyncio.run(handle.clicked(SimpleNamespace(client_id=1, client=1, target=handle)))


def change(handle: Handle, value: Any, client: int | None = 1) -> None:
    """Somebody's, or where there is no client the program's own."""
    handle.value = value
    asyncio.run(handle.updated(SimpleNamespace(client_id=client, client=client, target=handle)))


def drag(handle: Handle, position: Any) -> None:
    handle.position = np.array(position)
    asyncio.run(handle.updated(SimpleNamespace(client_id=1, client=1, target=handle)))


def drop(handle: Handle) -> None:
    asyncio.run(handle.dropped(SimpleNamespace(client_id=1, client=1, target=handle)))


def drag_mesh(handle: Handle, phase: str, start: Any, end: Any, client: int = 1) -> None:
    """The mouse on a mesh of the picture: world points, m."""
    event = SimpleNamespace(client_id=client, client=client, target=handle, phase=phase, start_position=start,
                            end_position=end)  # fmt: skip
    asyncio.run(handle.dragged(event))
