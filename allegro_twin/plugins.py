"""Kinds of backends and controllers: those of the package, and those that installed packages add by entry point."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np
from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler, ValidationError
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

from allegro_twin._lazy import entry_points_of
from allegro_twin.backend import HandBackend, PassThroughBackend
from allegro_twin.controller import Controller
from allegro_twin.errors import ConfigError, HandError, HandFault, unknown
from allegro_twin.files.first_error import message_of
from allegro_twin.files.schema import Settings
from allegro_twin.hands.description.calibration import NOTHING, Version
from allegro_twin.hands.description.specs import load_spec
from allegro_twin.hands.settings import HandSettings, TaskSettings
from allegro_twin.plugin_faults import as_plugin_fault, is_own
from allegro_twin.spec import HandSpec
from allegro_twin.types import Command, HandState, PositionCommand, TorqueCommand, Vector

if TYPE_CHECKING:
    from allegro_twin.grasping.trial import Trial

S = TypeVar("S", bound=Settings)


class BackendSettings(Settings):
    """The `backend` block of a config. A kind of backend has a subclass with `kind: Literal[...]` and keys of its
    own."""

    wire_keys: ClassVar[tuple[str, ...]] = ()
    """Keys that are read only for a hand outside this program."""

    kind: str

    @property
    def virtual(self) -> bool:
        """Whether the hand is a simulation in this program, which stands in the scene of the task."""
        return False

    def contradictions(self, task: TaskSettings) -> Iterator[str]:
        """What of these settings contradicts the task or is read by nobody: a line each, with the key and the way
        out."""
        for key in self.wire_keys if self.virtual else ():
            if key in self.model_fields_set:
                yield f"backend.{key}: the wire of a virtual hand is inside this program and has none: leave it out"

    @property
    def place(self) -> str:
        """Where the hand is, for people: "on socketcan can0"."""
        return f"behind {self.kind}"


class ControllerSettings(Settings):
    """The `controller` block of a config. A kind of controller has a subclass with `kind: Literal[...]` and keys of its
    own."""

    takes_posture: ClassVar[bool] = True
    """Whether `task.posture` and `task.grasp` mean anything to it; else they are refused."""

    kind: str


@dataclass(slots=True)
class BackendContext:
    """Config of a run besides the backend's own block."""

    hand: HandSettings
    period: float
    """Control period, s."""
    check: Callable[[HandSpec], None]
    """Raises ConfigError for a hand that cannot be driven in this period. Call it before the wire is opened."""
    simulate: Callable[[Settings | None, HandSpec, float], HandBackend]
    """`simulate(settings, spec, step)`: physics for a virtual hand, in the scene of the task, stepping by `step` s; its
    pictures and its trial then belong to the run. Raises ConfigError."""

    def spec(self, version: Version | None = None, over: Mapping[str, Any] = NOTHING) -> HandSpec:
        """The spec of the config's hand. `version`: of a hand on CAN; `over` overrides its file. Raises ConfigError."""
        return load_spec(self.hand.model, self.hand.side, self.hand.serial, version, over)


@dataclass(frozen=True, slots=True)
class ControllerContext:
    """Config of a run besides the controller's own block."""

    spec: HandSpec
    period: float
    """Control period, s."""
    task: TaskSettings
    trial: Trial | None = None
    """The scenario of the task, where it has one."""
    object_pose: Callable[[], Vector] | None = None
    """True pose of the object of a simulated or virtual hand's episode, m and quaternion w x y z, (7,)."""
    live: bool = False
    """Whether the hand's time passes by itself."""
    replayed: bool = False
    """Whether its motion is a recording's, which no command changes."""


class MadeController(NamedTuple):
    """A controller, and how long what it does takes."""

    controller: Controller[Any]
    seconds: float | None = None
    """When a run without `seconds` ends, s; None: it goes on until somebody ends it."""


