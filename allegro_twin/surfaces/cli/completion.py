"""Shell completion: names of what ships."""

from __future__ import annotations


def postures() -> list[str]:
    return _stems("conf/postures")


def grasps() -> list[str]:
    return _stems("conf/grasps")


def trajectories() -> list[str]:
    return _stems("conf/trajectories")


def configs() -> list[str]:
    return _stems("conf")


def hands() -> list[str]:
    from allegro_twin.hands.description.specs import installed_hands

    return [*_stems("conf/hands"), *installed_hands()]


def models() -> list[str]:
    """Models of hands."""
    from allegro_twin.hands.description.specs import is_hand_model

    return [name for name in hands() if is_hand_model(name)]


def protocols() -> list[str]:
    return _stems("conf/protocols")


def policies() -> list[str]:
    return _stems("conf/policies", "*.onnx")


def targets() -> list[str]:
    """Configs and scenarios."""
    return [*configs(), *_stems("scenarios", "**/*.yaml")]


def objects() -> list[str]:
    from allegro_twin.sim.objects.catalogue import object_catalogue

    return sorted(object_catalogue())


def kinds() -> list[str]:
    """Kinds of lists."""
    from allegro_twin.surfaces.cli.start.catalogue import KINDS

    return sorted(KINDS)


def tasks() -> list[str]:
    from allegro_twin.learning.tasks import task_names

    return sorted(task_names())


def recipes() -> list[str]:
    """Tasks and recipes."""
    return [*tasks(), *_stems("conf/training"), *_stems("conf/pick")]


def _stems(folder: str, pattern: str = "*.yaml") -> list[str]:
    from allegro_twin.files.assets import data_root

    return sorted(path.stem for path in (data_root() / folder).glob(pattern))
