import sys
from pathlib import Path

import pytest

from research import tune
from research.command import run_command
from research.gain_tuning import GainTable
from tests.program import interrupt

ROOT = Path(__file__).parents[2]
SMALL = "--cart-masses 0.5 1.0 --half-lengths 0.5 --population 60 --workers 1".split()


def refused(capsys: pytest.CaptureFixture[str], message: str, *arguments: str) -> None:
    with pytest.raises(SystemExit) as end:
        run_command(lambda: tune.main(arguments))
    said = capsys.readouterr()
    assert (end.value.code, said.out) == (2, "") and message in said.err
    assert len(said.err.splitlines()) == 1


@pytest.mark.slow
def test_an_interrupted_table_goes_on_to_the_same_bytes(tmp_path: Path, capsys) -> None:
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    table = (*SMALL, "--generations", "1500")
    tune.main((*table, "--out", str(whole)))
    interrupt(
        *table, "--out", str(broken), cwd=ROOT, command=(sys.executable, "-m", "research.tune"),
        name="research", once=lambda: list((broken / "searches" / "checkpoints").glob("*")),
    )  # fmt: skip
    assert not (broken / "gain_table.json").exists()

    capsys.readouterr()
    refused(capsys, "has a search: pass --resume to continue it", *table, "--out", str(broken))
    other = (*SMALL, "--generations", "1501", "--resume", "--out", str(whole))
    refused(capsys, "settings.generations is 1500 there and 1501 here", *other)
    tune.main((*table, "--resume", "--out", str(broken)))
    one, other_one = (folder / "gain_table.json" for folder in (whole, broken))
    assert one.read_bytes() == other_one.read_bytes() and len(GainTable.load(one).rows) == 2


@pytest.mark.parametrize(("arguments", "message"), [
    (("--lower", "100", "5", "90", "--upper", "200", "1", "110"), "not be below lower 5.0"),
    (("--cart-masses",), "cart mass of the grid must have at least one value"),
    (("--upper", "1e12", "5", "110"), "would take as many steps"),
    (("--population", "x"), "make tune cannot take that: argument --population: invalid int"),
])  # fmt: skip
def test_bad_input_is_one_line(capsys, arguments: tuple[str, ...], message: str) -> None:
    refused(capsys, message, *arguments)
