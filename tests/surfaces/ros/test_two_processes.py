"""The command, and a program of its own beside it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from allegro_twin.recording.messages import message_types as v
from tests.surfaces.ros.conftest import DOMAIN, Peer

pytestmark = pytest.mark.realtime


@pytest.fixture
def running(namespace: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "allegro_twin", "ros2", "can_virtual", "--domain", str(DOMAIN)]
    process = subprocess.Popen(
        [*command, "--namespace", namespace], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    yield process
    if process.poll() is None:
        process.kill()
    process.communicate()


def test_another_process_drives_a_hand_on_a_virtual_bus_and_ctrl_c_ends_it(
    running: subprocess.Popen[str], peer: Peer, namespace: str
) -> None:
    peer.hear("joint_states", v.JOINT_STATE)
    first = peer.listen(30.0, lambda topic, message: True)
    assert first is not None, running.stderr and running.stderr.read()
    peer.lib_cmd("home")
    home = peer.listen(
        10.0, lambda topic, message: bool(abs(message.position[2] - 0.7854) < 0.03 and message.velocity.max() < 0.05)
    )
    assert home is not None
    peer.lib_cmd("hoem")
    time.sleep(0.5)
    running.send_signal(signal.SIGINT)
    out, error = running.communicate()
    assert f"is on ROS domain {DOMAIN} in {namespace}" in out.replace("\n", " ")
    assert "did you mean 'home'" in error
    assert "Traceback" not in error
    assert running.returncode == 130


def test_five_hundred_messages_there_and_back_all_arrive_in_order(
    make_peer: Callable[[], Peer], types: v.RosTypes, tmp_path: os.PathLike[str]
) -> None:
    """The echo is a process of its own."""
    here = make_peer()
    code = f"""
import sys
from allegro_twin.recording.messages import message_types as v
from allegro_twin.surfaces.ros.node import Node
types = v.ros_types()
node = Node(types, "echo", "/", {DOMAIN})
node.subscribe("{here.full("ping")}", v.JOINT_STATE)
node.advertise("{here.full("pong")}", v.JOINT_STATE)
print("ready", flush=True)
while True:
    for topic, data, sender in node.wait(1.0):
        node.publish("{here.full("pong")}", types.decode(data, v.JOINT_STATE))
"""
    echo = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    try:
        assert echo.stdout is not None
        assert echo.stdout.readline() == "ready\n"
        here.hear("pong", v.JOINT_STATE)
        message = types.make(v.JOINT_STATE, header=types.header(0), name=["a"], position=np.zeros(16),
                             velocity=np.zeros(16), effort=np.zeros(16))  # fmt: skip
        here.say("ping", message)
        here.listen(5.0, lambda topic, message: True)
        trips = []
        for number in range(500):
            message.position[0] = number
            began = time.perf_counter()
            here.say("ping", message)
            back = here.listen(2.0, lambda topic, message: True)
            trips.append(time.perf_counter() - began)
            assert back is not None
            assert back.position[0] == number
        print(f"median {np.median(trips) * 1e3:.2f} ms, 99 % {np.quantile(trips, 0.99) * 1e3:.2f} ms")  # noqa: T201
    finally:
        echo.kill()
        echo.communicate()
