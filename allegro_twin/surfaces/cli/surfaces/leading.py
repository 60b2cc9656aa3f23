"""A cell that is remote from outside: by a marker in the browser, by programs on ROS 2."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING

from allegro_twin.errors import ConfigError

if TYPE_CHECKING:
    from allegro_twin.cell.assembly import Cell
    from allegro_twin.cell.journal.observers import Observer, ObserverCamera
    from allegro_twin.cell.remote.remote_control import RemoteControl
    from allegro_twin.recording.events import SessionEvent
    from allegro_twin.surfaces.ros.bridge import RosBridge


def bridged(cell: Cell, remote: RemoteControl | None, namespace: str, stack: ExitStack) -> RosBridge:
    """Put a cell on ROS 2, where `remote` carries out commands. Raises ConfigError without Cyclone DDS."""
    from allegro_twin.surfaces.cli.console import console
    from allegro_twin.surfaces.cli.surfaces.ros import domain_of

    domain = domain_of()
    try:
        from allegro_twin.surfaces.ros import open_cell

        bridge = stack.enter_context(open_cell(cell, remote, namespace=namespace, domain=domain))
    except ImportError as error:
        raise ConfigError(f"--ros needs Cyclone DDS: pip install 'allegro-twin[ros2]' ({error})") from error
    console.print(f"The cell is on ROS domain {domain} in {namespace}", soft_wrap=True, highlight=False)
    return bridge


def lead(
    remote: RemoteControl, looking: tuple[list[Observer], ObserverCamera | None], port: int, stack: ExitStack
) -> None:
    """Until Ctrl-C: whoever moves the marker at a port, 0: none, or the target on ROS, is obeyed."""
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
        console.print(f"Open {host.serve_beside()} (Ctrl-C ends it)", soft_wrap=True, highlight=False, markup=False)
    else:
        console.print("Ctrl-C ends it")
    try:
        run_remote_control(remote, Observers(remote.cell, [*observers, Refusals()], lens))
    except KeyboardInterrupt:
        return


class Refusals:
    """An onlooker that says what was refused."""

    def on_event(self, event: SessionEvent) -> None:
        """Print it."""
        from allegro_twin.recording.events import JournalEntry
        from allegro_twin.surfaces.cli import console

        if isinstance(event, JournalEntry) and event.track == "states" and event.row.get("sentence"):
            console.warn(str(event.row["sentence"]))
