"""Loading a controller by the name of its module and function."""

from __future__ import annotations

import importlib
import os
import sys
from typing import Any

from afl_mujoco.control.own.python_controller import PythonController
from afl_mujoco.errors import InvalidValueError, told
from afl_mujoco.scenario.parameters import CartPoleParameters


def load_python_controller(spec: str, belief: CartPoleParameters | None = None) -> PythonController:
    """Return the controller that a module defines, under the name ``module.attribute``.

    Parameters
    ----------
    spec
        ``"module:attribute"``; the module is looked for among the installed ones, then in the
        working directory.
    """
    name = spec.replace(":", ".")
    return PythonController(name=name, function=load_attribute(spec), belief=belief, spec=spec)


def load_attribute(spec: str) -> Any:
    """Return the function, class, factory or instance that a module defines."""
    thing = f"controller {spec!r}"
    module_name, _, function_name = spec.partition(":")
    if (stem := module_name.removesuffix(".py")) != module_name:
        rule = f"must be given without .py; did you mean {stem}:{function_name}?"
        raise InvalidValueError(thing, rule)
    if not all(x.isidentifier() for x in (*module_name.split("."), *function_name.split("."))):
        raise InvalidValueError(thing, "must be module:attribute")
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


def _hidden_by(file: str, module_name: str, folder: str) -> str:
    """Say that an installed module hides a file of the same name in a folder, if it does."""
    own = os.path.join(folder, f"{module_name}.py")
    if not os.path.exists(own) or (os.path.exists(file) and os.path.samefile(own, file)):
        return ""
    return f" and hides {module_name}.py of this folder: give that file another name"
