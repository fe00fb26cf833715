"""Parse the arguments, run the command, turn errors into exit codes."""

from __future__ import annotations

import contextlib
import io
import itertools
import re
import sys
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import fields, make_dataclass
from importlib.metadata import version
from typing import Annotated, Any, Union

import tyro

from afl_mujoco.cli.commands import Log, Regression, Render, Report, Simulate, View
from afl_mujoco.cli.study import study_command
from afl_mujoco.cli.terminal import (
    BAD_INPUT,
    INTERRUPTED,
    SUCCESS,
    Output,
    is_positional,
    numbers_apart,
    plain_help,
)
from afl_mujoco.errors import (
    NO_NUL,
    PROGRAM,
    AflMujocoError,
    FileError,
    InvalidValueError,
    UnknownNameError,
    meant,
    printable,
    warning_in_one_line,
)
from afl_mujoco.pool import interrupts_noted, is_interrupt
from afl_mujoco.studies.shared.contract import find_study, studies

OTHERS: dict[str, type] = {
    kind.__name__.lower(): kind for kind in (Report, Simulate, Log, Render, View, Regression)
}
"""Commands listed after those of the studies."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line, by default that of the process."""
    output, errors = Output(sys.stdout), Output(sys.stderr)
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
        code = _run(arguments)
        output.flush()
        if output.failure and code != INTERRUPTED:
            print(f"{PROGRAM}: stdout cannot be written: {output.failure}", file=sys.stderr)
            code = BAD_INPUT
        errors.flush()
    return code


def _run(arguments: Sequence[str] | None) -> int:
    with interrupts_noted():
        try:
            with contextlib.ExitStack() as stack:
                stack.callback(setattr, warnings, "formatwarning", warnings.formatwarning)
                warnings.formatwarning = warning_in_one_line
                command = _parse(arguments)
                if (limit := getattr(command, "call_limit", None)) is not None:
                    from afl_mujoco.control.own import calls_limited_to

                    stack.enter_context(calls_limited_to(limit))
                return int(command.run())
        except SystemExit as end:  # of the parser
            return int(end.code or SUCCESS)
        except BaseException as error:
            if is_interrupt(error):
                print(f"{PROGRAM}: interrupted", file=sys.stderr)
                return INTERRUPTED
            if not isinstance(error, AflMujocoError | OSError):
                raise
            if isinstance(error, OSError):  # as of a working folder that is gone
                gone = isinstance(error, FileNotFoundError)
                thing = "working directory" if gone else "the operating system's resource"
                error = FileError.cannot_be("used", error.filename or thing, error)
            print(f"{PROGRAM}: {error}", file=sys.stderr)
            return BAD_INPUT


def _parse(arguments: Sequence[str] | None) -> Any:
    """Parse the arguments; bad ones end the program with one line."""
    given = numbers_apart(sys.argv[1:] if arguments is None else arguments)
    for option, word in zip(["", *given], given, strict=False):
        if "\0" in word:
            raise InvalidValueError("argument", NO_NUL, word)
        if not word or (word.startswith("--") and word.endswith("=")):
            thing = next((x.rstrip("=") for x in (word, option) if x.startswith("--")), "argument")
            raise InvalidValueError(thing, "must not be empty", "''")
    if given == ["--version"]:
        print(PROGRAM, version("afl_mujoco"))
        raise SystemExit(SUCCESS)
    commands: Any = Union[(*commands_for("".join(given[:1])),)]
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            command = tyro.cli(
                commands,
                prog=PROGRAM,
                description="Judge controllers by requirements, and MuJoCo models by equations.\n\n"
                "Example: afl-mujoco compare step-step --controllers lqr adaptive\n\n"
                "--version prints the version.",
                args=given,
                config=(
                    tyro.conf.DisallowNone,
                    tyro.conf.FlagCreatePairsOff,
                    tyro.conf.OmitSubcommandPrefixes,
                ),
            )
    except SystemExit as end:
        if end.code == BAD_INPUT:
            said = _in_one_line(complaint.getvalue(), given)
            print(f"{PROGRAM}: {printable(said)}", file=sys.stderr)
        raise
    for field in fields(command):
        option = f"--{field.name.replace('_', '-')}"
        if getattr(command, field.name) in ((), {}) and option in given:
            raise InvalidValueError(option, "must have a value", "none")
    return command


