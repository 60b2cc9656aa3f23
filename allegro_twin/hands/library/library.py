"""The library: postures, grasps and trajectories by name, for either hand, from files and from memory.

Each is stored once, for one side; the other side is its mirror image, made when it is asked for. To store one for the
left hand whose file is written for the right changes that same entry, converted: the sides agree bit for bit, always.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple, get_args

from allegro_twin.control.demonstration import TaughtMotion
from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files import yaml_edit
from allegro_twin.files.assets import data_root, parse_yaml, refuse_shipped
from allegro_twin.hands.library.entries import (
    HAND,
    Entry,
    EntryKind,
    GraspFile,
    PostureFile,
    TrajectoryFile,
    angles_by_finger,
    convert_side,
    joint_values,
    parse_entry,
)
from allegro_twin.hands.library.entry_files import (
    LibraryEntry,
    check_free,
    check_name,
    read_all,
    read_file,
    read_shipped_entry,
    read_single_entry,
    shipped_entries,
)
from allegro_twin.hands.library.grasps import Grasp, build_grasp
from allegro_twin.hands.library.taxonomy import GRASP_TYPES, ClaimedType, Control, ObservedType
from allegro_twin.spec import HandSpec
from allegro_twin.types import Vector, frozen

FOLDER = Path("library")
"""The user's library, where the process runs."""


class _Added(NamedTuple):
    entry: Entry
    spec: HandSpec


