from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from afl_mujoco.errors import AflMujocoError
from afl_mujoco.files import read_json, write_json
from afl_mujoco.identification import identify as module
from afl_mujoco.identification import rig
from afl_mujoco.identification.description import load_description
from afl_mujoco.identification.identify import identify, identify_pole
from afl_mujoco.identification.least_squares import Estimate
from afl_mujoco.identification.log import cut, log_of, read_logs
from afl_mujoco.identification.prediction import DESCRIPTION, FIT, load_estimates
from afl_mujoco.studies.identify import Result, beside, report
from tests.coulomb_rig import RIGS, description_of
from tests.synthetic_logs import Truth, described, swing

TRUTH = Truth()


@pytest.fixture(scope="module")
def logs():
    return [log_of(f"log-{i}", swing(TRUTH, i, 3.0), TRUTH.description) for i in range(8)]


def assert_found(found, *names):
    for name in names:
        assert found.find(name).value == pytest.approx(TRUTH.expected[name], rel=0.01), name


def test_momentum_tells_the_drive_whatever_its_owner_guesses(logs) -> None:
    windows = cut(logs[:3], 0.5, 0.5)
    for factor in (0.05, 1.0, 17.0):
        own = described("own", TRUTH, TRUTH.count, cart_mass=0.5, force=factor * TRUTH.force)
        first = {one.name: one.start for one in rig.parameters_of(own, windows)}
        assert first["gain"] == pytest.approx(TRUTH.expected["gain"], rel=0.1)
        assert first["decay"] == pytest.approx(TRUTH.expected["decay"], rel=0.2)


@pytest.mark.slow
def test_known_parameters_are_found_within_their_intervals(logs, tmp_path) -> None:
    found = identify(logs, TRUTH.description, workers=2)
    write_json(tmp_path / "estimates.json", found)
    assert read_json(tmp_path / "estimates.json", module.Identified, "are none") == found
    held = {n: found.find(n).low <= x <= found.find(n).high for n, x in TRUTH.expected.items()}
    assert sum(held.values()) >= len(held) - 1, held
    assert_found(found, "gravity_term", "coupling", "gain", "decay", "mass_ratio")
    for name in ("half_length", "cart_mass", "force", "rail_damping"):
        one = found.find(name)
        assert one.value == pytest.approx(getattr(TRUTH, name), rel=0.02)
        assert one.low < one.value < one.high
    assert found.find("lag").on_bound


@pytest.mark.parametrize("noise", [3e-4, 1e-3])
def test_noise_of_the_position_is_no_compliance(noise: float, rng) -> None:
    some = []
    for i in range(6):
        columns = swing(TRUTH, i, 3.0)
        columns["z"] += noise * rng.standard_normal(len(columns["z"]))
        some.append(log_of(f"log-{i}", columns, TRUTH.description))
    found, _ = identify_pole(cut(some, 0.5, 0.5), TRUTH.description)
    assert found.estimates["compliance"].on_bound and found.by_name["compliance"] == 0.0
    for name in ("coupling", "damping", "skew"):
        one = found.estimates[name]
        assert one.low < TRUTH.expected[name] < one.high, name


def test_a_constant_command_says_nothing_of_the_drive_and_a_wrong_unit_is_named(logs) -> None:
    still = [replace(log, command=np.zeros_like(log.command)) for log in logs[:3]]
    found = identify(still, TRUTH.description)
    assert found.drive is None and found.physical == ()
    assert_found(found, "gravity_term")
    wrong = [replace(log, z=1e-3 * log.z) for log in logs[:3]]
    said = "coupling k must be near the expected value for a pole; check the units"
    with pytest.raises(AflMujocoError, match=said):
        identify(wrong, TRUTH.description)


