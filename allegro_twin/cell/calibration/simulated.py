"""Rehearsal of a hand-eye calibration: the simulated arm takes pictures of a pattern by the cell's own camera."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from allegro_twin.cell.assembly import Cell, make_cell
from allegro_twin.cell.calibration.pattern import Grey, PatternSettings, draw_pattern, printed_size
from allegro_twin.cell.calibration.pictures import ArmPicture
from allegro_twin.cell.camera.intrinsics import Intrinsics
from allegro_twin.cell.camera.mount import CameraMount, CameraPose, looking
from allegro_twin.cell.camera.settings import SimulatedSource
from allegro_twin.cell.motion.arm_motion import ArmGuide
from allegro_twin.cell.motion.finger_paths import SteeredReference, finger_controller
from allegro_twin.cell.planning.reachability import far_path
from allegro_twin.cell.run import arm_controller
from allegro_twin.cell.settings import LabSettings
from allegro_twin.control.setpoint_filter import SmoothSetpoint
from allegro_twin.errors import ConfigError
from allegro_twin.kinematics.orientation import matrix_from_quaternion, quaternion_from_matrix
from allegro_twin.kinematics.pose import Pose, compose, relative_to
from allegro_twin.loop import interleave, run
from allegro_twin.sim.model.plate import PicturePlate
from allegro_twin.types import Array, Vector
from allegro_twin.viewing.gl_context import OffscreenRenderer, PinholeView

DISTANCES = (0.36, 0.52)
"""m, from the pattern's middle: nearer it does not fit, further its corners are less exact."""
TILT = 40.0
"""Degrees at most, between the camera's axis and the pattern's normal."""
NOISE = 3.0
"""Grey levels of 255, standard deviation of a pixel (estimated: an infrared imager in a lit room)."""
_BLUR = 0.6  # Pixels, of the lens and the imager (estimated).
_FINE = 2  # Rendered pixels a pixel, each way.
_TEXELS = 120  # A square.
_AHEAD, _BELOW = 0.12, 0.03  # m. The plate of a camera that stands still: before the palm, and towards the fingertips.
_LIFTED = 0.002  # m. A printed pattern on the table.
_TRIES = 60  # Drawn views for each that is wanted.
_ROOM = 0.05  # rad that every joint stays from its ends.
_STILL, _REST = 0.004, 0.2  # rad/s of the fastest joint, and s after that.
_SPEED = 1.0  # rad/s of the fastest joint.