class Library:
    """Everything that ships, the user's own folders and files, and what was added for now.

    `sources` are folders or files; without any, the folder `library` where the process runs, if there is one. Files are
    read each time, so what another process stores is there at once. Raises ConfigError for a source that is missing.
    """

    def __init__(self, *sources: str | Path) -> None:
        for source in sources:
            if not Path(source).exists():
                raise ConfigError(f"library: there is no file or folder {source}")
        self._sources = [Path(source) for source in sources] or [FOLDER]
        self._added: dict[str, _Added] = {}

    def get(self, name: str, spec: HandSpec) -> Vector | Grasp | TaughtMotion:
        """A named entry for the spec's hand. Raises ConfigError with the nearest names, or the joint out of limits."""
        return _built(self._found(name, spec), spec)

    def posture(self, name: str | Path, spec: HandSpec) -> Vector:
        """Joint positions by name or path, shape (n,), rad."""
        listed = self._found(name, spec, "posture")
        return frozen(joint_values(listed.entry, spec, listed.where)["angles"])

    def grasp(self, name: str | Path, spec: HandSpec) -> Grasp:
        """A grasp by name or path."""
        listed = self._found(name, spec, "grasp")
        assert isinstance(listed.entry, GraspFile)
        return build_grasp(listed.name, listed.entry, spec, listed.where)

    def trajectory(self, name: str | Path, spec: HandSpec) -> TaughtMotion:
        """A motion by name or path; its `reference()` plays it."""
        listed = self._found(name, spec, "trajectory")
        assert isinstance(listed.entry, TrajectoryFile)
        return _motion(listed, listed.entry, spec)

    def list(
        self,
        kind: EntryKind | None = None,
        *,
        hand: HandSpec | None = None,
        taxonomy: int | str | None = None,
        fingers: int | None = None,
        object_size: float | tuple[float, float] | None = None,
    ) -> tuple[LibraryEntry, ...]:
        """All entries by name that pass every filter. Raises ConfigError for a taxonomy that no entry has.

        `hand`: those that this very hand can do; every entry is there for both sides, so it drops only what is outside
        its limits. `taxonomy`: the type's number (1 to 33) or name, or `power`, `intermediate`, `precision`. `fingers`:
        how many press, the thumb included. `object_size`: the width between the fingers, m, or the smallest and
        largest that will do. The last three are questions to grasps; one that says no size fits none.
        """
        user = read_all(self._sources)
        added = {name: LibraryEntry(name, item.entry, None) for name, item in self._added.items()}
        everything = {name: read_shipped_entry(name) for name in shipped_entries(kind)} | user | added
        if hand is not None:
            everything |= {name: _of_card(name, hand) for name in hand.postures}
        found = [everything[name] for name in sorted(everything)]
        return tuple(filter_entries(found, kind, hand, taxonomy, fingers, object_size))

    def add(self, name: str, entry: Entry, spec: HandSpec) -> None:
        """Have an entry under a name in this process only, in place of one in the user's files if there is one.

        Raises ConfigError unless the name is free for the user and the spec's hand can do it.
        """
        _check_name(name, spec)
        joint_values(entry, spec, name)
        self._added[name] = _Added(entry, spec)

    def delete(self, name: str, *, from_file: bool = False) -> None:
        """Forget what was added; with `from_file` also the entry in the user's file. What ships stays.

        Raises ConfigError for a name that is not there to be deleted.
        """
        check_free(name)
        added = self._added.pop(name, None)
        stored = read_all(self._sources).get(name) if from_file or added is None else None
        if stored is None:
            if added is None:
                raise ConfigError(unknown("entry", name, self._names(None)))
            return
        if not from_file:
            raise ConfigError(f"{name!r} is stored in {stored.path}; to delete it there, say so: from_file=True")
        assert stored.path is not None
        _remove(stored.path, name)

    def store(self, name: str, path: str | Path) -> None:
        """Write what was added to a YAML file, new or old, and keep everything else in the file as it is.

        An entry of that name in the file is replaced, on the side that the file has it for, and keeps its description
        unless a new one is given. Raises ConfigError and leaves the file as it was when anything is wrong; raises
        RecordingError when the disk does not let it.
        """
        if name not in self._added:
            raise ConfigError(f"nothing to store: {unknown('added entry', name, self._added)}")
        file = _library_file(path)
        with yaml_edit.lock_file(file):
            self._there(name, file)
            yaml_edit.write_text(file, _with(file, name, self._added[name]))
        if not any(file.is_relative_to(source.resolve()) for source in self._sources):
            self._sources.append(file)
        del self._added[name]

    def check_store(self, name: str, path: str | Path, spec: HandSpec) -> LibraryEntry | None:
        """The entry that `store` would replace in a file, None for a new one: to ask before a person shows what is to
        be stored. Raises ConfigError where `add` or `store` would refuse the name or the file."""
        _check_name(name, spec)
        return self._there(name, _library_file(path))

    def _there(self, name: str, file: Path) -> LibraryEntry | None:
        """The entry of a name in a file that it is to be stored in. Raises ConfigError for one in another file, and for
        a file that holds one entry, another."""
        others = read_all(self._sources).get(name)
        if others is not None and others.path != file:
            raise ConfigError(f"{name!r} is in {others.path} already; store it there or delete it first")
        before = {listed.name: listed for listed in read_file(file)}
        if before and name not in before and yaml_edit.ENTRIES not in parse_yaml(yaml_edit.read_text(file), str(file)):
            raise ConfigError(f"{file} holds one entry, {file.stem!r}; store {name!r} in another file")
        return before.get(name)

    def _found(self, name: str | Path, spec: HandSpec, kind: EntryKind | None = None) -> LibraryEntry:
        """By path, else from the hand's card, from memory, from what ships, from the user's files. What ships cannot be
        replaced, so a mistake in a user's file does not keep a hand from going home. What ships for one model of hand
        has its name in front: `home` of a LEAP Hand is `leap_home`."""
        if str(name) in spec.postures and kind in (None, "posture"):
            return _of_card(str(name), spec)
        if f"{spec.model}_{name}" in shipped_entries():
            name = f"{spec.model}_{name}"
        given = Path(name)
        if given.suffix == ".yaml" or len(given.parts) > 1:
            listed = _at(given, kind)
        elif (key := str(name)) in self._added:
            listed = LibraryEntry(key, self._added[key].entry, None)
        elif key in shipped_entries():
            listed = read_shipped_entry(key)
        elif (user := read_all(self._sources).get(key)) is not None:
            listed = user
        else:
            raise ConfigError(unknown(kind or "entry", key, self._names(kind)))
        if kind is not None and listed.kind != kind:
            raise ConfigError(f"{listed.name!r} is a {listed.kind}, not a {kind}")
        return listed

    def _names(self, kind: EntryKind | None) -> set[str]:
        return {listed.name for listed in self.list(kind)}


