"""What a plant is: an MJCF, named coordinates, inputs and parameters, and how these are written."""

from __future__ import annotations

import hashlib
import math
import os
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from types import MappingProxyType, ModuleType, SimpleNamespace
from typing import Any, Literal
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from afl_mujoco.errors import FileError, InvalidValueError, UnknownNameError, told
from afl_mujoco.loading import home_of, import_from, importing, look_in, run_file
from afl_mujoco.values import Finite, check_fields, require_finite

Floats = NDArray[np.float64]

LARGEST_MJCF = 10_000_000  # bytes of a file in which the names of others are looked for

AXES = {f"{sign}{x}": (k, float(f"{sign}1")) for sign in ("", "-") for k, x in enumerate("xyz")}


@dataclass(frozen=True, slots=True)
class Parameter:
    """A number of a plant that may change.

    Parameters
    ----------
    value
        Its nominal value.
    unit
        Its unit, for tables.
    low, high
        Where `afl_mujoco.check` draws it; by default only at `value`.
    rate
        ``"frozen"``: its rate does not act on the motion; ``"enters"``: it does, as that of a
        length which is reeled out under load.
    jump
        What stays when it rises at once: the ``"velocities"``, or the ``"momenta"``, as of a
        mass that joins at rest.

    Raises
    ------
    AflMujocoError
        If a number is not finite, or the value lies outside its bounds.

    Examples
    --------
    >>> import afl_mujoco as afl
    >>> afl.Parameter(0.3, "m", low=0.2, high=0.5).high
    0.5
    """

    value: Finite
    unit: str = ""
    low: Finite | None = None
    high: Finite | None = None
    rate: Literal["frozen", "enters"] = "frozen"
    jump: Literal["velocities", "momenta"] = "velocities"

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("low", "high"):
            if getattr(self, name) is None:
                object.__setattr__(self, name, self.value)
        if not self.low <= self.high:  # type: ignore[operator]
            raise InvalidValueError("low", f"must be at most high, {self.high}", self.low)
        if not self.low <= self.value <= self.high:  # type: ignore[operator]
            raise InvalidValueError("value", f"must lie in {self.low} to {self.high}", self.value)
        for name, words in (("rate", ("frozen", "enters")), ("jump", ("velocities", "momenta"))):
            if getattr(self, name) not in words:
                raise UnknownNameError.among(name, getattr(self, name), words)


@dataclass(frozen=True, slots=True)
class Shape:
    """Mass [kg], centre of mass [m] and principal inertia about it [kg m^2], in a body's frame."""

    mass: Any
    center: tuple[Any, Any, Any]
    inertia: tuple[Any, Any, Any]


def rod(
    *,
    mass: Any,
    length: Any,
    axis: str = "z",
    radius: Any = None,
    center: tuple[Any, Any, Any] | None = None,
) -> Shape:
    """Return mass, centre and inertia of a uniform slender rod.

    Parameters
    ----------
    mass
        Its mass [kg]: a number, or an array with one value for each time step.
    length
        Its length [m].
    axis
        Where it points from the origin of its body: ``"x"``, ``"y"``, ``"z"`` or ``"-z"``.
    radius
        Gives the inertia about its own axis, ``mass radius^2 / 2`` [m]; by default length / 100.
    center
        Its centre of mass [m]; by default half its length along the axis.

    Returns
    -------
    Shape
        What ``"body NAME"`` takes in a plant's ``write``: inertia ``mass length^2 / 12`` across it.

    Raises
    ------
    UnknownNameError
        If there is no such axis.

    Examples
    --------
    >>> import afl_mujoco as afl
    >>> afl.rod(mass=1.2, length=0.5).center
    (0.0, 0.0, 0.25)
    """
    if axis not in AXES:
        raise UnknownNameError.among("axis", axis, AXES)
    along, sign = AXES[axis]
    radius = 0.01 * length if radius is None else radius
    across, about = mass * length**2 / 12.0, 0.5 * mass * radius**2
    middle: list[Any] = [0.0, 0.0, 0.0]
    inertia = [across, across, across]
    middle[along], inertia[along] = sign * 0.5 * length, about
    x, y, z = center or middle
    return Shape(mass, (x, y, z), tuple(inertia))


