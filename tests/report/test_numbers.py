import math

import pytest

from afl_mujoco.report.numbers import limit, scientific, short


@pytest.mark.parametrize(("value", "text"), [
    (5.84e-12, "5.8×10⁻¹²"), (-0.0, "0"), (0.0, "0"), (None, "–"), (-1.1e-16, "−1.1×10⁻¹⁶"),
    (9.97e-14, "1.0×10⁻¹³"), (2.6, "2.6×10⁰"), (math.inf, "–"),
], ids=str)  # fmt: skip
def test_scientific_numbers_have_two_digits_and_a_power_of_ten(value, text) -> None:
    assert scientific(value) == text


@pytest.mark.parametrize(("value", "text"), [
    (38.03, "38.03"), (3.0, "3"), (-1.84265, "−1.843"), (100000, "100 000"), (9999.6, "10 000"),
    (0.001, "0.001"), (0.00099, "9.9×10⁻⁴"), (1.2e7, "1.2×10⁷"), (0.0, "0"), (None, "–"),
], ids=str)  # fmt: skip
def test_short_numbers_are_plain_where_that_is_short(value: float | None, text: str) -> None:
    assert short(value) == text


@pytest.mark.parametrize(("value", "text"), [
    (1e-9, "10⁻⁹"), (1e-11, "10⁻¹¹"), (0.0, "0"), (0.05, "0.05"), (0.3, "0.3"), (2e-9, "2.0×10⁻⁹"),
], ids=str)  # fmt: skip
def test_a_limit_that_is_a_power_of_ten_is_written_as_one(value: float, text: str) -> None:
    assert limit(value) == text
