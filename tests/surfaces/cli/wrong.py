"""A hundred wrong inputs and more: what is typed, the exit code, and what the one line must name.

They stand in a folder made by `workspace`. `python -m tests.surfaces.cli.wrong FOLDER BLOCKED…` answers all of them in
one process in which the BLOCKED packages are not installed, as JSON.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import shlex
import sys
from functools import cache
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple
from unittest import mock

from allegro_twin.files.assets import data_root
from allegro_twin.surfaces.teleop.tracks import HEADER

PERSON = [[0.0, 0.01 * (k % 4), 0.01 * k] for k in range(21)]
"""Landmarks, m, that no hand has, but which are as large as one's."""


class Wrong(NamedTuple):
    """A row of the table."""

    typed: str
    code: int
    names: str


TABLE = [
    Wrong(*row)
    for row in [
        # A hand on ROS.
        ("ros2 nope", 2, "no config named 'nope'"),
        ("ros2 sim_right --distro jazy", 2, "did you mean 'jazzy'"),
        ("ros2 sim_right --domain 300", 2, "ROS_DOMAIN_ID must be 0 to 232, not 300"),
        ("ros2 sim_right --namespace 'a b'", 2, "not 'a b'"),
        ("ros2 sim_right --rate 0", 2, "--rate must be above 0"),
        # A hand that follows a person's.
        ("teleop sim_right", 2, "--from"),
        ("teleop sim_right --from track.csv --camera 3", 2, "--camera is for --from webcam, and track.csv is a file"),
        ("teleop sim_right --from track.csv --model x.task", 2, "--model is for --from webcam, and track.csv is a"),
        ("teleop nope --from track.csv", 2, "no config named 'nope'"),
        ("teleop sim_right --from none.csv", 2, "none.csv: cannot be read"),
        ("teleop sim_right --from r.arrow", 2, "hand tracking is a file in .npz, .csv, .json, or `webcam`"),
        ("teleop sim_right --from track.csv", 2, "track.csv:2: has 2 values; the first line has 64 names"),
        ("teleop sim_right --from full.csv", 2, "full.csv: cannot be read: it is no plain file"),
        ("teleop sim_right --from webcam", 2, "--model hand_landmarker.task"),
        ("teleop sim_right --from track.csv --tracked both", 2, "'both' is not one of 'right', 'left'"),
        ("teleop sim_right --from left.json --tracked right", 2, "is of a left hand by its `side`, not right"),
        ("teleop sim_leap --from left.json", 2, "the Allegro Hand and hands of its geometry, not leap_right"),
        ("teleop sim_sih --from left.json", 2, "the Allegro Hand and hands of its geometry, not sih_right"),
        ("teleop sim_right --from track.csv --speed 0", 2, "--speed must be positive"),
        ("teleop sim_right --from track.csv --view --web", 2, "choose one"),
        # A rehearsal that is to be filmed.
        ("rehearse can_virtual --film", 2, "--film films grasps on simulated objects: name --grasps"),
        ("rehearse can_v4_right --film --grasps lemon --yes", 2, "motions of a real hand are in recordings/"),
        # What the parser does not know.
        ("nope", 2, "no such command 'nope'"),
        ("--nope", 2, "--nope"),
        ("run", 2, "missing argument"),
        ("run sim_right --nope", 2, "--nope"),
        ("run sim_right --seconds", 2, "--seconds"),
        ("run sim_right --seconds abc", 2, "'abc'"),
        ("run lemon --jobs 0", 2, "--jobs"),
        ("run lemon --side top", 2, "'top' is not one of 'right', 'left', 'both'"),
        ("list objects grasps", 2, "(grasps)"),
        ("view", 2, "missing argument"),
        ("view r.arrow r.arrow", 2, "extra argument"),
        ("view r.arrow --web --port x", 2, "'x'"),
        ("posture", 2, "missing argument"),
        ("posture home --speed abc", 2, "'abc'"),
        ("calibrate", 2, "missing command"),
        ("calibrate nope", 2, "no such command 'nope'"),
        ("hand", 2, "missing command"),
        ("hand show extra", 2, "no hand named 'extra'"),
        ("export r.arrow", 2, "missing argument"),
        ("firmware", 2, "missing argument"),
        ("check", 2, "missing argument"),
        ("evaluate reach_right", 2, "missing argument"),
        ("train", 2, "missing argument"),
        ("excite can_virtual", 2, "--pose"),
        ("excite can_virtual --pose upp", 2, "did you mean 'up'"),
        ("excite sim_right --pose up", 2, "a sim hand has no drive to find"),
        ("identify none.arrow", 2, "no recording at none.arrow"),
        ("identify r.arrow", 2, "does not say with which torque constant"),
        ("identify r.arrow --known-mass tip=0.05", 2, "say where, kg below 1, and in which recording"),
        ("identify r.arrow --hand x.YAML", 2, "a hand's file ends in .yaml: say x.yaml"),
        ("identify r.arrow --hand nope", 2, "--hand nope: no hand named 'nope'"),
        ("identify r.arrow --hand r.arrow/x.yaml", 2, "cannot write r.arrow/x.yaml"),
        ("rehearse can_virtual --poses ''", 2, "--poses is empty: give it a value, or leave it out"),
        ("gap none.arrow", 2, "no recording at none.arrow"),
        ("mirror sim_right", 2, "a simulated hand is its own twin"),
        ("mirror r.arrow --stop-on contact", 2, "are for a hand that runs"),
        ("mirror can_virtual --stop-on contcat", 2, "did you mean 'contact'"),
        ("branch r.arrow --at 0.1 --image out.jpg", 2, "must end in .png"),
        ("branch r.arrow --at 0.1 --set fricton=1", 2, "did you mean 'friction'"),
        ("branch r.arrow", 2, "--at"),
        # Names of no thing, or of the wrong kind of thing.
        ("run nope", 2, "no config or scenario named 'nope'"),
        ("run nope.yaml", 2, "nope.yaml: no such config or scenario file"),
        ("run ''", 2, "the argument after run is empty"),
        ("run folder", 2, "folder: no scenarios in this folder"),
        ("run folder/../nope", 2, "no such config or scenario file"),
        ("run bad.yaml", 2, "bad.yaml:2: not valid YAML"),
        ("run empty.yaml", 2, "empty.yaml: is empty; it must hold a mapping"),
        ("run text.txt", 2, "text.txt: must hold a mapping"),
        ("run r.arrow", 2, "r.arrow: cannot be read"),
        ("run typos.yaml", 2, "seconds_: unknown key; did you mean 'seconds'?; hnd: unknown key"),
        ("run fast.yaml", 2, "speed must be positive, in rad/s, from 0.001 to 60"),
        ("run leap_apple --config can_virtual", 2, "has allegro: --config leap_usb or leap_virtual or sim_leap"),
        ("run coarse.yaml --config can_virtual", 2, "wants control every 0.004 s, can_virtual has it every 0.003"),
        ("run lemon --grasp nope", 2, "no grasp named 'nope'"),
        ("run lemon --grasp home", 2, "'home' is a posture, not a grasp"),
        ("run lemon --object nope", 2, "no object named 'nope'"),
        ("run sim_right --policy nope", 2, "no policy named 'nope'; there are: arm_pick_right, grasp_right, hold_"),
        ("run sim_right --policy text.txt", 2, "text.txt: a policy file ends in .onnx or .zip"),
        ("run sim_right --policy bytes.zip", 2, "bytes.zip: not a zip file"),
        ("run sim_right --policy bytes.onnx", 2, "bytes.onnx: not a readable ONNX file"),
        ("run sim_right --policy reach_right", 2, "reaches goals: name a posture"),
        ("run sim_right --policy reach_right --goal nope", 2, "no posture named 'nope'"),
        ("run sim_left --policy reach_right --goal ok", 2, "is for the right hand"),
        ("run sim_right --goal ok", 2, "--goal is for a policy"),
        ("list nope", 2, "no list named 'nope'"),
        ("envs reach", 2, "no task named 'reach'; did you mean 'Reach'?"),
        ("posture nope", 2, "no posture named 'nope'"),
        ("posture grasp_3", 2, "'grasp_3' is a grasp, not a posture"),
        ("posture nope.yaml", 2, "nope.yaml: no such posture file"),
        ("plan lemon --by x=3", 2, "region 'x=3': write bounds in m in the object's frame, as x>0.045,z<0.03"),
        ("plan lemon --by z>0.1,z<0", 2, "nothing is between the bounds of z"),
        ("plan lemon --by z>1 --time 5", 2, "object lemon: nothing of its surface is in the region"),
        ("plan lemon --address here:1", 2, "--address is of a Ray cluster: say --engine ray, too"),
        ("posture home -c nope", 2, "no config named 'nope'; there are: arm_fer, arm_fr3, can_hidden"),
        ("posture home -c sim_rigth", 2, "did you mean 'sim_right'"),
        ("posture home -c lemon", 2, "('lemon' is a scenario)"),
        ("posture home -c home", 2, "('home' is a posture)"),
        ("posture home -c folder", 2, "no config named 'folder'"),
        ("posture home -c replay", 2, "no such recording file"),
        ("grasp nope", 2, "no grasp named 'nope'"),
        ("grasp home", 2, "'home' is a posture, not a grasp"),
        ("play nope", 2, "no trajectory named 'nope'; there are: ripple"),
        ("play home", 2, "'home' is a posture, not a trajectory"),
        ("keyboard -c nope", 2, "no config named 'nope'"),
        ("hand show -c lemon", 2, "('lemon' is a scenario)"),
        ("teach 'Bad Name' --seconds 0.1", 2, "not 'Bad Name'"),
        ("teach home --seconds 0.1", 2, "'home' ships with the package"),
        ("train nope", 2, "no task or recipe named 'nope'"),
        ("train Reach --side top", 2, "not 'top'"),
        ("train bad.yaml", 2, "bad.yaml:2: not valid YAML"),
        ("evaluate nope Reach", 2, "no policy named 'nope'"),
        ("evaluate reach_right nope", 2, "no task or recipe named 'nope'"),
        # Numbers that nothing can be done with.
        ("run sim_right --seconds -1", 2, "--seconds must be positive and finite, not -1.0"),
        ("run sim_right --seconds 0", 2, "--seconds must be positive and finite, not 0.0"),
        ("run sim_right --seconds nan", 2, "--seconds must be positive and finite, not nan"),
        ("run sim_right --seconds inf", 2, "--seconds must be positive and finite, not inf"),
        ("view r.arrow --web --port 99999", 2, "--port must be a TCP port, 1 to 65535, not 99999"),
        ("view r.arrow --web --port -1", 2, "not -1"),
        ("view r.arrow --web --port 0", 2, "not 0"),
        ("posture home --speed 0", 2, "speed must be positive"),
        ("posture home --speed nan", 2, "it is nan"),
        ("posture home --speed inf", 2, "it is inf"),
        ("posture home --speed 1e9", 2, "from 0.001 to 60; it is 1e+09"),
        ("posture home --speed 1e-9", 2, "it is 1e-09"),
        ("grasp grasp_3 --force 1000", 2, "force is at most 5.8 N, what the motors have; not 1000"),
        ("grasp grasp_3 --force inf", 2, "not inf"),
        ("grasp grasp_3 --force -1", 2, "force must be positive, not -1.0"),
        ("grasp envelop --force 1000", 2, "at most 4.0 times its torques"),
        ("grasp envelop --force nan", 2, "force must be positive, not nan"),
        ("grasp tripod --force 2", 2, "controls position and takes no force"),
        ("grasp grasp_3 --width 10", 2, "spans 46 to 159 mm"),
        ("grasp grasp_3 --width nan", 2, "an object of nan mm"),
        ("play ripple --speed 0", 2, "speed must be positive"),
        ("play ripple --speed 1e9", 2, "12 is where the guard stops: slow down to 4.8e-09 of that"),
        ("play ripple --speed inf", 2, "it is inf"),
        ("play ripple --approach 1e9", 2, "it is 1e+09"),
        ("teach mine --seconds 0", 2, "--seconds must be positive"),
        ("teach mine --seconds nan", 2, "not nan"),
        ("calibrate limits --by-hand inf", 2, "--by-hand must be positive and finite, not inf"),
        ("calibrate limits --by-hand -3", 2, "not -3.0"),
        ("firmware can_pty --seconds -1", 2, "--seconds must be positive"),
        ("firmware can_pty --step 0", 2, "--step must be positive"),
        ("firmware can_pty --step nan", 2, "--step must be positive and finite, not nan"),
        ("firmware can_pty --step 10", 2, "a step of 10.0 s is longer than the hand's period of 0.003 s"),
        ("sniff --interface virtual --seconds nan", 2, "--seconds must be positive and finite, not nan"),
        ("sniff --interface virtual --bitrate 0", 2, "bitrate: input should be greater than 0, not 0"),
        ("train Reach --steps 0", 2, "steps: input should be greater than or equal to 1, not 0"),
        ("train Reach --episodes 0", 2, "--episodes must be positive"),
        ("run bottle.stl", 2, "bottle.stl is a mesh or a scan, not a config: `allegro-twin plan bottle.stl`"),
        ("lab bottle.stl", 2, "or `lab lab_allegro --object bottle.stl`"),
        ("new track.csv", 2, "or .ply; export it as STL"),
        ("lab lab_allegro --object track.csv", 2, "track.csv: a mesh is .obj, .stl"),
        ("mpc rotate --film turn.gif", 2, "--film turn.gif: must end in .mp4 or .mkv or .mov"),
        ("evaluate reach_right Reach --episodes -1", 2, "--episodes must be positive and finite, not -1"),
        ("evaluate reach_right Reach --episodes 1 --can 5", 2, "--can must be 0 to --episodes, which is 1; not 5"),
        ("evaluate reach_right Reach --episodes 1 --can -1", 2, "not -1"),
        # Places that cannot be written, and formats that nobody writes.
        ("run sim_right --record x.txt", 2, "--record x.txt: must end in .arrow"),
        ("run sim_right --record folder", 2, "--record folder: must end in .arrow"),
        ("run sim_right --record folder.arrow", 2, "cannot write folder.arrow: it is a folder"),
        ("run sim_right --record file/x.arrow", 2, "cannot write file/x.arrow"),
        ("run sim_right --record /proc/no/x.arrow", 2, "cannot write /proc/no/x.arrow"),
        ("run sim_right --rrd /dev/full", 2, "--rrd /dev/full: must end in .rrd"),
        ("run sim_right --rrd full.rrd", 2, "cannot write full.rrd: it is no plain file"),
        ("run sim_right --rrd /proc/no/x.rrd", 2, "cannot write /proc/no/x.rrd"),
        ("run sim_right --rrd x.txt", 2, "must end in .rrd"),
        ("run sim_right --image x", 2, "--image x: must end in .png"),
        ("run sim_right --image x.txt", 2, "must end in .png"),
        ("run sim_right --image /proc/no/x.png", 2, "cannot write /proc/no/x.png"),
        ("run sim_right --video x.txt", 2, "--video x.txt: must end in .mp4"),
        ("run sim_right --video full.mp4", 2, "cannot write full.mp4: it is no plain file"),
        ("run sim_right --wire-log x.log", 2, "only a hand on a CAN bus has frames to log, and a sim hand has none"),
        ("run can_virtual --wire-log x.txt", 2, "--wire-log x.txt: must end in .blf or .log or .asc"),
        ("run sim_right --out file", 2, "--out file: cannot be a folder to write into: File exists"),
        ("run lemon --out /proc/no", 2, "--out /proc/no: cannot be a folder"),
        ("gallery file", 2, "file: cannot be a folder"),
        ("gallery /proc/no", 2, "cannot be a folder"),
        ("teach mine --seconds 0.1 --into x.txt", 2, "--into x.txt: must end in .yaml"),
        ("teach mine --seconds 0.1 --into /proc/no/x.yaml", 2, "cannot write /proc/no/x.yaml"),
        ("teach mine --seconds 0.1 --into bad.yaml", 2, "bad.yaml:2: not valid YAML"),
        ("calibrate limits --into x.txt", 2, "--into x.txt: must end in .yaml"),
        ("calibrate limits --into folder", 2, "--into folder: must end in .yaml"),
        ("train Reach --out file", 2, "--out file: cannot be a folder"),
        ("firmware can_pty --report folder", 2, "--report folder: must end in .json"),
        ("firmware can_pty --wire-log x.txt", 2, "--wire-log x.txt: must end in"),
        ("export r.arrow x.xlsx", 2, "no export format named '.xlsx'"),
        ("export r.arrow file/x.csv", 2, "cannot write file/x.csv"),
        ("export r.arrow /proc/no/x.parquet", 2, "cannot write /proc/no/x.parquet"),
        ("export r.arrow full.csv", 2, "cannot write full.csv: it is no plain file"),
        ("export r.arrow file --format lerobot", 2, "file is a file"),
        ("export r.arrow file/x --format lerobot", 2, "cannot write file/x: "),
        ("export r.arrow /proc/no --format lerobot", 2, "cannot write /proc/no"),
        ("export r.arrow full --format lerobot", 2, "full is not empty"),
        ("export r.arrow set --format nope", 2, "no data set format named 'nope'; there are: lerobot, minari"),
        ("export r.arrow set --format minari", 2, "whose name ends in a version: set-v0"),
        ("export r.arrow 's t-v0' --format minari", 2, "only letters, digits, _ and -, and ends in a version: s_t-v0"),
        ("collect Lift set --episodes 0", 2, "invalid value for '--episodes'"),
        ("collect Lft set", 2, "no task or recipe named 'Lft'; did you mean 'Lift'"),
        # Files that are not what they should be.
        ("view folder", 2, "cannot read folder: it is a folder"),
        ("view file/x", 2, "cannot read file/x"),
        ("view nothing.arrow", 2, "no recording at nothing.arrow"),
        ("view empty.arrow", 2, "found an empty file"),
        ("view bad.yaml", 2, "bad.yaml is not a recording"),
        ("view cut.arrow", 2, "cut.arrow is not a recording"),
        ("export r.arrow r.arrow x.csv", 2, "2 recordings make one data set"),
        ("export folder x.arrow", 2, "it was not made of recordings of this package"),
        ("export folder x.csv", 2, "x.csv: an episode becomes a recording again"),
        ("export text.txt x.arrow", 2, "name a config of that hand with --config"),
        ("export text.txt x.arrow --config sim_right", 2, "needs a config of a hand on a bus"),
        ("export text.txt x.arrow --config can_virtual", 2, "text.txt: a bus log ends in"),
        ("export none.log x.arrow --config can_virtual", 2, "no bus log at none.log"),
        # Options that nobody reads, and two that cannot be together.
        ("export r.arrow x.csv --episode 3", 2, "--episode is for a data set"),
        ("export r.arrow x.csv --config can_virtual", 2, "--config is for a bus log, a bag"),
        ("export r.arrow x.csv --bus can7", 2, "--bus is for a bus log"),
        ("run sim_right --partial", 2, "--partial is for recordings; this config has backend sim"),
        ("run sim_right --view --web", 2, "choose one"),
        ("keyboard --view --web", 2, "choose one"),
        ("run lemon lemon", 2, "lemon, right hand: asked for twice"),
        ("run lemon mug --record x.arrow", 2, "2 runs cannot share one output; use --out FOLDER"),
        # Buses and hands that are not there.
        ("firmware nope", 2, "no config named 'nope'"),
        ("firmware sim_right", 2, "a hand on a bus needs `backend: {kind: can}`"),
        ("firmware can_virtual", 2, "is a bus inside one program"),
        ("firmware leap_virtual", 2, "port virtual is a line inside one program"),
        ("firmware leap_usb leap_usb", 2, "a hand on a serial line is served alone"),
        ("firmware leap_usb --report r.json", 2, "which are for CAN"),
        ("firmware can_pty can_pty", 2, "cannot tell apart two hands of version v4, with device 0"),
        ("check sim_right", 2, "only a hand on a bus has a link to check"),
        ("check can_pty", 3, "slcan out/hand.tty does not open"),
        ("sniff sim_right", 2, "only a bus can be listened to"),
        ("sniff can_virtual", 2, "is a bus inside one program"),
        ("sniff --interface nope", 2, "python-can has no interface 'nope'"),
        ("sniff --interface virtual --version v9", 2, "not 'v9'"),
        ("sniff --interface virtual --option nope", 2, "--option needs KEY=VALUE, not 'nope'"),
        ("sniff --interface slcan --channel nowhere", 3, "slcan nowhere does not open"),
        ("sniff --interface slcan --channel folder", 3, "slcan folder does not open"),
        ("calibrate limits -c replay", 2, "no such recording file"),
    ]
]  # fmt: skip


