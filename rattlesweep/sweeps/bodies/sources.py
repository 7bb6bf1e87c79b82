"""Where parameter sets come from: one class per source, all with the same two questions.

How many samples has a case, and what are the bodies of these samples?
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from rattlesweep.arrays import Floats, Integers
from rattlesweep.errors import ConfigError
from rattlesweep.physics.body import PARAMETERS, PRESETS, shell_dumbbell, violations
from rattlesweep.sweeps.bodies.sampler import bodies_of, draw_bodies
from rattlesweep.sweeps.config.bodies import (
    GridSource,
    PresetBase,
    PresetSource,
    SdSource,
    TableSource,
)
from rattlesweep.sweeps.config.fields import TABLE
from rattlesweep.sweeps.config.schema import Config

if TYPE_CHECKING:
    from rattlesweep.sweeps.bodies.measured import Measured
    from rattlesweep.sweeps.bodies.quasi import Sequence

# Samples that are drawn and kept together while the cases of one target pass by.
CHUNK = 4096


@dataclass(frozen=True)
class Bodies:
    """Parameters of some samples, arrays of one length; ``f_sd`` is NaN where a source has none.

    ``c`` is None for paraboloids, and NaN for those among ellipsoids.

    ``n_i``, ``omega_xy0``, ``psi``, ``t_end``, ``sigma``, ``rolling`` and a full state, ``omega``
    and ``u`` of shape (samples, 3), are None unless a table gives them; NaN in ``t_end`` stands for
    the config's horizon.
    """

    alpha: Floats
    beta: Floats
    gamma: Floats
    theta: Floats
    phi: Floats
    xi: Floats
    f_sd: Floats
    n_i: Floats | None = None
    omega_xy0: Floats | None = None
    psi: Floats | None = None
    t_end: Floats | None = None
    omega: Floats | None = None
    u: Floats | None = None
    c: Floats | None = None
    sigma: Floats | None = None
    rolling: Floats | None = None

    @classmethod
    def drawn(cls, columns: Floats) -> Bodies:
        """Of what :func:`rattlesweep.sweeps.bodies.sampler.draw_bodies` gives."""
        gamma, f_sd, theta, phi, xi, alpha, beta, *c = columns
        return cls(alpha, beta, gamma, theta, phi, xi, f_sd, c=c[0] if c else None)


class Source(Protocol):
    """A source of bodies."""

    @property
    def samples(self) -> int:
        """Samples per case."""

    def bodies(self, group: Any, samples: Integers) -> Bodies:
        """Bodies of some samples, each of the cases of a target ``group``."""


def make_source(config: Config, base: Path | None = None) -> Source:
    """The source that a config asks for.

    A table's relative path is looked up from the working directory and then from `base`.
    """
    bodies = config.bodies
    if isinstance(bodies, SdSource):
        return SdBodies(config.seed, bodies)
    if isinstance(bodies, PresetSource):
        parameters = _fixed(bodies)
        for _, sentence in violations(**parameters):
            raise ConfigError(f"bodies.overrides: {sentence}")
        return GridBodies(parameters, {})
    if isinstance(bodies, TableSource):
        from rattlesweep.sweeps.bodies.table import read_table

        columns, measured = read_table(bodies.path, base)
        return TableBodies(_surfaced(columns, bodies), measured)
    return _grid(bodies)


def content_hash(source: Source) -> str:
    """Return a hash of what a source holds beside its config: the columns of a table; else nothing."""
    if not isinstance(source, TableBodies):
        return ""
    digest = hashlib.sha256()
    for name, values in sorted(source._columns.items()):
        digest.update(name.encode() + np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


class SdBodies:
    """Shell-dumbbell bodies drawn from ranges."""

    def __init__(self, seed: int, source: SdSource) -> None:
        self.samples = source.samples
        self._seed = seed
        theta = source.ranges.theta
        if source.c is not None and not source.c[0] > theta[1]:
            raise ConfigError(
                f"bodies.c: c down to {source.c[0]:g} and theta up to {theta[1]:g} give bodies "
                "that would rather lie on their sides; c must be above theta in all of them"
            )
        self._ranges = ranges_of(source)
        self._target = source.target
        # All cases share its points: with targets, there are random bodies only.
        self._sequence = _sequence(source, len(self._ranges), seed)
        self._chunk = lru_cache(maxsize=64)(self._draw_chunk)

    def check_targets(self) -> None:
        """Draw a few bodies of each target: one out of reach shows in its first samples."""
        if self._target is not None:
            for group in range(len(self._target.values)):
                self._columns(group, np.arange(min(self.samples, 16)))

    def bodies(self, group: Any, samples: Integers) -> Bodies:
        """Bodies of some samples, each of the cases of a target ``group``."""
        if self._target is None:
            return Bodies.drawn(self._columns(0, samples))
        # Every case of a target asks for the same bodies, and redrawing is slow.
        columns = np.empty((2 + len(self._ranges), len(samples)))
        group = np.array([self._target.values.index(v) for v in np.atleast_1d(group)])
        chunk, place = np.divmod(samples, CHUNK)
        group = np.broadcast_to(group, samples.shape)
        # A block may hold the end of one case and the start of the next.
        for number in np.unique(np.stack([group, chunk]), axis=1).T:
            here = (group == number[0]) & (chunk == number[1])
            columns[:, here] = self._chunk(*number.tolist())[:, place[here]]
        return Bodies.drawn(columns)

    def _draw_chunk(self, group: int, chunk: int) -> Floats:
        return self._columns(
            group, np.arange(chunk * CHUNK, min((chunk + 1) * CHUNK, self.samples))
        )

    def _columns(self, group: int, samples: Integers) -> Floats:
        samples = np.ascontiguousarray(samples, dtype=np.int64)
        target = self._target
        if self._sequence is not None:
            return bodies_of(self._sequence.points(samples), self._ranges)
        if target is None:
            return draw_bodies(self._seed, group, samples, self._ranges)[0]
        value = target.values[group]
        columns, draws, nearest = draw_bodies(
            self._seed, group, samples, self._ranges, 1 if target.name == "K_p" else 2,
            value, target.rel_tol, target.max_draws,
        )  # fmt: skip
        for place in np.flatnonzero(draws < 0):
            raise ConfigError(
                f"bodies.target.{target.name}: {value:g} was not met to {target.rel_tol:g} in "
                f"{target.max_draws} draws of sample {samples[place]}, the nearest being "
                f"{nearest[place]:.6g}; choose another target, wider ranges, a larger rel_tol "
                "or more max_draws"
            )
        return columns


def ranges_of(source: SdSource) -> Floats:
    """Ranges that bodies are drawn from, shape (5, 2), or (6, 2) with that of ``c``."""
    return np.array([*source.ranges.ends(), *([] if source.c is None else [source.c])])


def _sequence(source: SdSource, dimensions: int, seed: int) -> Sequence | None:
    if source.draw == "random":
        return None
    # scipy.stats takes longer to import than all the rest.
    from rattlesweep.sweeps.bodies.quasi import Design, Sequence

    if source.draw == "sobol":
        return Sequence(dimensions, seed)
    return Design(dimensions, seed, source.group)


class GridBodies:
    """A base body with some parameters varied over the product of their axes."""

    def __init__(self, base: dict[str, float], axes: dict[str, Floats]) -> None:
        self._base = base
        self._axes = axes
        self._shape = tuple(len(values) for values in axes.values())
        self.samples = math.prod(self._shape)

    def bodies(self, group: Any, samples: Integers) -> Bodies:
        """Bodies of some samples; all cases have the same."""
        places = np.unravel_index(samples, self._shape) if self._shape else ()
        values = {name: np.full(len(samples), value) for name, value in self._base.items()}
        for (name, axis), place in zip(self._axes.items(), places, strict=True):
            values[name] = axis[place]
        f_sd = values.pop("f_sd", np.full(len(samples), np.nan))
        if np.isfinite(f_sd).all() and len(f_sd):
            values["alpha"], values["beta"] = shell_dumbbell(values["gamma"], f_sd)
        return Bodies(f_sd=f_sd, c=values.get("c"), **{name: values[name] for name in PARAMETERS})


def _fixed(source: PresetSource | GridSource) -> dict[str, float]:
    """Parameters of all bodies of a source, where no axis replaces them."""
    given: dict[str, float] = {}
    if isinstance(source, PresetSource):
        preset, given = source.name, source.overrides.given()
    elif isinstance(source.base, PresetBase):
        preset = source.base.preset
    else:
        preset, given = None, source.base.given()
    if preset is not None:
        body = PRESETS[preset]()
        given = {name: getattr(body, name) for name in (*PARAMETERS, "c")} | given
    c = source.c[0] if isinstance(source.c, list) else source.c or given.get("c")
    rest = {name: value for name, value in given.items() if name != "c"}
    return rest if c is None or not source.ellipsoidal else rest | {"c": c}


def _surfaced(columns: dict[str, Floats], source: TableSource) -> dict[str, Floats]:
    """Columns of a table with those of its surface."""
    c = columns.pop("c", None)
    if source.surface is None and source.c is None:
        if c is not None and np.isfinite(c).any():
            raise ConfigError(
                "bodies.surface: missing; the table has a column c, so say ellipsoid, or "
                "paraboloid to leave it out"
            )
        return columns
    if not source.ellipsoidal:
        return columns
    rows = len(columns["alpha"])
    c = np.full(rows, np.nan) if c is None else c
    if source.c is not None:
        c = np.where(np.isnan(c), source.c, c)
    if np.isnan(c).all():
        raise ConfigError(
            "bodies.c: missing; the table has no column c, so the config must give one"
        )
    for row, sentence in violations(**{name: columns[name] for name in PARAMETERS}, c=c):
        raise ConfigError(f"bodies.path: row {row + 1}: {sentence}")
    return columns | {"c": c}


def _grid(source: GridSource) -> GridBodies:
    parameters = _fixed(source)
    axes = {name: np.asarray(values, float) for name, values in source.varying.items()}
    for name, sign in (("xi_deg", 1), ("minus_xi_deg", -1)):
        if name in axes:
            axes["xi"] = sign * np.radians(axes.pop(name))
    grid = GridBodies(parameters, axes)
    # A rule is linear in each parameter, so a grid that breaks it breaks it in a corner.
    ends = {name: np.array([axis.min(), axis.max()]) for name, axis in axes.items()}
    corners = GridBodies(parameters, ends)
    part = corners.bodies(0, np.arange(corners.samples))
    columns = {name: getattr(part, name) for name in PARAMETERS}
    if part.c is not None:
        columns["c"] = part.c
    for place, sentence in violations(**columns):
        corner = ", ".join(f"{name} {values[place]:g}" for name, values in columns.items())
        raise ConfigError(f"bodies.axes: at {corner}: {sentence}")
    return grid


class TableBodies:
    """Bodies from the rows of a table."""

    def __init__(self, columns: dict[str, Floats], measured: Measured | None = None) -> None:
        self._columns, self.measured = columns, measured
        self.samples = len(columns["alpha"])
        # Whether the rows say how they are launched.
        self.has_launch = "n_i" in columns
        # Whether that is a full state.
        self.has_state = "u_x" in columns
        # What it says of the dissipation: a number that all rows share, or that rows differ.
        own = {name: np.unique(columns[name]) for name in ("sigma", "rolling") if name in columns}
        self.losses: dict[str, float | str] = {
            name: float(values[0]) if len(values) == 1 else TABLE for name, values in own.items()
        }

    def bodies(self, group: Any, samples: Integers) -> Bodies:
        """Bodies of some samples; all cases have the same."""
        columns = {name: values[samples] for name, values in self._columns.items()}
        columns.setdefault("f_sd", np.full(len(samples), np.nan))
        for name in ("omega", "u") if self.has_state else ():
            parts = [columns.pop(f"{name}_{x}") for x in "xyz"]
            columns[name] = np.stack(parts, axis=1)
        return Bodies(**columns)
