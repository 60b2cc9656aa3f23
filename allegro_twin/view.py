"""The Rerun stage: the hand and the object in 3-D, and the series that explain them, on any backend."""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from allegro_twin.description import facts, mesh
from allegro_twin.errors import ConfigError, RecordingError
from allegro_twin.files.whole import whole_file
from allegro_twin.sim.statics import hand_model
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array, Sample, TorqueCommand

Look = Callable[[], Mapping[str, Array]]
"""What is known beside the hand's state: `target` (n,), `palm`, `object` (7,), `contact_force` (p,)."""


class Viewer:
    """Draws samples into a Rerun recording. One of `spawn`, `serve`, `to_file` says where it goes."""

    def __init__(self, spec: HandSpec, things: Sequence[Mapping[str, Any]] = (), rate: float = 30.0) -> None:
        self._spec, self._model, self._interval, self._next = spec, hand_model(spec), 1.0 / rate, 0.0
        self._stream = rr.RecordingStream("allegro_twin")
        self._things = [str(thing["name"]) for thing in things]
        self._meta = things

    def spawn(self) -> Viewer:
        """Open the native viewer. Raises ConfigError where there is no screen for it."""
        if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise ConfigError("there is no screen for Rerun's window: look in the browser with --web, or write a .rrd")
        self._stream.spawn(default_blueprint=self._blueprint())
        self._draw_static()
        return self

    def serve(self, *, open_browser: bool = True, web_port: int = 9090) -> str:
        """Serve a page to look at in the browser; its address. Raises ConfigError when the port is taken."""
        _claim(web_port)
        url = self._stream.serve_grpc(grpc_port=_claim(0), default_blueprint=self._blueprint())
        rr.serve_web_viewer(web_port=web_port, open_browser=open_browser, connect_to=url)
        self._draw_static()
        return f"http://localhost:{web_port}/?url={url.replace(':', '%3A').replace('/', '%2F').replace('+', '%2B')}"

    def to_file(self, path: Path) -> Viewer:
        """Write a file that `rerun` and https://app.rerun.io open."""
        self._stream.save(str(path), default_blueprint=self._blueprint())
        self._draw_static()
        return self

    def flush(self) -> None:
        """Wait until everything drawn has left this process."""
        self._stream.flush()

    def close(self) -> None:
        """Let go of the viewer or the file. Raises RecordingError when the disk did not take all that was drawn."""
        try:
            self._stream.flush()
        except RuntimeError as error:
            raise RecordingError(f"cannot write the Rerun recording: {error}; is the disk full?") from error
        finally:
            self._stream.disconnect()

    def draw(self, sample: Sample, look: Mapping[str, Array]) -> None:
        """Draw a sample, unless the last one drawn is nearer than the frame rate."""
        if sample.state.t < self._next - 1e-9:
            return
        self._next = sample.state.t + self._interval
        stream, state = self._stream, sample.state
        stream.set_time("time", duration=state.t)
        palm = look.get("palm")
        if palm is not None:
            stream.log("world/palm", rr.Transform3D(translation=palm[:3], quaternion=_xyzw(palm[3:])))
        for name, pose in self._model.links(state.position).items():
            stream.log(f"world/palm/{name}", rr.Transform3D(translation=pose.position, mat3x3=pose.rotation))
        if "object" in look and self._things:
            place = look["object"]
            path = f"world/objects/{self._things[0]}"
            stream.log(path, rr.Transform3D(translation=place[:3], quaternion=_xyzw(place[3:])))
        stream.log("joints/position", rr.Scalars(state.position))
        stream.log("joints/velocity", rr.Scalars(state.velocity))
        stream.log("joints/torque", rr.Scalars(state.torque))
        command = sample.command
        goal = command.torque if isinstance(command, TorqueCommand) else command.position
        stream.log("joints/command", rr.Scalars(goal))
        if "target" in look:
            stream.log("joints/target", rr.Scalars(look["target"]))
        if "contact_force" in look:
            stream.log("contact/force", rr.Scalars(look["contact_force"]))

    def _draw_static(self) -> None:
        hand, stream = facts.load(self._spec.model, self._spec.side), self._stream
        stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for link in hand.links:
            path = f"world/palm/{link.name}" if link.parent else "world/palm"
            for index, visual in enumerate(link.visuals):
                stream.log(f"{path}/look/{index}", _shape(visual, hand.colors[visual.color]), static=True)
            if link.tip is not None:
                tip = rr.Capsules3D(
                    lengths=[link.tip.end - link.tip.start], radii=[link.tip.radius],
                    translations=[[0.0, 0.0, link.tip.start]], colors=[hand.colors["tip"]],
                    fill_mode="solid",
                )  # fmt: skip
                stream.log(f"{path}/look/tip", tip, static=True)
        for thing in self._meta:
            stream.log(f"world/objects/{thing['name']}/look", _thing(thing), static=True)
        if self._meta:
            table = rr.Boxes3D(half_sizes=[[0.25, 0.25, 0.01]], centers=[[0, 0, -0.01]], colors=[[200, 180, 150]],
                               fill_mode="solid")  # fmt: skip
            stream.log("world/table", table, static=True)
        for name in ("position", "target", "velocity", "torque", "command"):
            stream.log(f"joints/{name}", rr.SeriesLines(names=list(self._spec.aliases)), static=True)
        parts = [finger.name for finger in self._spec.fingers] + ["palm"]
        stream.log("contact/force", rr.SeriesLines(names=parts), static=True)

    def _blueprint(self) -> rrb.Blueprint:
        series = [
            rrb.TimeSeriesView(origin="joints/position", name="Joint position (rad)"),
            rrb.TimeSeriesView(origin="joints/target", name="Target position (rad)"),
            rrb.TimeSeriesView(origin="joints/torque", name="Applied torque (N·m)"),
        ]
        if self._meta:
            series.append(rrb.TimeSeriesView(origin="contact/force", name="Contact force (N)"))
        scene = rrb.Spatial3DView(origin="world", name="Hand")
        return rrb.Blueprint(rrb.Horizontal(scene, rrb.Vertical(*series), column_shares=[3, 2]), collapse_panels=True)


