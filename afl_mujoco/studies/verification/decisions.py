"""The decisions taken where the paper is silent, for the report."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

DECISIONS: Mapping[str, str] = MappingProxyType(
    {
        "D1": "The paper's length l is the half-length: pivot to centre of mass of a uniform rod.",
        "D2": "K ~ 110 and Phi ~ 100 (Table 2, text); the header of Table 1 exchanges the two.",
        "D3": "Schedules: step M 0.5, 1, 2 kg and step l 0.2, 0.5, 1 m at 1 and 3 s; trapezoid "
        "M 0.5-2-0.5 kg and l 0.2-1-0.2 m, up over 0-2 s, down over 6-8 s.",
        "D4": "Objective over the scenario's horizon (20 s), each term divided by its value for "
        "the fixed gains on the nominal plant, whose objective is therefore 3.",
        "D5": "max(F) is the maximum of |F|.",
        "D6": "The impulse is a pulse of -10 N over 0.1 s from t = 10 s; an ideal impulse can be "
        "asked for in a scenario file.",
        "D7": "Controller and gain function see the true M(t), l(t); the controllers that end in "
        "-nominal assume M = 1 kg, l = 0.5 m.",
        "D8": "Gains are searched in K 100 to 200, lambda 1 to 5, Phi 90 to 110: the claims C10 to "
        "C12 and the retuned controllers rest on it.",
        "D9": "M' and l' do not enter the dynamics, as in the paper.",
    }
)
"""Decision by id, as in `docs/reference/notation.md`."""
