"""The manufacturer's topics on ROS 1: Debian's rospy, a real roscore, and a program that knows only ROS."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.patience import wait_for

DEBIAN = "/usr/lib/python3/dist-packages"
SYSTEM = "/usr/bin/python3"
PACKAGES = ("rospy", "sensor_msgs", "trajectory_msgs")
MISSING = [name for name in PACKAGES if not (Path(DEBIAN) / name).is_dir()]
if shutil.which("rosmaster") is None:
    MISSING.append("rosmaster")
pytestmark = [
    pytest.mark.realtime,
    pytest.mark.skipif(
        bool(MISSING),
        reason=f"needs Debian's {' '.join('python3-' + name.replace('_', '-') for name in MISSING)}; "
        "docs/how-to/use_ros.md",
    ),
]


@pytest.fixture
def master(tmp_path: Path) -> Iterator[dict[str, str]]:
    """A roscore's master on a free port of loopback; the environment that leads to it."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    clean = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    around = clean | {
        "ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1", "ROS_HOME": str(tmp_path / "ros"),
    }  # fmt: skip
    core = subprocess.Popen([SYSTEM, shutil.which("rosmaster") or "", "--core", "-p", str(port)], env=around,
                            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)  # fmt: skip

    def answers() -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", port)) == 0

    wait_for(answers, "the master")
    yield around
    core.terminate()
    core.wait()


PEER = """
import math, sys, time
import rospy
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

rospy.init_node("somebody", disable_signals=True)
states = []
rospy.Subscriber("/allegroHand_0/joint_states", JointState, states.append)
words = rospy.Publisher("/allegroHand_0/lib_cmd", String, queue_size=5)
cmd = rospy.Publisher("/allegroHand_0/joint_cmd", JointState, queue_size=5)
controller = "/allegroHand_0/allegro_hand_trajectory_controller"
way = rospy.Publisher(controller + "/joint_trajectory", JointTrajectory, queue_size=5)
described = rospy.wait_for_message("/allegroHand_0/robot_description", String, timeout=20)
assert described.data.startswith("<robot")
end = time.time() + 20
while not (states and words.get_num_connections() and cmd.get_num_connections() and way.get_num_connections()):
    assert time.time() < end, "the hand is not to be seen"
    time.sleep(0.05)

def until(posture, what):
    end = time.time() + 15
    while max(abs(a - b) for a, b in zip(states[-1].position, posture)) > 0.04:
        assert time.time() < end, what
        time.sleep(0.02)

home = [0, -.17453, .7854, .7854, 0, -.17453, .7854, .7854]
home += [.08727, -.08727, .87266, .7854, 1.0472, .43633, .2618, .7854]
words.publish(String("home"))
until(home, "home was not reached")
bent = [q + 0.1 for q in home]
cmd.publish(JointState(name=list(states[-1].name), position=bent))
until(bent, "joint_cmd was not followed")
plan = JointTrajectory(joint_names=list(states[-1].name))
plan.points = [JointTrajectoryPoint(positions=home, time_from_start=rospy.Duration(1.0))]
way.publish(plan)
until(home, "the trajectory was not followed")
bad = list(home)
bad[0] = math.nan
cmd.publish(JointState(name=list(states[-1].name), position=bad))
time.sleep(0.5)
words.publish(String("off"))
time.sleep(0.5)
assert states[0].name[0] == "joint_0.0" and len(states[0].effort) == len(states[0].name)
print("well", len(states))
"""


def test_the_manufacturers_topics_work_with_a_real_roscore(master: dict[str, str], tmp_path: Path) -> None:
    root = Path(__file__).resolve().parents[3]
    start = textwrap.dedent(f"""
        import sys
        sys.path.insert(0, {str(root)!r})
        sys.path.append({DEBIAN!r})  # As --system-site-packages has it: behind all else.
        from allegro_twin.__main__ import main
        sys.argv = ["allegro-twin", "ros1", "can_virtual"]
        main()
    """)
    extras = {"PYTHONPATH": os.environ["PYTHONPATH"]} if "PYTHONPATH" in os.environ else {}
    hand = subprocess.Popen([sys.executable, "-c", start], env=master | extras, stdout=subprocess.PIPE,
                            stderr=subprocess.PIPE, text=True)  # fmt: skip
    try:
        peer = subprocess.run([SYSTEM, "-c", textwrap.dedent(PEER)], env=master, capture_output=True, text=True,
                              timeout=90)  # fmt: skip
        assert peer.returncode == 0, peer.stderr
        assert peer.stdout.startswith("well")
        hand.send_signal(signal.SIGINT)
        out, error = hand.communicate()
    finally:
        if hand.poll() is None:
            hand.kill()
            hand.communicate()
    assert "is on ROS 1 in /allegroHand_0" in out
    assert "joint_cmd for joint_0.0 is nan; every value must be finite" in error
    assert "Traceback" not in error
    assert hand.returncode == 130
