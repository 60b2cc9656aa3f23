"""The package of docs/contract.md adds a backend and a controller without a change here, and everything drives them."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import venv
from pathlib import Path
from sysconfig import get_paths
from typing import Any

import numpy as np
import pytest

from allegro_twin.recording.reader import load
from allegro_twin.testing.rules import RULES
from tests.hands.models import GRIPPER, made

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "contract.md"
CONFIG = "backend: {kind: friendly, mass: 0.02}\ncontroller: {kind: wave}\n"


def block(heading: str, language: str) -> str:
    """The code below a line of the page."""
    found = re.search(rf"{re.escape(heading)}\n\n```{language}\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert found is not None, heading
    return found.group(1)


def write_package(folder: Path) -> None:
    (folder / "pyproject.toml").write_text(block("`pyproject.toml`:", "toml"))
    (folder / "friendly_hand.py").write_text(block("`friendly_hand.py`:", "python"))


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder on the path with the package as an installer leaves it, and a config beside it."""
    folder = tmp_path_factory.mktemp("friendly")
    write_package(folder)
    info = folder / "friendly_hand-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: friendly-hand\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[allegro_twin.backends]\nfriendly = friendly_hand:backend\nbroken = no_such_module:backend\n"
        "wrong = friendly_hand:Wave\n\n[allegro_twin.controllers]\nwave = friendly_hand:controller\n"
        "\n[allegro_twin.hands]\npincher = its_hand:CARD\nlost = its_hand:LOST\nleap = its_hand:CARD\n"
    )
    (folder / "gripper.xml").write_text(GRIPPER)
    (folder / "its_hand.py").write_text(
        "from pathlib import Path\nCARD = Path(__file__).with_name('mine') / 'gripper.yaml'\nLOST = 'nowhere.yaml'\n"
    )
    (folder / "friendly.yaml").write_text(CONFIG)
    return folder


def ran(folder: Path, *words: str, program: str = "", python: str = sys.executable) -> subprocess.CompletedProcess[str]:
    """A program beside the package."""
    paths = [str(folder), str(ROOT), os.environ.get("PYTHONPATH", "")]
    given = ["-c", program, *words] if program else ["-m", "allegro_twin", *words]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths)), "COLUMNS": "200"}
    return subprocess.run([python, *given], cwd=folder, capture_output=True, text=True, env=environment)


RUN = """
import sys
from allegro_twin.surfaces.cli.main import main
sys.argv = ["allegro-twin", "run", {!r}]
main()
"""
"""The command `run`, after what a program has done before it."""


def test_the_package_of_the_page_is_sixty_lines() -> None:
    lines = [line for line in block("`friendly_hand.py`:", "python").splitlines() if line.strip()]
    assert len(lines) <= 60


def test_a_hand_of_an_installed_package_goes_by_its_name_and_ours_keep_theirs(installed: Path) -> None:
    made("gripper", installed / "mine")
    config = "hand: {{model: {}}}\nbackend: {{kind: sim}}\ncontroller: {{kind: position}}\n"
    (installed / "pincher.yaml").write_text(config.format("pincher"))
    done = ran(installed, "run", "pincher.yaml")
    assert done.returncode == 0, done.stderr
    assert "pincher_right at" in done.stdout
    (installed / "pincher.yaml").write_text(config.format("lost"))
    own = "from allegro_twin.hands import load_spec; print(load_spec('leap').n_joints)\n"
    done = ran(installed, program=own + RUN.format("pincher.yaml"))
    assert (done.returncode, done.stdout) == (2, "16\n"), done.stderr
    assert "hand lost: its_hand:LOST says nowhere.yaml, which is no file" in done.stderr


def test_it_keeps_the_contract(installed: Path) -> None:
    done = ran(installed, "check-backend", "friendly.yaml")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "The contract is kept." in done.stdout


def test_a_backend_that_breaks_the_contract_ends_the_check_with_five(installed: Path) -> None:
    (installed / "bad.py").write_text(
        "from allegro_twin import load_config\nfrom allegro_twin.app import open_backend\n"
        "def factory():\n    hand = open_backend(load_config('friendly.yaml'))\n"
        "    hand.write = lambda command: None\n    return hand\n"
    )
    done = ran(installed, "check-backend", "bad:factory")
    assert done.returncode == 5
    assert "is taken; call `backend.torque_of`" in done.stdout
    assert "rules are broken" in done.stdout


