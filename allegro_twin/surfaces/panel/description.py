"""The page's description of a hand: its scene, its choices, and the entries of the library that it can perform."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from allegro_twin.app import Rig
from allegro_twin.app.config import RunConfig
from allegro_twin.app.simulated import following
from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import data_root
from allegro_twin.files.schema import parse_settings
from allegro_twin.hands.description.specs import is_hand_model
from allegro_twin.hands.library.gains import gains_names
from allegro_twin.hands.library.library import Library, load_grasp, load_posture, posture_names
from allegro_twin.spec import HandSpec
from allegro_twin.surfaces.panel.episode_watch import EpisodeWatch
from allegro_twin.surfaces.panel.requests import OpenScene
from allegro_twin.surfaces.panel.stream import LibraryContents, SessionInfo
from allegro_twin.viewing.scenery import scenery


def describe_hand(
    session: int,
    rig: Rig,
    config: RunConfig,
    controllers: tuple[str, ...],
    watch: EpisodeWatch | None = None,
) -> SessionInfo:
    """`watch`: of the episode, where the hand is in one. Raises ConfigError."""
    choice = config.backend.virtual
    return SessionInfo(
        session,
        f"{rig.spec.serial or rig.spec.name} · {config.backend.place}",
        rig.spec,
        scenery(rig.spec, _meta(rig) if watch is None else {"look": watch.appearance}),
        controllers,
        gains_names(rig.spec),
        _scenarios(rig.spec) if choice else (),
        _object_names() if choice else (),
        config.task.scenario,
        config.task.object,
        _no_tips(rig.spec),
        _no_drag(rig, config),
        episode="" if watch is None else watch.name,
        plans=watch is not None and watch.plans,
        turns=watch is not None and watch.turns,
    )


def library_contents(spec: HandSpec) -> LibraryContents:
    """Postures and grasps that this hand can have; others are left out."""
    return LibraryContents(
        {each.name: load_posture(each.name, spec) for each in Library().list("posture", hand=spec)},
        {each.name: load_grasp(each.name, spec).close for each in Library().list("grasp", hand=spec)},
    )


def scene_of(config: RunConfig, request: OpenScene) -> RunConfig:
    """The config in another scene; without a scenario in its own episode, where it has one. Raises ConfigError."""
    if not config.backend.virtual:
        raise ConfigError(f"only a simulated hand has a scene to change; this one is {config.backend.place}")
    content = config.model_dump(exclude_unset=True, exclude={"task", "seconds"})
    own = config.task
    if request.scenario is None and own.episode is not None:
        return config
    if request.scenario is not None and (request.scenario, request.object_name) == (own.scenario, own.object):
        return config  # With its grasp, its controller and its gains.
    if request.scenario is None:
        home = {"task": {"posture": "home"}} if posture_names(config.hand.model) else {}
        return parse_settings(RunConfig, content | home, "the scene")
    task = {"scenario": request.scenario} | ({} if request.object_name is None else {"object": request.object_name})
    return parse_settings(RunConfig, content | {"task": task, "controller": following(config.hand)}, "the scene")


def _meta(rig: Rig) -> Mapping[str, Any]:
    """The metadata that a recording of the rig would have, as far as they say how it looks."""
    if rig.trial is not None:
        return rig.trial.meta()
    if rig.sim is not None:
        from allegro_twin.sim.model.appearance import scene_appearance

        return {"look": scene_appearance(rig.sim.model, rig.spec, ())}
    recording = getattr(rig.backend, "recording", None)
    return {} if recording is None else dict(recording.meta)


def _scenarios(spec: HandSpec) -> tuple[str, ...]:
    """Those of a model of hand with a folder of its own; else those in no other model's folder."""
    folder = data_root() / "scenarios"
    own = folder / spec.model
    found = (
        own.glob("*.yaml") if own.is_dir() else (p for p in folder.rglob("*.yaml") if not is_hand_model(p.parent.name))
    )
    return tuple(sorted(p.stem for p in found if "grasps" not in p.relative_to(folder).parts[:-1]))


def _object_names() -> tuple[str, ...]:
    from allegro_twin.sim.objects.catalogue import object_catalogue

    return tuple(object_catalogue())


def _no_drag(rig: Rig, config: RunConfig) -> str:
    """Why objects cannot be pulled with the mouse."""
    if rig.episode is not None:
        return "objects of an episode cannot be pulled with the mouse; those of a scenario can"
    if rig.sim is None:
        return f"only simulated objects can be pulled with the mouse; this hand is {config.backend.place}"
    return "" if rig.trial is not None else "there is no object here; choose a scenario, and set the scene"


def _no_tips(spec: HandSpec) -> str:
    """Why fingertips cannot be dragged."""
    from allegro_twin.kinematics.hand import hand_kinematics

    try:
        hand = hand_kinematics(spec)
        for finger in spec.fingers:
            if shared := hand.finger(finger.name).shared:
                return f"the motors of {finger.name} move {', '.join(shared)} as well"
    except ConfigError as error:
        return str(error)
    return ""
