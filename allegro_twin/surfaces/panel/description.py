"""What the page is told once of a hand: who it is, what is there to choose, and what the library has for it."""

from __future__ import annotations

from allegro_twin.app.config import RunConfig
from allegro_twin.app.simulated import following
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import parse_settings
from allegro_twin.hands.description.specs import is_hand_model
from allegro_twin.hands.library.gains import gains_names
from allegro_twin.hands.library.library import Library, load_grasp, load_posture, posture_names
from allegro_twin.kinematics.closed_form.finger import ClosedFormFinger
from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.panel.requests import Scene
from allegro_twin.surfaces.panel.scene_state import scenery_of
from allegro_twin.surfaces.panel.session import OpenHand
from allegro_twin.surfaces.panel.stream import Opened, Shelf


def described(opened: OpenHand) -> Opened:
    """Raises ConfigError."""
    rig, config = opened.rig, opened.config
    choice = config.backend.virtual
    return Opened(
        opened.number,
        f"{rig.spec.serial or rig.spec.name} · {config.backend.place}",
        rig.spec,
        scenery_of(rig),
        rig.backend.period,
        opened.hand.controllers,
        gains_names(rig.spec),
        opened.gains,
        _scenarios(rig.spec) if choice else (),
        _things() if choice else (),
        config.task.scenario,
        config.task.object,
        _no_tips(rig.spec, opened),
    )


def shelf(spec: HandSpec) -> Shelf:
    """Postures and grasps that this hand can have; what is not for it is left out."""
    postures, grasps, library = {}, {}, Library()
    for listed in library.list("posture"):
        if listed.entry.hand != spec.model:
            continue
        try:
            postures[listed.name] = load_posture(listed.name, spec)
        except ConfigError:
            continue  # Outside the limits of this very hand.
    for listed in library.list("grasp"):
        if listed.entry.hand != spec.model:
            continue
        try:
            grasps[listed.name] = load_grasp(listed.name, spec).close
        except ConfigError:
            continue
    return Shelf(postures, grasps)


def scene_of(config: RunConfig, wish: Scene) -> RunConfig:
    """The config in another scene. Raises ConfigError."""
    if not config.backend.virtual:
        raise ConfigError(f"only a simulated hand has a scene to change; this one is {config.backend.place}")
    content = config.model_dump(exclude_unset=True, exclude={"task", "seconds"})
    if wish.scenario is None:
        home = {"task": {"posture": "home"}} if posture_names(config.hand.model) else {}
        return parse_settings(RunConfig, content | home, "the scene")
    task = {"scenario": wish.scenario} | ({} if wish.thing is None else {"object": wish.thing})
    return parse_settings(RunConfig, content | {"task": task, "controller": following(config.hand)}, "the scene")


def _scenarios(spec: HandSpec) -> tuple[str, ...]:
    """Of a model of hand that has a folder of its own that; else what is in no other model's."""
    folder = data_root() / "scenarios"
    own = folder / spec.model
    found = (
        own.glob("*.yaml") if own.is_dir() else (p for p in folder.rglob("*.yaml") if not is_hand_model(p.parent.name))
    )
    return tuple(sorted(p.stem for p in found if "grasps" not in p.relative_to(folder).parts[:-1]))


def _things() -> tuple[str, ...]:
    from allegro_twin.sim.objects.catalogue import catalogue

    return tuple(catalogue())


def _no_tips(spec: HandSpec, opened: OpenHand) -> str:
    from allegro_twin.kinematics.hand import hand_kinematics

    try:
        for finger in spec.fingers:
            ClosedFormFinger(spec, finger.name)
        hand_kinematics(spec).check_closed_form([finger.name for finger in spec.fingers])
    except ConfigError as error:
        return str(error)
    return ""