def test_run_drives_it_with_its_own_controller_and_records_it(installed: Path) -> None:
    done = ran(installed, "run", "friendly.yaml", "--record", "wave.arrow")
    assert done.returncode == 0, done.stderr
    recording = load(installed / "wave.arrow")
    assert recording.columns["t"][-1] == pytest.approx(1.0, abs=0.05)
    assert np.abs(recording.columns["position"][-1]).max() > 0.01
    assert json.loads(json.dumps(recording.meta["config"]))["backend"]["mass"] == 0.02


BROKEN = {
    "FriendlyHand.read": "backend friendly: FriendlyHand.read",
    "FriendlyHand.write": "backend friendly: FriendlyHand.write",
    "FriendlyHand.close": "backend friendly: FriendlyHand.close",
    "FriendlyHand.__init__": "backend friendly: FriendlyHand",
    "FriendlyHand.warnings": "FriendlyHand.warnings",
    "Wave.start": "controller wave: Wave.start",
    "Wave.__call__": "controller wave: Wave.__call__",
    "Wave.__init__": "controller wave: _wave",
}
"""What raises, and as what `run` names it."""


@pytest.mark.parametrize("method", BROKEN)
def test_what_it_raises_ends_a_run_in_one_line_as_a_fault(installed: Path, method: str) -> None:
    spoil = f"""
import friendly_hand
def explode(*given):
    raise RuntimeError("it exploded")
friendly_hand.{method} = explode
"""
    done = ran(installed, program=spoil + RUN.format("friendly.yaml"))
    assert done.returncode == 4, done.stderr
    assert done.stderr.startswith(f"allegro-twin: {BROKEN[method]} raises RuntimeError: it exploded (")
    assert done.stderr.count("\n") == 1


@pytest.mark.slow
def test_a_policy_drives_it(installed: Path) -> None:
    pytest.importorskip("onnxruntime")
    done = ran(installed, "run", "friendly.yaml", "--policy", "reach_right", "--goal", "home", "--seconds", "0.3")
    assert done.returncode in (0, 5), done.stderr


def test_hand_moves_it_and_its_time_passes_while_the_user_thinks(installed: Path) -> None:
    program = """
import time
from allegro_twin import Hand
with Hand.open("friendly.yaml") as hand:
    hand.move_to("home", speed=3.0)
    t = hand.state.t
    while hand.state.t < t + 0.1:
        time.sleep(0.01)  # Nobody calls the hand.
print("went on")
"""
    done = ran(installed, program=program)
    assert done.stdout == "went on\n", done.stderr


@pytest.mark.slow
def test_the_panels_host_drives_it(installed: Path) -> None:
    program = """
from pathlib import Path
from allegro_twin.app import load_config
from tests.surfaces.panel.test_host import Desk
desk = Desk(Path.cwd() / "kept", load_config("friendly.yaml"))
t = desk.page.frame().t
while desk.page.frame().t < t + 0.1:
    desk.host.turn()
print(desk.page.said[0].title)
desk.host.close()
"""
    done = ran(installed, program=program)
    assert done.stdout == "allegro_right · behind friendly\n", done.stderr


WRONG = {
    "backend: {kind: freindly}": "no backend kind named 'freindly'; did you mean 'friendly'",
    "backend: {kind: nothing}": "installed packages add broken, friendly, wrong (entry points ",
    "backend: {kind: broken}": "backend.kind broken: no_such_module:backend cannot be imported: No module named",
    "backend: {kind: wrong}": "backend.kind wrong: friendly_hand:Wave is no allegro_twin.BackendKind",
    "backend: {kind: friendly, maas: 1}": "backend.maas: unknown key; did you mean 'mass'?",
    "backend: {kind: friendly, mass: heavy}": "backend.mass: input should be a valid number",
    "backend: {kind: friendly}\nperiod: 3": "period 3 s: allegro_right needs its joints' loop every 0.01 s",
}  # fmt: skip
"""What stands in a config's block, and what is said of it."""
ALL_WRONG = """
import contextlib, io, json, sys
from allegro_twin.surfaces.cli.main import main
answers = []
for path in sys.argv[1:]:
    sys.argv = ["allegro-twin", "run", path]
    with contextlib.redirect_stderr(io.StringIO()) as said:
        try:
            main()
        except SystemExit as ended:
            answers.append([ended.code, said.getvalue()])
print(json.dumps(answers))
"""
"""Each exit code of `run`, and what it says: seven programs would import everything seven times."""


