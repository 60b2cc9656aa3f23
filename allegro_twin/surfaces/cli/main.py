"""The command line. Exit codes: 0 done, 2 config, file or usage, 3 link, 4 fault or a motion that met something, 5 what
was asked for was not done: a grasp that does not hold, a posture that is not reached; 130 interrupted."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from allegro_twin.surfaces.cli import ends
from allegro_twin.surfaces.cli.grasps import evaluating, improving, planning
from allegro_twin.surfaces.cli.hand import bus, check_backend, hands, live
from allegro_twin.surfaces.cli.policies import collecting, training
from allegro_twin.surfaces.cli.recorded import exchange
from allegro_twin.surfaces.cli.run import looking, running
from allegro_twin.surfaces.cli.shown import doctor, schemas, shipped
from allegro_twin.surfaces.cli.surfaces import lab, panel, ros, teleop
from allegro_twin.surfaces.cli.twins import twin
from allegro_twin.version import __version__

app = typer.Typer(
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="A digital twin of the Wonik Allegro Hand. A config (conf/*.yaml) says which hand and controller, a scenario "
    "(scenarios/**/*.yaml) what to grasp.",
)


def _version(wanted: bool) -> None:
    if wanted:
        sys.stdout.write(f"allegro-twin {__version__}\n")
        raise typer.Exit


@app.callback()
def _all(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Say which version this is.")
    ] = False,
) -> None:
    """What stands before any command."""


running.register(app)
shipped.register(app)
live.register(app)
looking.register(app)
panel.register(app)
planning.register(app)
improving.register(app)
exchange.register(app)
bus.register(app)
check_backend.register(app)
training.register(app)
collecting.register(app)
evaluating.register(app)
twin.register(app)
ros.register(app)
lab.register(app)
teleop.register(app)
schemas.register(app)
doctor.register(app)
hands.register(app)


def main() -> None:
    """Run the command line."""
    ends.run(app, sys.argv[1:] or ["--help"], "allegro-twin")
