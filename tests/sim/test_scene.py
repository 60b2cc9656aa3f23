"""Objects, the wrist and the probe: what stands around the hand is where and what it was said to be."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import mujoco
import numpy as np
import pytest

from allegro_twin.errors import ConfigError
from allegro_twin.files.schema import parse_settings
from allegro_twin.grasping.scenario import PhysicsSettings, Scenario, load_protocol
from allegro_twin.grasping.timeline import make_stage, make_timeline
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.library import load_grasp
from allegro_twin.sim.contact.contact_surfaces import box_edges
from allegro_twin.sim.contact.probe import ObjectProbe
from allegro_twin.sim.engine.backend import SimBackend
from allegro_twin.sim.model.physics import Cone, Physics
from allegro_twin.sim.model.scene import Stage, compile_scene
from allegro_twin.sim.model.wrist import (
    STIFF_WRIST,
    WRIST_JOINTS,
    WristSegment,
    WristServo,
    _shaken,
    set_wrist_servo,
    wrist_load,
    wrist_set_points,
)
from allegro_twin.sim.objects.catalogue import (
    GraspObject,
    PlacedObject,
    load_object,
    object_catalogue,
    standing_orientation,
)
from allegro_twin.spec import SIDES, HandSpec, Side
from allegro_twin.types import TorqueCommand

PROTOCOL = load_protocol("table_pick")
AWAY = {"position": (0, 0, 0.4), "facing": (0, 0, -1), "fingers": (1, 0, 0), "retreat": (0, 0, 0.1)}


def content(**changes: Any) -> dict[str, Any]:
    return {"objects": [{"name": "rubiks_cube"}], "grasp": "quadpod", "wrist": AWAY} | changes


def scenario(**changes: Any) -> Scenario:
    return Scenario.model_validate(content(**changes))


def backend_at(settings: Scenario, folder: Path = Path(), side: Side = "right") -> SimBackend:
    spec = load_spec(side=side)
    return SimBackend(spec, compile_scene(spec, make_stage(settings, load_protocol(settings.protocol), side, folder)))


def test_the_catalogue_has_the_22_ycb_objects() -> None:
    things = object_catalogue()
    assert len(things) == 22
    can = things["tomato_soup_can"]
    assert (can.shape, can.size, can.mass) == ("cylinder", (0.066, 0.101), 0.349)
    with pytest.raises(ConfigError, match="no object named 'tomato_can'; did you mean 'tomato_soup_can'"):
        load_object("tomato_can")


@pytest.mark.parametrize("name", sorted(object_catalogue()))
def test_every_object_weighs_what_it_should_and_rests_where_it_stands(name: str) -> None:
    backend = backend_at(scenario(objects=[{"name": name}]))
    backend.reset()
    body = backend.model.body(name)
    assert body.mass[0] == pytest.approx(load_object(name).mass)
    before = backend.data.body(name).xpos.copy()
    for _ in range(100):
        backend.read()
    np.testing.assert_allclose(backend.data.body(name).xpos, before, atol=5e-4)


@pytest.mark.parametrize(("up", "height"), [("x", 0.035), ("y", 0.110), ("z", 0.089)])
def test_up_says_for_either_hand_which_axis_of_the_object_points_at_the_sky(up: str, height: float, side: Side) -> None:
    placed = make_stage(scenario(objects=[{"name": "pudding_box", "up": up}]), PROTOCOL, side, Path()).objects[0]
    assert placed.position[2] == pytest.approx(height / 2, abs=2e-4)
    turned = np.empty(3)
    mujoco.mju_rotVecQuat(turned, np.eye(3)["xyz".index(up)], np.array(placed.quaternion))
    np.testing.assert_allclose(turned, [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_the_left_hand_finds_an_object_turned_the_other_way_about_the_vertical_and_otherwise_as_it_stands(
    up: str,
) -> None:
    own = {"name": "pudding_box", "up": up, "yaw": 30.0, "at": (0.1, 0.05)}
    (placed,) = make_stage(scenario(objects=[own]), PROTOCOL, "left", Path()).objects
    np.testing.assert_allclose(placed.quaternion, standing_orientation(up, -math.pi / 6), atol=1e-15)
    np.testing.assert_allclose(placed.position[:2], [0.1, -0.05])


def test_the_left_hand_is_shaken_and_pulled_by_gravity_in_the_mirror() -> None:
    tilted = PROTOCOL.model_copy(update={"physics": PhysicsSettings(gravity=(1.0, 2.0, -9.0))})
    assert make_stage(scenario(), tilted, "right", Path()).physics.gravity == (1.0, 2.0, -9.0)
    assert make_stage(scenario(), tilted, "left", Path()).physics.gravity == (1.0, -2.0, -9.0)
    ways = {}
    for side in SIDES:
        spec = load_spec(side=side)
        grasp = load_grasp("quadpod", spec)
        segments = make_timeline(PROTOCOL, grasp, scenario(), grasp.preshape, spec, 0.003).segments
        ways[side] = wrist_set_points(segments, 0.003, 1.0)
    np.testing.assert_array_equal(ways["left"], ways["right"] * [1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    assert ways["right"][:, 1].any()


def test_yaw_turns_about_the_vertical() -> None:
    turned = np.empty(3)
    mujoco.mju_rotVecQuat(turned, np.array([1.0, 0, 0]), standing_orientation("z", math.pi / 2))
    np.testing.assert_allclose(turned, [0, 1, 0], atol=1e-12)


def test_a_mesh_and_an_mjcf_of_the_users_own_become_objects(tmp_path: Path) -> None:
    corners = [(x, y, z) for x in (-20, 20) for y in (-20, 20) for z in (-20, 20)]
    faces = [(1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)]
    text = [f"v {x} {y} {z}" for x, y, z in corners] + ["f " + " ".join(map(str, face)) for face in faces]
    (tmp_path / "cube.obj").write_text("\n".join(text))
    (tmp_path / "ball.xml").write_text(
        "<mujoco><worldbody><body name='b'><freejoint/>"
        "<geom name='g' size='0.02' mass='0.05'/></body></worldbody></mujoco>"
    )
    mesh = {"name": "cube", "shape": "mesh", "file": "cube.obj", "scale": 0.001, "mass": 0.1, "at": (0, 0, 0.0201)}
    ball = {"name": "ball", "shape": "mjcf", "file": "ball.xml", "at": (0.1, 0, 0.0201)}
    backend = backend_at(scenario(objects=[mesh, ball]), tmp_path)
    backend.reset()
    for _ in range(100):
        backend.read()
    assert backend.mass_of("cube") == pytest.approx(0.1)
    assert backend.mass_of("ball") == pytest.approx(0.05)
    for name, x in (("cube", 0.0), ("ball", 0.1)):
        np.testing.assert_allclose(backend.data.body(name).xpos, [x, 0, 0.02], atol=5e-4)


@pytest.mark.parametrize("own", ["", "friction='2 1 1' priority='1'"])
def test_an_mjcfs_own_friction_gives_way_to_the_scenarios(own: str, tmp_path: Path) -> None:
    (tmp_path / "cube.xml").write_text(
        f"<mujoco><worldbody><body><geom type='box' size='0.02 0.02 0.02' mass='0.05' {own}/>"
        f"<body><geom size='0.005' pos='0 0 0.02' {own}/></body></body></worldbody></mujoco>"
    )
    cube = {"name": "cube", "shape": "mjcf", "file": "cube.xml", "at": (0, 0, 0.0201)}
    box = {"name": "box", "shape": "box", "size": (0.04, 0.04, 0.04), "mass": 0.05, "at": (0.1, 0)}
    backend = backend_at(scenario(objects=[cube, box], friction=0.03), tmp_path)
    backend.reset()
    for _ in range(10):
        backend.read()
    model, data = backend.model, backend.data
    names = [{model.body(model.geom_bodyid[g]).name for g in contact.geom} for contact in data.contact]
    rubs = {name: {tuple(c.friction) for c, of in zip(data.contact, names, strict=True) if name in of} for name in
            ("cube", "box")}  # fmt: skip
    assert rubs["cube"] == rubs["box"]
    assert {friction[0] for friction in rubs["cube"]} == {0.03}


@pytest.mark.parametrize(
    ("own", "message"),
    [
        ({"name": "it", "shape": "mesh"}, "s.yaml: objects.0: object it: a mesh needs `file`"),
        ({"name": "it", "shape": "mesh", "file": "no.stl"}, "object it: no file at"),
        (
            {"name": "it", "shape": "box", "size": (0.1,), "mass": 1},
            "s.yaml: objects.0: object it: a box needs `size` with 3 values",
        ),
        ({"name": "it", "shape": "sphere", "size": (0.1,)}, "s.yaml: objects.0: object it: a sphere needs `mass`"),
        (
            {"name": "it", "shape": "mjcf", "file": "no.xml"},
            "s.yaml: objects.0: object it: a mjcf needs a third value in `at`",
        ),
    ],
)
def test_an_own_object_says_what_it_lacks(own: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=message):
        make_stage(parse_settings(Scenario, content(objects=[own]), "s.yaml"), PROTOCOL, "right", tmp_path)


def test_an_unreadable_mjcf_is_one_line_with_its_file(tmp_path: Path) -> None:
    (tmp_path / "bad.xml").write_text("<mujoco><worldbody><geom size='x'/></worldbody></mujoco>")
    own = {"name": "it", "shape": "mjcf", "file": "bad.xml", "at": (0, 0, 0)}
    with pytest.raises(ConfigError, match=r"bad\.xml: (not a readable MJCF|must hold one body)") as caught:
        backend_at(scenario(objects=[own]), tmp_path)
    assert "\n" not in str(caught.value)


def wrist_run(protocol: str, side: Side) -> tuple[SimBackend, Any]:
    spec = load_spec(side=side)
    settings = scenario()
    grasp = load_grasp("quadpod", spec)
    timeline = make_timeline(load_protocol(protocol), grasp, settings, grasp.preshape, spec, 0.003)
    model = compile_scene(spec, make_stage(settings, PROTOCOL, side, Path()))
    drive = wrist_set_points(timeline.segments, Physics().timestep, wrist_load(model))
    return SimBackend(spec, model, posture=grasp.preshape, drive=drive), timeline


@pytest.mark.slow
def test_the_wrist_is_where_the_timeline_says_and_shakes_as_hard_as_it_says(side: Side) -> None:
    backend, timeline = wrist_run("table_pick", side)
    backend.reset()
    palm = backend.model.body("palm_link").id
    places, ends = [], {}
    for k in range(round(timeline.seconds / 0.003)):
        state = backend.read()
        places.append(backend.data.xpos[palm].copy())
        for window in timeline.windows:
            if abs(state.t - window.end) < 1e-9:
                ends[window.name] = (places[-1], backend.data.xmat[palm].reshape(3, 3).copy())
        assert k >= 0
    start = np.array(places[0])
    np.testing.assert_allclose(ends["approach"][0] - start, [0, 0, -0.1], atol=5e-4)
    np.testing.assert_allclose(ends["lift"][0] - ends["approach"][0], [0, 0, 0.15], atol=5e-4)
    np.testing.assert_allclose(ends["turn"][1], ends["hold"][1] @ np.diag([-1, -1, 1]), atol=2e-3)
    np.testing.assert_allclose(ends["shake"][0], ends["turn"][0], atol=5e-4)
    shake = next(window for window in timeline.windows if window.name == "shake")
    inside = np.array(places)[round(shake.begin / 0.003) :]
    acceleration = np.diff(inside, 2, axis=0) / 0.003**2
    np.testing.assert_allclose(np.abs(acceleration).max(axis=0), 3.0, rtol=0.15)


def test_the_left_trial_is_the_mirror_image_of_the_right() -> None:
    right, left = (
        backend_at(scenario(objects=[{"name": "gelatin_box", "yaw": 20, "at": (0.01, 0.02)}]), side=s)
        for s in ("right", "left")
    )
    right.reset()
    left.reset()
    mirror = np.diag([1.0, -1.0, 1.0])
    for name in ("palm_link", "gelatin_box"):
        np.testing.assert_allclose(left.data.body(name).xpos, mirror @ right.data.body(name).xpos, atol=1e-12)
        np.testing.assert_allclose(
            left.data.body(name).xmat.reshape(3, 3),
            mirror @ right.data.body(name).xmat.reshape(3, 3) @ mirror,
            atol=1e-12,
        )


@pytest.mark.parametrize("cone", get_args(Cone))
def test_the_probe_weighs_an_object_that_lies_on_the_palm(cone: Cone, spec: HandSpec) -> None:
    upward = np.array([math.sqrt(0.5), 0.0, -math.sqrt(0.5), 0.0])  # The palm looks at the sky.
    thing = GraspObject("brick", "box", (0.04, 0.04, 0.02), 0.2)
    place = PlacedObject(thing, (0.06, 0.0, 0.0225), (1.0, 0.0, 0.0, 0.0))
    backend = SimBackend(spec, compile_scene(spec, Stage(np.zeros(3), upward, [place], physics=Physics(cone=cone))))
    probe = ObjectProbe(backend.model, backend.data, spec, "brick")
    backend.reset()
    for _ in range(200):
        backend.write(TorqueCommand(np.zeros(16)))
        backend.read()
    seen = probe()
    assert seen["contact_force"][probe.parts.index("palm")] == pytest.approx(0.2 * 9.81, rel=0.02)
    assert seen["on_table"] == [0.0]


def test_a_fingertip_feels_what_it_presses(spec: HandSpec) -> None:
    """A tip that pushes on a fixed wall with a known torque reports that force."""
    place = PlacedObject(GraspObject("wall", "box", (0.02, 0.2, 0.2), 50.0), (0.030, 0.0, 0.16), (1.0, 0, 0, 0))
    stage_ = Stage(np.zeros(3), np.array([1.0, 0, 0, 0]), [place], physics=Physics(gravity=(0.0, 0.0, 0.0)))
    backend = SimBackend(spec, compile_scene(spec, stage_))
    backend.reset()
    torque = np.zeros(16)
    torque[5] = 0.2
    for _ in range(150):
        backend.write(TorqueCommand(torque))
        backend.read()
    touch = {f.name: backend.data.sensor(f"{f.name}_touch").data for f in spec.fingers}
    assert touch["middle"][0] > 0
    assert np.linalg.norm(touch["middle"][1:]) > 0.5
    assert touch["index"][0] == 0


def test_the_left_wrist_moves_and_turns_as_the_mirror_image_of_the_right(tmp_path: Path) -> None:
    protocol = tmp_path / "sideways.yaml"
    protocol.write_text(
        "version: 1\nreference: go\nphases: [{name: go, seconds: 0.6, move: [0.02, 0.05, 0.1], turn: [20, 10, 30]}]\n"
    )
    poses = {}
    for side in SIDES:
        backend, timeline = wrist_run(str(protocol), side)
        backend.reset()
        for _ in range(round(timeline.seconds / 0.003)):
            backend.read()
        palm = backend.data.body("palm_link")
        poses[side] = (palm.xpos.copy(), palm.xmat.reshape(3, 3).copy())
    mirror = np.diag([1.0, -1.0, 1.0])
    np.testing.assert_allclose(poses["left"][0], mirror @ poses["right"][0], atol=1e-6)
    np.testing.assert_allclose(poses["left"][1], mirror @ poses["right"][1] @ mirror, atol=1e-6)


def test_the_wrist_is_as_stiff_as_a_good_arms_end_and_critically_damped() -> None:
    """20 N/mm and 8 kg along, 600 N·m/rad and 0.08 kg·m² about, 2 √(k m) of damping."""
    model = backend_at(scenario()).model
    for number, name in enumerate(WRIST_JOINTS):
        stiffness, inertia = (2e4, 8.0) if number < 3 else (600.0, 0.08)
        motor, joint = model.actuator(name), model.joint(name)
        assert motor.gainprm[0] == stiffness
        assert motor.biasprm[1] == -stiffness
        assert motor.biasprm[2] == pytest.approx(-2.0 * math.sqrt(stiffness * inertia))
        assert model.dof_armature[joint.dofadr[0]] == inertia
        kind = mujoco.mjtJoint.mjJNT_SLIDE if number < 3 else mujoco.mjtJoint.mjJNT_HINGE
        assert model.jnt_type[joint.id] == kind


def test_a_wrist_that_yields_has_the_drive_that_it_is_given_and_the_hands_mass_counts_to_its_slides() -> None:
    model = backend_at(scenario()).model
    servo = WristServo(np.arange(1.0, 7.0) * 100.0, np.arange(1.0, 7.0))
    carried = wrist_load(model)
    assert carried == pytest.approx(model.body_subtreemass[model.body("palm_link").id])
    set_wrist_servo(model, servo)
    for number, name in enumerate(WRIST_JOINTS):
        motor = model.actuator(name)
        assert motor.gainprm[0] == servo.stiffness[number]
        np.testing.assert_allclose(motor.biasprm[1:3], [-servo.stiffness[number], -servo.damping[number]])
        inertia = servo.inertia[number] - (carried if number < 3 else 0.0)
        assert model.dof_armature[model.joint(name).dofadr[0]] == pytest.approx(inertia)


def test_set_points_lead_the_wrist_by_what_its_drive_lags_and_lift_what_it_carries() -> None:
    """Half way through minimum jerk: half of the way, 15/8 of the mean speed and no acceleration."""
    move = np.array([0.1, 0.0, 0.2, 0.0, 0.3, 0.0])
    table = wrist_set_points([WristSegment(1.0, move, np.zeros(6)), WristSegment(0.5, -move, np.zeros(6))], 0.01, 2.0)
    assert table.shape == (150, 6)
    servo = STIFF_WRIST
    weight = np.array([0.0, 0.0, 2.0 * 9.81 / 2e4, 0.0, 0.0, 0.0])
    half = move / 2.0 + servo.damping * 1.875 * move / servo.stiffness + weight
    np.testing.assert_allclose(table[49], half, atol=1e-12)
    np.testing.assert_allclose(table[99], move + weight, atol=1e-12)
    np.testing.assert_allclose(table[149], weight, atol=1e-12)
    speed = servo.damping * -1.875 * move / 0.5 / servo.stiffness
    np.testing.assert_allclose(table[124], move / 2.0 + speed + weight, atol=1e-12)
    # At a quarter of the time: 0.103515625 of the way, 1.0546875 of the speed, 5.625 of the acceleration.
    quarter = 0.103515625 * move + (servo.damping * 1.0546875 * move + servo.inertia * 5.625 * move) / servo.stiffness
    np.testing.assert_allclose(table[24], quarter + weight, atol=1e-12)
    np.testing.assert_array_equal(wrist_set_points([], 0.01, 0.0), np.zeros((1, 6)))


def test_a_shake_goes_one_axis_after_the_other_and_rises_and_falls_over_a_cycle() -> None:
    shake = np.array([2.0, 0.0, 0.0, 0.0, 3.0, 0.0])
    table = wrist_set_points([WristSegment(4.0, np.zeros(6), shake)], 1e-3, 0.0)
    omega = 4.0 * math.pi
    assert np.abs(table[:, [1, 2, 3, 5]]).max() == 0.0
    assert np.abs(table[2002:, 0]).max() == 0.0
    assert np.abs(table[:1998, 4]).max() == 0.0
    t = 1e-3 * np.arange(1.0, 4001.0)
    full = (t > 0.6) & (t < 1.4)  # The envelope is whole between the first and the last of four cycles.
    wanted = 2.0 / omega**2 * np.sin(omega * t)
    ahead = STIFF_WRIST.damping[0] * 2.0 / omega * np.cos(omega * t) - STIFF_WRIST.inertia[0] * 2.0 * np.sin(omega * t)
    np.testing.assert_allclose(table[full, 0], (wanted + ahead / 2e4)[full], atol=2e-6)
    early = t[:125] * 2.0
    envelope = early**3 * (10 - 15 * early + 6 * early**2)
    lag = WristSegment(4.0, np.zeros(6), shake)
    position = _shaken(t, lag)[0]
    np.testing.assert_allclose(position[:125, 0], (wanted[:125] * envelope), atol=1e-12)
    np.testing.assert_allclose(position[2000:2125, 4], 1.5 * wanted[:125] * envelope, atol=1e-9)


def test_the_edges_of_an_object_are_of_the_box_around_all_its_shapes(tmp_path: Path) -> None:
    """A box that lies askew beside a ball."""
    file = tmp_path / "two.xml"
    file.write_text(
        '<mujoco><worldbody><body name="two"><freejoint/>'
        '<geom type="box" size="0.01 0.02 0.03" pos="0.05 0 0" euler="0 0 30"/>'
        '<geom type="sphere" size="0.015" pos="-0.02 0.01 0.04"/></body></worldbody></mujoco>'
    )
    model = mujoco.MjModel.from_xml_path(str(file))
    along, across = math.cos(math.pi / 6), math.sin(math.pi / 6)
    x, y = 0.01 * along + 0.02 * across, 0.01 * across + 0.02 * along
    expected = [(0.05 + x) - (-0.02 - 0.015), max(y, 0.025) + y, 0.04 + 0.015 + 0.03]
    np.testing.assert_allclose(box_edges(model, "two"), expected, atol=1e-9)


def test_a_hand_in_the_middle_of_many_pieces_has_room_for_all_contacts(spec: HandSpec) -> None:
    """MuJoCo's own guess leaves none of them, and says so where nobody looks."""
    ball = load_object("golf_ball")
    heap = [PlacedObject(replace(ball, name=f"ball_{k}"), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)) for k in range(30)]
    model = compile_scene(spec, Stage(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), heap))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.ncon > 300
    assert data.nefc > 3 * data.ncon
    assert not any(warning.number for warning in data.warning)
    alone = compile_scene(spec, Stage(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), heap[:1]))
    assert alone.narena < model.narena / 4, "thousands of simulations of one object need no more than before"
