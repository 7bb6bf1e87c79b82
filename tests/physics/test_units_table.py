"""The table of common units says what pint says."""

from rattlesweep.words import units
from rattlesweep.words.common_units import COMMON


def test_common_units_are_those_of_pint(monkeypatch):
    monkeypatch.setattr(units, "COMMON", {})
    for unit, expected in COMMON.items():
        assert units._base.__wrapped__(unit) == expected, unit