@pytest.mark.parametrize(("units", "phi", "z", "said"), [
    (("rad", "m"), 180.0 / np.pi, 1.0, "unit of phi must be 'deg' according to gravity"),
    (("deg", "m"), np.pi / 180.0, 1.0, "unit of phi must be 'rad' according to gravity"),
    (("rad", "m"), 0.5 / np.pi, 1.0, "unit of phi must be 'turn' according to gravity"),
    (("rad", "m"), 1.0, 100.0, "unit of z must be 'cm', as the cart moves the pole"),
    (("rad", "cm"), 1.0, 10.0, "unit of z must be 'mm', as the cart moves the pole"),
])  # fmt: skip
def test_gravity_and_the_cart_tell_the_units(logs, units, phi, z, said) -> None:
    d = TRUTH.description
    module.require_units(logs[:3], d)
    wrong = replace(d, phi=replace(d.phi, unit=units[0]), z=replace(d.z, unit=units[1]))
    others = [replace(log, phi=phi * log.phi, z=z * log.z) for log in logs[:3]]
    with pytest.raises(AflMujocoError, match=said):
        module.require_units(others, wrong)


def test_lost_rows_take_nothing_from_what_gravity_explains() -> None:
    columns, rng = swing(TRUTH, 1, 3.0), np.random.default_rng(1)
    kept = np.sort(rng.choice(150, 130, replace=False))
    log = log_of("lost", {name: x[kept] for name, x in columns.items()}, TRUTH.description)
    assert module._curvature([log], 1.0).share > 0.95


@pytest.mark.parametrize(("phi", "z", "said"), [
    (0.0, 100.0, "logs must move as a pole on a cart does: .* got a fit that leaves 100% of"),
    (0.6, 1.0, "zero of phi must be the reading of the upright pole, .* 0.5 rad or more off"),
])  # fmt: skip
def test_a_fit_that_does_not_explain_the_angle_is_no_estimate(logs, phi, z, said) -> None:
    some = [replace(log, phi=log.phi + phi, z=z * log.z) for log in logs[:3]]
    with pytest.raises(AflMujocoError, match=said):
        identify_pole(cut(some, 0.5, 0.5), TRUTH.description)


def test_behind_a_lag_windows_begin_when_what_was_before_a_log_is_forgotten(logs) -> None:
    windows = cut(logs, 0.5, 0.5)
    drive = module._Drive(windows, TRUTH.description, None, windows.starts, 1)
    for lag, first in ((0.0, 0.0), (0.02, 0.1)):
        kept = drive._settled(SimpleNamespace(by_name={"lag": lag, "delay": 0.0}))
        np.testing.assert_array_equal(kept, windows.time[:, 0] >= first)
    assert np.count_nonzero(~kept) == len(logs)


def test_a_drive_that_is_not_linear_and_rows_that_are_too_slow_are_remarked_on() -> None:
    shipped = load_estimates()
    assert shipped.drive is not None
    worse = replace(shipped.drive, scatter_phi=2.5 * shipped.pole.scatter_phi)
    one = Result(identified=replace(shipped, drive=worse, period=0.04), shown=None)
    slow, drive = [block for block in report(one).blocks if isinstance(block, str)]
    assert slow.startswith("Rows are 40 ms apart,")
    assert drive.startswith("The whole leaves 2.5 times")
    assert not [x for x in report(replace(one, identified=shipped)).blocks if isinstance(x, str)]
    bent = {"coupling": {"value": 0.98, "low": 0.97, "high": 0.99},
            "delay": {"value": 0.1, "on_bound": True}}  # fmt: skip
    pole, drive = (
        replace(step, estimates=tuple(replace(x, **bent.get(x.name, {})) for x in step.estimates))
        for step in shipped.steps
    )
    pole = replace(pole, scatter_phi=3.0 * shipped.description.phi.count)
    one = Result(identified=replace(shipped, pole=pole, drive=drive), shown=None)
    assert [block[:26] for block in report(one).blocks if isinstance(block, str)] == [
        "The pole alone leaves 3 re",
        "k is 0.98, and 1 for a rig",
        "The delay of the command i",
    ]