def ball(*, mass: Any, radius: Any, center: tuple[Any, Any, Any] = (0.0, 0.0, 0.0)) -> Shape:
    """Return mass, centre and inertia of a uniform solid ball.

    Parameters
    ----------
    mass, radius
        Its mass [kg] and radius [m]: numbers, or arrays with one value for each time step.
    center
        Its centre [m]; by default the origin of its body.

    Returns
    -------
    Shape
        What ``"body NAME"`` takes in a plant's ``write``: inertia ``2/5 mass radius^2``.

    Examples
    --------
    >>> import afl_mujoco as afl
    >>> afl.ball(mass=1.0, radius=0.5).inertia
    (0.1, 0.1, 0.1)
    """
    inertia = 0.4 * mass * radius**2
    return Shape(mass, center, (inertia, inertia, inertia))


def box(
    *, mass: Any, lengths: tuple[Any, Any, Any], center: tuple[Any, Any, Any] = (0.0, 0.0, 0.0)
) -> Shape:
    """Return mass, centre and inertia of a uniform box.

    Parameters
    ----------
    mass
        Its mass [kg]: a number, or an array with one value for each time step.
    lengths
        The lengths of its edges along x, y and z [m]; MJCF gives half of them.
    center
        Its centre [m]; by default the origin of its body.

    Returns
    -------
    Shape
        What ``"body NAME"`` takes in a plant's ``write``: ``mass (b^2 + c^2) / 12`` about x.

    Examples
    --------
    >>> import afl_mujoco as afl
    >>> afl.box(mass=12.0, lengths=(1.0, 2.0, 3.0)).inertia
    (13.0, 10.0, 5.0)
    """
    a, b, c = (length**2 for length in lengths)
    x, y, z = (mass * squares / 12.0 for squares in (b + c, a + c, a + b))
    return Shape(mass, center, (x, y, z))


