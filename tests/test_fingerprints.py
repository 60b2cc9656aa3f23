"""Fingerprints tell contents apart, by every byte that counts, and by nothing else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.files.fingerprints import fingerprint, reached_sources, source_fingerprint
from allegro_twin.grasping.scenario import load_scenario
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.learning.tasks import start_states
from allegro_twin.sim.model.fingerprint import hand_fingerprint, model_fingerprint
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.sim.objects.catalogue import load_object
from allegro_twin.sim.objects.convex_decomposition import _key
from allegro_twin.sim.objects.meshes import Mesh
from allegro_twin.spec import HandSpec


def test_contents_that_differ_have_different_fingerprints() -> None:
    ones = np.ones((2, 3))
    contents: list[Any] = [
        None, True, False, 0, 1, 1.0, float(np.nextafter(1.0, 2.0)), "1", "", b"", b"1", [], [[]], [1, [2]], [[1], 2],
        {}, {"a": 1}, {"a": 2}, {"b": 1}, ["ab", "c"], ["a", "bc"], ones, ones.T, ones.astype(np.float32),
        ones.astype(int), ones * np.nextafter(1.0, 2.0),
    ]  # fmt: skip
    assert len({fingerprint(each) for each in contents}) == len(contents)
    assert fingerprint(1, 2) != fingerprint(12)
    assert fingerprint({"a": 1, "b": 2}) == fingerprint({"b": 2, "a": 1})
    assert fingerprint((1, 2)) == fingerprint([1, 2])


def test_a_file_is_its_bytes_wherever_it_lies(tmp_path: Path) -> None:
    for name, content in (("a", "x"), ("b", "x"), ("c", "y")):
        (tmp_path / name).write_text(content)
    assert fingerprint(tmp_path / "a") == fingerprint(tmp_path / "b") != fingerprint(tmp_path / "c")
    with pytest.raises(ConfigError, match="nowhere: cannot be read: No such file"):
        fingerprint(tmp_path / "nowhere")


def test_what_has_no_content_has_no_fingerprint() -> None:
    with pytest.raises(TypeError, match="no fingerprint of a function"):
        fingerprint({"a": [lambda: 1]})


@pytest.mark.parametrize("part", ["lower", "upper", "actuation", "joints", "mirror_flips"])
def test_a_hand_is_all_that_its_spec_says(spec: HandSpec, part: str) -> None:
    value: Any = getattr(spec, part)
    if part == "actuation":
        changed: Any = replace(value, damping=value.damping * 1.0001)
    else:
        changed = value + 1e-9 if isinstance(value, np.ndarray) else value[::-1]
    assert hand_fingerprint(replace(spec, **{part: changed})) != hand_fingerprint(spec)
    assert hand_fingerprint(replace(spec, card="elsewhere.yaml")) == hand_fingerprint(spec)


def test_a_scene_is_its_physics_and_not_its_looks(spec: HandSpec) -> None:
    model = compile_scene(spec, Stage(np.zeros(3), np.array([1.0, 0, 0, 0])))
    before = model_fingerprint(model)
    model.geom_rgba[:] *= 0.5
    model.mat_rgba[:] *= 0.5
    model.light_pos[:] += 1.0
    model.vis.headlight.ambient[:] = 1.0
    assert model_fingerprint(model) == before
    for change in ("body_mass", "dof_damping", "geom_size", "jnt_range", "geom_friction", "actuator_forcerange"):
        array = getattr(model, change)
        kept = array.copy()
        array[:] = kept * 1.001 + 1e-6
        assert model_fingerprint(model) != before, change
        array[:] = kept
    model.opt.timestep *= 1.001
    assert model_fingerprint(model) != before


def test_sources_are_followed_into_functions_and_lazy_packages_and_not_into_types(tmp_path: Path) -> None:
    reached = reached_sources("tests.sweep.work")
    assert {"tests", "tests.sweep", "tests.sweep.work", "allegro_twin.errors"} <= reached.keys()
    assert "tests.sweep.test_sweep" not in reached
    lazy = reached_sources("benchmarks.sweeping")  # It imports names of the package `sweep`.
    assert {"allegro_twin.sweep.runner", "allegro_twin.sweep.store"} <= lazy.keys()
    assert source_fingerprint("nowhere.at_all") == ""


def test_what_a_higher_wing_provides_is_among_the_sources_of_who_asks_for_it() -> None:
    assert "allegro_twin.sim.model.link_tree" in reached_sources("allegro_twin.kinematics.tree")
    assert "allegro_twin.sim.model.link_tree" not in reached_sources("allegro_twin.kinematics.pose")


def test_states_of_fingertips_are_of_one_hand_and_pieces_of_one_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    cube = load_object("rubiks_cube")
    before, stiffer = start_states.file_name(cube), load_spec()
    motors = replace(stiffer.actuation, frictionloss=stiffer.actuation.frictionloss + 0.01)
    monkeypatch.setattr(start_states, "load_spec", lambda **_: replace(stiffer, actuation=motors))
    assert start_states.file_name(cube) != before
    pytest.importorskip("coacd", reason="pieces need CoACD: extra objects")
    mesh = Mesh(np.eye(4, 3), np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]))
    moved = Mesh(mesh.vertices * np.nextafter(1.0, 2.0), mesh.faces)
    was = _key(mesh)
    assert _key(moved) != was
    monkeypatch.setattr("allegro_twin.sim.objects.convex_decomposition.version", lambda _: "0")
    assert _key(mesh) != was


def test_settings_count_by_what_they_say() -> None:
    scenario, _ = load_scenario("lemon")
    assert fingerprint(scenario) == fingerprint(scenario.model_copy())
    assert fingerprint(scenario) != fingerprint(scenario.model_copy(update={"friction": 0.7}))
