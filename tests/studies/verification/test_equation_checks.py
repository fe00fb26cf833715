"""The checks of the equations look where they say, and measure an error as large as it is."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest

from afl_mujoco.studies.verification.checks import equation_checks

RIGHT = 0.97  # of a range that thousands of draws fill


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[list[float]]:
    """What MuJoCo is asked: z, phi, z', phi' and the force."""
    found: list[list[float]] = []
    forward = equation_checks.forward

    def noted(at: object, *numbers: float) -> object:
        found.append(list(numbers[:5]))
        return forward(at, *numbers)

    monkeypatch.setattr(equation_checks, "forward", noted)
    return found


def test_accelerations_are_compared_all_over_the_state_space(asked: list[list[float]]) -> None:
    equation_checks.acceleration_error(np.random.default_rng(0), 2000)
    ends = np.array([10.0, np.pi, 10.0, 10.0, 200.0])
    assert np.all(np.max(asked, axis=0) > RIGHT * ends)
    assert np.all(np.min(asked, axis=0) < -RIGHT * ends)
    assert np.all(np.abs(asked) <= ends)


def test_symmetries_are_asked_all_over_the_controllers_domain(asked: list[list[float]]) -> None:
    equation_checks.asymmetry(np.random.default_rng(0), 1000)
    here = asked[::4]  # then mirrored, shifted and scaled
    ends = np.array([10.0, 1.5, 10.0, 10.0, 200.0])
    assert np.all(np.max(here, axis=0) > RIGHT * ends)
    assert np.all(np.min(here, axis=0) < -RIGHT * ends)
    assert np.all(np.abs(here) <= ends)


def test_plants_are_drawn_from_the_whole_box() -> None:
    rng = np.random.default_rng(0)
    drawn = [asdict(equation_checks.random_plant(rng)) for _ in range(1000)]
    box = {
        "cart_mass": (0.1, 2.0),
        "pole_mass": (0.01, 0.5),
        "half_length": (0.05, 1.0),
        "gravity": (1.0, 20.0),
    }
    for name, (low, high) in box.items():
        values = [plant[name] for plant in drawn]
        assert low <= min(values) < low + 0.03 * (high - low)
        assert high - 0.03 * (high - low) < max(values) <= high


def test_an_error_is_relative_where_an_acceleration_is_large_and_else_absolute(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for true, measured, error in ((0.0, 1e-6, 1e-6), (99.0, 100.0, 1e-2), (0.0, np.nan, np.inf)):
        for name in ("cart_acceleration", "pole_acceleration"):
            monkeypatch.setattr(equation_checks, name, lambda *_, true=true: true)
        monkeypatch.setattr(equation_checks, "forward", lambda *_, m=measured: (m, m))
        found = equation_checks.acceleration_error(np.random.default_rng(0), 3)
        assert found == pytest.approx(error)


def test_a_model_that_is_not_written_is_stale(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        equation_checks.CartPoleModel, "set_parameters", lambda self, p: None, raising=True
    )
    assert equation_checks.stale_numbers(np.random.default_rng(0), 2) > 0
