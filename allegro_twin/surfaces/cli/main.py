"""The command line: every command, in the panel in which `allegro-twin --help` shows it.

Exit codes: 0 done; 2 config, file or usage; 3 link; 4 fault, or a motion that was blocked; 5 the task failed (a grasp
that does not hold, a posture that is not reached); 130 interrupted (by another signal than that of
Ctrl-C: 128 and its number).
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Annotated

import typer

from allegro_twin.surfaces.cli import exit_codes
from allegro_twin.surfaces.cli.cell import calibrate, lab, look
from allegro_twin.surfaces.cli.data import export, schemas
from allegro_twin.surfaces.cli.grasps import evaluate, improve, plan
from allegro_twin.surfaces.cli.grasps import mesh as scans
from allegro_twin.surfaces.cli.hardware import bus, check_backend, hand, ros, teleop
from allegro_twin.surfaces.cli.learning import collect, mpc, train
from allegro_twin.surfaces.cli.machine import doctor
from allegro_twin.surfaces.cli.start import lists, move, panel, run, view
from allegro_twin.surfaces.cli.twin import commands as twin
from allegro_twin.surfaces.cli.twin import rehearse
from allegro_twin.version import __version__

PANELS: dict[str, tuple[Callable[..., None] | typer.Typer, ...]] = {
    "Start": (run.run, view.view, lists.list_, lists.examples, panel.panel, move.posture, move.grasp, move.play,
              move.keyboard),
    "Grasps": (plan.plan, plan.new, scans.mesh, improve.improve, evaluate.evaluate, evaluate.compare, lists.gallery),
    "Hardware": (hand.hand, hand.calibrate, bus.check, bus.sniff, bus.firmware, check_backend.check_backend, move.teach,
                 teleop.teleop, ros.ros2, ros.ros1),
    "Learning": (lists.envs, train.train, mpc.mpc, collect.collect),
    "Twin": (twin.excite, twin.identify, twin.gap, twin.mirror, twin.branch, rehearse.rehearse),
    "Cell": (lab.lab, look.lab_look, calibrate.lab_calibrate),
    "Data": (export.export, export.layout, schemas.schemas),
    "Machine": (doctor.doctor,),
}  # fmt: skip
"""Commands and groups of commands, by the panel that shows them."""

app = typer.Typer(
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="A digital twin of the Wonik Allegro Hand. A config (conf/*.yaml) names a hand and its controller, a scenario "
    "(scenarios/**/*.yaml) an object and a grasp. First try: allegro-twin run lemon",
)


def _version(wanted: bool) -> None:
    if wanted:
        sys.stdout.write(f"allegro-twin {__version__}\n")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Options before any command."""


def _register() -> None:
    for name, commands in PANELS.items():
        for command in commands:
            if isinstance(command, typer.Typer):
                app.add_typer(command, rich_help_panel=name)
            else:
                app.command(command.__name__.rstrip("_").replace("_", "-"), rich_help_panel=name)(command)


_register()


def main() -> None:
    """Run the command line."""
    exit_codes.run(app, sys.argv[1:] or ["--help"], "allegro-twin")
