from pathlib import Path

import pytest

import afl_mujoco.studies as packages

TOY = Path(__file__).parent / "toy"


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch) -> str:
    """Put the folder of the toy study beside those of the studies; return the study's name."""
    monkeypatch.setattr(packages, "__path__", [*packages.__path__, str(TOY)])
    return "dice"
