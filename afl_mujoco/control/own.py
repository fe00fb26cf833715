"""Controllers of one's own, in Python: their memory, their calls, and how they are loaded."""

from __future__ import annotations

import contextlib
import copy
import dis
import hashlib
import inspect
import math
import numbers
import os
import types
from collections import namedtuple
from collections.abc import Callable, Collection, Iterator
from contextvars import ContextVar
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from afl_mujoco.control.controller import Controller
from afl_mujoco.errors import AflMujocoError, ControllerDomainError, InvalidValueError, told
from afl_mujoco.loading import ASIDE, LIMIT, Overrun, import_from, limited
from afl_mujoco.plants.cartpole import CART_POLE, has_its_names
from afl_mujoco.plants.plant import Floats, Plant
from afl_mujoco.scenario.parameters import CartPoleParameters
from afl_mujoco.values import require_positive, require_type

ARGUMENTS = (0.0, np.zeros(4), None)  # as many arguments as a controller's function takes

_WRITES = ("STORE_GLOBAL", "DELETE_GLOBAL", "STORE_DEREF", "DELETE_DEREF")
"""Instructions that write a variable which outlives a call, or which an inner function shares."""

_COUNTS = "an object counts as one with a memory unless it has stateless = True"


def makes_controllers(function: Any) -> bool:
    """Return whether something is a class, or a factory that is called without arguments."""
    if inspect.isclass(function):
        return True
    return not _takes(function, ARGUMENTS) and _takes(function, ())


def remembers(function: Any) -> bool:
    """Return whether what a controller answers may depend on earlier calls.

    A function is stateless unless it writes a variable that outlives the call; so is the partial
    of one, and what has the attribute ``stateless = True``. All else may remember.
    """
    return makes_controllers(function) or bool(why_it_remembers(function))


def _is_compiled(function: Any) -> bool:
    """Return whether a function is one that a library has compiled, as Numba and JAX do."""
    if isinstance(function, partial):
        return _is_compiled(function.func)
    plain = types.FunctionType | types.BuiltinFunctionType | types.MethodType
    return not isinstance(function, plain) and _is_function(function)


@cache
def _named(names: tuple[str, ...]) -> Any:
    return namedtuple("belief", names)  # one type: it is compiled for


def _belief(function: Any, given: dict[str, float], cart_pole: bool) -> Any:
    """Return what a function is given as its belief."""
    if _is_compiled(function):  # Numba and JAX know named tuples
        return _named(tuple(given))(**given)
    return CartPoleParameters(**given) if cart_pole else SimpleNamespace(**given)


def why_it_remembers(function: Any) -> str:
    """Return why something that makes no controllers may remember, and what helps; or nothing."""
    if _declared(function):
        return ""
    if isinstance(function, partial):
        bound = (*function.args, *function.keywords.values())
        changeable = not all(_is_constant(x) for x in bound)
        return why_it_remembers(function.func) or _COUNTS * changeable
    if not _is_function(function):
        return _COUNTS
    if written := _written(function):
        return f"it writes {written!r}, which outlives the call: make it a class"
    return ""


def _is_constant(x: Any) -> bool:
    """Return whether a bound argument cannot keep anything: numbers, text, what is declared so."""
    if is_dataclass(type(x)) and type(x).__dataclass_params__.frozen:
        x = tuple(getattr(x, one.name) for one in fields(x))
    if isinstance(x, tuple):
        return all(_is_constant(one) for one in x)
    if isinstance(x, np.ndarray):
        return not x.flags.writeable
    plain = isinstance(x, numbers.Number | str | bytes | np.generic | None)
    return plain or _declared(x) or _is_function(x)


def fresh(name: str, function: Any) -> Any:
    """Return the function for one run: made anew, copied, or itself if it is stateless."""
    makes = makes_controllers(function)
    try:
        return function() if makes else _copied(function, {})
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        what = f"{type(error).__name__}: {told(error)}"
        rule = f"cannot be started: {what}"
        if not makes:
            rule = f"must be copied for each run, but cannot be: {what}; give its class, or set "
            rule += "stateless = True on it if it remembers nothing"
        raise InvalidValueError(f"controller {name!r}", rule) from error


def _copied(function: Any, memo: dict[int, Any]) -> Any:
    """Return a deep copy, reset; a function is stateless and has none."""
    if _declared(function):
        return function
    if isinstance(function, partial):
        copied = _copied(function.func, memo)
        arguments, named = copy.deepcopy((function.args, function.keywords), memo)
        return partial(copied, *arguments, **named)
    if _is_function(function):
        return function
    owner = _owner(function)
    mine = copy.deepcopy(owner, memo)
    if callable(reset := getattr(mine, "reset", None)):
        reset()
    if owner is function:
        return mine
    if inspect.ismethod(function):
        return types.MethodType(function.__func__, mine)
    return getattr(mine, function.__name__)  # of a class in C