@dataclass(frozen=True, slots=True)
class BackendKind(Generic[S]):
    """A kind of backend: the entry point `allegro_twin.backends` of a package names one."""

    settings: type[S]
    """A subclass of `BackendSettings`."""
    open: Callable[[S, BackendContext], HandBackend]
    """Opens the hand. Raises ConfigError or LinkError."""
    virtual: Callable[[S, BackendContext, float], Any] | None = None
    """Makes a virtual hand, physics stepping by so many s, for the far end of the wire; None: there is no such hand.
    Raises ConfigError."""
    replays: bool = False
    """Whether it repeats what has happened: then no guard limits it, and it says itself when it ends."""


class PluginBackend(PassThroughBackend):
    """A backend of an installed package, of which every error is a HandError in one line.

    What it raises besides, and a state that is none of its hand, is a HandFault that names its class, the call and the
    place in its source. `close` raises one where the backend's does; an error that is on its way gets it as a note.
    """

    def __init__(self, backend: HandBackend, kind: str) -> None:
        super().__init__(backend)
        self._kind = kind

    @classmethod
    def open(cls, kind: BackendKind[S], settings: S, context: BackendContext, name: str) -> HandBackend:
        """Open a backend of a package's kind; one that is of this package stays as it is. Raises HandError."""
        opener = kind.open
        with as_plugin_fault(opener, f"backend {name}: {_name(opener)}", "backend"):
            backend = opener(settings, context)
        return backend if is_own(type(backend)) else cls(backend, name)

    def reset(self) -> HandState:
        with self._call("reset"):
            state = super().reset()
        return self._checked(state, "reset")

    def write(self, command: Command) -> None:
        with self._call("write"):
            super().write(command)

    def read(self) -> HandState:
        with self._call("read"):
            state = super().read()
        return self._checked(state, "read")

    def recover(self) -> HandState:
        with self._call("recover"):
            state = super().recover()
        return self._checked(state, "recover")

    def close(self) -> None:
        coming = sys.exc_info()[1]
        try:
            with self._call("close"):
                super().close()
        except HandError as error:
            if not isinstance(coming, Exception):
                raise
            if str(error) not in message_of(coming):  # It was told, and `close` is called again.
                coming.add_note(str(error))

    def _call(self, method: str) -> AbstractContextManager[None]:
        backend = type(self._inner)
        return as_plugin_fault(backend, f"backend {self._kind}: {backend.__qualname__}.{method}", "backend")

    def _checked(self, state: HandState, method: str) -> HandState:
        """The state. Raises HandFault for what is no state of this hand."""
        n, wrong = self.spec.n_joints, ""
        if not isinstance(state, HandState):
            wrong = f"{_short(state)}, no HandState"
        elif not (isinstance(state.t, float | int | np.floating) and isinstance(state.tick, int | np.integer)):
            wrong = f"t {state.t!r:.60} and tick {state.tick!r:.60}, no numbers"
        else:
            for name, size in (("position", n), ("velocity", n), ("torque", n), ("temperature", n), ("gravity", 3)):
                array: Any = getattr(state, name)
                if not (isinstance(array, np.ndarray) and array.shape == (size,) and array.dtype.kind == "f"):
                    found = f"{getattr(array, 'dtype', type(array).__name__)} of shape {np.shape(array)}"
                    wrong = f"a state whose {name} is {found}, not float64 of shape ({size},)"
                    break
        if not wrong:
            return state
        code = getattr(getattr(type(self._inner), method, None), "__code__", None)
        place = "" if code is None else f" ({code.co_filename}:{code.co_firstlineno})"
        raise HandFault(
            f"backend {self._kind}: {type(self._inner).__qualname__}.{method} returns {wrong}{place}; "
            "`allegro-twin check-backend` tries every rule"
        )


@dataclass(frozen=True, slots=True)
class ControllerKind(Generic[S]):
    """A kind of controller: the entry point `allegro_twin.controllers` of a package names one."""

    settings: type[S]
    """A subclass of `ControllerSettings`."""
    make: Callable[[S, ControllerContext], MadeController]
    """Makes the controller. Raises ConfigError."""