@dataclass(frozen=True, kw_only=True, eq=False)
class Plant:
    """A plant: an MJCF, its coordinates, inputs and parameters, and the equations it should obey.

    Parameters
    ----------
    name
        Its name in reports.
    model
        The MJCF: a path, relative to the file that makes the plant, or the XML itself.
    coordinates
        Names of its hinges and slides, all of them, in the order of the MJCF and of the state.
    inputs
        Names of its actuators, all of them, in the order of the MJCF.
    parameters
        What may change, by name.
    write
        ``write(p)`` returns what the parameters ``p.NAME`` are in the model, by target:
        ``"body NAME"`` for a shape, else ``"KIND NAME FIELD [INDEX]"`` (body mass, ipos, inertia
        or pos; geom size or pos; site pos; joint damping, armature, stiffness or frictionloss;
        actuator gear) and ``"option gravity INDEX"``. ``p.NAME`` may be an array.
    accelerations
        ``accelerations(q, v, u, p)`` returns one acceleration for each coordinate.
    terms
        In place of it, ``terms(q, v, p)`` returns ``(M, h, B)`` of ``M v' + h = B u``: shapes
        (n, n), (n,) and (n, k). A check can then name the wrong term.
    upright
        The coordinates about which linear controllers are designed.
    wraps
        Coordinates whose targets, limits and bands are met modulo 2 pi; a controller gets the
        angle with all its turns.
    signals
        Further names for requirements: functions of (q, v, p).
    start
        The state from which a run starts where a scenario does not say it; at rest at 0 by default.
    ends_at
        How far from its target a coordinate ends a run as failed, by name; never by default.
    details
        Further numbers that ``write`` gets, ideal here, and set by imperfections: neither the
        equations nor a controller know them.

    Raises
    ------
    AflMujocoError
        If a name is used twice or not known, or an argument is of another kind.

    Examples
    --------
    >>> import afl_mujoco as afl
    >>> pendulum = afl.Plant(
    ...     name="pendulum",
    ...     model='<mujoco><worldbody><body name="rod"><joint name="angle" axis="0 1 0"/>'
    ...     '<inertial pos="0 0 .1" mass="1" diaginertia=".1 .1 .1"/></body></worldbody></mujoco>',
    ...     coordinates=("angle",),
    ... )
    >>> pendulum.states
    ('angle', 'angle_dot')
    """

    name: str
    model: str | Path
    coordinates: Sequence[str]
    inputs: Sequence[str] = ()
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    write: Callable[[Any], Mapping[str, Any]] | None = None
    accelerations: Callable[..., Any] | None = None
    terms: Callable[..., Any] | None = None
    upright: Sequence[float] | None = None
    wraps: Sequence[str] = ()
    signals: Mapping[str, Callable[..., Any]] = field(default_factory=dict)
    start: Sequence[float] | None = None
    ends_at: Mapping[str, float] = field(default_factory=dict)
    details: Mapping[str, float] = field(default_factory=dict)
    # what `load_plant` takes, if it was loaded; one that is made of another has none
    origin: str = field(default="", init=False, repr=False)
    text: str = field(default="", init=False, repr=False)  # digest of the file that it is from
    stamp: str = field(default="", init=False, repr=False, compare=False)  # of its MJCF, as made

    def __post_init__(self) -> None:
        if not (isinstance(self.name, str) and self.name):
            raise InvalidValueError("plant", "must have a name", told(self.name, repr))
        if not isinstance(self.model, str | Path):
            rule = "must be a path or the XML itself"
            raise InvalidValueError("model", rule, told(self.model, repr))
        if not str(self.model).lstrip().startswith("<"):
            caller = sys._getframe(2)  # what calls the constructor, by dataclasses.replace or not
            while caller.f_back and caller.f_globals.get("__name__") in ("dataclasses", "copy"):
                caller = caller.f_back
            maker = caller.f_globals.get("__file__", "")
            here = Path(maker).absolute().parent if maker else Path.cwd()
            object.__setattr__(self, "model", here / Path(self.model).expanduser())
        for thing in ("coordinates", "inputs", "wraps"):
            object.__setattr__(self, thing, _names(thing, getattr(self, thing)))
        for thing in ("parameters", "signals", "ends_at", "details"):
            given = getattr(self, thing)
            if not isinstance(given, Mapping):
                raise InvalidValueError(thing, "must be a dictionary", told(given, repr))
            object.__setattr__(self, thing, MappingProxyType(dict(given)))
            for name in _names(thing, tuple(given)):
                if not name.isidentifier():
                    raise InvalidValueError(thing, "must be names as Python has them", repr(name))
        self._require_kinds()
        self._take_numbers()
        self._refuse_doubles()
        object.__setattr__(self, "stamp", _stamp(self.model))

    def __reduce__(self) -> Any:
        if not self.origin:
            rule = "must be loaded from a file, as FILE.py:NAME, for more than one process"
            raise InvalidValueError(f"plant {self.name!r}", rule)
        return _loaded, (self.origin, self.text, self.stamp)

    def __deepcopy__(self, memo: Any) -> Plant:
        return self

    def _require_kinds(self) -> None:
        if not self.coordinates:
            raise InvalidValueError("coordinates", "must name at least one joint", "none")
        for thing in ("wraps", "ends_at"):
            if strange := [name for name in getattr(self, thing) if name not in self.coordinates]:
                raise UnknownNameError.among(thing, strange[0], self.coordinates)
        for name, one in self.parameters.items():
            if not isinstance(one, Parameter):
                rule = "must be an afl.Parameter"
                raise InvalidValueError(f"parameter {name!r}", rule, told(one, repr))
        own = {name: getattr(self, name) for name in ("write", "accelerations", "terms")}
        given = {name: function for name, function in own.items() if function is not None}
        for thing, function in {**self.signals, **given}.items():
            if not callable(function):
                raise InvalidValueError(thing, "must be a function", told(function, repr))
        if {"terms", "accelerations"} <= given.keys():
            raise InvalidValueError("plant", "must have accelerations or terms, not both")

    def _take_numbers(self) -> None:
        for thing, count in (("upright", len(self.coordinates)), ("start", len(self.states))):
            if (given := getattr(self, thing)) is not None:
                numbers = tuple(require_finite(thing, x) for x in given)
                if len(numbers) != count:
                    rule = f"must be {count} finite number{'s' * (count != 1)}"
                    raise InvalidValueError(thing, rule, numbers)
                object.__setattr__(self, thing, numbers)

    def _refuse_doubles(self) -> None:
        owner = {"time": "time in tables", "command": "command in tables"}
        for kind, names in {
            "state": self.states, "input": self.inputs, "parameter": self.parameters,
            "command": [f"{name}_command" for name in self.inputs], "signal": self.signals,
        }.items():  # fmt: skip
            for name in names:
                if name in owner:
                    other = f"the {owner[name]}" if owner[name] != kind else f"another {kind}"
                    rule = f"must not be the name of {other} too"
                    raise InvalidValueError(f"{kind} {name!r}", rule)
                owner[name] = kind

    def __repr__(self) -> str:
        given = [f"{x}={tuple(getattr(self, x))}" for x in ("coordinates", "inputs", "parameters")]
        return f"Plant(name={self.name!r}, {', '.join(given)})"

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of the state: the coordinates, then their rates."""
        return (*self.coordinates, *(f"{name}_dot" for name in self.coordinates))

    @property
    def nominal(self) -> NDArray[np.float64]:
        """Nominal values of the parameters, shape (parameters,)."""
        return np.array([float(one.value) for one in self.parameters.values()])

    def named(self, values: NDArray[np.float64]) -> SimpleNamespace:
        """Return parameters by name: floats from shape (parameters,), arrays from one more axis."""
        values = np.asarray(values, dtype=np.float64)
        columns: Any = values.tolist() if values.ndim == 1 else np.moveaxis(values, -1, 0)
        return SimpleNamespace(**dict(zip(self.parameters, columns, strict=True)))

    @cached_property
    def entering(self) -> NDArray[np.bool_]:
        """Which parameters' rates act on the motion, shape (parameters,)."""
        return np.array([one.rate == "enters" for one in self.parameters.values()], dtype=np.bool_)

    @property
    def changes(self) -> dict[str, str]:
        """What changes of parameters do, for provenance."""
        keeps = any(one.jump == "momenta" for one in self.parameters.values())
        return {
            "dynamics": "rates enter" if self.entering.any() else "quasi-static",
            "jumps": "momenta" if keeps else "velocities",
        }

    @property
    def has_equations(self) -> bool:
        """Whether it says what it should obey."""
        return self.accelerations is not None or self.terms is not None

    @cached_property
    def units(self) -> Mapping[str, str]:
        """The units of states, inputs and parameters by name, as far as the MJCF says them."""
        there = _Mjcf(self.model)
        slides = {name: one.get("type") == "slide" for name, one in there.joints.items()}
        lengths = {name: "m" if slides.get(name) else "rad" for name in self.coordinates}
        rates = {f"{name}_dot": f"{unit}/s" for name, unit in lengths.items()}
        moved = {
            name: one.get("joint", "") for name, one in there.motors.items()
            if abs(math.prod(_first(one.get(x, ""), 1.0) for x in ("gear", "gainprm"))) == 1.0
        }  # fmt: skip
        known = {True: "N", False: "N m", None: ""}
        drives = {name: known[slides.get(moved.get(name, ""))] for name in self.inputs}
        return {**lengths, **rates, **drives, **{k: p.unit for k, p in self.parameters.items()}}

    @cached_property
    def limits(self) -> NDArray[np.float64]:
        """The limits that the MJCF gives inputs, by ctrlrange and by forcerange, (inputs, 2)."""
        motors, found = _Mjcf(self.model).motors, np.tile([-np.inf, np.inf], (len(self.inputs), 1))
        for i, one in enumerate(motors.get(name, {}) for name in self.inputs):
            gain = _first(one.get("gainprm", ""), 1.0) or 1.0
            for kind, share in (("ctrl", 1.0), ("force", gain)):
                given = _numbers(one.get(f"{kind}range", ""))
                if len(given) == 2 and one.get(f"{kind}limited", "auto") != "false":
                    least, most = sorted(x / share for x in given)
                    found[i] = max(found[i, 0], least), min(found[i, 1], most)
        return found

    def require_unchanged(self) -> None:
        """Raise if its MJCF is another than when it was made, of which limits and designs are."""
        if self.stamp != _stamp(self.model):
            rule = "must be as it was when the plant was made: make or load the plant anew"
            raise InvalidValueError(f"MJCF of plant {self.name!r}", rule)

    @property
    def limited_joints(self) -> list[str]:
        """The joints that limit what drives exert, by the MJCF."""
        joints, off = _Mjcf(self.model).joints, "actuatorfrclimited"
        given = {name: one for name, one in joints.items() if one.get("actuatorfrcrange")}
        return [name for name, one in given.items() if one.get(off) != "false"]


