"""A plant's own equations: called by the interpreter, compiled where that succeeds and agrees."""

from __future__ import annotations

import hashlib
import sys
import types
import warnings
from collections import namedtuple
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from numba import carray  # type: ignore[attr-defined]

from afl_mujoco.compiled import Callback, kernel
from afl_mujoco.errors import (
    AflMujocoError,
    InvalidValueError,
    MissingPackageError,
    UnknownNameError,
    told,
)
from afl_mujoco.loading import INSTALLED, told_of
from afl_mujoco.plants.plant import Floats, Plant

Fill = Callable[..., None]  # a function (q, v, u, p, out) that fills `out`

POINTS = 20
"""Random points at which the compiled equations are held against the interpreted, at every load."""

AGREE = 1e-9  # how well they must agree: compilers reorder sums, and no mistake is that small
ROUNDING = 1e-12  # what of the largest number may be left where terms cancel


class Points(NamedTuple):
    """States, inputs and parameters, a row each."""

    q: Floats  # (K, n)
    v: Floats  # (K, n)
    u: Floats  # (K, k)
    p: Floats  # (K, parameters)


@dataclass(frozen=True)
class Equations:
    """The equations of a plant, as a function that fills what they give."""

    plant: Plant
    fill: Fill
    how: str  # "compiled", or why they are interpreted
    compiled: Any = None  # the same for `Callback`, if they are compiled

    @cached_property
    def callback(self) -> Callback:
        """The same as compiled loops call it, (time, state, inputs, parameters, out)."""
        if self.compiled is not None:
            return Callback(self.compiled)
        plant = self.plant
        n, k = len(plant.coordinates), len(plant.inputs)

        def fill(_: float, state: Floats, *rest: Floats) -> None:
            self.fill(state[:n], state[n:], *rest)

        return Callback(fill, (2 * n, k, len(plant.parameters), self.size))

    @property
    def size(self) -> int:
        """How many numbers they give."""
        return _size(self.plant)

    def at(self, points: Points, *, gaps: bool = False) -> Floats:
        """Return what they give, a row a point; with `gaps` NaN where that is no number."""
        found = np.full((len(points.q), self.size), np.nan)
        for *point, out in zip(*points, found, strict=True):
            try:
                self.fill(*point, out)
                if not np.isfinite(out).all():
                    rule = "must be finite; box= of afl.check leaves singularities out"
                    at = f"{out.tolist()} at q = {point[0].tolist()}"
                    raise InvalidValueError(_word(self.plant), rule, at)
            except AflMujocoError:
                if not gaps:
                    raise
                out[:] = np.nan
        return found


def split(plant: Plant, rows: Floats) -> tuple[Floats, Floats, Floats]:
    """Return M (K, n, n), h (K, n) and B (K, n, k) of what equations in terms give."""
    n = len(plant.coordinates)
    mass, bias, inputs = rows[:, : n * n], rows[:, n * n : n * n + n], rows[:, n * n + n :]
    return mass.reshape(-1, n, n), bias, inputs.reshape(len(rows), n, len(plant.inputs))


def _size(plant: Plant) -> int:
    n, k = len(plant.coordinates), len(plant.inputs)
    return n * (n + 1 + k) if plant.terms else n


def _word(plant: Plant) -> str:
    return "terms" if plant.terms else "accelerations"


def load_equations(plant: Plant, points: Points) -> Equations:
    """Return the equations of a plant, compiled where both ways agree at random points.

    Numba keeps compiled code by a key of all that the functions read; that the key saw everything
    is not taken on trust: an answer from the cache is held against the interpreter like any other.
    """
    plain = Equations(plant, _interpreted(plant), "interpreted")
    expected = plain.at(points)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of numba, about what it will not do one day
            compiled, called = _compiled(plant)
            compiled(*(x[0] for x in points), np.empty_like(expected[0]))
    except Exception as error:  # whatever numba says of what it cannot compile
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        why = next((line for line in lines if not line.startswith("Failed in nopython")), "")
        return Equations(plant, plain.fill, f"interpreted: {type(error).__name__}: {why[:120]}")

    def fill(*given: Floats) -> None:
        with told_of(_word(plant)):
            compiled(*given)

    fast = Equations(plant, fill, "compiled", called)
    rounding = ROUNDING * np.abs(expected).max(axis=1, keepdims=True)
    same = np.abs(fast.at(points, gaps=True) - expected) <= AGREE * np.abs(expected) + rounding
    how = "interpreted: compiled, they give other numbers"
    return fast if same.all() else Equations(plant, plain.fill, how)


