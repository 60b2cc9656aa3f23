"""Domain randomisation: ranges as settings, drawn at every reset for every simulation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from pydantic import AfterValidator, model_validator

from allegro_twin.errors import ConfigError, unknown
from allegro_twin.files.schema import Settings
from allegro_twin.kinematics.orientation import quaternion_from_vector, quaternion_product
from allegro_twin.learning.environments.random_streams import Draws
from allegro_twin.sim.batch.core import Rows
from allegro_twin.sim.batch.shared_model import FreeBody, SharedModelBatch
from allegro_twin.spec import HandSpec
from allegro_twin.types import Array


def _ordered(value: tuple[float, float]) -> tuple[float, float]:
    if not 0.0 <= value[0] <= value[1]:
        raise ValueError("the smallest comes first, and none is negative")
    return value


def _positive(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] <= 0.0:
        raise ValueError("both must be greater than 0: a factor")
    return value


def _friction(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] <= 0.0 or value[1] > LARGEST_FRICTION:
        raise ValueError(f"more than 0, and at most {LARGEST_FRICTION:g}")
    return value


def _mass(value: tuple[float, float]) -> tuple[float, float]:
    if value[1] > HEAVIEST:
        raise ValueError(f"at most {HEAVIEST:g} times its mass: give the object another mass")
    return value


def _short(value: tuple[int, int]) -> tuple[int, int]:
    if value[1] > LONGEST_DELAY:
        raise ValueError(f"at most {LONGEST_DELAY}")
    return value


LARGEST_FRICTION = 1.0
"""Sliding friction of contacts, in an option as in a range."""
HEAVIEST = 10.0
"""Factor on an object's mass."""
LONGEST_DELAY = 4  # Periods: 12 ms, twice the default. No measured one is published.
Range = Annotated[tuple[float, float], AfterValidator(_ordered)]
Factor = Annotated[tuple[float, float], AfterValidator(_ordered), AfterValidator(_positive)]
Periods = Annotated[tuple[int, int], AfterValidator(_ordered), AfterValidator(_short)]


class Randomise(Settings):
    """Smallest and largest value of each quantity; None: as in the model. `Randomise.default()` has a range for all."""

    twin: str | None = None
    """The file of one hand, as `identify` writes it: its drive is drawn for every joint from the values and intervals
    there."""
    mass: Annotated[Factor, AfterValidator(_mass)] | None = None
    """Factor on the object's mass."""
    size: Factor | None = None
    """Factor on the object's size."""
    friction: Annotated[Range, AfterValidator(_friction)] | None = None
    """Sliding friction of every contact."""
    gains: Range | None = None
    """Factors on kp and kd, one each: of the control law, or of the loop that the hand closes itself."""
    strength: Range | None = None
    """Factor on motor strength: on a commanded torque, or on the limit where the hand closes the loop."""
    armature: Range | None = None
    """kg·m², all joints."""
    damping: Range | None = None
    """Factor on the joints' damping."""
    frictionloss: Range | None = None
    """Dry friction of all joints, N·m."""
    encoder_noise: Range | None = None
    """Half-width of the noise on measured joint positions, rad."""
    velocity_noise: Range | None = None
    """Half-width of the noise on measured joint speeds, rad/s."""
    quantisation: Range | None = None
    """Step of measured joint positions, rad."""
    actuator_delay: Periods | None = None
    """Whole control periods until a torque acts."""
    sensor_delay: Periods | None = None
    """Whole control periods until a measurement arrives."""
    wrist_tilt: Range | None = None
    """Largest tilt of the palm about each of its axes, rad."""

    touch_noise: Range | None = None
    """Half-width of the noise on the external torque of joints, N·m."""
    camera_shift: Range | None = None
    """Half-width of the noise on an object's observed position, m, in privileged tasks."""
    camera_turn: Range | None = None
    """Half-width of the noise on an object's observed orientation, about each axis, rad."""
    camera_delay: Periods | None = None
    """Whole decisions until a picture arrives."""

    @model_validator(mode="after")
    def _check_twin(self) -> Randomise:
        if self.twin is not None and (twice := [name for name in _OF_TWIN if getattr(self, name) is not None]):
            raise ValueError(f"{', '.join(twice)} comes from the twin: leave it out, or leave out twin")
        return self

    @classmethod
    def default(cls, spec: HandSpec | None = None) -> Randomise:
        """Ranges around the nominal hand, which takes torques by default. For any other hand, what was measured on its
        motors is left out. Sources: docs/reference/environments.md#randomisation."""
        everything = cls(
            mass=(0.7, 1.3),
            size=(0.95, 1.05),
            friction=(0.6, 1.0),
            gains=(0.9, 1.1),
            strength=(0.85, 1.15),
            armature=(0.001, 0.005),
            damping=(0.8, 1.2),
            frictionloss=(0.01, 0.03),
            encoder_noise=(0.0, 0.002),
            velocity_noise=(0.0, 0.1),
            quantisation=(8.9e-5, 8.9e-5),
            actuator_delay=(0, 2),
            sensor_delay=(0, 1),
            wrist_tilt=(0.0, 0.05),
            touch_noise=(0.0, 0.02),
            camera_shift=(0.0, 0.005),
            camera_turn=(0.0, 0.1),
            camera_delay=(0, 1),
        )
        strange = (
            () if spec is None or "torque" in spec.commands else ("quantisation", *(_ROTORS if spec.followers else ()))
        )
        return cls(**everything.model_dump(exclude=set(strange)))