def test_the_shipped_pole_is_the_rod_that_its_owners_describe() -> None:
    description = load_description(DESCRIPTION)
    found, _ = identify_pole(cut(read_logs([FIT], description)[::4], 0.5, 0.5), description)
    assert found.by_name["gravity_term"] == pytest.approx(37.25, rel=0.015)
    assert found.by_name["coupling"] == pytest.approx(1.0, abs=0.03)
    assert found.by_name["angle_scale"] == pytest.approx(4096.0 / 4271.34, rel=0.005)
    assert found.estimates["compliance"].high < 0.0  # of its belt
    shipped = load_estimates()
    for name in ("gravity_term", "coupling", "angle_scale"):
        one = found.estimates[name]
        assert abs(one.value - shipped.find(name).value) < 3.0 * (one.high - one.value)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(RIGS)))
def test_dry_friction_does_not_bias_the_masses(number: int) -> None:
    """Against rigs of exact Coulomb friction that share no code with the package."""
    truth = RIGS[number]
    d = description_of(truth)
    logs = [log_of(f"log-{i}", truth.log(100 * number + i), d) for i in range(4)]
    found = identify(logs, d, workers=2)
    for name, value in truth.physical.items():
        one = found.find(name)
        half = 0.5 * (one.high - one.low)
        assert abs(one.value - value) < 1.5 * half, name  # seven intervals of 95 %, three rigs
        assert half < 0.04 * value, name
    assert found.drive is not None and found.drive.scatter_z is not None
    assert found.drive.scatter_z < 2.0 * truth.position_count


@pytest.mark.slow
def test_logs_of_two_carts_and_a_command_that_does_not_drive_are_refused(logs) -> None:
    heavy = replace(TRUTH, cart_mass=1.1)
    some = [log_of(f"a{i}", swing(TRUTH, i, 3.0), TRUTH.description) for i in range(2)]
    some += [log_of(f"b{i}", swing(heavy, 9 + i, 3.0), TRUTH.description) for i in range(2)]
    with pytest.raises(AflMujocoError, match="logs must be of one cart-pole, got acceleration of"):
        identify(some, TRUTH.description, workers=2)
    rng = np.random.default_rng(1)
    other = [replace(log, command=rng.uniform(-1.0, 1.0, len(log.command))) for log in logs[:1]]
    with pytest.raises(AflMujocoError, match="command must drive the cart: check its sign"):
        identify(other, TRUTH.description)


@pytest.mark.slow
def test_missing_rows_do_not_mislead_nor_five_hundred_rows_a_second() -> None:
    d, some = TRUTH.description, []
    for i in range(2):
        kept = np.delete(np.arange(150), slice(60 + 10 * i, 80 + 10 * i))  # 0.4 s
        some.append(log_of(f"gap-{i}", {k: v[kept] for k, v in swing(TRUTH, i, 3.0).items()}, d))
    found = identify(some, d, workers=2)
    assert_found(found, "gravity_term", "coupling", "gain", "decay")
    assert found.find("delay").value == pytest.approx(TRUTH.delay, abs=5e-4)
    d = replace(TRUTH.description, period=0.002)
    logs = [log_of("fast", swing(TRUTH, 0, 3.0, 0.002), d)]
    found = identify(logs, d, workers=2)
    assert_found(found, "gravity_term", "coupling", "gain", "decay")
    for name in ("skew", "delay"):
        assert found.find(name).value == pytest.approx(TRUTH.expected[name], abs=5e-4), name
    shown = beside(found, logs[0])
    assert shown is not None and shown.simulated_time.shape[1] == 51


@pytest.mark.parametrize(("value", "half", "expected"), [
    (0.006, 0.002, True), (0.0046, 0.0025, False), (0.0, 0.0, False),
])  # fmt: skip
def test_a_lag_shows_by_the_interval_of_its_square(value, half, expected) -> None:
    """Of lag^2 it is 2 lag times that of the lag: (36 +- 24) ms^2, and (21 +- 23) ms^2."""
    told = {"value": value, "low": value - half, "high": value + half, "on_bound": not half}
    lag = Estimate(name="lag", title="lag", unit="s", **told)
    assert module._lags(SimpleNamespace(estimates={"lag": lag})) == expected
