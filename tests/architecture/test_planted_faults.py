"""The list of planted faults fits the code: each text that a fault replaces stands there once."""

from tests.planted_faults import load_faults


def test_every_fault_can_be_planted() -> None:
    assert len(load_faults()) > 80
