"""Commands `identify` and `gap`: run the identification, write the hand's file, print tables of results."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.table import Table

from allegro_twin.errors import ConfigError
from allegro_twin.files.assets import find_file, parse_yaml, refuse_shipped
from allegro_twin.files.atomic_write import atomic_file, check_place
from allegro_twin.files.yaml_edit import has_content, read_text
from allegro_twin.spec import HandSpec

if TYPE_CHECKING:
    from allegro_twin.twin.identify.fitting.fit import Friction
    from allegro_twin.twin.identify.pipeline import Identification, KnownWeight
    from allegro_twin.twin.identify.results.gap import Gap
    from allegro_twin.twin.identify.results.uncertainty import IdentifiedValue

_HEADS = ("torque constant\nN·m", "armature/k\ng·m²", "damping/k\nmN·m·s/rad", "friction/k\nmN·m", "offset\nmrad")
_SHOWN = (1.0, 1e3, 1e3, 1e3, 1e3)
MOST = 10
"""Lines of advice: what follows is on the page."""
GUESSED = "In brackets: not determined and yet written, for the part that was kept back is predicted no worse with it."


def hand_file(name: str) -> Path:
    """The path of a hand's file: a .yaml to write, or a file of conf/hands by name. Raises ConfigError."""
    path = Path(name)
    if path.suffix == ".yaml":
        return path
    return find_file(name, "hand", "conf/hands")


def file_to_write(name: str) -> Path:
    """The path of a hand's file that is to be written. Raises ConfigError or RecordingError where it cannot be."""
    path = Path(name)
    if path.suffix not in ("", ".yaml"):
        raise ConfigError(f"--hand {name}: a hand's file ends in .yaml: say {path.with_suffix('.yaml')}")
    try:
        path = hand_file(name)
    except ConfigError as error:
        raise ConfigError(f"--hand {name}: {error}; a file of your own ends in .yaml") from error
    refuse_shipped(path)
    check_place(path)
    return path


def identify_drive(
    recordings: Sequence[Path],
    weights: Sequence[KnownWeight],
    path: Path | None,
    known: bool,
    friction: Friction,
    tell: Callable[[str], None],
) -> Identification:
    """Identify the drive from recordings. Refuses the file of another hand before the work. Raises HandError."""
    check_scipy()
    from allegro_twin.twin.identify.motions.motion import read_motion
    from allegro_twin.twin.identify.pipeline import identify_hand
    from allegro_twin.twin.identify.results.hand_file import check_hand_file

    if path is not None:
        text = read_text(path)
        check_hand_file(path, parse_yaml(text, str(path)) if has_content(text) else {}, [read_motion(recordings[0])])
    return identify_hand(
        recordings, weights, masses_known=known, hand=str(path or ""), friction=friction, progress=tell
    )


def check_scipy() -> None:
    """Raise ConfigError where SciPy is not installed."""
    if find_spec("scipy") is None:
        raise ConfigError("a twin needs SciPy: pip install 'allegro-twin[twin]'")


def store_values(path: Path, found: Identification) -> str:
    """Write the identifiable values into the hand's file. Returns a warning, or nothing. Raises HandError."""
    from allegro_twin.twin.identify.results.hand_file import write_hand_file

    return write_hand_file(path, found.fit, found.values, found.motions, today())


def gain_lines(recording: Path, path: Path) -> str:
    """Advice on the gains that a hand was recorded with, by its file; empty where it has none, and for a recording
    without the config of a hand on CAN. Raises RecordingError."""
    from allegro_twin.recording.reader import load
    from allegro_twin.twin.rehearsal.gain_check import advice_on_gains

    config = load(recording, partial=True).meta.get("config") or {}
    backend, controller = config.get("backend", {}), config.get("controller", {})
    if backend.get("kind") != "can":
        return ""
    gains = controller.get("gains", "default")
    return advice_on_gains(config["hand"], backend.get("version"), str(path), gains)


def today() -> str:
    """The day in UTC, as it stands in a hand's file."""
    return str(datetime.now(UTC).date())


def write_page(path: Path, text: str) -> None:
    """Raises RecordingError."""
    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def table(found: Identification) -> Table:
    """One row for each joint: value ± half of its 95 % interval; in brackets what is not determined and yet written, a
    dash for what is neither."""
    from allegro_twin.twin.identify.results.uncertainty import VALUES

    spec = found.motions[0].spec
    made = Table(
        title=f"{spec.name} {spec.serial}: per N·m at full PWM, ± half of the 95 % interval".replace(" :", ":")
    )
    made.add_column("joint")
    for head in (*_HEADS, "residual\n× noise"):
        made.add_column(head, justify="right")
    for joint in range(spec.n_joints):
        cells = [
            _cell(found.values[name], joint, by, guessed=found.written.guessed(name, joint))
            for name, by in zip(VALUES, _SHOWN, strict=True)
        ]
        made.add_row(_name(spec, joint), *cells, f"{found.fit.spread.residual[joint]:.1f}")
    late = found.values["delay"]
    delay = "not determined" if late.reason[0] else f"{1000 * late.value[0]:.2f} ± {1000 * late.half[0]:.2f} ms"
    made.caption = (
        f"delay {delay}; {found.fit.segments} pieces of 0.3 s; noise {1e6 * np.median(found.fit.floor):.0f} µrad"
    )
    if found.fit.bristly:
        made.caption += "; friction breaks away (LuGre)"
    made.caption += f"; backlash: {_backlash(found)}"
    return made


