"""What may follow on the command line: names of what ships, for the shell's completion."""

from __future__ import annotations

from allegro_twin.files.assets import data_root


def postures() -> list[str]:
    return _stems("conf/postures")


def grasps() -> list[str]:
    return _stems("conf/grasps")


def trajectories() -> list[str]:
    return _stems("conf/trajectories")


def configs() -> list[str]:
    return _stems("conf")


def hands() -> list[str]:
    return _stems("conf/hands")


def models() -> list[str]:
    """Of hands."""
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
    """Of lists."""
    from allegro_twin.surfaces.cli.shown.catalogue import KINDS

    return sorted(KINDS)


def tasks() -> list[str]:
    from allegro_twin.learning.tasks import task_names

    return sorted(task_names())


def recipes() -> list[str]:
    """Recipes, and tasks, which are recipes too."""
    return [*tasks(), *_stems("conf/training")]


def _stems(folder: str, pattern: str = "*.yaml") -> list[str]:
    return sorted(path.stem for path in (data_root() / folder).glob(pattern))
