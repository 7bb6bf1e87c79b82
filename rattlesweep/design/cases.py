"""Cases of a sweep, and the set of its runs.

A case is one combination of target, launch and dissipation.  A run is one sample of a
case and has the key ``(case, sample)``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import pyarrow as pa

from rattlesweep.config.schema import Config
from rattlesweep.rows.columns import runs_schema
from rattlesweep.words.quantities import ACTING, INITIAL_RATES, QUANTITIES
from rattlesweep.words.units import Quantity, Setting

MAX_RUNS = 10**9  # in a sweep, which holds one byte for each of them


# Columns that a case may share, and their kinds.
VARIES = {
    name: QUANTITIES[name].kind for name in (*INITIAL_RATES, *ACTING, "base_amplitude")
}


@dataclass(frozen=True)
class Design:
    """The runs of a sweep: a number of samples of each case."""

    config: Config  # with all defaults filled in
    # In a directory that has grown, cases are not in the order of the config.
    cases: tuple[Case, ...]
    samples: int  # of each case
    extra: tuple[pa.Field, ...]  # columns of bodies and launches beside the usual ones

    @cached_property
    def schema(self) -> pa.Schema:
        """Arrow schema of the runs; fields have metadata `unit` and `description`."""
        return runs_schema(self.config.parts, self.config.model, self.extra)

    @property
    def shape(self) -> tuple[int, int]:
        """Number of cases, and of samples of each."""
        return len(self.cases), self.samples

    @property
    def runs(self) -> int:
        """Number of runs, if none is left out."""
        return len(self.cases) * self.samples


@dataclass(frozen=True)
class Case:
    """Target, launch and dissipation that the runs of a case share; None where they
    differ.

    `losses` has the constants of what acts, by name.  `in_si` has the values in SI
    units, by name, that differ in the units of the bodies.
    """

    index: int = field(compare=False)
    target_name: str | None
    target: float | None
    n_i: float | None = None
    omega_xy0: float | None = None
    losses: tuple[tuple[str, float], ...] = ()
    in_si: tuple[tuple[str, Quantity], ...] = ()
    mesh: str | None = None  # file of the body, where each case has its own

    @classmethod
    def of(
        cls,
        index: int,
        target_name: str | None,
        target: float | None,
        settings: Mapping[str, Setting],
    ) -> Case:
        """Return the case of the settings of some of the columns `VARIES`."""
        natural: dict[str, float] = {}
        in_si: dict[str, Quantity] = {}
        for name, setting in settings.items():
            if setting.natural is not None:
                natural[name] = setting.natural
            elif setting.si is not None:
                in_si[name] = setting.si
        n_i = natural.pop("n_i", None)
        omega_xy0 = natural.pop("omega_xy0", None)
        losses = tuple(natural.items())
        in_order = tuple(in_si.items())
        return cls(index, target_name, target, n_i, omega_xy0, losses, in_order)

    def setting(self, name: str) -> Setting:
        """Return the value of a column of `VARIES`."""
        return Setting(self.value(name), dict(self.in_si).get(name))

    def value(self, name: str) -> float | None:
        """Return the value of a column of `VARIES` in units of the bodies, or None."""
        if name not in INITIAL_RATES:
            return dict(self.losses).get(name)
        return getattr(self, name)

    def dump(self) -> dict[str, str | float]:
        """Return the case as JSON data, without what is None."""
        data: dict[str, str | float] = {"case": self.index}
        if self.mesh is not None:
            data["mesh"] = self.mesh
        if self.target_name is not None and self.target is not None:
            data[self.target_name] = self.target
        for name in VARIES:
            natural, in_si = self.setting(name)
            if in_si is not None:
                data[name] = in_si.text
            elif natural is not None:
                data[name] = natural
        return data

    @classmethod
    def load(cls, data: Mapping[str, Any]) -> Case:
        """Return the case of such data; raise a ValueError for other data."""
        name = next((name for name in ("K_p", "K_r") if name in data), None)
        kinds = VARIES if name is None else {name: "", **VARIES}
        settings: dict[str, Setting] = {}
        for key, kind in kinds.items():
            value = data.get(key)
            if isinstance(value, str):
                settings[key] = Setting(si=Quantity(value, kind))
            elif value is not None:
                settings[key] = Setting(float(value))
        target = None if name is None else settings.pop(name).natural
        if not isinstance(data["case"], int):
            raise ValueError("the number of a case is no whole number")
        for key, setting in settings.items():
            if not math.isfinite(setting.natural or setting.si or 0.0):
                raise ValueError(f"{key} of a case is not finite")
        mesh = data.get("mesh")
        if not isinstance(mesh, str | None):
            raise ValueError("the mesh of a case is no path")
        return replace(cls.of(data["case"], name, target, settings), mesh=mesh)

    def __str__(self) -> str:
        texts = []
        for name, value in self.dump().items():
            if name == "case":
                continue
            shown = str(value)
            if isinstance(value, float) and float(f"{value:g}") == value:
                shown = f"{value:g}"
            texts.append(f"{name} {shown}")
        return ", ".join(texts)