def workspace(folder: Path, recording: Path) -> None:
    """The files that the table speaks of."""
    for name in ("folder", "folder.arrow", "full"):
        (folder / name).mkdir()
    for name in ("full.rrd", "full.mp4", "full.csv"):
        (folder / name).symlink_to("/dev/full")
    data = recording.read_bytes()
    contents: dict[str, bytes] = {
        "full/something": b"x", "file": b"x", "text.txt": b"hello\n", "bad.yaml": b"x: [\n", "empty.yaml": b"",
        "bytes.onnx": b"\0\1\2", "bytes.zip": b"\0\1\2", "empty.arrow": b"", "r.arrow": data, "cut.arrow": data[:2000],
        "coarse.yaml": (data_root() / "scenarios" / "demo" / "lemon.yaml").read_bytes() + b"\nprotocol: tabletop\n",
        "typos.yaml": b"backend: {kind: sim}\ncontroller: {kind: pd}\nseconds_: 1\nhnd: {}\n",
        "track.csv": (",".join(HEADER) + "\n0,1\n").encode(),
        "left.json": json.dumps({"side": "left", "frames": [{"t": 0, "landmarks": PERSON}]}).encode(),
        "fast.yaml": b"backend: {kind: sim}\ncontroller: {kind: pd, speed: 1.0e+9}\ntask: {posture: home}\n",
    }  # fmt: skip
    for name, content in contents.items():
        (folder / name).write_bytes(content)