def require_seen_limits(joints: Iterable[str]) -> None:
    """Raise for a joint that limits what drives exert, of which no record of an input knows."""
    for name in joints:
        rule = "would limit inputs unseen: give the actuator a ctrlrange or a forcerange"
        raise InvalidValueError(f"<joint {name!r} actuatorfrcrange>", rule)


def _stamp(model: str | Path) -> str:
    """Return a digest of an MJCF, and of the files that it names, as far as they can be read."""
    read = hashlib.sha256()
    waiting, seen = [model] if isinstance(model, str) or model.is_file() else [], set[Path]()
    while waiting:
        one = waiting.pop()
        text = one.encode() if isinstance(one, str) else b""
        with suppress(OSError):
            text = one.read_bytes() if isinstance(one, Path) else text
        read.update(text)
        if isinstance(model, Path) and len(text) < LARGEST_MJCF:
            named = re.findall(rb"""(?:file|dir)=["']([^"']*)""", text)
            names = [os.fsdecode(name) for name in named]
            folders = [model.parent, *(x for name in names if (x := model.parent / name).is_dir())]
            places = (folder / name for folder in folders for name in names)
            fresh = [*dict.fromkeys(x for x in places if x not in seen and x.is_file())]
            waiting += fresh
            seen.update(fresh)
    return read.hexdigest()


