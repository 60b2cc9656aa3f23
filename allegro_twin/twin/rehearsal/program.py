"""The program of a rehearsal: its steps in order, each written down as it ends, in a folder that goes on where it was
interrupted."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from itertools import groupby, product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from allegro_twin.errors import ConfigError, HandError, HandFault, LinkError, RecordingError, WrongPose
from allegro_twin.files.assets import find_file, refuse_shipped
from allegro_twin.files.atomic_write import atomic_file
from allegro_twin.files.yaml_edit import read_text
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.library.gains import load_gains
from allegro_twin.spec import HandSpec
from allegro_twin.twin.identify.joint_ends import note, store_offsets
from allegro_twin.twin.identify.motions.excitation import ExcitationPose, find_pose
from allegro_twin.twin.identify.pipeline import identify_hand
from allegro_twin.twin.identify.report import report_page
from allegro_twin.twin.identify.results.findings import describe_outcome, describe_terms, describe_unfollowed
from allegro_twin.twin.identify.results.hand_file import write_hand_file
from allegro_twin.twin.rehearsal.gain_check import advice_on_gains
from allegro_twin.twin.rehearsal.measures import (
    Following,
    closing_time,
    far_joints,
    oscillating_joints,
    spent_joints,
    steady_error,
    tracking_error,
    tracking_lag,
)
from allegro_twin.twin.rehearsal.page import write_page
from allegro_twin.twin.rehearsal.protocol import RehearsalProtocol
from allegro_twin.twin.rehearsal.sessions import (
    Advance,
    RehearsedHand,
    RehearsedTwin,
    close_in_air,
    excite_in_pose,
    follow_trajectory,
    hold_posture,
    lead_to_ends,
)
from allegro_twin.version import __version__

RESULT, HAND, PAGE, IDENTIFICATION = "result.json", "hand.yaml", "report.html", "identification.html"
FILMS = "films"
FORMAT = 1


@dataclass(slots=True)
class Conversation:
    """Dialogue with the person at the hand; the defaults say nothing and ask nothing."""

    place: Callable[[ExcitationPose], object] = lambda pose: None
    """Called before the hand moves in another pose than before; returns when it lies so."""
    again: Callable[[ExcitationPose], bool] = lambda pose: False
    """Called where the hand's IMU shows another pose; returns whether it has been laid anew."""
    begin: Callable[[str], None] = lambda step: None
    """Called with the name of a step that begins."""
    advance: Advance = lambda t: None
    say: Callable[[str], None] = lambda line: None


class RehearsalStep(NamedTuple):
    """One step: what it is called, the pose that it needs, the steps that must have gone well, and what it does."""

    name: str
    pose: str
    needs: tuple[str, ...]
    perform: Callable[[], dict[str, Any]]


