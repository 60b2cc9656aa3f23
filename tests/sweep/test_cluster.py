"""On a Ray cluster a sweep has the same bits as on one computer, whatever becomes of a node."""

from __future__ import annotations

import socket
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from allegro_twin.errors import ConfigError, HandError, LinkError
from allegro_twin.sweep import Local, RayCluster, Store, Sweep, run
from tests.sweep.test_sweep import WAVES, sweep_of
from tests.sweep.work import as_bytes, calls, numbered


def test_without_ray_one_line_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ConfigError, match=r"a cluster needs Ray: pip install 'allegro-twin\[ray\]'"):
        RayCluster()


def test_a_folder_of_that_name_is_not_taken_for_ray(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "ray").mkdir()
    (tmp_path / "ray" / "__init__.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "ray", raising=False)
    with pytest.raises(ConfigError, match=r"`import ray` finds .*ray/__init__\.py: start elsewhere, or rename it"):
        RayCluster()
    monkeypatch.delitem(sys.modules, "ray")


def test_a_unit_needs_a_core() -> None:
    with pytest.raises(ConfigError, match="a unit needs 1 core or more, not 0"):
        RayCluster(cores=0)


def on_ray(test: Any) -> Any:
    """Takes long, and Ray's own warnings are not ours."""
    return pytest.mark.long(pytest.mark.filterwarnings("default")(test))


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two nodes of two cores on this computer, the first of which is the head and has no cores."""
    pytest.importorskip("ray", reason="Ray is not installed: pip install 'allegro-twin[ray]'")
    made = import_module("ray.cluster_utils").Cluster(
        initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False}
    )
    made.add_node(num_cpus=2)
    made.add_node(num_cpus=2)
    made.wait_for_nodes()
    yield made
    import_module("ray").shutdown()
    made.shutdown()


@pytest.fixture
def engine(cluster: Any) -> RayCluster:
    return RayCluster(cluster.address)


@on_ray
def test_the_table_and_its_parts_are_the_same_to_the_bit_as_on_this_computer(
    tmp_path: Path, engine: RayCluster
) -> None:
    sweep = sweep_of("fussy", 100, unit=7, disliked=[3, 50])
    table = run(sweep, Store(tmp_path / "ray"), engine)
    assert as_bytes(table) == as_bytes(run(sweep, Store(tmp_path / "local"), Local(2)))
    parts = [{path.name: path.read_bytes() for path in (tmp_path / each).iterdir()} for each in ("ray", "local")]
    assert parts[0] == parts[1]


@on_ray
@pytest.mark.parametrize(
    ("sweep", "message"),
    [
        (sweep_of("too_few", 3), "gave 2 rows for 3 items"),
        (sweep_of("wavse"), "did you mean 'waves'"),
        (sweep_of("broken", 3), "items 0 to 2: ZeroDivisionError: as a mistake in a function does; what is finished"),
    ],
)
def test_what_a_function_does_wrong_is_one_line(sweep: Sweep, message: str, engine: RayCluster) -> None:
    with pytest.raises(HandError) as raised:
        run(sweep, engine=engine)
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


@on_ray
def test_a_process_that_is_killed_is_tried_again_twice_and_then_named(tmp_path: Path, engine: RayCluster) -> None:
    again = sweep_of("fatal", 10, marks=str(tmp_path / "two"), at=4, times=2)
    assert run(again, engine=engine)["n"].to_pylist() == list(range(10))
    never = sweep_of("fatal", 10, marks=str(tmp_path / "three"), at=9, times=3)
    with pytest.raises(HandError, match="tests.sweep.work:fatal, item 9: lost by Ray: .*; what is finished stays"):
        run(never, engine=engine)


@on_ray
def test_a_node_that_is_lost_in_the_middle_costs_at_most_what_was_in_flight(
    tmp_path: Path, cluster: Any, engine: RayCluster
) -> None:
    log = tmp_path / "log"
    sweep = Sweep(WAVES, numbered(60), {"log": str(log), "seconds": 0.3}, unit=2)
    node = cluster.add_node(num_cpus=2)
    cluster.wait_for_nodes()
    killed: list[int] = []

    def kill(done: int, total: int) -> None:
        if done >= 20 and not killed:
            killed.append(done)
            cluster.remove_node(node, allow_graceful=False)

    table = run(sweep, Store(tmp_path / "s"), engine, kill)
    computed = sorted(n for call in calls(log) for n in call)
    assert killed
    assert as_bytes(table) == as_bytes(run(sweep, engine=Local(2)))
    assert set(computed) == set(range(60))
    assert len(computed) - 60 <= 2 * 2  # Two cores, a unit of two items on each.


@on_ray
def test_without_an_address_a_cluster_of_this_computer_is_joined(engine: RayCluster) -> None:
    assert run(sweep_of(), engine=RayCluster())["n"].to_pylist() == list(range(10))


def test_a_cluster_that_does_not_answer_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", SimpleNamespace(is_initialized=lambda: False))
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
    with pytest.raises(LinkError, match=f"no Ray cluster at {address}: Connection refused"):
        RayCluster(address)
