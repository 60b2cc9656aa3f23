"""A hidden hand, its recording, and the file that says what it is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from allegro_twin.app.config import RunConfig, load_config
from allegro_twin.app.rig import assemble
from allegro_twin.app.session import Outputs, perform
from allegro_twin.drivers.can.config import CanSettings
from allegro_twin.hands.description.calibration import HandCalibration
from allegro_twin.twin.identify.results.hand_file import offset_shift


@pytest.fixture(scope="package")
def hidden() -> RunConfig:
    """A virtual hand that is not what its host believes."""
    return load_config("can_hidden").changed(seconds=2.4)


@pytest.fixture(scope="package")
def made(tmp_path_factory: pytest.TempPathFactory, hidden: RunConfig) -> Path:
    """Its recording."""
    path = tmp_path_factory.mktemp("hidden") / "run.arrow"
    perform(assemble(hidden), hidden, Outputs(record=path))
    return path


@pytest.fixture(scope="package")
def own(tmp_path_factory: pytest.TempPathFactory, hidden: RunConfig) -> str:
    """The file that `identify` would write of it, were it perfect."""
    assert isinstance(hidden.backend, CanSettings)
    assert hidden.backend.scene is not None
    truth: Any = hidden.backend.scene.truth
    used = HandCalibration()
    step = -offset_shift("v4", used, tuple(count + 1 for count in used.encoder_offset))
    counts = np.rint(-np.array(truth["drive"]["encoder_offset"]) / step).astype(int).tolist()
    wire = {"version": "v4", "side": "right", "encoder_offset": counts, **truth["wire"]}
    path = tmp_path_factory.mktemp("hands") / "own.yaml"
    path.write_text(yaml.safe_dump({"wire": wire, "actuation": truth["actuation"], "drive": {"delay": 0.0035}}))
    return str(path)
