"""The lab's cell: see a thing, take it, lift it, and say whether it is held."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allegro_twin.cli import options

if TYPE_CHECKING:
    from allegro_twin.lab.run import Report
    from allegro_twin.lab.states import Now

_CODES = {"held": 0, "missed": 5, "refused": 5, "fault": 4}


def register(app: typer.Typer) -> None:
    """Add the command to the command line."""
    app.command()(lab)


def lab(
    config: Annotated[Path, typer.Argument(help="Of a cell: conf/lab_allegro.yaml.")],
    thing: Annotated[
        str | None, typer.Option("--object", help="Of the catalogue, in place of the config's first.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Of the camera's and the force sensor's noise.")] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="A folder for pictures and recordings of arm and hand.", callback=options.folder),
    ] = None,
) -> None:
    """An arm with a hand and a camera takes a thing off the table: every state with its time, and the verdict."""
    from allegro_twin.cli.console import console
    from allegro_twin.files.assets import find
    from allegro_twin.files.schema import load
    from allegro_twin.lab.cell import make_room
    from allegro_twin.lab.kept import Kept
    from allegro_twin.lab.run import perform
    from allegro_twin.lab.settings import LabSettings

    settings = load(LabSettings, find(config, "config", "conf"))
    first = settings.objects[0]
    placed = (first.model_copy(update={"name": thing or first.name}), *settings.objects[1:])
    settings = settings.model_copy(update={"objects": placed, "seed": settings.seed if seed is None else seed})
    room = make_room(settings)

    def said(now: Now) -> None:
        attempt = f"  try {now.tries}" if now.tries > 1 and now.state == "ToSecurityPose" else ""
        console.print(f"{now.since:7.2f} s  {now.state}{attempt}", highlight=False)

    try:
        kept = None if out is None else Kept(room, out)

        def entered(now: Now) -> None:
            said(now)
            if kept is not None:
                kept.entered(now)

        stages = {} if kept is None else {"arm": kept.stage("arm"), "hand": kept.stage("hand")}
        report = perform(room, entered=entered, **stages)
        if kept is not None:
            kept.close()
    finally:
        room.close()
    for line in told(report):
        console.print(line, highlight=False, soft_wrap=True)
    if out is not None:
        console.print(f"In {out}/: pictures, arm.arrow, hand.arrow", soft_wrap=True)
    raise typer.Exit(_CODES[report.end.word])


def told(report: Report) -> list[str]:
    """What was seen, what the checks say, and the verdict."""
    lines = []
    if report.solid is not None:
        size = " x ".join(f"{1e3 * edge:.0f}" for edge in report.solid.size)
        lines.append(
            f"seen: a {report.solid.shape} of {size} mm, {1e3 * report.error:.1f} mm off; grasp: {report.grasp}"
        )
    if report.checked is not None:
        check = report.checked
        lines.append(
            f"weight {1e3 * check.weight:.0f} g: {_there(check.by_force)}; fingers stopped by {check.torque:.2f} N·m: "
            f"{_there(check.by_torque)}; {check.between:.2f} N·m between them: {_there(check.by_fingers)}; in truth "
            f"lifted by {1e3 * report.lifted:.0f} mm"
        )
    sentence = f"; {report.end.sentence}" if report.end.sentence else ""
    return [*lines, f"{report.end}{sentence}"]


def _there(held: bool) -> str:
    return "held" if held else "not held"
