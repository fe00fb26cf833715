import io
import json
import struct

import numpy as np
import pytest

from afl_mujoco.errors import FileError, InvalidValueError, UnknownNameError, reading
from tests.messages import line


def refuse() -> None:
    raise InvalidValueError("schema", "must be 1", 2)


def test_an_unknown_name_is_told_what_was_probably_meant() -> None:
    known = ["adaptive", "adaptive-retuned", "lqr"]
    said = str(UnknownNameError.among("controller", "adaptve", known))
    assert said.startswith("controller must be one of adaptive, adaptive-retuned, lqr, got ")
    assert said.endswith("'adaptve'; did you mean adaptive or adaptive-retuned?")
    assert "mean" not in str(UnknownNameError.among("controller", "zzz", known))


def unknown() -> None:
    raise UnknownNameError.among("law", "x", ["a", "b"])


def archive(flags: int = 0, method: int = 0) -> io.BytesIO:
    """An npz file of an array x, its bits for encryption and compression changed."""
    stream = io.BytesIO()
    np.savez(stream, x=np.zeros(2))
    content = bytearray(stream.getvalue())
    for place in (6, content.index(b"PK\x01\x02") + 8):
        content[place : place + 4] = struct.pack("<HH", flags, method)
    return io.BytesIO(content)


def array(header: str) -> io.BytesIO:
    return io.BytesIO(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode())


HUGE = "{'descr': '<f8', 'fortran_order': False, 'shape': (10000000000000000,)}"


@pytest.mark.parametrize(("block", "said"), [
    (lambda: json.loads("{"), "Expecting property name"), (lambda: {}["runs"], "'runs' is missing"),
    (lambda: [][0], "list index out of range"),
    (lambda: len(3), "object of type 'int' has no len()"),  # type: ignore[arg-type]
    (lambda: 1 / 0, "division by zero"),
    (lambda: np.load(io.BytesIO(b"PK\x03\x04")), "File is not a zip file"),
    (lambda: np.load(archive(flags=1))["x"], "File 'x.npy' is encrypted"),
    (lambda: np.load(archive(method=99))["x"], "That compression method is not supported"),
    (lambda: np.load(array("{'descr': '<f8', 'shape': (")), "EOF in multi-line statement"),
    (lambda: np.load(array(HUGE)), "Unable to allocate"), (refuse, "schema must be 1, got 2"),
    (unknown, "law must be one of a, b, got 'x'"),
])  # fmt: skip
def test_whatever_a_block_fails_on_names_the_file(block, said: str) -> None:
    whole = line("x.json is no study: ", ..., said, ..., ": make it anew")
    with pytest.raises(FileError, match=whole), reading("x.json", "is no study", "make it anew"):
        block()


def test_a_sound_file_and_a_mistake_of_the_program_pass() -> None:
    with reading("x.json", "is no study"):
        found = json.loads("[1]")
    assert found == [1]
    with pytest.raises(AssertionError), reading("x.json", "is no study"):
        raise AssertionError