class CalibrationCell:
    """A cell with a calibration pattern instead of objects: on the table for a camera at the wrist, on a bracket
    before the palm for one that stands still. For one thread; `close` it. Raises ConfigError as `make_cell`."""

    def __init__(self, settings: LabSettings, pattern: PatternSettings, seed: int = 0) -> None:
        self.at_the_wrist, self.pattern = settings.at_the_wrist, pattern
        self._draws = np.random.default_rng(seed)
        plate = PicturePlate(
            "calibration_pattern", None if self.at_the_wrist else "palm_link", *_place(pattern, self.at_the_wrist),
            printed_size(pattern), draw_pattern(pattern, _TEXELS),
        )  # fmt: skip
        camera = settings.camera.model_copy(update={"source": SimulatedSource()})
        self.cell: Cell = make_cell(settings.model_copy(update={"objects": (), "camera": camera}), (plate,))
        self.cell.clearance.clear_table()
        robot, lens = self.cell.robot, settings.camera.intrinsics
        self.lens: Intrinsics = lens
        self._model, self._data = robot.world.model, robot.world.data
        self._screen = OffscreenRenderer(self._model, _FINE * lens.height, _FINE * lens.width, sites=False)

    @property
    def truth(self) -> Pose:
        """Where the camera really is: in the flange's frame, or in the arm's base where it stands still."""
        where = self.cell.settings.camera.mount.pose(self._model, self._data)
        return relative_to(self._flange() if self.at_the_wrist else self.cell.robot.base, Pose(*where))

    def mount(self, camera: Pose) -> CameraMount:
        """What the config's `camera: mount:` is to say of a camera that was found."""
        robot = self.cell.robot
        return camera_mount(camera, robot.spec.flange if self.at_the_wrist else None, robot.base)

    def postures(self, count: int) -> list[Vector]:
        """Postures of the arm, (n,), rad, each from the one before on a free way, in which the camera sees the whole
        pattern from all around. Raises ConfigError where fewer than that are found."""
        cell, found, at = self.cell, list[Vector](), self.cell.posture
        cell.arm.reset()
        cell.hand.reset()
        fixed = self.truth
        plate = self._pattern(fixed)
        for k in range(_TRIES * count):
            flange = self._flange_for(self._view(len(found), count), fixed, plate)
            try:
                posture = cell.robot.model.reach(flange, near=cell.posture if k % 2 else at, tolerance=1e-3)
            except ConfigError:
                continue  # Another view.
            if self._is_free(at, posture):
                found.append(posture)
                at = posture
            if len(found) == count:
                return found
        raise ConfigError(
            f"{cell.robot.spec.name} reaches {len(found)} of {count} postures from which the camera sees the pattern; "
            "ask for fewer, or take a smaller pattern"
        )

    def picture(self) -> Grey:
        """What the left imager sees now, (rows, columns), with noise."""
        pose = self.cell.settings.camera.mount.pose(self._model, self._data)
        view = PinholeView(pose.position, pose.rotation, *self.lens.edges())
        fine = self._screen.draw(self._data, view).mean(axis=-1)
        grey = fine.reshape(self.lens.height, _FINE, self.lens.width, _FINE).mean(axis=(1, 3))
        noisy = _blurred(grey) + NOISE * self._draws.standard_normal(grey.shape)
        return np.asarray(np.clip(np.rint(noisy), 0, 255), np.uint8)

    def take(self, postures: list[Vector], on_picture: Callable[[int], None] = lambda k: None) -> Iterator[ArmPicture]:
        """Drive the arm to each posture, wait until it rests, and take a picture with the pose that its encoders
        report. Raises HandFault where the arm stops by itself."""
        cell, model = self.cell, self.cell.robot.model
        guide, left = ArmGuide(cell.posture, model), list(postures)
        grip = finger_controller(SteeredReference(SmoothSetpoint(cell.open)), cell.settings.hand.gains, cell.hand.spec,
                                 cell.model)  # fmt: skip
        arms, hands = run(cell.arm, arm_controller(cell, guide)), run(cell.hand, grip)
        there = still = 0.0
        for turn, sample in interleave((arms, cell.arm.period), (hands, cell.hand.period)):
            state = sample.state
            if turn == 1 or state.t < there:
                continue
            if float(np.abs(state.velocity).max()) > _STILL:
                still = state.t
            if state.t < still + _REST:
                continue
            if there > 0.0:
                done = len(postures) - len(left)
                yield ArmPicture(f"{done:02d}.png", model.pose(state.position), self.picture())
                on_picture(done)
            if not left:
                return
            there = guide.through_joints(state.t, state.position, left.pop(0), _SPEED)

    def teleport(self, posture: Vector, name: str) -> ArmPicture:
        """The picture in a posture, (n,), rad, without the way there: for campaigns."""
        arm = self.cell.robot.arm_sim
        arm.posture = posture
        return ArmPicture(name, self.cell.robot.model.pose(arm.reset().position), self.picture())

    def close(self) -> None:
        """Idempotent."""
        self._screen.close()
        self.cell.close()

    def _flange(self) -> Pose:
        body = self._data.body(self.cell.robot.spec.flange)
        return Pose(body.xpos.copy(), body.xmat.reshape(3, 3).copy())

    def _pattern(self, camera: Pose) -> Pose:
        """The squares' frame: in the arm's base, or in the flange's frame."""
        position, quaternion = _place(self.pattern, self.at_the_wrist)
        corner = Pose(position, matrix_from_quaternion(quaternion))
        half = self.pattern.square / 2.0
        squares = compose(corner, Pose(np.array([half, half, 0.0]), np.eye(3)))
        if self.at_the_wrist:
            return relative_to(self.cell.robot.base, squares)
        mount = self.cell.robot.mount
        return compose(Pose(mount.position, matrix_from_quaternion(mount.quaternion)), squares)

    def _view(self, k: int, count: int) -> CameraPose:
        """A camera in the pattern's frame that looks at it: all around in turn, tilted and rolled at random."""
        draws = self._draws
        around = 2.0 * np.pi * (k / count + draws.uniform(-0.15, 0.15))
        tilt, far = np.radians(TILT) * np.sqrt(draws.uniform(0.05, 1.0)), draws.uniform(*DISTANCES)
        way = np.array([np.sin(tilt) * np.cos(around), np.sin(tilt) * np.sin(around), -np.cos(tilt)])
        aim = self.pattern.middle + np.append(draws.uniform(-0.02, 0.02, 2), 0.0)
        roll = draws.uniform(-np.pi, np.pi)
        return looking(aim + far * way, aim, (np.cos(roll), np.sin(roll), 0.0))

    def _flange_for(self, view: CameraPose, camera: Pose, pattern: Pose) -> Pose:
        """Where the flange is to be, in the arm's base."""
        seen = Pose(*view)
        unit = Pose(np.zeros(3), np.eye(3))
        if self.at_the_wrist:
            return compose(compose(pattern, seen), relative_to(camera, unit))
        return compose(compose(camera, relative_to(seen, unit)), relative_to(pattern, unit))

    def _is_free(self, begin: Vector, end: Vector) -> bool:
        cell, spec = self.cell, self.cell.robot.spec
        if float(np.minimum(end - spec.lower, spec.upper - end).min()) < _ROOM:
            return False
        way, _ = far_path(begin, end, _SPEED)
        hand = np.repeat(cell.open[None], len(way), axis=0)
        return cell.clearance.of_arm(end, cell.open) is None and cell.clearance.check_path(way, hand) is None