@pytest.fixture(scope="module")
def answers(installed: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[int, str]]:
    """Of each wrong block the exit code and what is said."""
    folder = tmp_path_factory.mktemp("wrong")
    paths = [folder / f"{k}.yaml" for k in range(len(WRONG))]
    for path, text in zip(paths, WRONG, strict=True):
        path.write_text(f"{text}\ncontroller: {{kind: wave}}\n")
    done = ran(installed, *map(str, paths), program=ALL_WRONG)
    assert done.returncode == 0, done.stderr
    return {text: (code, error) for text, (code, error) in zip(WRONG, json.loads(done.stdout), strict=True)}


@pytest.mark.parametrize(("text", "said"), WRONG.items())
def test_what_is_wrong_with_a_block_is_one_line(answers: dict[str, tuple[int, str]], text: str, said: str) -> None:
    code, error = answers[text]
    assert code == 2
    assert said in error
    assert error.count("\n") == 1


def test_schemas_have_the_kinds_of_installed_packages(installed: Path) -> None:
    assert ran(installed, "schemas", "schemas").returncode == 0
    text = (installed / "schemas" / "config.schema.json").read_text()
    schema: dict[str, Any] = json.loads(text)
    assert '"title": "FriendlySettings"' in text
    assert '"title": "WaveSettings"' in text
    import jsonschema
    import yaml

    jsonschema.validate(yaml.safe_load(CONFIG), schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({"backend": {"kind": "friendly", "maas": 1}, "controller": {"kind": "wave"}}, schema)


def test_the_page_has_every_rule() -> None:
    rows = [f"| {rule.__name__.replace('_', ' ')} | {' '.join((rule.__doc__ or '').split())} |" for rule in RULES]
    assert "\n".join(rows) in PAGE.read_text(), "put these into docs/contract.md:\n" + "\n".join(rows)


@pytest.mark.slow
def test_pip_installs_it_beside_a_built_wheel_in_a_clean_environment(tmp_path: Path) -> None:
    """As a stranger does: two wheels, an environment of their own. What they need is lent from this one."""
    made = tmp_path / "wheels"
    package = tmp_path / "package"
    package.mkdir()
    write_package(package)
    for folder in (ROOT, package):
        command = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(made)]
        assert subprocess.run(command, cwd=folder, capture_output=True).returncode == 0
    own = tmp_path / "venv"
    venv.create(own, with_pip=True)
    python = own / "bin" / "python"
    site = next((own / "lib").glob("python*/site-packages"))
    (site / "lent.pth").write_text(f"import site; site.addsitedir({get_paths()['purelib']!r})\n")
    clean = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    wheels = [str(path) for path in sorted(made.glob("*.whl"))]
    command = [str(python), "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--force-reinstall", *wheels]
    done = subprocess.run(command, capture_output=True, text=True, env=clean)
    assert done.returncode == 0, done.stderr
    (tmp_path / "friendly.yaml").write_text(CONFIG)
    (tmp_path / "test_friendly.py").write_text(block("In your package's own tests:", "python"))
    for words in (
        [str(own / "bin" / "allegro-twin"), "check-backend", "friendly.yaml"],
        [str(own / "bin" / "allegro-twin"), "run", "friendly.yaml"],
        [str(python), "-c", block("allegro-twin panel friendly.yaml\n```", "python")],
        [str(python), "-c", "import allegro_twin; assert 'venv' in allegro_twin.__file__, allegro_twin.__file__"],
        [str(python), "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_friendly.py"],
    ):  # fmt: skip
        done = subprocess.run(words, cwd=tmp_path, env=clean, capture_output=True, text=True)
        assert done.returncode == 0, (words, done.stdout[-2000:], done.stderr[-2000:])
