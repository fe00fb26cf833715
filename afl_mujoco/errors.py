"""Errors of the package: each names the thing, the rule it breaks and the value that breaks it."""

from __future__ import annotations

import difflib
import re
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from numbers import Integral
from pathlib import Path, PurePath
from typing import Any


class AflMujocoWarning(UserWarning):
    """Something that works less well than it could, explained in one line."""


PROGRAM = "afl-mujoco"

NO_NUL = "must not contain a NUL character"  # of paths, and of arguments of commands


def warning_in_one_line(
    message: Warning | str, category: type[Warning], filename: str, lineno: int, line: object = None
) -> str:
    """Return a warning as the command line prints it; it replaces `warnings.formatwarning`."""
    own = issubclass(category, AflMujocoWarning)
    place = "" if own else f" ({PurePath(filename).name}, line {lineno})"
    return f"{PROGRAM}: warning: {printable(' '.join(str(message).split()))}{place}\n"


def printable(text: str) -> str:
    """Return a text as it may be shown: what would steer a terminal is as Python writes it.

    File names and the names in files are anyone's.
    """
    if text.isprintable():
        return text
    kept = "\n\N{NO-BREAK SPACE}\N{NARROW NO-BREAK SPACE}"
    return "".join(x if x.isprintable() or x in kept else repr(x)[1:-1] for x in text)


class AflMujocoError(Exception):
    """A request that cannot be met, explained in one line.

    Parameters
    ----------
    thing
        What is wrong, as the user would name it (``"pole_mass"``).
    rule
        The rule that it breaks (``"must be positive"``).
    value
        The offending value; left out of the message when it is ``None``.
    """

    def __init__(self, thing: str, rule: str, value: object = None) -> None:
        self.thing = thing
        self.rule = rule
        self.value = value
        got = "" if value is None else f", got {value}"
        said = " ".join(f"{thing} {rule}{got}".split())
        super().__init__(printable(said))

    def within(self, place: str) -> AflMujocoError:
        """Return the same error with a place, as ``"schedule."``, put before the thing it names."""
        return type(self)(f"{place}{self.thing}", self.rule, self.value)

    def __reduce__(self) -> tuple[type[AflMujocoError], tuple[str, str, object]]:
        return type(self), (self.thing, self.rule, self.value)


def told(value: object, how: Callable[[Any], str] = str) -> str:
    """Return the text of an object of the user's, or the name of its type if it has no text."""
    if type(value).__repr__ is object.__repr__ and type(value).__str__ is object.__str__:
        return f"an object of class {type(value).__name__}"  # and no address
    try:
        return re.sub(" at 0x[0-9a-fA-F]+", "", how(value))
    except Exception:
        return f"<{type(value).__name__} without a text>"


class InvalidValueError(AflMujocoError, ValueError):
    """A number or a setting outside its allowed values."""


def meant(name: object, known: Sequence[str]) -> str:
    """Return a guess which name was meant, as the end of a message; empty if none is near."""
    folded = {one.lower(): one for one in known}
    near = [folded[one] for one in difflib.get_close_matches(str(name).lower(), folded, n=2)]
    return f"; did you mean {' or '.join(near)}?" if near else ""


def require_count(thing: str, value: object, least: int, most: int) -> int:
    """Return a whole number, or raise unless it lies in `least` to `most`.

    What is counted takes time and memory: `most` is far above what a machine completes in a day.
    """
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise InvalidValueError(thing, "must be a whole number", told(value, repr))
    count = int(value)
    if count < least:
        raise InvalidValueError(thing, f"must be at least {least}", count)
    if count > most:
        raise InvalidValueError(thing, f"must be at most {most}", count)
    return count


class UnknownNameError(AflMujocoError, LookupError):
    """A name that is not in its catalogue."""

    @classmethod
    def among(cls, thing: str, name: object, valid: Iterable[str]) -> UnknownNameError:
        """Build the error for `name`, listing the `valid` names and guessing which was meant."""
        known = list(valid)
        rule = f"must be one of {', '.join(known)}" if known else "must be left out: there is none"
        return cls(thing, rule, f"{name!r}{meant(name, known)}")


class FileError(AflMujocoError):
    """A file or folder that cannot be read, understood or written."""

    @classmethod
    def cannot_be(cls, deed: str, path: object, error: OSError) -> FileError:
        """Build the error of a file that the operating system refuses, with its reason."""
        return cls(str(path), f"cannot be {deed}: {(error.strerror or str(error)).lower()}")

    @classmethod
    def none_at(cls, path: Path) -> FileError:
        """Build the error of a path at which there is no file."""
        there = "it is no file" if path.exists() else "no such file"
        return cls(str(path), f"cannot be read: {'it is a folder' if path.is_dir() else there}")


_MALFORMED = (
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    ArithmeticError,
    RuntimeError,
    StopIteration,
    MemoryError,
    EOFError,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)
"""Errors of reading a file whose content is not what was expected."""


@contextmanager
def reading(path: object, wrong: str, then: str = "") -> Iterator[None]:
    """Turn any error of reading a file in the block into a `FileError` of one line."""
    try:
        yield
    except OSError as error:
        raise FileError.cannot_be("read", path, error) from None
    except _MALFORMED as error:
        said = f"{error} is missing" if isinstance(error, KeyError) else str(error)
        raise FileError(str(path), ": ".join(filter(None, (wrong, said, then)))) from None


@contextmanager
def writing(place: object) -> Iterator[None]:
    """Turn the operating system's refusal of a file in the block into a `FileError`."""
    try:
        yield
    except OSError as error:
        raise FileError.cannot_be("written", place, error) from None


class MissingPackageError(AflMujocoError, ImportError):
    """A package that is not installed, and how to install it."""


class ControllerDomainError(AflMujocoError, ValueError):
    """The control law evaluated at a pole angle outside ``|phi| < pi/2``, where it has no value."""


class GraphicsError(AflMujocoError):
    """A drawing that this machine cannot make with the given settings."""