def _interpreted(plant: Plant) -> Fill:
    n, k = len(plant.coordinates), len(plant.inputs)
    function: Any = plant.terms or plant.accelerations
    word = _word(plant)
    shapes: dict[str, tuple[int, ...]] = {"M": (n, n), "h": (n,), "B": (n, k)}

    def fill(q: Floats, v: Floats, u: Floats, p: Floats, out: Floats) -> None:
        arrays = (q.copy(), v.copy()) if plant.terms else (q.copy(), v.copy(), u.copy())
        named = plant.named(p)
        given = dict(vars(named))
        # what is not finite is refused
        with told_of(word, given=named), np.errstate(all="ignore"):
            found = function(*arrays, named)
        same = all(np.array_equal(a, b) for a, b in zip(arrays, (q, v, u), strict=False))
        if not same or vars(named) != given:
            raise InvalidValueError(word, "must not change its arguments, but does")
        if not plant.terms:
            out[:] = _numbers(word, found, (n,))
            return
        if not (isinstance(found, Sequence) and len(found) == 3):
            raise InvalidValueError(word, "must return (M, h, B)", told(found, repr)[:80])
        pairs = zip(shapes.items(), found, strict=True)
        parts = [_numbers(f"{word}: {name}", part, shape) for (name, shape), part in pairs]
        out[:] = np.concatenate([part.ravel() for part in parts])

    return fill


def _numbers(thing: str, found: Any, shape: tuple[int, ...]) -> Floats:
    try:
        array = np.asarray(found)
        real = array.astype(np.float64) if array.dtype.kind in "biufO" else None
    except (TypeError, ValueError):
        array, real = np.array(None), None
    if real is None:
        kind = "complex numbers" if array.dtype.kind == "c" else told(found, repr)[:80]
        raise InvalidValueError(thing, "must be real numbers", kind)
    if 0 in shape and real.size == 0:
        return np.zeros(shape)
    if real.shape != shape:
        count = f"{shape[0]} number{'s' * (shape[0] != 1)}"
        rule = f"must have shape {shape}" if len(shape) > 1 else f"must be {count}"
        raise InvalidValueError(thing, rule, f"shape {real.shape}" if real.shape else found)
    return real


def _compiled(plant: Plant) -> tuple[Fill, Any]:
    """Return the equations as compiled code under a key of all they read, and for `Callback`."""
    function: Any = plant.terms or plant.accelerations
    lines = list(_source(plant))
    said = [*lines, *plant.parameters, *_read(function, {})]
    key = hashlib.blake2b("\0".join(said).encode(), digest_size=12).hexdigest()
    source = f"def equations_{key}(q, v, u, p, out):\n    " + "\n    ".join(lines)
    # Its file is this one, so that the cache is where that of the package is.
    names = list(plant.parameters)
    space = {"__name__": __name__, "F": _jitted(function, {}), "P": namedtuple("P", names)}
    n, k, size = len(plant.coordinates), len(plant.inputs), _size(plant)
    source += (
        f"\ndef called_{key}(time, x, u, p, out):\n    state = carray(x, ({2 * n},))\n"
        f"    E(state[:{n}], state[{n}:], carray(u, ({k},)), "
        f"carray(p, ({len(plant.parameters)},)), carray(out, ({size},)))\n"
    )
    exec(compile(source, __file__, "exec"), space)
    space["E"], space["carray"] = kernel(space[f"equations_{key}"]), carray
    return cast(Callable[..., None], space["E"]), space[f"called_{key}"]


