"""The command `lab`: a cell of arm, hand and camera picks an object, or is controlled from outside."""

from __future__ import annotations

from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.files.first_error import closing_noted
from allegro_twin.surfaces.cli import options

if TYPE_CHECKING:
    from allegro_twin.cell.assembly import Cell
    from allegro_twin.cell.journal.observers import Observer, ObserverCamera, Observers
    from allegro_twin.cell.perception.fits.model import Solid
    from allegro_twin.cell.remote.remote_control import RemoteControl
    from allegro_twin.cell.run import LabReport, SampleStage
    from allegro_twin.cell.settings import LabSettings, TableObjectSettings
    from allegro_twin.cell.states import MachineState
    from allegro_twin.recording.events import SessionEvent
    from allegro_twin.surfaces.ros.bridge import RosBridge

_ROS_PICTURES = 5.0  # Hz; default rate of the camera's point clouds on ROS.
_CODES = {"held": 0, "cleared": 0, "missed": 5, "refused": 5, "fault": 4}


def lab(
    config: Annotated[Path, typer.Argument(help="Config of a cell, such as conf/lab_allegro.yaml.")],
    object_name: Annotated[
        str | None,
        typer.Option("--object", help="Object on the table; or of the catalogue, or a mesh file, for the first."),
    ] = None,
    scale: Annotated[
        float | None,
        typer.Option(help="Unit of a mesh for --object, m; default: as its size says.", callback=options.positive),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of the noise of camera and force sensor.")] = None,
    clear: Annotated[
        bool, typer.Option("--clear", help="Clear the table: put one object after the other away.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for pictures and a recording of everything.",
            callback=options.folder,
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    film: Annotated[
        Path | None,
        typer.Option(
            help="Film of the run, an .mp4; replaces what is there.",
            callback=options.film,
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    pictures: Annotated[
        float,
        typer.Option(help="Rate of camera pictures to record and show, Hz; 0: none.", rich_help_panel=options.OUTPUT),
    ] = 0.0,
    view: Annotated[
        bool, typer.Option(help="Watch live in Rerun's own window.", rich_help_panel=options.OUTPUT)
    ] = False,
    web: Annotated[bool, typer.Option(help="Watch live in the browser.", rich_help_panel=options.OUTPUT)] = False,
    ros: Annotated[bool, typer.Option("--ros", help="Serve the cell on ROS 2, on this machine only.")] = False,
    namespace: Annotated[str | None, typer.Option(help="Namespace of the topics of --ros; / where not given.")] = None,
    follow: Annotated[
        bool, typer.Option("--follow", help="Do not pick; follow the marker of --panel, or target_frame of --ros.")
    ] = False,
    panel: Annotated[bool, typer.Option("--panel", help="Control the palm by a marker in the browser.")] = False,
    port: Annotated[
        int | None, typer.Option(help="TCP port of the page of --panel; 8080 where not given.", callback=options.port)
    ] = None,
) -> None:
    """Pick an object with arm, hand and camera in simulation."""
    from allegro_twin.cell.assembly import make_cell
    from allegro_twin.cell.journal.observers import Observers, film_stage
    from allegro_twin.cell.remote.remote_control import RemoteControl
    from allegro_twin.cell.settings import LabSettings, TraySettings
    from allegro_twin.files.assets import find_file
    from allegro_twin.files.schema import load_settings
    from allegro_twin.surfaces.cli.console import console, hint, say

    options.refuse_mesh(config)
    file = find_file(config, "config", "conf")
    settings = load_settings(LabSettings, file)
    objects, wanted = _objects(settings, object_name, scale, file.parent)
    settings = settings.model_copy(
        update={
            "objects": objects,
            "seed": settings.seed if seed is None else seed,
            "tray": TraySettings() if clear and settings.tray is None else settings.tray,
        }
    )
    if follow and not (ros or panel):
        raise ConfigError("--follow needs somebody who leads: say --panel, or --ros")
    if namespace is not None and not ros:
        raise ConfigError("--namespace is of --ros: say --ros as well")
    if port is not None and not panel:
        raise ConfigError("--port is of --panel: say --panel as well")
    if (follow or panel) and (film is not None or clear):
        raise ConfigError(
            f"{'--clear' if clear else '--film'} is of a cell that picks by itself, and with "
            f"{'--follow' if follow else '--panel'} somebody leads it: leave out one of them"
        )
    cell = make_cell(settings, wanted=wanted)
    report, unwritten = None, ""
    try:
        with options.interruptible(film), ExitStack() as stack:
            folder = None if out is None else stack.enter_context(options.run_folder(out))
            stack.callback(cell.close)
            observers, lens = _observers(cell, folder, pictures or (_ROS_PICTURES if ros else 0.0), stack)
            if view or web:
                observers.append(_viewer(cell, stack, web=web))
            remote = RemoteControl(cell) if follow or panel else None
            if ros:
                observers.append(_open_bridge(cell, remote, namespace or "/", stack))
            if remote is not None:
                _follow(remote, (observers, lens), (port or 8080) if panel else 0, stack)
                return
            live = view or web or ros or settings.camera.source.kind == "realsense"
            looking = Observers(cell, observers, lens)
            shown = looking.hand if film is None else stack.enter_context(film_stage(cell, film, looking.hand))
            report = _performed(cell, looking, shown, live=live)
            if looking.unwritten is not None:
                raise looking.unwritten
    except RecordingError as error:
        if report is None:
            raise
        unwritten = str(error)
    for line in outcome_lines(report):
        console.print(line, highlight=False, soft_wrap=True)
    if unwritten:
        options.end_unwritten(unwritten, _CODES[report.end.kind])
    if out is not None:
        say(f"In {out}/: pictures, and all of it in lab.arrow")
    elif not (view or web or ros):
        hint("Next: --out FOLDER keeps pictures and a recording; --view shows it live")
    raise typer.Exit(_CODES[report.end.kind])


def _objects(
    settings: LabSettings, object_name: str | None, scale: float | None, folder: Path
) -> tuple[tuple[TableObjectSettings, ...], str | None]:
    """What stands on the table, and the name of what is wanted: the object of that name, or else what `object_name`
    is, where the first one would stand; files are those of the config's folder. Raises ConfigError."""
    from allegro_twin.cell.settings import TableObjectSettings
    from allegro_twin.grasping.scenario import parse_object

    objects, place = list(settings.objects), 0
    names = [each.name for each in objects]
    if object_name in names:
        place = names.index(object_name)
    elif object_name is not None:
        first = objects[0]
        placed, asked = {"at": first.at[:2], "yaw": first.yaw}, parse_object(object_name)
        if asked.name in names[1:]:
            raise ConfigError(
                f"--object {object_name}: another {asked.name} is on the table; rename one: objects have different "
                f"names. --object {asked.name} takes that one"
            )
        objects[0] = TableObjectSettings(**{**asked.model_dump(exclude_unset=True), **placed})
    if scale is not None:
        if object_name is None or objects[place].file is None:
            raise ConfigError(f"--scale is for the mesh of --object; {objects[place].name} is none")
        objects[place] = objects[place].model_copy(update={"scale": scale})
    found = tuple(
        each if each.file is None else each.model_copy(update={"file": (folder / each.file).resolve()})
        for each in objects
    )
    return found, None if object_name is None else objects[place].name


def _observers(
    cell: Cell, out: Path | None, pictures: float, stack: ExitStack
) -> tuple[list[Observer], ObserverCamera | None]:
    """The observers of the cell and their camera; `stack` closes them."""
    from allegro_twin.cell.journal.observers import RECORDING, ObserverCamera, StatePictures
    from allegro_twin.cell.journal.recording import SessionRecorder

    found: list[Observer] = []
    lens = ObserverCamera(cell, pictures) if pictures else None
    if lens is not None:
        stack.callback(lens.close)
    if out is not None:
        recorded, kept = SessionRecorder(cell, out / RECORDING), StatePictures(cell, out)
        stack.enter_context(closing_noted(recorded))
        stack.callback(kept.close)
        found += [recorded, kept]
    return found, lens


def _viewer(cell: Cell, stack: ExitStack, *, web: bool) -> Observer:
    """A live Rerun viewer."""
    from allegro_twin.surfaces.cli.console import say
    from allegro_twin.surfaces.cli.start.view import cell_viewer

    viewer = cell_viewer(cell)
    stack.callback(viewer.close)
    if web:
        say(f"Open {viewer.serve()}")
    else:
        viewer.spawn()
    return viewer


def _performed(cell: Cell, observers: Observers, hand: SampleStage, *, live: bool) -> LabReport:
    """Run the state machine. `hand`: the stage of the hand; `live`: not faster than real time."""
    from allegro_twin.cell.run import perform
    from allegro_twin.loop import paced
    from allegro_twin.surfaces.cli.console import say

    def entered(now: MachineState) -> None:
        attempt = f"  try {now.tries}" if now.tries > 1 and now.state == "ToSecurityPose" else ""
        say(f"{now.since:7.2f} s  {now.state}{attempt}")
        if now.state == "Retreat" and now.cause is not None:
            say(f"           {now.cause.sentence}")
        observers.on_state(now)

    def planning(said: str) -> None:
        say(f"           {said}")

    arm: SampleStage = (lambda samples: paced(observers.arm(samples))) if live else observers.arm
    return perform(cell, arm=arm, hand=hand, on_state=entered, on_prepare=observers.on_prepare, on_planning=planning)


def outcome_lines(report: LabReport) -> list[str]:
    """What perception found, the results of the checks, and the verdict."""
    lines = []
    if report.solid is not None:
        lines.append(f"seen: {solid_text(report.solid)}, {1e3 * report.error:.1f} mm off; grasp: {report.grasp}")
    if report.checked is not None:
        check = report.checked
        lines.append(
            f"weight {1e3 * check.weight:.0f} g: {_there(check.by_force)}; fingers stopped by {check.torque:.2f} N·m: "
            f"{_there(check.by_torque)}; {check.between:.2f} N·m between them: {_there(check.by_fingers)}; camera: "
            f"{_there(check.by_camera)}; in truth {_truth(report)}"
        )
    if report.released or report.in_tray:
        places = {"in it": report.in_tray, "on the table": report.on_table, "off the table": report.off_table}
        said = "; ".join(f"{where}: {', '.join(names)}" for where, names in places.items() if names)
        lines.append(f"{report.released} put into the tray, as the cell counts; in truth {said or 'none is in it'}")
        return [*lines, f"{report.end}; {report.end.sentence}"]
    for name, way in report.moved:
        said = "is in the hand, too" if name in report.in_hand else f"was moved by {1e3 * way:.0f} mm"
        lines.append(f"another object, {name}, {said}")
    lines += [f"another object, {name}, fell off the table" for name in report.off_table if name != report.object_name]
    sentence = f"; {report.end.sentence}" if report.end.sentence else ""
    return [*lines, f"{report.end}{sentence}"]


def _truth(report: LabReport) -> str:
    """Where the thing really is, by its name."""
    if report.object_name in report.off_table:
        return f"{report.object_name} is off the table"
    higher = "higher" if report.lifted >= 0.0 else "lower"
    return f"{report.object_name} is {1e3 * abs(report.lifted):.0f} mm {higher} than where it stood"


def solid_text(solid: Solid) -> str:
    """Shape and size of what perception found; of a sphere, whose edges differ by what is not known, one diameter."""
    if solid.shape == "sphere":
        return f"a sphere of {1e3 * sum(solid.size) / 3.0:.0f} mm"
    return f"a {solid.shape} of {' x '.join(f'{1e3 * edge:.0f}' for edge in solid.size)} mm"


def _there(held: bool | None) -> str:
    if held is None:
        return "cannot tell"
    return "held" if held else "not held"


def _open_bridge(cell: Cell, remote: RemoteControl | None, namespace: str, stack: ExitStack) -> RosBridge:
    """Serve a cell on ROS 2, where `remote` carries out commands. Raises ConfigError without Cyclone DDS."""
    from allegro_twin.surfaces.cli.console import say
    from allegro_twin.surfaces.cli.hardware.ros import domain_of

    domain = domain_of()
    try:
        from allegro_twin.surfaces.ros import open_cell

        bridge = stack.enter_context(open_cell(cell, remote, namespace=namespace, domain=domain))
    except ImportError as error:
        raise ConfigError(f"--ros needs Cyclone DDS: pip install 'allegro-twin[ros2]' ({error})") from error
    say(f"The cell is on ROS domain {domain} in {namespace}")
    return bridge


def _follow(
    remote: RemoteControl, looking: tuple[list[Observer], ObserverCamera | None], port: int, stack: ExitStack
) -> None:
    """Follow the marker of the page at `port` (0: no page), or the target on ROS, until Ctrl-C."""
    from allegro_twin.cell.journal.observers import Observers
    from allegro_twin.cell.remote.remote_control import run_remote_control
    from allegro_twin.surfaces.cli.console import console

    observers, lens = looking
    if port:
        from allegro_twin.surfaces.panel.cell_session import CellSession
        from allegro_twin.surfaces.panel.host import Host
        from allegro_twin.surfaces.panel.page_process import PageServer

        session = CellSession(remote)
        host = Host(session, PageServer("127.0.0.1", port, "hold"))
        stack.callback(host.close)
        observers.append(session)
        console.print(
            f"Open {host.serve_in_background()} (Ctrl-C ends it)", soft_wrap=True, highlight=False, markup=False
        )
    else:
        console.print("Ctrl-C ends it")
    hearing = Observers(remote.cell, [*observers, _PrintRefusals()], lens)
    with suppress(KeyboardInterrupt):
        run_remote_control(remote, hearing)
    if hearing.unwritten is not None:
        raise hearing.unwritten


class _PrintRefusals:
    """Observer that prints refused commands."""

    def on_event(self, event: SessionEvent) -> None:
        """Print the refusal of an event."""
        from allegro_twin.recording.events import JournalEntry
        from allegro_twin.surfaces.cli import console

        if isinstance(event, JournalEntry) and event.track == "states" and event.row.get("sentence"):
            console.warn(str(event.row["sentence"]))