class HandRehearsal:
    """A rehearsal in a folder. What is done there already, by the same config and protocol, is not done again.
    `films`: whether grasps on simulated objects are filmed, which takes EGL and PyAV; what was done without is done
    again."""

    def __init__(
        self, hand: RehearsedHand, protocol: RehearsalProtocol, folder: Path, day: str = "",
        talk: Conversation | None = None, *, films: bool = False,
    ) -> None:  # fmt: skip
        self.hand, self.protocol, self.folder, self.talk = hand, protocol, folder, talk or Conversation()
        self._day, self._own, self._moved, self._films = day, hand.config.hand, 0.0, films
        self._not_had = set[str]()
        self.spec: HandSpec = load_spec(self._own.model, self._own.side, self._own.serial, hand.settings.version)
        refuse_shipped(folder / HAND)
        self._controllers, self.notes = self._compared()
        self._about = {
            "format": FORMAT, "program": f"allegro-twin {__version__}",
            "hand": {"model": self._own.model, "side": self._own.side, "serial": self._own.serial},
            "config": hand.config.model_dump(mode="json"), "protocol": json.loads(json.dumps(asdict(protocol))),
        }  # fmt: skip
        self.steps: dict[str, dict[str, Any]] = self._before()

    def run(self) -> dict[str, Any]:
        """Perform all steps that are left. Returns the result, as it is in RESULT. The hand is limp between them and
        afterwards. A step that cannot be done is named there, and so are those that need it. Raises LinkError or
        HandFault, after writing, where the link or the guard ends the session; KeyboardInterrupt likewise."""
        try:
            self._run()
        finally:
            write_page(self.folder / PAGE, self.result())
        return self.result()

    def _run(self) -> None:
        lies = ""
        for step in self._steps():
            before = self.steps.get(step.name, {})
            unfilmed = self._films and before.get("with") == "object" and "film" not in before
            if before.get("state") == "done" and step.name != "checkup" and not unfilmed:
                continue
            missing = [name for name in step.needs if self.steps.get(name, {}).get("state") != "done"]
            if missing:
                self._write(step.name, {"state": "skipped", "text": f"it needs: {', '.join(missing)}"})
                continue
            if step.pose in self._not_had:
                self._write(step.name, {"state": "skipped", "text": f"the hand does not lie in the pose {step.pose!r}"})
                continue
            if step.pose and step.pose != lies:
                self.talk.place(find_pose(step.pose, self._own.side))
                lies = step.pose
            self.talk.begin(step.name)
            self._moved = 0.0
            self._write(step.name, {"state": "interrupted", "text": "it was not finished"})
            self._perform(step)

    def _perform(self, step: RehearsalStep) -> None:
        try:
            found = step.perform()
        except (LinkError, HandFault) as error:
            self._write(step.name, {"state": "failed", "text": str(error), "hand_s": self._moved})
            raise
        except WrongPose as error:
            self._write(step.name, {"state": "failed", "text": str(error), "hand_s": self._moved})
            self.talk.say(f"{step.name}: {error}")
            if self.talk.again(find_pose(step.pose, self._own.side)):
                self._perform(step)
            else:
                self._not_had.add(step.pose)
        except HandError as error:
            self._write(step.name, {"state": "failed", "text": str(error), "hand_s": self._moved})
            self.talk.say(f"{step.name}: {error}")
        except KeyboardInterrupt:
            text = f"it was interrupted after {self._moved:.1f} s of motion"
            self._write(step.name, {"state": "interrupted", "text": text, "hand_s": self._moved})
            raise
        else:
            self._write(step.name, {"state": "done", "text": found.pop("text", ""), "hand_s": self._moved, **found})
            if problem := _problem("done", found):
                self.talk.say(f"{step.name}: {problem}")

    def result(self) -> dict[str, Any]:
        """What RESULT has: the steps, and by twin what was measured."""
        wanted = [step.name for step in self._steps()]
        states = {name: self.steps.get(name, {}).get("state", "not begun") for name in wanted}
        twins = {
            twin: {kind: [row for name in wanted for row in [self.steps.get(name, {})]
                          if row.get("twin") == twin and row.get("of") == kind and row.get("state") == "done"]
                   for kind in ("postures", "trajectories", "grasps")}
            for twin in self.protocol.twins
        }  # fmt: skip
        moved = sum(row.get("hand_s", 0.0) for row in self.steps.values())
        result = self._about | {"hand_s": round(moved, 3), "states": states, "steps": self.steps} | twins
        return result | {"problems": problems_of(result), "notes": self.notes}

    @property
    def _gains(self) -> str:
        return str(getattr(self.hand.config.controller, "gains", "default"))

    def _compared(self) -> tuple[tuple[str, ...], list[str]]:
        """The controllers under which postures are held, and why not all: PID without an integral is PD."""
        asked, gains = self.protocol.controllers, load_gains(self._gains, self.spec)
        if not {"pd", "pid"} <= set(asked) or (gains.ki * gains.clamp).any():
            return asked, []
        note = f"No postures under PID: the gains `{self._gains}` have no integral, so PID is PD with them"
        return tuple(kind for kind in asked if kind != "pid"), [f"{note}; set controller.gains to compare."]

    def _steps(self) -> Iterator[RehearsalStep]:
        """All steps, in their order; what a pose needs is together where it can be."""
        protocol, poses = self.protocol, list(self.protocol.poses)
        excited = tuple(f"excite {pose}" for pose in poses)
        yield RehearsalStep("checkup", "", (), self._check)
        yield RehearsalStep("ends", poses[0], ("checkup",), lambda: self._lead(poses[0]))
        for pose in poses:
            yield RehearsalStep(f"excite {pose}", pose, ("ends",), lambda pose=pose: self._excite(pose))  # type: ignore[misc]
        yield RehearsalStep("identify", "", excited, self._identify)
        for pose in protocol.tracking_poses():
            for twin in protocol.twins:
                yield from self._tracking(pose, twin)

    def _tracking(self, pose: str, twin: str) -> Iterator[RehearsalStep]:
        protocol, needs = self.protocol, ("checkup",) if twin == "nominal" else ("identify",)
        for kind in self._controllers:
            for posture in protocol.postures:
                yield RehearsalStep(f"{twin} {pose} {posture} {kind}", pose, needs,
                                    lambda p=posture, k=kind: self._posture(pose, twin, p, k))  # type: ignore[misc]  # fmt: skip
        if pose != protocol.tracking_poses()[0]:
            return
        first = self._controllers[0]
        for fed, (level, speed) in product(protocol.feedforward, protocol.speeds.items()):
            name = f"{twin} {pose} trajectory {level} {first}{' feedforward' if fed else ''}"
            yield RehearsalStep(name, pose, needs,
                                lambda n=level, v=speed, f=fed: self._trajectory(pose, twin, n, v, first, f))  # type: ignore[misc]  # fmt: skip
        for scenario in protocol.grasps:
            yield RehearsalStep(f"{twin} grasp {scenario}", "" if self.hand.simulated else pose, needs,
                                lambda s=scenario: self._grasp(pose, twin, s, first))  # type: ignore[misc]  # fmt: skip

    def _check(self) -> dict[str, Any]:
        return {"text": self.hand.check_link()}

    def _lead(self, pose: str) -> dict[str, Any]:
        found = lead_to_ends(self.hand, pose, self._own.serial, self._file("ends"), self._advance)
        right, file = found.encoder_offsets(), self.folder / HAND
        assert found.codec is not None
        if self._own.serial:
            with atomic_file(file) as temporary:
                temporary.write_text(read_text(find_file(self._own.serial, "hand", "conf/hands")))
        store_offsets(file, right, found.model, found.codec, note("rehearse", None, self._day))
        shift = right.limits.lower - found.limits.lower
        return {"offset": list(right.offset), "shift": shift.tolist(),
                "text": f"encoders are up to {1e3 * np.abs(shift).max():.0f} mrad off"}  # fmt: skip

    def _excite(self, pose: str) -> dict[str, Any]:
        seconds, place = self.protocol.poses[pose], self.folder / "excitation"
        paths = excite_in_pose(self.hand, pose, seconds, self.protocol.seed, place, str(self.folder / HAND),
                               self._advance)  # fmt: skip
        return {"recordings": [path.relative_to(self.folder).as_posix() for path in paths]}

    def _identify(self) -> dict[str, Any]:
        file = self.folder / HAND
        paths = [self.folder / name for pose in self.protocol.poses
                 for name in self.steps[f"excite {pose}"]["recordings"]]  # fmt: skip
        found = identify_hand(paths, (), masses_known=False, hand=str(file), progress=self.talk.say)
        text = write_hand_file(file, found.fit, found.values, found.motions, self._day)
        with atomic_file(self.folder / IDENTIFICATION) as temporary:
            temporary.write_text(report_page(found), encoding="utf-8")
        constant, outcome = found.values["torque_constant"], list(describe_outcome(found.fit, self.spec, found.written))
        advice = advice_on_gains(self._about["hand"], self.hand.settings.version, str(file), self._gains)
        terms = describe_terms(found.fit, found.values, found.motions, found.written)
        lines = [*describe_unfollowed(found.motions), *terms, *outcome, advice]
        for line in (*describe_unfollowed(found.motions), *outcome, advice):
            if line:
                self.talk.say(line)
        return {
            "text": text, "lines": [line for line in lines if line],
            "constant": constant.value.tolist(), "constant_half": constant.half.tolist(),
            "written": [str(each) for each in found.written.source], "residual": found.fit.spread.residual.tolist(),
        }  # fmt: skip

    def _posture(self, pose: str, twin: str, posture: str, kind: str) -> dict[str, Any]:
        name = f"{twin}_{pose}_{posture}_{kind}"
        found = hold_posture(self.hand, pose, self._twin(twin), posture, kind, self._file(name), self._advance)
        error = steady_error(found, found.known)
        return self._row("postures", twin, pose, kind, found) | {
            "posture": posture, "error": error.tolist(), "by_encoders": steady_error(found, found.position).tolist(),
            "missed": far_joints(error, found), "oscillates": oscillating_joints(found, found.known),
        }  # fmt: skip

    def _trajectory(self, pose: str, twin: str, level: str, speed: float, kind: str, fed: bool) -> dict[str, Any]:
        name = f"{twin}_{pose}_trajectory_{level}_{kind}{'_feedforward' if fed else ''}"
        found = follow_trajectory(self.hand, pose, self._twin(twin), speed, kind, self._file(name), self._advance,
                                  feedforward=fed)  # fmt: skip
        return self._row("trajectories", twin, pose, kind, found) | {
            "level": level, "speed": speed, "feedforward": fed, "spent": spent_joints(found),
            "rms": tracking_error(found, found.known).tolist(),
            "by_encoders": tracking_error(found, found.position).tolist(), "lag": tracking_lag(found, found.known),
            "steady": steady_error(found, found.known).tolist(),
        }  # fmt: skip

    def _grasp(self, pose: str, twin: str, scenario: str, kind: str) -> dict[str, Any]:
        about = {"of": "grasps", "twin": twin, "scenario": scenario}
        if self.hand.simulated:
            film = f"{FILMS}/{twin}_{Path(scenario).stem}.mp4" if self._films else None
            report = self.hand.trial(scenario, self._twin(twin).serial, None if film is None else self.folder / film)
            shown = {} if film is None else {"film": film}
            if film is not None and not (self.folder / film).exists():
                shown = {"text": "its film could not be written"}
            return about | {"with": "object", "held": report.held, "reason": report.reason} | shown
        name, own = f"{twin}_grasp_{Path(scenario).stem}", self._twin(twin)
        found = close_in_air(self.hand, pose, own, scenario, kind, self._file(name), self._advance)
        error = steady_error(found, found.known)
        return about | {
            "with": "air", "error": error.tolist(), "closing_s": closing_time(found, found.known),
            "planned_s": float(found.begins[-1] - found.begins[-2]), "missed": far_joints(error, found),
        }  # fmt: skip

    def _row(self, kind_of: str, twin: str, pose: str, kind: str, found: Following) -> dict[str, Any]:
        judge = "encoders" if found.truth is None else "simulation"
        return {"of": kind_of, "twin": twin, "pose": pose, "controller": kind, "judged_by": judge}

    def _twin(self, name: str) -> RehearsedTwin:
        shift = np.array(self.steps.get("ends", {}).get("shift") or np.zeros(self.spec.n_joints))
        if name == "nominal":
            return RehearsedTwin(name, self._own.serial, shift)
        return RehearsedTwin(name, str(self.folder / HAND), np.zeros(self.spec.n_joints))

    def _file(self, name: str) -> Path:
        place = self.folder / "recordings"
        place.mkdir(parents=True, exist_ok=True)
        return place / f"{name}.arrow"

    def _advance(self, t: float) -> None:
        self._moved = t
        self.talk.advance(t)

    def _before(self) -> dict[str, dict[str, Any]]:
        """The steps that the folder has. Raises ConfigError for one of another hand, config or protocol."""
        path = self.folder / RESULT
        if not path.exists():
            return {}
        try:
            content: Mapping[str, Any] = json.loads(path.read_text(encoding="utf-8"))
            steps, about = dict(content["steps"]), {key: content[key] for key in self._about}
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise RecordingError(f"{path}: is no result of a rehearsal ({error}): give another folder") from error
        for key in ("format", "config", "protocol"):
            if about[key] != self._about[key]:
                raise ConfigError(f"{path} is of another {key}: give another folder, or what it was begun with")
        return steps

    def _write(self, name: str, found: dict[str, Any]) -> None:
        self.steps[name] = found
        with atomic_file(self.folder / RESULT) as temporary:
            temporary.write_text(json.dumps(self.result(), indent=1, allow_nan=False), encoding="utf-8")


def problems_of(result: Mapping[str, Any]) -> list[str]:
    """A line for every posture that was not reached, every grasp that did not hold, and for steps that were not done,
    together where they follow each other for the same reason."""
    lines = list[str]()
    problems = (
        (_problem(state, result["steps"].get(name, {})), state, name) for name, state in result["states"].items()
    )
    for (problem, _), together in groupby(problems, key=lambda one: (one[0], one[2] if one[1] == "done" else "")):
        names = [name for *_, name in together]
        if problem:
            named = names[0] if len(names) == 1 else f"{names[0]} to {names[-1]} ({len(names)} steps)"
            lines.append(f"{named}: {problem}")
    return lines


def _problem(state: str, row: Mapping[str, Any]) -> str:
    """What is wrong with a step; empty: nothing."""
    if state != "done":
        return f"{state}: {row.get('text', 'the session ended before')}"
    wrong = [
        f"not reached: rad off: {missed}" if (missed := row.get("missed")) else "",
        f"oscillates: {shaken}; less damping may calm it, as of `gains: loose`"
        if (shaken := row.get("oscillates"))
        else "",
        f"not held: {row['reason']}" if row.get("held") is False else "",
    ]
    return "; ".join(filter(None, wrong))