def _claim(port: int) -> int:
    """A port of this machine that is free: the given one, or any for 0. Raises ConfigError when it is taken."""
    with socket.socket() as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OverflowError as error:
            raise ConfigError(f"port {port} is no TCP port: they go from 1 to 65535; choose one with --port") from error
        except PermissionError as error:
            raise ConfigError(f"port {port} is not for everyone; choose one above 1023 with --port") from error
        except OSError as error:
            raise ConfigError(f"port {port} is taken by another program; choose another with --port") from error
        return int(probe.getsockname()[1])


def shown(samples: Iterable[Sample], viewer: Viewer, look: Look | None = None) -> Iterator[Sample]:
    """A stage that draws what passes."""
    for sample in samples:
        viewer.draw(sample, look() if look is not None else {})
        yield sample


def write_rrd(samples: Iterable[Sample], viewer: Viewer, path: Path, look: Look | None = None) -> None:
    """Consume all samples into a `.rrd` file, which is there only when it is whole."""
    with whole_file(path) as temporary:
        viewer.to_file(temporary)
        try:
            for _ in shown(samples, viewer, look):
                pass
        finally:
            viewer.close()


def _shape(visual: facts.Visual, color: tuple[float, ...]) -> Any:
    rgba = [round(255 * part) for part in color]
    if visual.kind == "cylinder":
        turn = rr.RotationAxisAngle(axis=[1, 0, 0], angle=rr.Angle(deg=90))
        return rr.Cylinders3D(lengths=[2 * visual.size[1]], radii=[visual.size[0]], centers=[visual.at],
                              rotation_axis_angles=[turn], colors=[rgba], fill_mode="solid")  # fmt: skip
    vertices, triangles = mesh.rounded_box(visual.size, visual.radius)
    normals = vertices - np.clip(vertices, *(s * (np.array(visual.size) - visual.radius) for s in (-1, 1)))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return rr.Mesh3D(vertex_positions=vertices + visual.at, triangle_indices=triangles, vertex_normals=normals,
                     albedo_factor=rgba)  # fmt: skip


def _thing(thing: Mapping[str, Any]) -> Any:
    color = [[214, 122, 62]]
    match thing["shape"], thing["size"]:
        case "sphere", [d]:
            return rr.Ellipsoids3D(half_sizes=[[d / 2] * 3], colors=color, fill_mode="solid")
        case "cylinder", [d, h]:
            return rr.Cylinders3D(lengths=[h], radii=[d / 2], colors=color, fill_mode="solid")
        case "ellipsoid", [short, long]:
            return rr.Ellipsoids3D(half_sizes=[[long / 2, short / 2, short / 2]], colors=color, fill_mode="solid")
        case "box", edges:
            return rr.Boxes3D(sizes=[edges], colors=color, fill_mode="solid")
    # A file of the user's: its place is shown, its shape stays in the simulator's pictures.
    return rr.Ellipsoids3D(half_sizes=[[0.02] * 3], colors=color, fill_mode="dense_wireframe")


def _xyzw(quaternion: Array) -> rr.Quaternion:
    if quaternion.shape != (4,):
        raise ConfigError(f"a pose has a quaternion of four numbers, not {quaternion.shape}")
    w, x, y, z = quaternion
    return rr.Quaternion(xyzw=[x, y, z, w])
