"""The lab's cell: see a thing, take it, lift it, and say whether it is held."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import options
from allegro_twin.surfaces.cli.surfaces.leading import bridged, lead

if TYPE_CHECKING:
    from allegro_twin.cell.assembly import Cell
    from allegro_twin.cell.journal.observers import Observer, ObserverCamera, Observers
    from allegro_twin.cell.run import LabReport, SampleStage
    from allegro_twin.cell.states import MachineState

_ROS_PICTURES = 5.0  # Hz, of what the camera sees, where nothing is said.
_CODES = {"held": 0, "missed": 5, "refused": 5, "fault": 4}


def register(app: typer.Typer) -> None:
    """Add the command to the command line."""
    app.command()(lab)


def lab(
    config: Annotated[Path, typer.Argument(help="Of a cell: conf/lab_allegro.yaml.")],
    thing: Annotated[
        str | None, typer.Option("--object", help="Of the catalogue, in place of the config's first.")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the camera's and the force sensor's noise.")] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="A folder for pictures, and for a recording of everything.", callback=options.folder),
    ] = None,
    pictures: Annotated[
        float, typer.Option(help="So many pictures of the camera a second are recorded, and shown, Hz; 0: none.")
    ] = 0.0,
    view: Annotated[bool, typer.Option(help="Watch it live in Rerun's own window.")] = False,
    web: Annotated[bool, typer.Option(help="Watch it live in Rerun in the browser.")] = False,
    ros: Annotated[bool, typer.Option("--ros", help="Put the cell on ROS 2, on this machine (docs/ros.md).")] = False,
    namespace: Annotated[str, typer.Option(help="Of its topics, with --ros.")] = "/",
    follow: Annotated[
        bool, typer.Option("--follow", help="Decide nothing: be remote by --panel, or by target_frame with --ros.")
    ] = False,
    panel: Annotated[bool, typer.Option("--panel", help="Lead the palm by a marker in the browser.")] = False,
    port: Annotated[int, typer.Option(help="Of that page.", callback=options.port)] = 8080,
) -> None:
    """An arm with a hand and a camera takes a thing off the table: every state with its time, and the verdict."""
    from allegro_twin.cell.assembly import make_cell
    from allegro_twin.cell.journal.observers import Observers
    from allegro_twin.cell.remote.remote_control import RemoteControl
    from allegro_twin.cell.settings import LabSettings
    from allegro_twin.files.assets import find_file
    from allegro_twin.files.schema import load_settings
    from allegro_twin.surfaces.cli.console import console

    settings = load_settings(LabSettings, find_file(config, "config", "conf"))
    first = settings.objects[0]
    placed = (first.model_copy(update={"name": thing or first.name}), *settings.objects[1:])
    settings = settings.model_copy(update={"objects": placed, "seed": settings.seed if seed is None else seed})
    if follow and not (ros or panel):
        raise ConfigError("--follow needs somebody who leads: say --panel, or --ros")
    cell = make_cell(settings)
    with ExitStack() as stack:
        folder = None if out is None else stack.enter_context(options.run_folder(out))
        stack.callback(cell.close)
        observers, lens = _observers(cell, folder, pictures or (_ROS_PICTURES if ros else 0.0), stack)
        if view or web:
            observers.append(_viewer(cell, stack, web=web))
        remote = RemoteControl(cell) if follow or panel else None
        if ros:
            observers.append(bridged(cell, remote, namespace, stack))
        if remote is not None:
            lead(remote, (observers, lens), port if panel else 0, stack)
            return
        report = _performed(cell, Observers(cell, observers, lens), live=view or web or ros)
    for line in told(report):
        console.print(line, highlight=False, soft_wrap=True)
    if out is not None:
        console.print(f"In {out}/: pictures, and all of it in lab.arrow", soft_wrap=True)
    raise typer.Exit(_CODES[report.end.word])


def _observers(
    cell: Cell, out: Path | None, pictures: float, stack: ExitStack
) -> tuple[list[Observer], ObserverCamera | None]:
    """Who looks on, and by which camera; `stack` lets go of them."""
    from allegro_twin.cell.journal.observers import RECORDING, ObserverCamera, StatePictures
    from allegro_twin.cell.journal.recording import SessionRecorder

    found: list[Observer] = []
    lens = ObserverCamera(cell, pictures) if pictures else None
    if lens is not None:
        stack.callback(lens.close)
    if out is not None:
        recorded, kept = SessionRecorder(cell, out / RECORDING), StatePictures(cell, out)
        stack.callback(recorded.close)
        stack.callback(kept.close)
        found += [recorded, kept]
    return found, lens


def _viewer(cell: Cell, stack: ExitStack, *, web: bool) -> Observer:
    """Rerun, which shows what happens from now on."""
    from allegro_twin.surfaces.cli.console import console
    from allegro_twin.surfaces.cli.run import cells

    viewer = cells.live(cell)
    stack.callback(viewer.close)
    if web:
        console.print(f"Open {viewer.serve()}", soft_wrap=True, highlight=False)
    else:
        viewer.spawn()
    return viewer


def _performed(cell: Cell, observers: Observers, *, live: bool) -> LabReport:
    """`live`: no faster than real time."""
    from allegro_twin.cell.run import perform
    from allegro_twin.loop import paced
    from allegro_twin.surfaces.cli.console import console

    def entered(now: MachineState) -> None:
        attempt = f"  try {now.tries}" if now.tries > 1 and now.state == "ToSecurityPose" else ""
        console.print(f"{now.since:7.2f} s  {now.state}{attempt}", highlight=False)
        observers.on_state(now)

    arm: SampleStage = (lambda samples: paced(observers.arm(samples))) if live else observers.arm
    return perform(cell, arm=arm, hand=observers.hand, on_state=entered, on_prepare=observers.on_prepare)


def told(report: LabReport) -> list[str]:
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
            f"{_there(check.by_torque)}; {check.between:.2f} N·m between them: {_there(check.by_fingers)}; camera: "
            f"{_there(check.by_camera)}; in truth {report.thing} was lifted by {1e3 * report.lifted:.0f} mm"
        )
    lines += [f"another object, {name}, was moved by {1e3 * way:.0f} mm" for name, way in report.moved]
    sentence = f"; {report.end.sentence}" if report.end.sentence else ""
    return [*lines, f"{report.end}{sentence}"]


def _there(held: bool | None) -> str:
    if held is None:
        return "cannot tell"
    return "held" if held else "not held"
