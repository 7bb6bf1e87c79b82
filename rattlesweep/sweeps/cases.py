"""Cases: what the runs of a sweep differ in beside their bodies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from rattlesweep.errors import ConfigError

TARGETS = ("K_p", "K_r")
VARIES = ("n_i", "omega_xy0", "sigma", "rolling")


@dataclass(frozen=True)
class Case:
    """Target, launch and dissipation that the runs of a case share; None where they differ."""

    index: int
    target_name: str | None
    target: float | None
    n_i: float | None
    omega_xy0: float | None
    sigma: float | None = None
    rolling: float | None = None

    @cached_property
    def key(self) -> tuple[Any, ...]:
        """Everything but the number."""
        return self.target_name, self.target, *(getattr(self, name) for name in VARIES)

    def dump(self) -> dict[str, Any]:
        """Return the case as JSON data: its number, and what it has."""
        data = {"case": self.index, self.target_name: self.target}
        data |= {name: getattr(self, name) for name in VARIES}
        return {str(name): value for name, value in data.items() if value is not None}

    @classmethod
    def load(cls, data: Mapping[str, Any]) -> Case:
        """Return the case that :meth:`dump` has written."""
        name = next((name for name in TARGETS if name in data), None)
        found = (None if data.get(k) is None else float(data[k]) for k in (name or "", *VARIES))
        return cls(int(data["case"]), name, *found)

    def __str__(self) -> str:
        return ", ".join(f"{name} {value:g}" for name, value in list(self.dump().items())[1:])


def grown(held: Sequence[Case], asked: Sequence[Case]) -> tuple[Case, ...]:
    """Return the cases `held` by a directory, and behind them new ones that a config asks for.

    Raises a ConfigError if the config has lost a case.
    """
    there, wanted = {case.key for case in held}, {case.key for case in asked}
    if lost := [case for case in held if case.key not in wanted]:
        told = f"it holds runs with {lost[0]}, which the config does not ask for"
        raise ConfigError(f"{told}; a sweep can only grow")
    new = [case for case in asked if case.key not in there]
    return (*held, *(replace(case, index=len(held) + k) for k, case in enumerate(new)))