def commands_for(chosen: str) -> Iterator[Any]:
    """Yield every command in the form that tyro takes, only the chosen one with its options.

    The others have nothing but their name and what the list of commands says of them.
    """
    summaries = {name: study.summary for name, study in studies().items()}
    summaries |= {name: str(kind.__doc__).splitlines()[0] for name, kind in OTHERS.items()}
    for name, summary in summaries.items():
        if name == chosen:
            command = plain_help(_kind_of(name))
        else:
            command = make_dataclass(name, (), namespace={"__doc__": summary})
        yield Annotated[command, tyro.conf.subcommand(name)]


def _kind_of(name: str) -> Any:
    return OTHERS[name] if name in OTHERS else study_command(find_study(name))


def _in_one_line(complaint: str, given: Sequence[str]) -> str:
    """Return the complaint of the parser in one line, with a suggestion."""
    names = [*studies(), *OTHERS]
    if given and not given[0].startswith("-") and given[0] not in names:
        return str(UnknownNameError.among("command", given[0], names))
    lines = (line.strip("│╭╮╰╯─ ") for line in complaint.splitlines()[1:])
    said = " ".join(line for line in lines if line.strip("-"))
    if found := re.match(r"Missing value for argument '(--\S+)'\. Expected (\d+) values\.", said):
        if found[2] == "1":
            return str(InvalidValueError(found[1], "must have a value", "none"))
        return _no_number(found[1], int(found[2]) * "FLOAT ", given)
    if found := re.match(
        r"Error parsing (--\S+): .* Argument helptext: \1 (\{.*?\}|\[.*?\.\.\.\]\]|[A-Z ]+) ", said
    ):
        return _no_number(found[1], found[2], given)
    if found := re.match(r"Expected one of \{(.*)\}\.", said):
        return str(InvalidValueError("command", f"must be one of {found[1]}", "none"))
    found = re.match(r"Unrecognized (?:or misplaced )?options: ([^\s,=]+)", said)
    if found is None:
        return said
    if not found[1].startswith("-"):
        for option in (word.partition("=")[0] for word in given if word.endswith(f"={found[1]}")):
            return str(InvalidValueError(option, "must have no value", found[1]))
        return f"argument {found[1]!r} is one too many"
    if given[0] not in names:
        return f"{found[1]} is not an option of {PROGRAM}"
    kind = _kind_of(given[0])
    options = [
        f"--{'no-' * (field.default is True)}{field.name.replace('_', '-')}"
        for field in fields(kind)
        if not is_positional(kind, field.name)
    ]
    return f"{found[1]} is not an option of {given[0]}{meant(found[1], options)}"


def _no_number(option: str, kinds: str, given: Sequence[str]) -> str:
    """Return what is wrong with the value of an option that takes numbers, kinds like ``INT``."""
    count = kinds.count("FLOAT")
    rule = "a whole number" if "INT" in kinds else "a number" if count == 1 else f"{count} numbers"
    words = list(given[next(i for i, word in enumerate(given) if word.startswith(option)) :])
    if "=" in words[0]:
        words[:1] = words[0].split("=", 1)
    got = list(itertools.takewhile(lambda word: not word.startswith("--"), words[1:]))
    if "NAME" in kinds:
        rule = "NAME LOW HIGH, again for each name"
    elif "..." in kinds:
        rule = "numbers"
    else:
        got = got[: max(count, 1)]
    return str(InvalidValueError(option, f"must be {rule}", " ".join(got) or "none"))
