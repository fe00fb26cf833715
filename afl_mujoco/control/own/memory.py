"""Whether a user's controller remembers, and what a run gets so that nothing is carried over."""

from __future__ import annotations

import copy
import dis
import inspect
import types
from collections.abc import Callable, Collection
from functools import partial
from typing import Any

import numpy as np

from afl_mujoco.errors import InvalidValueError, told

ARGUMENTS = (0.0, np.zeros(4), None)
"""As many arguments as a controller's function takes."""

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


def why_it_remembers(function: Any) -> str:
    """Return why something that makes no controllers may remember, and what helps; or nothing."""
    if _declared(function):
        return ""
    if isinstance(function, partial):
        return why_it_remembers(function.func)
    if not _is_function(function):
        return _COUNTS
    if written := _written(function):
        return f"it writes {written!r}, which outlives the call: make it a class"
    return ""


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
    """Return whether a function takes these arguments; False if it has no signature."""
    try:
        inspect.signature(function).bind(*arguments)
    except (TypeError, ValueError):
        return False
    return True