def _declared(function: Any) -> bool:
    """Return whether something, or the object of a bound method, says that it is stateless."""
    return any(getattr(x, "stateless", None) is True for x in (function, _owner(function)))


def _owner(function: Any) -> Any:
    """Return the object of a bound method, or what is none itself."""
    if inspect.isfunction(function) or not inspect.isroutine(function):
        return function
    owner = getattr(function, "__self__", None)
    is_object = owner is not None and not isinstance(owner, types.ModuleType | type)
    return owner if is_object else function


def _is_function(function: Any) -> bool:
    """Return whether something is a function: of Python, builtin, or compiled by a library.

    What a library compiles (numba, JAX, Cython) is an object that Python does not call by a method
    written in Python; a user's own class is called by one.
    """
    if _owner(function) is not function or not inspect.isroutine(function):
        return False
    return not inspect.isfunction(type(function).__call__)


def _written(function: Any) -> str:
    """Return a variable that a function, or the one behind it, writes and that outlives a call."""
    seen: list[Any] = []
    while function is not None and not any(function is x for x in seen):
        seen.append(function)
        method = getattr(function, "__func__", function)
        code = getattr(method, "__code__", None)
        if isinstance(code, types.CodeType) and (found := _writes(code, code.co_freevars)):
            return found
        function = getattr(function, "__wrapped__", getattr(function, "py_func", None))
    return ""


def _writes(code: types.CodeType, outside: Collection[str]) -> str:
    """Return a global, or a variable from outside, that code or a function within it writes."""
    for step in dis.get_instructions(code):
        if step.opname in _WRITES and ("GLOBAL" in step.opname or step.argval in outside):
            return str(step.argval)
    for inner in code.co_consts:
        if isinstance(inner, types.CodeType):
            shared = set(inner.co_freevars) & set(outside)
            if found := _writes(inner, shared):
                return found
    return ""


def _takes(function: Callable[..., Any], arguments: tuple[Any, ...]) -> bool:
    try:
        inspect.signature(function).bind(*arguments)
    except (TypeError, ValueError):
        return False
    return True


Function = Callable[[float, Floats, CartPoleParameters], Any]
"""(time [s], state, assumed parameters of the plant) -> force [N]."""

CALL_LIMIT = 1.0  # how long one call may take [s], unless `calls_limited_to` says otherwise
FIRST_CALL_LIMIT = LIMIT  # the same of the first call [s]: a library compiles, a network is loaded

_limit: ContextVar[float] = ContextVar("call_limit", default=CALL_LIMIT)

_hung: set[str] = set()
"""Controllers whose first call took too long in this process: to wait again, in each of a
thousand runs, would take a day."""


@contextlib.contextmanager
def calls_limited_to(seconds: float | None) -> Iterator[None]:
    """Give controllers that are made within the block this limit [s]; None changes nothing."""
    limit = _limit.get() if seconds is None else require_positive("call_limit", seconds)
    before = _limit.set(limit)
    try:
        yield
    finally:
        _limit.reset(before)