def answered(typed: str) -> tuple[int, str]:
    """The command line in this process: its exit code, and what it wrote to standard error."""
    from rich.console import Console

    from allegro_twin.surfaces.cli import console, main

    out, errors = io.StringIO(), io.StringIO()
    sys.argv = ["allegro-twin", *shlex.split(typed)]
    console.console, console.errors = Console(file=out, width=160), Console(file=errors, width=160)
    parser = mock.patch.object(main, "app", built())
    with parser, contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
        try:
            main.main()
        except SystemExit as ended:
            return int(ended.code or 0), errors.getvalue()
    raise AssertionError("the command line always ends with an exit code")


@cache
def built() -> Any:
    """The parser. Typer would make it anew for every command line, which takes longer than most answers."""
    from typer.main import get_command

    from allegro_twin.surfaces.cli import main

    return get_command(main.app)


class Blocked(MetaPathFinder):
    """Packages that are not installed."""

    def __init__(self, names: list[str]) -> None:
        self._names = names

    def find_spec(self, name: str, path: Any = None, target: ModuleType | None = None) -> ModuleSpec | None:
        if name.split(".")[0] in self._names:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return None


def answer_all(rows: list[str], blocked: list[str]) -> dict[str, tuple[int, str]]:
    """What the command line answers without some packages."""
    sys.meta_path.insert(0, Blocked(blocked))
    return {typed: answered(typed) for typed in rows}


if __name__ == "__main__":
    os.chdir(sys.argv[1])
    wanted = json.loads(sys.stdin.read())
    found = answer_all(wanted, sys.argv[2:])
    sys.__stdout__.write(json.dumps(found))  # type: ignore[union-attr]  # It is there.