def _source(plant: Plant) -> Iterator[str]:
    """Yield the lines of a function that calls the equations and stores what they return."""
    n, k = len(plant.coordinates), len(plant.inputs)
    named = f"P({', '.join(f'p[{i}]' for i in range(len(plant.parameters)))})"
    if not plant.terms:
        yield f"a = F(q, v, u, {named})"
        yield from (f"out[{i}] = a[{i}]" for i in range(n))
        return
    yield f"M, h, B = F(q, v, {named})"
    places = [f"M[{i}][{j}]" for i in range(n) for j in range(n)]
    places += [f"h[{i}]" for i in range(n)] + [f"B[{i}][{j}]" for i in range(n) for j in range(k)]
    yield from (f"out[{i}] = {place}" for i, place in enumerate(places))


def _jitted(function: Any, done: dict[int, Any]) -> Any:
    """Return a function for numba, with the plain functions that it calls compiled too."""
    from numba import njit

    if not isinstance(function, types.FunctionType):
        return function
    if id(function) not in done:
        f, space = function, dict(function.__globals__)
        parts = (f.__code__, space, f.__name__, f.__defaults__, f.__closure__)
        done[id(f)] = njit(error_model="numpy")(types.FunctionType(*parts))
        for name in _names_in(f.__code__):
            if isinstance(space.get(name), types.FunctionType):
                space[name] = _jitted(space[name], done)
    return done[id(function)]


def _names_in(code: types.CodeType) -> set[str]:
    """Return the names that code reads, and the code within it."""
    inner = [c for c in code.co_consts if isinstance(c, types.CodeType)]
    return set(code.co_names).union(*map(_names_in, inner))


def _read(thing: Any, seen: dict[int, int]) -> Iterator[str]:
    """Yield texts that differ whenever what a function computes with differs.

    What was read before is said by its place: which function is called where is in the order.
    """
    thing = getattr(thing, "py_func", thing)  # what numba has wrapped
    if not isinstance(thing, types.ModuleType | types.FunctionType):
        yield thing.tobytes().hex() if isinstance(thing, np.ndarray) else told(thing, repr)
        return
    if id(thing) in seen:
        yield f"= {seen[id(thing)]}"
        return
    seen[id(thing)] = len(seen)
    if isinstance(thing, types.FunctionType):
        yield from _read_by(thing, seen)
        return
    file = getattr(thing, "__file__", None) or ""
    if file.endswith(".py") and not file.startswith(INSTALLED):
        yield f"{thing.__name__} {hashlib.sha256(Path(file).read_bytes()).hexdigest()}"
        for name, one in sorted(vars(thing).items(), key=lambda item: item[0]):
            if isinstance(one, types.ModuleType | types.FunctionType):
                yield from (name, *_read(one, seen))


def _read_by(thing: types.FunctionType, seen: dict[int, int]) -> Iterator[str]:
    """Yield the code of a function, its cells, the globals it reads, and the file it is from."""
    yield f"{thing.__module__} {thing.__qualname__} {thing.__defaults__!r} {_text(thing.__code__)}"
    if thing.__code__.co_filename.startswith(INSTALLED[:-1]):
        return
    closed = zip(thing.__code__.co_freevars, thing.__closure__ or (), strict=True)
    cells = {name: cell.cell_contents for name, cell in closed}
    read = sorted(_names_in(thing.__code__) & thing.__globals__.keys())
    for name, value in (cells | {name: thing.__globals__[name] for name in read}).items():
        yield name
        yield from _read(value, seen)
    if home := sys.modules.get(thing.__module__):
        yield from _read(home, seen)


def _text(code: types.CodeType) -> str:
    constants = [_text(x) if isinstance(x, types.CodeType) else repr(x) for x in code.co_consts]
    return f"{code.co_code.hex()} {code.co_names} {constants}"