def parse_randomise(value: Any, spec: HandSpec | None = None) -> Any:
    """Read None, `off`, `default`, or the ranges. Raises ConfigError for another name."""
    if value is None or value == "off":
        return Randomise()
    if isinstance(value, str):
        if value != "default":
            raise ConfigError(unknown("randomisation", value, ("default", "off")))
        return Randomise.default(spec)
    return value


RANGES = tuple(name for name in Randomise.model_fields if name != "twin")
"""What has a smallest and a largest value."""
_OF_TWIN = ("strength", "armature", "damping", "frictionloss", "encoder_noise", "quantisation", "actuator_delay",
            "sensor_delay")  # fmt: skip
"""What a twin's file says instead. Its delay is that of actuators and sensors together."""
_ROTORS = ("armature", "frictionloss")
"""Ranges in physical units, for joints with a motor each; not for joints on tendons."""


def check_randomise(settings: Randomise, spec: HandSpec) -> None:
    """Raise ConfigError for a range that does not apply to this hand."""
    for name in _ROTORS if spec.followers else ():
        if getattr(settings, name) is not None:
            raise ConfigError(f"randomise.{name} is of joints that a motor turns each, and {spec.name} has tendons: "
                              "leave it out")  # fmt: skip


_OF_OBJECTS = ("mass", "size", "camera_shift", "camera_turn", "camera_delay")


def check_without_object(settings: Randomise, task: str) -> None:
    """Raise ConfigError for ranges of an object in a task that has none. `default` names all of them, of any task."""
    named = [name for name in _OF_OBJECTS if getattr(settings, name) is not None]
    if 0 < len(named) < len(_OF_OBJECTS):
        raise ConfigError(f"randomise.{named[0]} is of an object, and {task} has none: leave it out")


LATER = ("touch_noise",)
"""Drawn by their user, after everything else: the episodes of a seed are the same with and without."""


def draw_values(settings: Randomise, draws: Draws) -> dict[str, Array]:
    """One value of each given range for each simulation, (m,), or (m, 2) for the gains, (m, 3) for the tilt."""
    found: dict[str, Array] = {}
    for name in RANGES:
        if name in LATER:
            continue
        count = {"gains": 2, "wrist_tilt": 3}.get(name, 1)
        low, high = getattr(settings, name) or (0.0, 0.0)
        if name.endswith("delay"):
            values = draws.integers_between(low, high)
        else:
            values = draws.uniform(low, high, count)
        if getattr(settings, name) is not None:
            found[name] = values if count > 1 else values[:, 0]
    if (tilt := found.get("wrist_tilt")) is not None:
        found["wrist_tilt"] = tilt * draws.signs(3)
    return found


