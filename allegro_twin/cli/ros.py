"""The command that puts a hand on ROS."""

from __future__ import annotations

import os
from typing import Annotated

import typer

from allegro_twin.cli import complete
from allegro_twin.cli.options import OtherHand
from allegro_twin.errors import ConfigError


def register(app: typer.Typer) -> None:
    """Add the command to the command line."""
    app.command()(ros2)


def ros2(
    config: Annotated[
        str, typer.Argument(help="Which hand: a config by path or name.", autocompletion=complete.configs)
    ] = "sim_right",
    other: OtherHand = None,
    namespace: Annotated[str, typer.Option(help="Of the hand's own topics.")] = "/allegroHand_0",
    domain: Annotated[int | None, typer.Option(help="Default: ROS_DOMAIN_ID, else 0.")] = None,
    distro: Annotated[str, typer.Option(help="Whose message types: humble, iron, jazzy, kilted or lyrical.")] = "jazzy",
    rate: Annotated[float, typer.Option(help="Of what is published, Hz.")] = 100.0,
    speed: Annotated[float, typer.Option(help="Peak of joints that are sent somewhere without a time, rad/s.")] = 2.0,
    network: Annotated[
        bool, typer.Option("--network", help="Be seen, and obey, beyond this machine: ROS asks nobody for a password.")
    ] = False,
) -> None:
    """A hand on ROS 2, without ROS installed: joint_states, tf, joint_cmd, lib_cmd, trajectories; Ctrl-C ends it."""
    from allegro_twin.cli import console
    from allegro_twin.cli.runs import on_hand
    from allegro_twin.config import load_config
    from allegro_twin.hand import Hand

    settings = on_hand(load_config(config), other)
    try:
        from allegro_twin.ros import open_bridge
    except ImportError as error:
        raise ConfigError(f"ros2 needs Cyclone DDS: pip install 'allegro-twin[ros2]' ({error})") from error
    with Hand.open(settings, background=True) as hand:
        number = _domain() if domain is None else domain
        with open_bridge(
            hand, namespace=namespace, domain=number, distro=distro, rate=rate, speed=speed, network=network,
            told=lambda line: console.errors.print(f"[yellow]{line}[/]", soft_wrap=True),
        ) as bridge:  # fmt: skip
            console.console.print(
                f"{hand.spec.name} is on ROS domain {number} as {bridge.name}; Ctrl-C ends it", soft_wrap=True
            )
            bridge.serve()


def _domain() -> int:
    """As ROS has it. Raises ConfigError."""
    text = os.environ.get("ROS_DOMAIN_ID", "0") or "0"
    if not text.isdecimal():
        raise ConfigError(f"ROS_DOMAIN_ID is a number, not {text!r}")
    return int(text)