ACTUATORS = ("general", "motor", "position", "velocity", "intvelocity", "damper", "cylinder")


class _Mjcf:
    """The attributes of the joints and of the actuators of an MJCF by name, defaults included.

    What cannot be read has none: whatever is wrong is said where the model is compiled.
    """

    def __init__(self, model: str | Path) -> None:
        self.joints: dict[str, dict[str, str]] = {}
        self.motors: dict[str, dict[str, str]] = {}
        self._defaults: dict[tuple[str, str], dict[str, str]] = {}
        try:
            text = model.read_text("utf-8") if isinstance(model, Path) else model
            root = ElementTree.fromstring(text)
            if isinstance(model, Path):
                for place in [*root.iter()]:
                    for one in place.findall("include"):
                        file = model.parent / one.get("file", "")
                        place.extend(ElementTree.parse(file).getroot())
        except (OSError, ValueError, ElementTree.ParseError):
            return
        for one in root.findall("default"):
            self._learn(one, "main")
        for one in root.findall("worldbody"):
            self._visit(one, "main")
        for one in root.findall("actuator/*"):
            self.motors[one.get("name", "")] = self._whole(one, "main")

    def _learn(self, element: ElementTree.Element, above: str) -> None:
        name = element.get("class", "main")
        for (at, tag), given in [*self._defaults.items()]:
            if at == above:
                self._defaults[name, tag] = given
        for one in element:
            if one.tag != "default":
                self._defaults[name, _kind(one)] = self._whole(one, name)
        for one in element.findall("default"):
            self._learn(one, name)

    def _whole(self, element: ElementTree.Element, inherited: str) -> dict[str, str]:
        at = element.get("class", inherited)
        given = {**self._defaults.get((at, _kind(element)), {}), **element.attrib}
        if element.tag == "motor":  # whatever the defaults say
            given.pop("gainprm", None)
        return given

    def _visit(self, element: ElementTree.Element, inherited: str) -> None:
        inherited = element.get("childclass", inherited)
        for joint in element.findall("joint"):
            self.joints[joint.get("name", "")] = self._whole(joint, inherited)
        for inner in (*element.findall("body"), *element.findall("frame")):
            self._visit(inner, inherited)


