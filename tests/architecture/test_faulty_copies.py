"""What makes faulty copies quick leaves no fault out, and what is excused is in the code."""

import pytest

from tests.faulty_copies import REPOSITORY, outline
from tests.mutants import equivalents

SOURCE = '''
from afl_mujoco.compiled import kernel

FACTOR = made()

def made():
    return 2.0

@kernel
def compiled(x):
    return x + 1.0

class Plain:
    @property
    def value(self):
        return 3.0

    def method(self):
        """Return a number."""
        return 4.0

def factory():
    @kernel
    def inner(x):
        return x + 5.0
    return inner

def plain(x):
    return x + 6.0
'''
RAN = {SOURCE.splitlines().index("def made():") + 1}


@pytest.mark.parametrize("number", ["1.0", "2.0", "5.0", "x)"])
def test_what_may_be_compiled_or_runs_at_import_is_in_an_outline(number: str) -> None:
    assert outline(SOURCE.replace(number, number + " "), RAN) != outline(SOURCE, RAN)


@pytest.mark.parametrize("number", ["3.0", "4.0", "6.0"])
def test_what_is_neither_is_not_and_leaves_its_lines(number: str) -> None:
    assert outline(SOURCE.replace(number, "7.0"), RAN) == outline(SOURCE, RAN)
    lines = outline(SOURCE, RAN).splitlines()
    assert lines.index("def plain(x):") == SOURCE.splitlines().index("def plain(x):")


def test_every_equivalent_mutant_is_of_a_line_of_its_file_and_has_a_reason() -> None:
    for (file, was, now), reason in equivalents().items():
        lines = (REPOSITORY / file).read_text(encoding="utf-8").splitlines()
        assert was in map(str.strip, lines), f"{file} has no line {was}"
        assert now != was and reason