class ControllerError(AflMujocoError):
    """A Python controller that raised, took too long, or did not return a force."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PythonController(Controller):
    """A user's own controller, called by the interpreter.

    A simulator that evaluates it continuously also calls it at states that the run does not pass
    through, and more than once at an instant: there it must be stateless. Sampled mode calls it
    once per control period, in order.
    """

    name: str  # name for reports and files
    # ``function(time, state, belief) -> force``; or a class or factory without arguments whose
    # instances are such functions, one for each run; or such an instance, or a bound method of one:
    # each run has a deep copy of it, on which its method ``reset()`` is called if it has one. An
    # instance with ``stateless = True`` is used as it is. NaN, or a `ControllerDomainError`, says
    # that it has no force there, and ends the run
    function: Any
    call_limit: float = field(default_factory=_limit.get)  # how long one call may take [s]
    # ``"module:attribute"`` if it was loaded by name; a worker process loads it again from this
    spec: str | None = None
    # whether what it answers depends on earlier calls; by default it does unless ``function`` is a
    # function that writes no global and no nonlocal, a partial of one, or has the attribute
    # ``stateless = True``
    stateful: bool = None  # type: ignore[assignment]
    # how long the first call of a run may take [s], if that is more: a library may compile then.
    # After one that took longer, a process waits no more than `call_limit`
    first_call_limit: float = FIRST_CALL_LIMIT
    plant: Plant = CART_POLE  # what it controls
    source: str | None = None  # hash of the user's files behind it, as they were loaded
    called: bool = field(default=False, init=False, repr=False, compare=False)
    interpreted: ClassVar[bool] = True
    not_compiled: ClassVar[str] = "is written in Python, which this simulator does not run"

    def __post_init__(self) -> None:
        require_type("controller name", self.name, str)
        require_positive("call_limit", self.call_limit)
        require_positive("first_call_limit", self.first_call_limit)
        if self.stateful is None:
            self._fresh()
            object.__setattr__(self, "stateful", remembers(self.function))
        if self.source is None:
            object.__setattr__(self, "source", _source_hash(_defined(self.function)))

    def start(self) -> PythonController:
        """Return the controller for one run: made anew or copied, if it is no function."""
        function = self._fresh()
        return self if function is self.function else replace(self, function=function)

    def _fresh(self) -> Function:
        function = fresh(self._known_as, self.function)
        require_controller_function(self._known_as, function)
        return function  # type: ignore[no-any-return]

    @property
    def outlives(self) -> bool:
        """Whether it is known to write what outlives a run, as no copy of it does."""
        return bool(self.memory and _written(self.function))

    @property
    def memory(self) -> str:
        """Why it counts as one with a memory, and what helps; empty if that is plain."""
        plain = not self.stateful or makes_controllers(self.function)
        return "" if plain else why_it_remembers(self.function)

    def command(self, time: float, state: ArrayLike, assumed: Floats) -> Any:
        """Return the force [N] at a state and assumed parameters, NaN where it has none.

        Of a plant with several inputs, shape (k,).
        """
        cart_pole = has_its_names(self.plant)
        given = dict(zip(self.plant.parameters, map(float, assumed), strict=True))
        belief = _belief(self.function, given, cart_pole)
        falling = cart_pole and not abs(float(np.asarray(state)[1])) < 0.5 * np.pi
        limit, kind = self.call_limit, ""
        # its first call may go to its own folder, where it would leave relative paths of others
        place = contextlib.nullcontext() if self.called else contextlib.chdir(os.curdir)
        if not self.called and self.first_call_limit > limit and self._known_as not in _hung:
            limit, kind = self.first_call_limit, " its first call"
        object.__setattr__(self, "called", True)
        try:
            with limited(limit), place:
                value = self.function(float(time), np.array(state, dtype=np.float64), belief)
        except ControllerDomainError:
            return math.nan
        except Overrun:
            if kind:
                _hung.add(self._known_as)
            rule = f"must answer{kind} within {limit:g} s (--call-limit), but did not"
            rule += f" at t = {time:g} s"
            raise ControllerError(f"controller {self.name!r}", rule) from None
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            if falling:  # an integrator's stage or sensor noise may lead there
                return math.nan
            said = told(error)
            rule = f"raised {type(error).__name__} at t = {time:g} s{said and f': {said}'}"
            if isinstance(error, AttributeError) and error.obj is belief:
                rule += f"; belief has {', '.join(given)}"
            raise ControllerError(f"controller {self.name!r}", rule) from error
        k = len(self.plant.inputs)
        try:
            found = _as_floats(value, k)
        except Exception:  # of any library
            words = "one number" if k == 1 else f"{k} numbers ({', '.join(self.plant.inputs)})"
            rule = f"must return {words} at t = {time:g} s"
            raise ControllerError(f"controller {self.name!r}", rule, _seen(value)) from None
        return float(found[0]) if k == 1 else found

    @property
    def _known_as(self) -> str:
        """What it is called in messages about it, the same in every run."""
        return self.spec or self.name

    def inputs_for(self, values: Floats) -> Floats:
        """Return the inputs: what it is told of the parameters, in rows."""
        return values

    def forces(self, states: Floats, inputs: Floats, times: Floats | None = None) -> Floats:
        """Return the force [N] at each of many states; see `Controller.forces`."""
        clock_times = np.zeros(len(states)) if times is None else times
        rows = zip(clock_times.tolist(), states, inputs, strict=True)
        return np.array([self.command(*row) for row in rows], dtype=np.float64)

    def __reduce__(self) -> Any:
        given = {one.name: getattr(self, one.name) for one in fields(self) if one.init}
        return _restored, (given if self.spec is None else {**given, "function": None},)

    def describe(self) -> dict[str, Any]:
        """Return the controller as plain data, for provenance: its name and a hash of its file."""
        named = _defined(self.function)
        return {
            "name": self.name,
            "function": f"{named.__module__}.{named.__qualname__}".removeprefix(ASIDE),
            "source": self.source,
            "belief": "true",
        }


_NO_NUMBERS = (str, bytes, bytearray, bool, np.bool_, complex, np.complexfloating)
"""Types that are not taken as a number, though some convert to one."""


def _as_floats(value: Any, count: int) -> Floats:
    """Return numbers from a number, a sequence, an array or a tensor of any library, or raise."""
    if inspect.iscoroutine(value):
        value.close()  # nobody awaits it
    if callable(detach := getattr(value, "detach", None)):
        value = detach()  # a tensor that is part of a graph of gradients
    try:
        array = np.asarray(value)
    except Exception:  # as of a type that NumPy lacks, bfloat16
        array = np.array([float(value)])
    if array.dtype.kind in "OV" and not any(isinstance(x, _NO_NUMBERS) for x in array.flat):
        array = np.array([float(x) for x in array.flat])
    if array.size != count or array.dtype.kind not in "fiu" or np.ma.is_masked(value):
        raise ValueError
    return array.astype(np.float64).reshape(count)


def _seen(value: Any) -> str:
    """Return a text of what is no number: of an array or a tensor its shape and type."""
    try:
        shape = tuple(int(x) for x in value.shape)
    except Exception:
        shape = ()
    kind = f" of {value.dtype}" if hasattr(value, "dtype") else ""
    return f"an array of shape {shape}{kind}" if shape else told(value, repr)


def _restored(given: dict[str, Any]) -> PythonController:
    if given["spec"] is not None:
        function, source = load_attribute(given["spec"])
        if given["source"] not in (None, source):
            rule = "must not change while it runs, but its file or the working directory did"
            raise InvalidValueError(f"controller {given['spec']}", rule)
        given = {**given, "function": function}
    return PythonController(**given)


def _defined(function: Any) -> Any:
    """Return what has a name and a file: a function or a class, or the class of an instance."""
    return function if hasattr(function, "__qualname__") else type(function)


def require_controller_function(name: str, function: object) -> None:
    """Raise unless a controller's function can be called with time, state and belief."""
    if not callable(function):
        raise InvalidValueError(f"controller {name!r}", "must be callable", told(function, repr))
    try:
        signature = inspect.signature(function)
    except ValueError:  # a function in C without a signature
        return
    try:
        signature.bind(*ARGUMENTS)
    except TypeError as error:
        rule = f"must take (time, state, belief): {error}"
        raise InvalidValueError(f"controller {name!r}", rule) from None