def _kind(element: ElementTree.Element) -> str:
    """Return what an element makes: all kinds of actuators share their defaults."""
    return "actuator" if element.tag in ACTUATORS else element.tag


def _numbers(text: str) -> list[float]:
    """Return the numbers of an attribute; none if it cannot be read, as in `_Mjcf`."""
    try:
        return [float(x) for x in text.split()]
    except ValueError:
        return []


def _first(text: str, default: float) -> float:
    return next(iter(_numbers(text)), default)


def _names(thing: str, given: Any) -> tuple[str, ...]:
    if isinstance(given, str) or not isinstance(given, Sequence):
        raise InvalidValueError(thing, "must be a tuple of names", told(given, repr))
    for name in given:
        if not (isinstance(name, str) and name):
            raise InvalidValueError(thing, "must be names", told(name, repr))
    return tuple(given)


KNOWN = {"cart-pole": "afl_mujoco.plants.cartpole_equations:plant"}
"""Plants by name: the cart-pole of the paper is that of a scenario that names none."""


def known_as(plant: Plant, origin: str, text: str = "") -> Plant:
    """Return a plant that says where another process, and a reader of a result, finds it."""
    object.__setattr__(plant, "origin", origin)
    object.__setattr__(plant, "text", text)
    return plant


@cache
def _loaded(origin: str, text: str, stamp: str) -> Plant:
    found = load_plant(origin, home_of(origin.rpartition(":")[0]))
    if (found.text, found.stamp) != (text, stamp):
        rule = "must not change while it runs, but its file did"
        raise InvalidValueError(f"plant {origin}", rule)
    return found


def load_plant(spec: str, folder: Path | None = None) -> Plant:
    """Return the plant of ``"file.py:plant"``, relative to a folder, or ``"module:plant"``."""
    place, _, attribute = KNOWN.get(spec, spec).rpartition(":")
    if not (place and attribute.isidentifier()):
        rule = "must be FILE.py:NAME or MODULE:NAME"
        hint = f"; did you mean {spec}:plant?" if spec.endswith(".py") else ""
        raise InvalidValueError("plant", rule, f"{spec!r}{hint}")
    here, origin = folder or Path.cwd(), spec
    if place.endswith(".py"):
        file = (here / Path(place).expanduser()).absolute()
        origin = f"{file}:{attribute}"
        module, text = _run_file(file)
    else:
        module, text = import_from(here, place, f"plant {spec!r}")
    found = getattr(module, attribute, None)
    if found is None:
        plants = [name for name, one in vars(module).items() if isinstance(one, Plant)]
        if not plants:
            raise InvalidValueError(f"plant {spec!r}", "must be defined there: there is no Plant")
        raise UnknownNameError.among("plant", attribute, plants).within(f"{place}: ")
    if not isinstance(found, Plant):
        raise InvalidValueError(f"plant {spec!r}", "must be an afl.Plant", told(found, repr))
    digest = hashlib.sha256(text).hexdigest() if text else ""
    return found if found.origin else known_as(found, origin, digest)


def _run_file(path: Path) -> tuple[ModuleType, bytes]:
    """Return the module of a file, executed anew, and the text of it and what it imports."""
    if not path.is_file():
        raise FileError.none_at(path)
    path = path.resolve()
    look_in(path.parent)  # for what it imports from beside it
    name = path.stem if path.stem.isidentifier() else "plant"
    with importing(str(path)):
        return run_file(path, name)
