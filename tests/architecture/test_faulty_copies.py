"""What makes faulty copies quick leaves no fault out, and what is listed is in the code."""

import pytest

from tests.faulty_copies import REPOSITORY, outline
from tests.mutants import equivalents
from tests.planted_faults import load_faults

SOURCE = """
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
def factory():
    @kernel
    def inner(x):
        return x + 5.0
    return inner
def plain(x):
    return x + 6.0
"""
RAN = {SOURCE.splitlines().index("def made():") + 1}


@pytest.mark.parametrize("number", ["1.0", "2.0", "5.0", "x)", "3.0", "6.0"])
def test_what_may_be_compiled_or_runs_at_import_alone_is_in_an_outline(number: str) -> None:
    changed, lines = SOURCE.replace(number, f"{number} "), outline(SOURCE, RAN).splitlines()
    assert (outline(changed, RAN) == outline(SOURCE, RAN)) == (number in ("3.0", "6.0"))
    assert lines.index("def plain(x):") == SOURCE.splitlines().index("def plain(x):")


def test_every_fault_can_be_planted_and_an_equivalent_mutant_is_of_a_line_of_its_file() -> None:
    assert len(load_faults()) > 80
    for (file, was, now), reason in equivalents().items():
        lines = (REPOSITORY / file).read_text(encoding="utf-8").splitlines()
        assert was in map(str.strip, lines), f"{file} has no line {was}"
        assert now != was and reason