def _source_hash(function: object) -> str | None:
    with contextlib.suppress(TypeError, OSError):
        file = inspect.getsourcefile(function)  # type: ignore[arg-type]
        if file is not None:
            return _hash(Path(file).read_bytes())
    return None


def _hash(text: bytes) -> str:
    return hashlib.blake2b(text, digest_size=16).hexdigest()


def load_python_controller(spec: str) -> PythonController:
    """Return the controller that a module or a file defines, named ``module.attribute``."""
    place, _, attribute = spec.partition(":")
    spec = f"{_module_of(place) or place}:{attribute}"
    name = spec.replace(":", ".")
    function, source = load_attribute(spec)
    return PythonController(name=name, function=function, spec=spec, source=source)


def load_attribute(spec: str) -> tuple[Any, str | None]:
    """Return what a module defines, and the hash of the files that were run for it."""
    thing = f"controller {spec!r}"
    module_name, _, function_name = spec.partition(":")
    parts = (*module_name.split("."), *function_name.split("."))
    if not all(part.isidentifier() for part in parts):
        rule = "must be module:attribute, or FILE.py:NAME below this folder"
        raise InvalidValueError(thing, rule)
    found: Any
    found, text = import_from(Path.cwd(), module_name, thing, own=True)
    for part in function_name.split("."):
        if not hasattr(found, part):
            file = getattr(found, "__file__", None) or module_name
            raise InvalidValueError(thing, f"must be defined in {file}, which has no {part!r}")
        found = getattr(found, part)
    return found, _hash(text) if text else _source_hash(_defined(found))


def _module_of(path: str) -> str:
    """Return the module of a file below the working directory, or nothing if there can be none."""
    module = os.path.normpath(path.removesuffix(".py")).replace(os.sep, ".")
    return module if all(part.isidentifier() for part in module.split(".")) else ""