def camera_mount(camera: Pose, flange: str | None, base: Pose) -> CameraMount:
    """The mount of a camera in the flange's frame, by the name of its body; None: of one in the arm's base, whose pose
    in the world is `base`."""
    there = camera if flange is not None else compose(base, camera)
    x, y, z = (round(float(value), 6) for value in there.position)
    w, i, j, k = (round(float(value), 7) for value in quaternion_from_matrix(there.rotation))
    return CameraMount(body=flange, position=(x, y, z), quaternion=(w, i, j, k))


def _place(pattern: PatternSettings, at_the_wrist: bool) -> tuple[Array, Array]:
    """The plate's upper left corner and its axes, w x y z: flat on the table, or in the palm's frame (x where the palm
    looks, z along stretched fingers), where it looks as the palm does."""
    wide, high = printed_size(pattern)
    if at_the_wrist:
        return np.array([-wide / 2.0, high / 2.0, _LIFTED]), np.array([0.0, 1.0, 0.0, 0.0])
    # Its x along the palm's y, its y against the fingers, into it against where the palm looks.
    axes = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    corner = np.array([_AHEAD, 0.0, _BELOW]) - axes @ np.array([wide / 2.0, high / 2.0, 0.0])
    return corner, quaternion_from_matrix(axes)


def _blurred(picture: Array) -> Array:
    """Smoothed by a Gaussian of `_BLUR` pixels, edges repeated."""
    steps = np.arange(-2, 3)
    weights = np.exp(-0.5 * (steps / _BLUR) ** 2)
    weights /= weights.sum()
    for axis in (0, 1):
        padded = np.pad(picture, [(2, 2) if k == axis else (0, 0) for k in (0, 1)], mode="edge")
        length = picture.shape[axis]
        picture = sum(w * np.take(padded, np.arange(k, k + length), axis=axis) for k, w in enumerate(weights))
    return picture