def head_lines(found: Identification) -> Iterator[str]:
    """What comes first: what the hand has beyond friction, how well it is predicted, what is not explained."""
    from allegro_twin.twin.identify.results.findings import describe

    yield from describe(found.fit, found.values, found.motions, found.written)


def lines(found: Identification) -> Iterator[str]:
    """Notes: the source of the scale of N·m, and values that are not determined, with the reason, MOST at most."""
    from allegro_twin.twin.identify.results.hand_file import SCALE

    yield f"Scale of N·m: {SCALE[found.fit.masses]}."
    if any(mask.any() for mask in found.written.guesses.values()):
        yield GUESSED
    missing = list(_missing(found))
    yield from missing[:MOST]
    if len(missing) > MOST:
        yield f"… and {len(missing) - MOST} more: --report FILE.html has them all"
    yield from _notes(found)


def _missing(found: Identification) -> Iterator[str]:
    """Values that are not determined, with the reason; those that most joints lack first."""
    spec = found.motions[0].spec
    said: list[tuple[int, str]] = []
    for name, value in found.values.items():
        reasons: dict[str, list[str]] = {}
        for joint, why in enumerate(value.reason):
            if why:
                reasons.setdefault(why, []).append(_name(spec, joint) if name != "delay" else "all")
        for why, joints in reasons.items():
            said.append(
                (len(joints), f"{name.replace('_', ' ')} of {', '.join(joints)}: not determined, because {why}")
            )
    for _, line in sorted(said, key=lambda each: -each[0]):
        yield line


def _notes(found: Identification) -> Iterator[str]:
    spec = found.motions[0].spec
    offset = found.values["offset"]
    if np.isfinite(found.end_stop_offsets).all() and offset.identifiable.any():
        apart = np.where(offset.identifiable, np.abs(offset.value - found.end_stop_offsets), 0.0)
        most, usual = int(apart.argmax()), float(np.median(apart[offset.identifiable]))
        yield (
            f"Encoder offsets by weight and by end stops are {1000 * usual:.1f} mrad apart "
            f"in the median, {1000 * apart[most]:.1f} at most ({_name(spec, most)})."
        )
    left = [f"{motion.name} {100 * motion.saturated:.1f} %" for motion in found.motions if motion.saturated > 0.005]
    if left:
        yield f"Left out, at a limit of driver or joint or around a gap: {', '.join(left)}."


def gap_table(gap: Gap) -> Table:
    """Root mean square errors, mrad: nominal model, and the hand's file."""
    made = Table(title=f"{gap.name}: open loop, rms over 16 joints, mrad".replace("16", str(gap.before.joint.shape[1])))
    made.add_column("horizon")
    for head in ("nominal", "this hand", "worst joint"):
        made.add_column(head, justify="right")
    for k, horizon in enumerate(gap.horizons):
        row = (gap.before.all[k], gap.after.all[k], gap.after.joint[k].max())
        made.add_row(f"{horizon:g} s", *(f"{1000 * value:.2f}" for value in row))
    for name, before, after in zip(
        ("creeping, 0.3 s", "moving, 0.3 s"), gap.before.phase, gap.after.phase, strict=True
    ):
        if np.isfinite(after).any():
            rows = [np.sqrt(np.nanmean(np.square(side))) for side in (before, after)]
            made.add_row(name, *(f"{1000 * value:.2f}" for value in (*rows, np.nanmax(after))))
    if gap.lean.any():
        made.caption = (
            f"In this recording the palm leans by {np.degrees(np.linalg.norm(gap.lean)):.1f}° from what it says of "
            f"gravity; with that {1000 * gap.upright.all[-1]:.2f} mrad after {gap.horizons[-1]:g} s"
        )
    return made


def _backlash(found: Identification) -> str:
    """Backlash of the median joint and the worst one."""
    if not found.fit.loose:
        return "none seen"
    play, spec = found.values["backlash"], found.motions[0].spec
    if not play.identifiable.any():
        return "seen, not determined"
    sure = np.where(play.identifiable, play.value, 0.0)
    most = int(sure.argmax())
    usual = float(np.median(sure[play.identifiable]))
    said = f"{1000 * usual:.1f} mrad in the median, {1000 * sure[most]:.1f} ± {1000 * play.half[most]:.1f} at most"
    return f"{said} ({_name(spec, most)})"


def _cell(value: IdentifiedValue, joint: int, by: float, *, guessed: bool = False) -> str:
    if (value.reason[joint] and not guessed) or value.absent(joint):
        return "–"
    half = by * value.half[joint]
    digits = max(0, 1 - int(np.floor(np.log10(max(half, 1e-9)))))
    text = f"{by * value.value[joint]:.{min(digits, 5)}f} ± {half:.{min(digits, 5)}f}"
    return f"({text})" if guessed else text


def _name(spec: HandSpec, joint: int) -> str:
    return spec.joint_labels[joint]