class PluginController:
    """A controller of an installed package, of which every error is a HandError in one line, as of a `PluginBackend`.

    An answer that is no command with a memory is a HandFault, too.
    """

    def __init__(
        self,
        controller: Controller[Any],
        kind: str,
        look: Callable[[Controller[Any], HandState], None] = lambda controller, state: None,
    ) -> None:
        """`look`: looks at the started controller, and the state that it started from, before its first command; it may
        raise HandError."""
        self._inner, self.kind, self._look = controller, kind, look

    @classmethod
    def make(cls, kind: ControllerKind[S], settings: S, context: ControllerContext, name: str) -> MadeController:
        """Make a controller of a package's kind; one that is of this package stays as it is. Raises HandError."""
        with as_plugin_fault(kind.make, f"controller {name}: {_name(kind.make)}", "controller"):
            made = kind.make(settings, context)
        if not isinstance(made, MadeController):
            raise HandFault(
                f"controller {name}: {_name(kind.make)} returns {_short(made)}, no MadeController: see to its package"
            )
        return made if is_own(type(made.controller)) else made._replace(controller=cls(made.controller, name))

    def with_look(self, look: Callable[[Controller[Any], HandState], None]) -> PluginController:
        """Copy at which `look` looks once it has started, before its first command."""
        return PluginController(self._inner, self.kind, look)

    def start(self, state: HandState) -> Any:
        with self._call("start"):
            memory = self._inner.start(state)
        self._look(self._inner, state)
        return memory

    def __call__(self, state: HandState, memory: Any) -> tuple[Command, Any]:
        with self._call("__call__"):
            answer: Any = self._inner(state, memory)
        if isinstance(answer, tuple) and len(answer) == 2 and isinstance(answer[0], TorqueCommand | PositionCommand):
            return answer
        raise HandFault(
            f"controller {self.kind}: {_name(type(self._inner))}.__call__ returns {_short(answer)}; it returns a "
            "command (TorqueCommand, PositionCommand) and its memory: see to its package"
        )

    def _call(self, method: str) -> AbstractContextManager[None]:
        controller = type(self._inner)
        return as_plugin_fault(controller, f"controller {self.kind}: {_name(controller)}.{method}", "controller")


def reference_of(controller: Controller[Any]) -> Any:
    """The reference that a controller follows; None where there is none. Of another package's controller, such as a
    subclass of PD, one of this package counts."""
    inner = unwrapped(controller)
    reference = member_of(inner, "reference")
    return reference if inner is controller or is_own(type(reference)) else None


def member_of(controller: Any, name: str) -> Any:
    """A member of a controller; None where it has none, and where another package's has a property that raises, as
    before `start` it may: that it shows more than the contract asks is of no one else's concern."""
    try:
        return getattr(controller, name, None)
    except Exception:
        if is_own(type(controller)):
            raise
        return None


def unwrapped(controller: Controller[Any]) -> Controller[Any]:
    """The controller itself, where it is that of an installed package."""
    return controller._inner if isinstance(controller, PluginController) else controller


def _name(source: Any) -> str:
    return str(getattr(source, "__qualname__", type(source).__name__))


def _short(value: object) -> str:
    return f"{' '.join(repr(value).split()):.60}"


