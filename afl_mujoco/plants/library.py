"""MuJoCo, and its C functions for compiled code."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

from llvmlite import binding
from numba import types

from afl_mujoco.compiled import inlined_kernel, store
from afl_mujoco.errors import FileError
from afl_mujoco.graphics import choose_backend

choose_backend()
import mujoco as mujoco  # noqa: E402  (it reads MUJOCO_GL when imported)


def _load_library() -> None:
    folder = Path(mujoco.__file__).parent
    for pattern in ("libmujoco*", "mujoco.dll"):
        for library in sorted(folder.glob(pattern)):
            binding.load_library_permanently(str(library))
            # MuJoCo would print warnings and write MUJOCO_LOG.TXT where a run diverges, which its
            # outcome says; strlen reads a text and does nothing
            handler = ctypes.c_void_p.in_dll(ctypes.CDLL(str(library)), "mju_user_warning")
            handler.value = ctypes.cast(ctypes.CDLL(None).strlen, ctypes.c_void_p).value
            return
    raise FileError(str(folder), "does not contain the MuJoCo library")


_load_library()
_model_data = types.void(types.intp, types.intp)
mj_forward = types.ExternalFunction("mj_forward", _model_data)
mj_reset_data = types.ExternalFunction("mj_resetData", _model_data)
mj_step = types.ExternalFunction("mj_step", _model_data)
mj_kinematics = types.ExternalFunction("mj_kinematics", _model_data)
mj_com_pos = types.ExternalFunction("mj_comPos", _model_data)
mj_com_vel = types.ExternalFunction("mj_comVel", _model_data)
mj_set_const = types.ExternalFunction("mj_setConst", _model_data)
_product = types.void(types.intp, types.intp, types.intp, types.intp)
mj_mul_m: Any = types.ExternalFunction("mj_mulM", _product)
_solution = types.void(types.intp, types.intp, types.intp, types.intp, types.int32)
_wrench = types.void(*[types.intp] * 5, types.int32, types.intp)
mj_apply_ft: Any = types.ExternalFunction("mj_applyFT", _wrench)
mj_solve_m: Any = types.ExternalFunction("mj_solveM", _solution)


@inlined_kernel
def write_row(structures, addresses, row):
    """Write a checked row into a model, and refresh what depends on it by scratch data."""
    for i in range(len(addresses)):
        store(addresses[i], row[i])
    mj_set_const(structures[0], structures[1])
