"""A C++ program on Debian's Fast DDS, the family of ROS 2's default middleware, hears the hand and moves it."""

from __future__ import annotations

import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from allegro_twin.messages import vocabulary as v
from allegro_twin.types import Vector
from tests.ros.conftest import DOMAIN, Peer, bridged, sim_config, waited
from tests.ros.test_cell import Served, cell  # noqa: F401  # A fixture.

HERE = Path(__file__).parent / "fastdds"
MISSING = [name for name in ("fastddsgen", "g++") if shutil.which(name) is None]
if not Path("/usr/include/fastdds").is_dir():
    MISSING.append("libfastrtps-dev")
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(bool(MISSING), reason=f"needs Debian's {' '.join(MISSING)}"),
]


@pytest.fixture(scope="session")
def echo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The program, built."""
    folder = tmp_path_factory.mktemp("fastdds")
    shutil.copy(HERE / "JointState.idl", folder)
    subprocess.run(["fastddsgen", "-typeros2", "JointState.idl"], cwd=folder, check=True, capture_output=True)
    made = [str(path) for path in folder.glob("*.cxx") if "main" not in path.name.lower()]
    subprocess.run(
        ["g++", "-O1", "-w", "-I.", *made, str(HERE / "echo.cpp"), "-lfastrtps", "-lfastcdr", "-o", "echo"],
        cwd=folder, check=True, capture_output=True,
    )  # fmt: skip
    return folder / "echo"


@contextmanager
def echoing(program: Path, heard: str, said: str) -> Iterator[None]:
    process = subprocess.Popen(
        [str(program), str(DOMAIN), f"rt{heard}", f"rt{said}"], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        yield
    finally:
        process.kill()
        process.communicate()


def test_five_hundred_of_five_hundred_messages_come_back_from_fast_dds(
    echo: Path, peer: Peer, words: v.Vocabulary
) -> None:
    peer.hear("pong", v.JOINT_STATE)
    with echoing(echo, peer.full("ping"), peer.full("pong")):
        message = words.make(
            v.JOINT_STATE, header=words.header(12345678901, "palm"), name=["joint_0.0", "é"],
            position=np.arange(16.0), velocity=np.full(16, np.nan), effort=np.zeros(3),
        )  # fmt: skip
        peer.say("ping", message)
        peer.listen(5.0, lambda topic, message: True)
        trips = []
        for number in range(500):
            message.position[0] = number
            began = time.perf_counter()
            peer.say("ping", message)
            back = peer.listen(2.0, lambda topic, message: True)
            trips.append(time.perf_counter() - began)
            assert words.encode(back) == words.encode(message)
    print(f"median {np.median(trips) * 1e3:.2f} ms, 99 % {np.quantile(trips, 0.99) * 1e3:.2f} ms")  # noqa: T201


def test_fast_dds_hears_the_hand_and_moves_it(
    echo: Path, make_peer: Callable[[], Peer], namespace: str, home: Vector
) -> None:
    peer = make_peer()
    with bridged(sim_config(), namespace) as (hand, _):
        peer.hear("mirror", v.JOINT_STATE)
        with echoing(echo, peer.full("joint_states"), peer.full("mirror")):
            seen = peer.listen(10.0, lambda topic, message: True)
            assert seen is not None
            assert seen.name == list(hand.spec.joints)
        with echoing(echo, peer.full("wish"), peer.full("joint_cmd")):
            time.sleep(1.0)
            peer.say("wish", peer.words.make(
                v.JOINT_STATE, header=peer.words.header(0), name=list(hand.spec.joints), position=np.array(home),
                velocity=np.zeros(0), effort=np.zeros(0)))  # fmt: skip
            waited(lambda: bool(np.abs(hand.state.position - home).max() < 0.03), "home was not reached")


def test_fast_dds_hears_arm_and_hand_of_a_cell_in_one_message(
    echo: Path,
    peer: Peer,
    cell: Served,  # noqa: F811  # The fixture of that name.
) -> None:
    peer.hear("again", v.JOINT_STATE)
    with echoing(echo, peer.full("joint_states"), peer.full("again")):
        message = peer.listen(30.0, lambda topic, message: True)
    assert message.name == [*cell.room.cell.spec.joints, *cell.room.hand.spec.joints]
    np.testing.assert_allclose(message.position[:7], cell.room.posture, atol=0.02)
