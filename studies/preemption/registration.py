"""The registration of a study: what its trials are made of, by fingerprint, written down before the first of them.

A protocol says what is done; models, grasps, objects and code say with what. A change of any of them after trials were
seen can be a choice that the trials made, so a registration is of all of it, and holds only as long as nothing differs.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from allegro_twin import ConfigError, RecordingError
from allegro_twin.files import atomic_file, data_root, fingerprint, read_yaml, source_fingerprint
from studies.preemption.arm.grasps import arm_content, grasps_file
from studies.preemption.protocol import ArmStudy, Study, named

EXPLORATORY = "none (exploratory)"
"""What trials without a registration are stamped with."""
CODE = ("code of trials", "code of the analysis")
_MODULES = ("studies.preemption.jobs", "studies.preemption.analysis")
_WORDS = ("description", "evidence", "taxonomy", "observed", "object_size")
"""Keys that no trial goes by."""
_SHOWN = 3


@dataclass(frozen=True, slots=True)
class Registration:
    """What was registered."""

    protocol: str
    """The digest of the protocol."""
    when: str
    """And of which state of the repository, in words."""
    contents: Mapping[str, str]
    """Fingerprints by name."""

    @property
    def digest(self) -> str:
        """Of all of it but when."""
        return fingerprint(self.protocol, self.contents)


def contents_of(study: Study, root: Path | None = None) -> dict[str, str]:
    """All that the trials of a study are made of, as it is now, or as it is in another checkout's folder. Comments and
    descriptions do not count. Raises ConfigError for a file that is missing."""
    folder = data_root() if root is None else root
    found = {"engine": f"mujoco {version('mujoco')}"}
    if root is None:
        found |= {name: source_fingerprint(module) for name, module in zip(CODE, _MODULES, strict=True)}
    for hand in study.hands:
        found[f"model of {hand}"] = _model(folder, hand)
        if isinstance(study, ArmStudy):
            found |= _cell_parts(study, hand, folder)
        else:
            for thing in (*study.train, *study.test):
                found |= parts_of(study, hand, thing, folder)
    return found


def inputs_of(study: Study, hand: str, thing: str) -> tuple[str, ...]:
    """Of the contents those that trials of a hand with an object are made of; objects of the protocol are in its
    digest."""
    if isinstance(study, ArmStudy):
        return f"model of {hand}", f"arm of {hand}", f"grasp of {thing} with {hand}"
    return (f"model of {hand}", f"scenario of {thing} with {hand}", f"grasp of {thing} with {hand}", f"object {thing}")


def _cell_parts(study: ArmStudy, hand: str, folder: Path) -> dict[str, str]:
    """Of a hand on the arm: the arm and how the hand sits on it, and the grasps that were planned."""
    content = arm_content(study, hand, folder)
    model = folder / "models" / "mjcf" / f"{content.get('model', 'none')}.xml"
    mount = read_yaml(_one(folder / "conf" / "mounts", f"{hand}.yaml"))
    found = {f"arm of {hand}": fingerprint(content, mount, _one(model.parent, model.name))}
    prepared = json.loads(grasps_file(hand).read_text())
    return found | {f"grasp of {name} with {hand}": fingerprint(one) for name, one in prepared.items()}


def parts_of(study: Study, hand: str, thing: str, folder: Path) -> dict[str, str]:
    """Of one object in one hand: its scenario, its grasp, and itself."""
    name = study.hands[hand].format(object=thing)
    scenario = read_yaml(_one(folder / "scenarios", f"**/{name}.yaml"))
    grasp = read_yaml(_one(folder / "conf" / "grasps", f"{scenario['grasp']}.yaml"))
    rows = [read_yaml(path).get(thing) for path in sorted((folder / "conf" / "objects").glob("*.yaml"))]
    return {
        f"scenario of {thing} with {hand}": fingerprint(_plain(scenario)),
        f"grasp of {thing} with {hand}": fingerprint(_plain(grasp)),
        f"object {thing}": fingerprint(rows),
    }


def differences(registered: Registration, study: Study, now: Mapping[str, str]) -> list[str]:
    """What does not fit any more, by name; a kind of which more than a few differ is counted."""
    changed = [] if registered.protocol == study.digest else ["the protocol"]
    kinds: dict[str, list[str]] = {}
    for name in {**registered.contents, **now}:
        if registered.contents.get(name) != now.get(name):
            kind, _, which = name.partition(" of ")
            of, _, hand = which.partition(" with ")
            kinds.setdefault(f"{kind}s of {hand}" if hand else name, []).append(of)
    for kind, names in kinds.items():
        shown = ", ".join(names[:_SHOWN]) + (f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else "")
        changed.append(f"{kind} ({shown})" if kind.partition(" of ")[0] in ("scenarios", "grasps") else kind)
    return changed


def place_of(protocol: str) -> Path:
    """Where the registration of a protocol stands: beside it."""
    return named(protocol).with_suffix(".registration.json")


def registered(path: Path) -> Registration | None:
    """The registration in a file; None where there is none. Raises RecordingError."""
    if not path.exists():
        return None
    try:
        return Registration(**json.loads(path.read_text()))
    except (OSError, ValueError, TypeError) as error:
        raise RecordingError(f"{path}: no registration can be read: {error}") from error


def register(study: Study, path: Path, when: str) -> Registration:
    """Write down what the study is made of now. Raises ConfigError where it is registered already: what was changed
    since is another study."""
    if path.exists():
        raise ConfigError(f"{path} is there: a study is registered once; a changed one is a protocol of another name")
    made = Registration(study.digest, when, contents_of(study))
    _write(path, made)
    return made


def _write(path: Path, made: Registration) -> None:
    with atomic_file(path) as temporary:
        temporary.write_text(json.dumps(asdict(made), indent=1) + "\n")


def stamp_of(study: Study, protocol: str, *, exploratory: bool) -> str:
    """What trials that are made now are stamped with: the digest of the registration that they are made under, or
    that they are exploratory. Raises ConfigError where there is one and it does not fit."""
    path = place_of(protocol)
    found = registered(path)
    if exploratory or found is None:
        return EXPLORATORY
    if changed := differences(found, study, contents_of(study)):
        raise ConfigError(
            f"{path.name} ({found.when}) no longer fits: {', '.join(changed)}; say --exploratory, or register this "
            "under another name before its first trial"
        )
    return found.digest


def status_of(stamps: Mapping[str, str]) -> str:
    """What trials with these stamps can show, in a sentence."""
    stamp = stamps.get("registration")
    if stamp is None:
        return ("Exploratory: of these trials the protocol alone was registered; models, grasps and code could change "
                "after trials had been seen.")  # fmt: skip
    if stamp == EXPLORATORY:
        return "Exploratory: no registration of models, grasps, objects and code was in force."
    return f"Registered: protocol, models, grasps, objects and code as in registration {stamp}."


def _model(folder: Path, hand: str) -> str:
    """A hand's card, the table that its model is made of, MJCF, URDF and gains."""
    parts: dict[str, Any] = {"card": read_yaml(folder / "conf" / "hands" / f"{hand}.yaml")}
    for name, path in {
        "facts": folder / "models" / f"{hand}.yaml",
        "tendons": folder / "models" / "tendons" / f"{hand}.yaml",
        "gains": folder / "conf" / "gains" / f"{hand}.yaml",
    }.items():
        parts[name] = read_yaml(path) if path.is_file() else None
    return fingerprint(parts, *(folder / "models" / kind / f"{hand}_right.{end}" for kind, end in
                                (("mjcf", "xml"), ("urdf", "urdf"))))  # fmt: skip


def _plain(content: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in content.items() if key not in _WORDS}


def _one(folder: Path, pattern: str) -> Path:
    found = sorted(folder.glob(pattern))
    if not found:
        raise ConfigError(f"{folder}: no {pattern}, which the study needs")
    return found[0]
