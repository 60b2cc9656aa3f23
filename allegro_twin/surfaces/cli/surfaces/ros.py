"""The commands that put a hand on ROS."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Annotated

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import complete
from allegro_twin.surfaces.cli.options import OtherHand

if TYPE_CHECKING:
    from allegro_twin.surfaces.hand import Hand


def register(app: typer.Typer) -> None:
    """Add the commands to the command line."""
    app.command()(ros2)
    app.command()(ros1)


Target = Annotated[str, typer.Argument(help="Which hand: a config by path or name.", autocompletion=complete.configs)]
Namespace = Annotated[str, typer.Option(help="Of the hand's own topics.")]
Rate = Annotated[float, typer.Option(help="Of what is published, Hz.")]
Speed = Annotated[float, typer.Option(help="Peak of joints that are sent somewhere without a time, rad/s.")]


def ros2(
    config: Target = "sim_right",
    other: OtherHand = None,
    namespace: Namespace = "/allegroHand_0",
    domain: Annotated[int | None, typer.Option(help="Default: ROS_DOMAIN_ID, else 0.")] = None,
    distro: Annotated[str, typer.Option(help="Whose message types: humble, iron, jazzy, kilted or lyrical.")] = "jazzy",
    rate: Rate = 100.0,
    speed: Speed = 2.0,
    network: Annotated[
        bool, typer.Option("--network", help="Be seen, and obey, beyond this machine: ROS asks nobody for a password.")
    ] = False,
) -> None:
    """A hand on ROS 2, without ROS installed: joint_states, tf, joint_cmd, lib_cmd, trajectories; Ctrl-C ends it."""
    from allegro_twin.surfaces.cli import console

    number = domain_of() if domain is None else domain
    with _opened(config, other) as hand:
        from allegro_twin.surfaces.ros import open_bridge

        try:
            bridge = open_bridge(hand, namespace=namespace, domain=number, distro=distro, rate=rate, speed=speed,
                                 network=network, on_refusal=_warn)  # fmt: skip
            with bridge as serving:
                console.console.print(f"{hand.spec.name} is on ROS domain {number} in {namespace}; Ctrl-C ends it",
                                      soft_wrap=True)  # fmt: skip
                serving.serve()
        except ImportError as error:
            raise ConfigError(f"ros2 needs Cyclone DDS: pip install 'allegro-twin[ros2]' ({error})") from error


def ros1(
    config: Target = "sim_right",
    other: OtherHand = None,
    namespace: Namespace = "/allegroHand_0",
    rate: Rate = 100.0,
    speed: Speed = 2.0,
) -> None:
    """A hand on ROS 1, by Debian's rospy, at the master of ROS_MASTER_URI; Ctrl-C ends it."""
    from allegro_twin.surfaces.cli import console

    with _opened(config, other) as hand:
        from allegro_twin.surfaces.ros import open_ros1

        with open_ros1(hand, namespace=namespace, rate=rate, speed=speed, on_refusal=_warn) as bridge:
            console.console.print(f"{hand.spec.name} is on ROS 1 in {namespace}; Ctrl-C ends it", soft_wrap=True)
            bridge.serve()


def _opened(config: str, other: str | None) -> Hand:
    from allegro_twin.app.config import load_config
    from allegro_twin.surfaces.cli.performers import on_hand
    from allegro_twin.surfaces.hand import Hand

    return Hand.open(on_hand(load_config(config), other), background=True)


def _warn(line: str) -> None:
    from allegro_twin.surfaces.cli import console

    console.warn(line)


def domain_of() -> int:
    """As ROS has it. Raises ConfigError."""
    text = os.environ.get("ROS_DOMAIN_ID", "0") or "0"
    if not text.isdecimal():
        raise ConfigError(f"ROS_DOMAIN_ID is a number, not {text!r}")
    return int(text)