def found_later(path: str | Path) -> str:
    """What a person who stores something in a file should know: empty where its names are found without saying
    where."""
    if _library_file(path).is_relative_to(FOLDER.resolve()):
        return ""
    return f"names are found in the folder {FOLDER}: put {path} there, too"


def _check_name(name: str, spec: HandSpec) -> None:
    """Raise ConfigError for a name that is none, and for one under which a hand finds what ships, or is on its card."""
    check_free(check_name(name, "library"))
    if name in spec.postures or f"{spec.model}_{name}" in shipped_entries():
        raise ConfigError(f"{name!r} of a {spec.model} is the hand's own and stays as it is; choose another name")


def _library_file(path: str | Path) -> Path:
    """The file, without links. Raises ConfigError for one that is no file of a user's library."""
    file = Path(path).resolve()
    if file.suffix != ".yaml":
        raise ConfigError(f"{path}: a library file ends in .yaml")
    refuse_shipped(path)
    return file


def _at(path: Path, kind: EntryKind | None) -> LibraryEntry:
    file = path if path.is_file() else data_root() / path
    if not file.is_file():
        raise ConfigError(f"{path}: no such {kind or 'library'} file")
    return read_single_entry(file)


def _of_card(name: str, spec: HandSpec) -> LibraryEntry:
    """A posture that a hand's card names."""
    entry = PostureFile(hand=spec.model, side=spec.side, angles=angles_by_finger(spec.postures[name], spec))
    return LibraryEntry(name, entry, Path(spec.card) if spec.card else None)


def _built(listed: LibraryEntry, spec: HandSpec) -> Vector | Grasp | TaughtMotion:
    match listed.entry:
        case PostureFile() as posture:
            return frozen(joint_values(posture, spec, listed.where)["angles"])
        case GraspFile() as grasp:
            return build_grasp(listed.name, grasp, spec, listed.where)
        case TrajectoryFile() as trajectory:
            return _motion(listed, trajectory, spec)


def _motion(listed: LibraryEntry, entry: TrajectoryFile, spec: HandSpec) -> TaughtMotion:
    positions = joint_values(entry, spec, listed.where)["positions"]
    return TaughtMotion(frozen(entry.times), frozen(positions), listed.name)


def _with(file: Path, name: str, added: _Added) -> str:
    """The file's text with the entry. Raises ConfigError."""
    text = yaml_edit.read_text(file)
    before = {listed.name: listed.entry for listed in read_file(file)}
    old = before.get(name)
    entry = added.entry if old is None else convert_side(added.entry, added.spec, old.side, name)
    content = {"kind": entry.kind} | entry.model_dump(exclude_unset=True)
    content["side"] = entry.side
    if not entry.description:
        content.pop("description", None)
        if old is not None and old.kind == entry.kind and old.description:
            content["description"] = old.description
    joint_values(parse_entry(content, name), added.spec, name)
    if before and yaml_edit.ENTRIES not in parse_yaml(text, str(file)):
        return yaml_edit.replace_document(text, content, str(file))
    return yaml_edit.replace_entry(text, name, content, str(file))


def _remove(file: Path, name: str) -> None:
    with yaml_edit.lock_file(file):
        text = yaml_edit.read_text(file)
        if yaml_edit.ENTRIES in parse_yaml(text, str(file)):
            yaml_edit.write_text(file, yaml_edit.replace_entry(text, name, None, str(file)))
        else:
            file.unlink()


_TYPES = get_args(Control)


