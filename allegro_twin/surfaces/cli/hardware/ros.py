"""Commands that serve a hand on ROS 2 and ROS 1."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Annotated

import typer

from allegro_twin.errors import ConfigError
from allegro_twin.surfaces.cli import completion
from allegro_twin.surfaces.cli.options import OtherHand

if TYPE_CHECKING:
    from allegro_twin.surfaces.hand import Hand


Target = Annotated[str, typer.Argument(help="Config of the hand, by path or name.", autocompletion=completion.configs)]
Namespace = Annotated[str, typer.Option(help="Namespace of the hand's topics.")]
Rate = Annotated[float, typer.Option(help="Publishing rate, Hz.")]
Speed = Annotated[float, typer.Option(help="Peak joint speed of set-points without a time, rad/s.")]


def ros2(
    config: Target = "sim_right",
    other: OtherHand = None,
    namespace: Namespace = "/allegroHand_0",
    domain: Annotated[int | None, typer.Option(help="ROS domain; default: ROS_DOMAIN_ID, else 0.")] = None,
    distro: Annotated[str, typer.Option(help="Message types of humble, iron, jazzy, kilted or lyrical.")] = "jazzy",
    rate: Rate = 100.0,
    speed: Speed = 2.0,
    network: Annotated[bool, typer.Option("--network", help="Serve other machines too. ROS has no passwords.")] = False,
) -> None:
    """Serve a hand on ROS 2; no ROS installation is needed.

    Topics: joint_states, tf, joint_cmd, lib_cmd, joint_trajectory and others. Ctrl-C ends it."""
    from allegro_twin.surfaces.cli import console

    number = domain_of() if domain is None else domain
    with _open(config, other) as hand:
        from allegro_twin.surfaces.ros import open_bridge

        try:
            bridge = open_bridge(hand, namespace=namespace, domain=number, distro=distro, rate=rate, speed=speed,
                                 network=network, on_refusal=_report)  # fmt: skip
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
    """Serve a hand on ROS 1, with Debian's rospy.

    It connects to the master at ROS_MASTER_URI. Ctrl-C ends it."""
    from allegro_twin.surfaces.cli import console

    with _open(config, other) as hand:
        from allegro_twin.surfaces.ros import open_ros1

        with open_ros1(hand, namespace=namespace, rate=rate, speed=speed, on_refusal=_report) as bridge:
            console.say(f"{hand.spec.name} is on ROS 1 in {namespace}; Ctrl-C ends it")
            bridge.serve()


def _open(config: str, other: str | None) -> Hand:
    from allegro_twin.app.config import load_config
    from allegro_twin.surfaces.cli.hand_override import on_hand
    from allegro_twin.surfaces.hand import Hand

    return Hand.open(on_hand(load_config(config), other), background=True)


def _report(line: str) -> None:
    from allegro_twin.surfaces.cli import console

    console.warn(line)


def domain_of() -> int:
    """The domain of ROS_DOMAIN_ID. Raises ConfigError."""
    text = os.environ.get("ROS_DOMAIN_ID", "0") or "0"
    if not text.isdecimal():
        raise ConfigError(f"ROS_DOMAIN_ID is a number, not {text!r}")
    return int(text)