def from_sympy(
    mass_matrix: Any, forcing: Any, q: Sequence[Any], v: Sequence[Any], u: Sequence[Any], p: Any
) -> Callable[..., Any]:
    """Return ``terms`` of a plant from SymPy expressions, as `sympy.physics.mechanics` gives them.

    Parameters
    ----------
    mass_matrix
        M of ``M v' = forcing``, shape (n, n).
    forcing
        The right-hand side, n expressions, linear in the inputs.
    q, v
        Symbols of the coordinates and of their rates, which may be ``q.diff(t)``.
    u
        Symbols of the inputs.
    p
        Symbols of the parameters, each named as in the plant; or a dictionary from symbols to
        these names.

    Returns
    -------
    callable
        What `Plant` takes as ``terms``.

    Raises
    ------
    AflMujocoError
        If the forcing is not linear in the inputs, or a symbol is left over.

    Examples
    --------
    >>> import sympy as sp, afl_mujoco as afl
    >>> q, v, u, m = sp.symbols("q v u m")
    >>> terms = afl.from_sympy([[m]], [u - sp.sin(q)], [q], [v], [u], [m])
    """
    try:
        import sympy as sp
    except ImportError:
        raise MissingPackageError("from_sympy", "needs a package: pip install sympy") from None

    names = dict(p) if hasattr(p, "items") else {symbol: str(symbol) for symbol in p}
    if strange := [name for name in names.values() if not isinstance(name, str)]:
        rule = "must be symbols, or a dictionary from symbols to names of parameters"
        raise InvalidValueError("p", rule, told(strange[0], repr))
    states, rates, inputs = ([sp.Symbol(f"{word}_{i}_") for i in range(len(some))]
                             for word, some in zip("qvu", (q, v, u), strict=True))  # fmt: skip
    plain: Any = {symbol: sp.Symbol(f"p_{name}_") for symbol, name in names.items()}
    matrix, right = sp.Matrix(mass_matrix), sp.Matrix(forcing)
    # The rates first: q.diff(t) would be 0 once q is a symbol.
    for old, new in ((v, rates), (q, states), (u, inputs), (plain, plain.values())):
        step: Any = dict(zip(old, new, strict=True))
        matrix, right = matrix.subs(step), right.subs(step)
    jacobian = right.jacobian(sp.Matrix(inputs)) if inputs else sp.zeros(len(q), 0)
    if any(jacobian.has(one) for one in inputs):
        raise InvalidValueError("forcing", "must be linear in the inputs")
    everything = [*matrix, *-right.subs(dict.fromkeys(inputs, 0)), *jacobian]
    known = {*states, *rates, *plain.values()}
    for one in everything:
        unknown = one.free_symbols | one.atoms(sp.Derivative, sp.core.function.AppliedUndef)
        if left := sorted(map(str, unknown - known)):
            given = [*map(str, (*q, *v, *u)), *names.values()]
            raise UnknownNameError.among("symbol", left[0], given)
    shared, (reduced,) = sp.cse([sp.Matrix(everything)], list=False)
    n, k = len(q), len(u)
    flat = [_python(one) for one in reduced]
    parts = (_tuple(_tuple(flat[i * n : i * n + n]) for i in range(n)),
             _tuple(flat[n * n : n * n + n]),
             _tuple(_tuple(flat[n * (n + 1) :][i * k : i * k + k]) for i in range(n)))  # fmt: skip
    lines = [f"q_{i}_, v_{i}_ = q[{i}], v[{i}]" for i in range(n)]
    lines += [f"p_{name}_ = p.{name}" for name in names.values()]
    lines += [f"{name} = {_python(expression)}" for name, expression in shared]
    source = "\n    ".join(["def terms(q, v, p):", *lines, f"return {', '.join(parts)}"])
    space: dict[str, Any] = {"__name__": __name__, "math": __import__("math")}
    exec(compile(source, "<from_sympy>", "exec"), space)
    return cast(Callable[..., Any], space["terms"])


def _tuple(items: Iterable[str]) -> str:
    return f"({''.join(f'{x}, ' for x in items)})"


def _python(expression: Any) -> str:
    from sympy import pycode

    try:
        text = str(pycode(expression))
    except (NotImplementedError, ValueError) as error:
        text = f"Not supported: {error}"
    if "Not supported" in text:
        raise InvalidValueError("expressions", "must have a form in Python", told(expression)[:80])
    return text
