"""Numbers as the page writes them: few digits, powers of ten, a proper minus sign."""

from __future__ import annotations

import math
from collections.abc import Sequence

SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
MISSING = "–"  # sign for a missing number


def scientific(value: float | None, digits: int = 2) -> str:
    """Return a value with a few digits and a power of ten; 0 as it is."""
    if value is None or not math.isfinite(value):
        return MISSING
    if value == 0.0:
        return "0"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    return f"{_signed(mantissa)}×10{str(int(exponent)).translate(SUPERSCRIPTS)}"


def short(value: float | None, digits: int = 4) -> str:
    """Return a value as a person writes it: plain if that is short, else scientific."""
    if value is None or not math.isfinite(value):
        return MISSING
    if value and not 1e-3 <= abs(value) < 1e6:
        return scientific(value, min(digits, 2))
    rounded = float(f"{value:.{digits}g}")
    return _signed(f"{rounded:,.0f}".replace(",", " ") if abs(rounded) >= 1e4 else f"{rounded:g}")


def fixed(value: float | None, decimals: int) -> str:
    """Return a value with a number of decimals, for columns that are read from top to bottom."""
    if value is None or not math.isfinite(value):
        return MISSING
    return _signed(f"{value:.{decimals}f}")


def limit(value: float) -> str:
    """Return a limit: a bare power of ten if it is a small one."""
    if 0.0 < value < 1e-2:
        exponent = round(math.log10(value))
        if math.isclose(value, 10.0**exponent):
            return "10" + str(exponent).translate(SUPERSCRIPTS)
    return short(value)


def percent(share: float | None, digits: int = 2) -> str:
    """Return a share in percent."""
    if share is None or not math.isfinite(share):
        return MISSING
    return f"{short(100.0 * share, digits)} %"


def _signed(text: str) -> str:
    """Return a number's text with a proper minus sign, and none before zero."""
    return text.replace("-", "−" if text.strip("-0.") else "")


def listed(parts: Sequence[str], word: str) -> str:
    """Join parts as in a sentence, the last by ``and`` or ``or``."""
    return f" {word} ".join(filter(None, (", ".join(parts[:-1]), *parts[-1:])))


def sentence(text: str) -> str:
    """Return a text with a capital first letter."""
    return text[:1].upper() + text[1:]