def filter_entries(
    entries: Sequence[LibraryEntry],
    kind: EntryKind | None,
    hand: HandSpec | None,
    taxonomy: int | str | None,
    fingers: int | None,
    object_size: float | tuple[float, float] | None,
) -> Iterator[LibraryEntry]:
    """Entries that pass every filter that is not None; see `Library.list`. Raises ConfigError."""
    if taxonomy is not None:
        check_type(taxonomy)
    for listed in entries:
        entry = listed.entry
        if kind is not None and listed.kind != kind:
            continue
        if taxonomy is not None and not (isinstance(entry, GraspFile) and is_of_type(entry.kind_of_grasp, taxonomy)):
            continue
        if fingers is not None and not (isinstance(entry, GraspFile) and len(entry.fingers) == fingers):
            continue
        if object_size is not None and not (isinstance(entry, GraspFile) and _fits(entry, object_size)):
            continue
        if hand is None or _can(listed, hand):
            yield listed


def check_type(wanted: int | str) -> None:
    """Raises ConfigError for what is no type of the taxonomy: not its number, its name, or how it controls."""
    if isinstance(wanted, int) or wanted.isdigit():
        if int(wanted) not in GRASP_TYPES:
            raise ConfigError(f"the GRASP taxonomy has the numbers 1 to 33, not {wanted}")
    elif wanted.lower() not in (
        names := {kind.name.lower(): kind.name for kind in GRASP_TYPES.values()}
    ) | dict.fromkeys(_TYPES):
        raise ConfigError(unknown("taxonomy", wanted, {*names.values(), *_TYPES}))


def is_of_type(kind: ClaimedType | ObservedType, wanted: int | str) -> bool:
    """Whether a type has this number or name, or is of this control (`power`, `intermediate`, `precision`), which what
    is none of the 33 may be, too."""
    if isinstance(wanted, int) or wanted.isdigit():
        return int(wanted) == kind.number
    return wanted.lower() == (kind.type if wanted.lower() in _TYPES else kind.name.lower())


def _fits(grasp: GraspFile, wanted: float | tuple[float, float]) -> bool:
    smallest, largest = wanted if isinstance(wanted, tuple) else (wanted, wanted)
    size = grasp.object_size
    return size is not None and size[0] - 1e-9 <= largest and smallest <= size[1] + 1e-9


def _can(listed: LibraryEntry, hand: HandSpec) -> bool:
    try:
        joint_values(listed.entry, hand, listed.where)
    except ConfigError:
        return False  # The answer, not an error: it is outside that hand's limits, or for another hand.
    return True


def load_posture(name: str | Path, spec: HandSpec) -> Vector:
    """Joint positions by name or path for the spec's side, shape (n,), rad. Raises ConfigError."""
    return Library().posture(name, spec)


def home_posture(spec: HandSpec) -> Vector | None:
    """The hand's `home`, shape (n,), rad; None for a hand without one."""
    names = posture_names(spec)
    return load_posture("home", spec) if {"home", f"{spec.model}_home"} & set(names) else None


def posture_names(hand: HandSpec | str = HAND) -> list[str]:
    """Names of all postures of a hand that ship with the package, or that its card has."""
    if isinstance(hand, str):
        return _names("posture", hand)
    return sorted({*_names("posture", hand.model), *hand.postures})


def load_grasp(name: str | Path, spec: HandSpec) -> Grasp:
    """A grasp by name or path, for the spec's side. Raises ConfigError naming the joint and the excess."""
    return Library().grasp(name, spec)


def load_trajectory(name: str | Path, spec: HandSpec) -> TaughtMotion:
    """A motion by name or path, for the spec's side. Raises ConfigError naming the joint and the excess."""
    return Library().trajectory(name, spec)


def grasp_names(model: str = HAND) -> list[str]:
    """Names of all grasps of a model of hand that ship with the package."""
    return _names("grasp", model)


def _names(kind: EntryKind, model: str) -> list[str]:
    return sorted(name for name in shipped_entries(kind) if read_shipped_entry(name).entry.hand == model)
