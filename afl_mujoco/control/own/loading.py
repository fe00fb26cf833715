"""Loading a controller by the name of its module and function."""

from __future__ import annotations

import importlib
import os
import sys
from typing import Any

from afl_mujoco.control.names import ESTIMATED
from afl_mujoco.control.own.python_controller import PythonController
from afl_mujoco.errors import InvalidValueError, told
from afl_mujoco.scenario.parameters import CartPoleParameters


def load_python_controller(spec: str, belief: CartPoleParameters | None = None) -> PythonController:
    """Return the controller that a module defines, under the name ``module.attribute``."""
    name = spec.replace(":", ".")
    return PythonController(name=name, function=load_attribute(spec), belief=belief, spec=spec)


def load_attribute(spec: str) -> Any:
    """Return the function, class, factory or instance that a module defines."""
    thing = f"controller {spec!r}"
    module_name, _, function_name = spec.partition(":")
    parts = (*module_name.split("."), *function_name.split("."))
    if module_name.endswith(".py") or not all(part.isidentifier() for part in parts):
        rule = f"must be module:attribute{_hint(module_name, function_name)}"
        raise InvalidValueError(thing, rule)
    folder = os.getcwd()
    if folder not in sys.path:
        sys.path.append(folder)  # last, so that no user file hides an installed module
    try:
        found: Any = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name not in (module_name, module_name.split(".")[0]):
            raise InvalidValueError(thing, f"needs a module: {error}") from None
        rule = f"must be in a module that is installed or in {folder}: {error}"
        raise InvalidValueError(thing, rule) from None
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        rule = f"cannot be imported: {type(error).__name__}: {told(error)}"
        raise InvalidValueError(thing, rule) from error
    for part in function_name.split("."):
        if not hasattr(found, part):
            file = getattr(found, "__file__", None) or module_name
            hides = _hidden_by(file, module_name, folder)
            raise InvalidValueError(
                thing, f"must be defined in {file}, which has no {part!r}{hides}"
            )
        found = getattr(found, part)
    return found


def _hint(module_name: str, function_name: str) -> str:
    """Say what may have been meant by names of which one is not an identifier."""
    if function_name.endswith(ESTIMATED):
        return f"; only a controller of the catalogue can be followed by {ESTIMATED}"
    if (meant := _module_of(module_name)) in ("", module_name):
        return ""
    return f", with no slash or .py; did you mean {meant}:{function_name}?"


def rule_for_file(name: str) -> str:
    """Say how to name a controller of a file in the working directory, if the file is there."""
    module = _module_of(name)
    if not module or not os.path.isfile(file := f"{module.replace('.', os.sep)}.py"):
        return ""
    return f"must be given as {module}:NAME, where NAME is a function or a class of {file}"


def _module_of(path: str) -> str:
    """Return the module of a file below the working directory, or nothing if there can be none."""
    module = os.path.normpath(path.removesuffix(".py")).replace(os.sep, ".")
    return module if all(part.isidentifier() for part in module.split(".")) else ""


def _hidden_by(file: str, module_name: str, folder: str) -> str:
    """Say that an installed module hides a file of the same name in a folder, if it does."""
    own = os.path.join(folder, f"{module_name}.py")
    if not os.path.exists(own) or (os.path.exists(file) and os.path.samefile(own, file)):
        return ""
    return f" and hides {module_name}.py of this folder: give that file another name"