@dataclass(frozen=True)
class Registry:
    """The kinds that may stand in one block of a config.

    As the metadata of a pydantic field it validates the block by the settings of its `kind`; the JSON Schema of such a
    field has every kind, those of installed packages too.
    """

    block: str
    """As in a config: backend, controller."""
    group: str
    """Group of entry points."""
    builtin: Mapping[str, str] = field(repr=False)
    """Where the package's own kinds are, `module:attribute` by kind."""

    def names(self) -> list[str]:
        """Every kind, the package's own first."""
        return [*self.builtin, *(name for name in sorted(entry_points_of(self.group)) if name not in self.builtin)]

    def kind(self, name: str) -> Any:
        """A kind by its name. Raises ConfigError with the nearest names, or with what is wrong with a package."""
        if name in self.builtin:
            module, _, attribute = self.builtin[name].partition(":")
            return getattr(import_module(module), attribute)
        point = entry_points_of(self.group).get(name)
        if point is None:
            raise ConfigError(self._unknown(name))
        try:
            found = point.load()
        except Exception as error:  # A package of somebody else's may raise anything.
            raise ConfigError(f"{self.block}.kind {name}: {point.value} cannot be imported: {error}") from error
        wanted = BackendKind if self.block == "backend" else ControllerKind
        if not isinstance(found, wanted):
            raise ConfigError(f"{self.block}.kind {name}: {point.value} is no allegro_twin.{wanted.__name__}")
        return found

    def _unknown(self, name: object) -> str:
        installed = [each for each in self.names() if each not in self.builtin]
        text = unknown(f"{self.block} kind", str(name), self.names()).partition("; there are: ")[0].rstrip("?")
        return (
            f"{text}; there are {', '.join(self.builtin)}; installed packages add {', '.join(installed) or 'none'} "
            f"(entry points {self.group})"
        )

    def models(self) -> list[type[Settings]]:
        """The settings of the kinds that installed packages add."""
        return [settings for _, settings in self.installed()]

    def installed(self) -> Iterator[tuple[str, type[Settings]]]:
        """The settings of every kind that an installed package adds and that can be imported."""
        for name in self.names():
            if name not in self.builtin:
                try:
                    yield name, self.kind(name).settings
                except ConfigError:
                    continue  # Said when a config asks for it.

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_wrap_validator_function(
            self._validated, handler(source), serialization=core_schema.simple_ser_schema("any")
        )

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        found = handler(schema)
        for name, settings in self.installed():
            more = handler(settings.__pydantic_core_schema__)
            found.setdefault("oneOf", []).append(more)
            if "discriminator" in found and "$ref" in more:
                found["discriminator"]["mapping"][name] = more["$ref"]
        return found

    def _validated(self, value: Any, inner: Callable[[Any], Any]) -> Any:
        name = value.get("kind") if isinstance(value, Mapping) else getattr(value, "kind", None)
        if name is None or name in self.builtin:
            return inner(value)
        try:
            settings = self.kind(str(name)).settings
        except ConfigError as error:
            raise PydanticCustomError("unknown_kind", "{reason}", {"reason": str(error)}) from error
        try:
            return settings.model_validate(value)
        except ValidationError as error:  # With the kind in the place of an error, as in a union of settings.
            details = [
                InitErrorDetails(
                    type=PydanticCustomError("in_kind", "{msg}", {"msg": each["msg"]})
                    if each["type"] not in _TYPES
                    else each["type"],
                    loc=(str(name), *each["loc"]),
                    input=each["input"],
                )
                for each in error.errors()
            ]
            raise ValidationError.from_exception_data(error.title, details) from error


_TYPES = ("extra_forbidden", "missing")
"""Errors that `files.schema` words itself."""


BACKENDS = Registry(
    "backend",
    "allegro_twin.backends",
    {
        "sim": "allegro_twin.app.simulated:KIND",
        "can": "allegro_twin.drivers.can.opening:KIND",
        "dynamixel": "allegro_twin.drivers.dynamixel.opening:KIND",
        "qb": "allegro_twin.drivers.qb.opening:KIND",
        "schunk": "allegro_twin.drivers.schunk.opening:KIND",
        "replay": "allegro_twin.app.replayed:KIND",
    },
)
CONTROLLERS = Registry(
    "controller",
    "allegro_twin.controllers",
    {
        kind: f"allegro_twin.app.controllers:{name}"
        for kind, name in {
            "torque": "TORQUE",
            "gravity": "GRAVITY",
            "pd": "POSITION",
            "pid": "POSITION",
            "limp": "LIMP",
            "position": "SETPOINTS",
            "policy": "POLICY",
            "mpc": "MPC",
            "impedance": "CARTESIAN",
            "compliance": "CARTESIAN",
        }.items()
    },
)
