"""The doctor says what works, what does not, and the one line that mends it."""

from __future__ import annotations

import inspect
import json
import socket
import subprocess
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import pytest

from allegro_twin.surfaces.cli.machine import bus, computer, packages
from allegro_twin.surfaces.cli.machine.finding import Diagnosis
from tests.surfaces.cli.conftest import Run


def test_it_looks_at_this_computer_and_every_line_that_is_not_well_says_what_mends_it(command: Run) -> None:
    code, out, _ = command("doctor", "--json")
    found = [Diagnosis(**row) for row in json.loads(out)]
    assert {"Python", "packages", "extra view", "EGL", "GPU", "real time"} <= {each.what for each in found}
    assert code == (2 if any(each.status == "broken" for each in found) else 0)
    for each in found:
        assert "\n" not in each.says + each.mend
        assert each.mend or each.status == "works" or each.what == "GPU"
    code, out, _ = command("doctor")
    assert "works" in out


def versions(installed: dict[str, str]) -> packages.Version:
    def version(name: str) -> str:
        if name not in installed:
            raise PackageNotFoundError(name)
        return installed[name]

    return version


def fine(modules: Sequence[str]) -> dict[str, str]:
    return {}


def test_a_needed_package_that_is_installed_and_cannot_be_imported_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, text in (
        ("pinocchio", "raise ImportError('libgomp.so.1: not there\\nand more')"),
        ("can", "import os; os.abort()"),
        ("yaml", "print('[I print]')"),
    ):
        (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    given = ["pyyaml>=6", "pin>=4.0", "python-can>=4.5", "pyserial>=3.5", "gone>=1"]
    (found,) = packages.packages(given, versions({"pyyaml": "6.0", "pin": "4.0", "python-can": "4.5", "pyserial": "4"}))
    assert found.status == "broken"
    assert found.says == (
        "gone is not installed; pinocchio cannot be imported: libgomp.so.1: not there; can cannot be imported: its "
        "import ends Python with -6"
    )
    assert found.mend == (
        "pip install --upgrade allegro-twin; pip install --force-reinstall 'pin>=4.0'; pip install --force-reinstall "
        "'python-can>=4.5'"
    )


def test_the_packages_of_this_computer_are_all_imported_by_their_own_names() -> None:
    found = next(packages.packages())
    assert (found.status, found.mend) == ("works", ""), found.says


@pytest.mark.parametrize("value", ["", "egl", "off", "glfw"])
def test_where_mujoco_cannot_be_imported_nobody_is_told_to_install_a_renderer(
    monkeypatch: pytest.MonkeyPatch, value: str
) -> None:
    monkeypatch.setenv("MUJOCO_GL", value)
    (found,) = computer.pictures(lambda backend: "a card", lambda modules: {"mujoco": "half installed"})
    assert found.status == "broken"
    assert found.says == "mujoco cannot be imported: half installed"
    assert "apt-get" not in found.mend


def test_packages_that_are_missing_or_too_old_or_too_new_are_named_with_their_extra() -> None:
    given = [
        "numpy>=2.0",
        "mujoco<4.1,>=4.0",
        "av>=14; extra == 'view'",
        'ray>=2.40; extra == "ray"',
        "x; extra == 'dev'",
    ]
    well = list(packages.packages(given, versions({"numpy": "2.4.6", "mujoco": "4.0.0", "av": "18.1.0"}), imports=fine))
    assert [(each.what, each.status) for each in well] == [
        ("packages", "works"), ("extra ray", "absent"), ("extra view", "works")]  # fmt: skip
    assert well[1].mend == "pip install 'allegro-twin[ray]'"
    ill = next(iter(packages.packages(given, versions({"numpy": "1.26.4", "mujoco": "4.1.2"}), imports=fine)))
    assert ill.status == "broken"
    assert "numpy is 1.26.4; >=2.0 is needed" in ill.says
    assert "mujoco is 4.1.2; <4.1,>=4.0 is needed" in ill.says


def test_an_extra_that_is_not_for_this_python_says_for_which_it_is() -> None:
    given = ["dex>=0.5; python_version < '3.13' and extra == 'teleop'", 'av>=14; extra == "view"']
    for minor, words in ((12, False), (13, True), (14, True)):
        _, teleop, view = packages.packages(given, versions({"av": "18.1.0"}), minor, fine)
        assert (teleop.status, view.status) == ("absent", "works")
        assert ("not for Python 3.13 and later" in teleop.says) == words
        assert ("use Python 3.12" in teleop.mend) == words
        assert "pip install 'allegro-twin[teleop]'" in teleop.mend


def test_without_rospy_it_says_which_package_of_debian_has_it() -> None:
    (there,), (absent,) = packages.rospy(True), packages.rospy(False)
    assert (there.status, absent.status) == ("works", "absent")
    assert "apt-get install python3-rospy" in absent.mend


def test_a_library_of_the_system_that_a_wheel_takes_for_granted_is_named_with_its_package() -> None:
    def fail(name: str) -> None:
        raise OSError(f"{name}: cannot open shared object file: No such file or directory")

    (broken,), (fine,) = computer.libraries(fail), computer.libraries(lambda name: None)
    assert (broken.status, broken.mend) == ("broken", "apt-get install libgomp1")
    assert fine.status == "works"


def test_a_webcam_without_permission_names_the_group(tmp_path: Path) -> None:
    (tmp_path / "video0").touch()
    (tmp_path / "video").touch()
    (found,) = computer.cameras(tmp_path, lambda path: False)
    assert (found.what, found.status, "video" in found.mend) == ("camera video0", "broken", True)
    (found,) = computer.cameras(tmp_path, lambda path: True)
    assert found.status == "works"


def test_it_looks_at_the_ports_of_every_page(command: Run) -> None:
    from allegro_twin.surfaces.cli.start.panel import panel
    from allegro_twin.surfaces.cli.start.view import view

    pages = {inspect.signature(page).parameters["port"].default for page in (view, panel)}
    assert pages < set(computer.PORTS.values())


def interface(net: Path, name: str, flags: str, kind: str = "280") -> None:
    (net / name).mkdir(parents=True)
    (net / name / "type").write_text(f"{kind}\n")
    (net / name / "flags").write_text(f"{flags}\n")


def test_can_interfaces_that_are_down_or_may_not_be_opened_say_how_to_bring_them_up(tmp_path: Path) -> None:
    interface(tmp_path, "can0", "0x40081")
    interface(tmp_path, "can1", "0x40080")
    interface(tmp_path, "eth0", "0x1003", kind="1")
    found = list(bus.interfaces(tmp_path, lambda name: None))
    assert [(each.what, each.status) for each in found] == [("CAN can0", "works"), ("CAN can1", "broken")]
    assert found[1].mend == "ip link set can1 up type can bitrate 1000000"

    def refuse(name: str) -> None:
        raise PermissionError(1, "Operation not permitted")

    assert "CAP_NET_RAW" in next(iter(bus.interfaces(tmp_path, refuse))).mend
    (none,) = bus.interfaces(tmp_path / "nothing")
    assert (none.status, "ip link set can0 up" in none.mend) == ("absent", True)


def test_a_serial_adapter_without_permission_names_the_group(tmp_path: Path) -> None:
    (tmp_path / "ttyACM0").touch()
    (found,) = bus.adapters(tmp_path, lambda path: False)
    assert (found.status, "dialout" in found.mend) == ("broken", True)


def test_pictures_are_tried_with_the_mujoco_gl_that_commands_have(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[str] = []

    def draw(backend: str) -> str:
        tried.append(backend)
        if backend == "glfw":
            raise OSError("no screen")
        return "a card"

    found = {}
    for value in ("off", "glfw", "osmesa", ""):
        monkeypatch.setenv("MUJOCO_GL", value)
        (found[value],) = computer.pictures(draw, fine)
    assert tried == ["glfw", "osmesa", "egl"]
    assert [found[value].status for value in ("off", "glfw", "osmesa", "")] == ["broken", "broken", "works", "works"]
    assert found["glfw"].says == "no picture with MUJOCO_GL=glfw: no screen"
    assert found["off"].mend == "unset MUJOCO_GL"


def test_a_picture_that_cannot_be_made_names_the_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "egl")

    def fail(backend: str) -> str:
        raise OSError("no EGL display")

    (broken,) = computer.pictures(fail, fine)
    assert (broken.status, "libegl1" in broken.mend) == ("broken", True)
    (slow,) = computer.pictures(lambda backend: "llvmpipe (LLVM 15)", fine)
    assert (slow.status, "software" in slow.says) == ("works", True)

    def hang(backend: str) -> str:
        raise subprocess.TimeoutExpired("python", 60.0)

    assert next(iter(computer.pictures(hang, fine))).status == "broken"


def test_real_time_that_is_not_allowed_says_where_it_is_allowed() -> None:
    def refuse() -> None:
        raise PermissionError(1, "Operation not permitted")

    assert "rtprio" in list(computer.scheduling(refuse))[-1].mend
    assert list(computer.scheduling(lambda: None))[-1].status == "works"


def test_a_port_in_use_says_who_to_look_for() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        (found,) = computer.ports({"a page": port})
        assert (found.status, f"grep {port}" in found.mend) == ("broken", True)
    (free,) = computer.ports({"a page": port})
    assert free.status == "works"