class PhysicsRandomiser:
    """Writes randomised values into the models of the simulations."""

    def __init__(self, worlds: SharedModelBatch, object_body: FreeBody | None) -> None:
        self._worlds, self._object_body = worlds, object_body
        self._dofs = worlds.xp.asarray(worlds.dofs)
        self._loss = worlds.xp.asarray(worlds.model.dof_damping[worlds.dofs])

    def sizes(self, variant: Rows, factor: Array) -> Array:
        """Possible size factors, (m,), for simulations of these variants: a mesh keeps its size."""
        if self._object_body is None:
            return factor
        return self._worlds.xp.where(self._worlds.meshes(self._object_body)[variant], 1.0, factor)  # type: ignore[no-any-return]

    def apply(self, rows: Rows, values: dict[str, Array]) -> None:
        """`values` from `draw_values`, shape (m,) each; for simulations that have just chosen their variant."""
        for name, value in values.items():
            if (how := _HOW.get(name)) is not None:
                how(self, rows, value)
        if values.keys() & {"mass", "size", "armature", "wrist_tilt"}:
            self._worlds.derive(rows)

    def _mass(self, rows: Rows, factor: Array) -> None:
        if self._object_body is not None:
            self._worlds.expand("body_mass")[rows, self._object_body.id] *= factor
            self._worlds.expand("body_inertia")[rows, self._object_body.id] *= factor[:, None]

    def _size(self, rows: Rows, factor: Array) -> None:
        """The mass stays the same."""
        if self._object_body is None:
            return
        geoms = self._object_body.geoms
        self._worlds.expand("geom_size")[rows, geoms] *= factor[:, None, None]
        self._worlds.expand("geom_rbound")[rows, geoms] *= factor[:, None]
        self._worlds.expand("geom_aabb")[rows, geoms] *= factor[:, None, None]
        self._worlds.expand("bvh_aabb")[rows, self._object_body.boxes] *= factor[:, None, None]
        self._worlds.expand("body_inertia")[rows, self._object_body.id] *= factor[:, None] ** 2

    def _friction(self, rows: Rows, friction: Array) -> None:
        self._worlds.expand("geom_friction")[rows, :, 0] = friction[:, None]

    def _armature(self, rows: Rows, armature: Array) -> None:
        self._worlds.expand("dof_armature")[rows[:, None], self._dofs] = armature[:, None]

    def _damping(self, rows: Rows, factor: Array) -> None:
        damping = self._loss * factor[:, None]
        self._worlds.expand("dof_damping")[rows[:, None], self._dofs] = damping

    def _frictionloss(self, rows: Rows, torque: Array) -> None:
        self._worlds.expand("dof_frictionloss")[rows[:, None], self._dofs] = torque[:, None]

    def _gains(self, rows: Rows, factors: Array) -> None:
        """Stiffness and damping of the loop that a hand closes itself, (m, 2)."""
        if self._worlds.closes_loop:
            stiffness, motors = factors[:, None, :1], self._worlds.motors
            self._worlds.expand("actuator_gainprm")[rows, motors, :1] *= stiffness
            bias = self._worlds.expand("actuator_biasprm")
            bias[rows, motors, :2] *= stiffness
            bias[rows, motors, 2:3] *= factors[:, None, 1:]

    def _strength(self, rows: Rows, factor: Array) -> None:
        if self._worlds.closes_loop:
            self._worlds.expand("actuator_forcerange")[rows, self._worlds.motors] *= factor[:, None, None]

    def _tilt(self, rows: Rows, angles: Array) -> None:
        """Rotate by a rotation vector in the palm's own axes, rad."""
        palm = self._worlds.model.body("palm_link").id
        own = self._worlds.expand("body_quat")
        own[rows, palm] = quaternion_product(own[rows, palm], quaternion_from_vector(angles))


_HOW: dict[str, Callable[[PhysicsRandomiser, Rows, Array], None]] = {
    "mass": PhysicsRandomiser._mass,
    "size": PhysicsRandomiser._size,
    "friction": PhysicsRandomiser._friction,
    "armature": PhysicsRandomiser._armature,
    "damping": PhysicsRandomiser._damping,
    "frictionloss": PhysicsRandomiser._frictionloss,
    "gains": PhysicsRandomiser._gains,
    "strength": PhysicsRandomiser._strength,
    "wrist_tilt": PhysicsRandomiser._tilt,
}
