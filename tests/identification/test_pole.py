import numpy as np
import pytest

import afl_mujoco as afl
from afl_mujoco.identification import pole
from afl_mujoco.identification.least_squares import fitted_starts
from afl_mujoco.identification.log import cut, log_of
from tests.synthetic_logs import Truth, swing


def test_the_driven_pole_obeys_the_equations_of_the_paper() -> None:
    # a cart that MuJoCo moves, its velocity recorded exactly: z = 0.1 sin(5 t)
    step, steps, half_length = 1e-3, 800, 0.2
    w2 = 0.75 * 9.81 / half_length
    t = 0.5 * step * np.arange(2 * steps + 1)
    drive = (w2 / 9.81) * 0.5 * np.cos(5.0 * t)
    track = pole.pole_motion(np.array([[0.4, 0.3]]), drive[None], step, w2, 0.0, 0.0)[0]
    curvature = np.gradient(track[:, 1], step)[5:-5]
    plant = afl.CartPoleParameters(cart_mass=1.0, pole_mass=0.1, half_length=half_length)
    for i in range(0, len(curvature), 97):
        phi, rate = track[i + 5]
        z_ddot = -2.5 * np.sin(5.0 * step * (i + 5))
        # the force that gives the cart this acceleration, by the plant's own linearity in it
        state = (0.0, phi, 0.0, rate)
        at0, at1 = afl.acceleration(state, 0.0, plant), afl.acceleration(state, 1.0, plant)
        force = (z_ddot - at0[0]) / (at1[0] - at0[0])
        expected = at0[1] + force * (at1[1] - at0[1])
        assert curvature[i] == pytest.approx(float(expected), rel=2e-4, abs=2e-3)


def test_friction_takes_energy_as_it_says() -> None:
    still = np.zeros((1, 8001))
    track = pole.pole_motion(np.array([[np.pi + 0.3, 0.0]]), still, 1e-3, 37.0, 0.2, 0.0)[0]
    energy = 0.5 * track[:, 1] ** 2 + 37.0 * np.cos(track[:, 0])
    lost = 0.2 * np.trapezoid(track[:, 1] ** 2, dx=1e-3)
    assert energy[0] - energy[-1] == pytest.approx(lost, rel=1e-4)
    dry = pole.pole_motion(np.array([[np.pi + 0.3, 0.0]]), still, 1e-3, 37.0, 0.0, 0.5)[0]
    energy = 0.5 * dry[:, 1] ** 2 + 37.0 * np.cos(dry[:, 0])
    path = np.abs(np.diff(dry[:, 0])).sum()
    assert energy[0] - energy[-1] == pytest.approx(0.5 * path, rel=0.03)


def test_a_recorded_motion_of_the_cart_predicts_the_recorded_pole() -> None:
    truth = Truth()
    windows = cut([log_of("a", swing(truth, 3), truth.description)], 0.5, 0.5, least=None)
    values = {**truth.expected, "friction": 0.0, "compliance": 0.0}
    driven = pole.Drive(windows=windows, gravity=9.81)

    def residuals(own):
        read = pole.readings(values, driven.angles(values, own), windows.turns)
        return (read - windows.phi) / truth.count

    first = windows.starts[:, [1, 3]]
    starts = fitted_starts(lambda own: residuals(own) / 1e3, first, pole.START_SCALE)
    assert np.sqrt(np.mean(residuals(starts) ** 2)) < 1.0  # counts: noise of a half, and rounding


def test_readings_are_what_the_sensor_makes_of_angles() -> None:
    values = {"angle_offset": 0.1, "angle_scale": 0.96}
    angles = np.array([[0.5, 6.5]])
    read = pole.readings(values, angles, np.array([[0.0, 1.0]]))
    assert 0.96 * read + 0.1 + 2.0 * np.pi * np.array([0.0, 1.0]) == pytest.approx(angles)
    bent = pole.readings({**values, "sin_1": 0.01, "cos_1": 0.0}, angles, np.zeros((1, 2)))
    straight = pole.readings(values, angles, np.zeros((1, 2)))
    assert bent - straight == pytest.approx(0.01 * np.sin(angles))
