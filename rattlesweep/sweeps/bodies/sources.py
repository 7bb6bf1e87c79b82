"""Sources of bodies: drawn from ranges, a preset, a grid or a shape; for tables see `table`."""

from __future__ import annotations

import math
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from rattlesweep.arrays import Floats, Integers
from rattlesweep.errors import ConfigError
from rattlesweep.physics import si
from rattlesweep.physics.body import PARAMETERS, PRESETS, shell_dumbbell, violations
from rattlesweep.physics.si import half_ellipsoid
from rattlesweep.sweeps.bodies.protocol import Bodies, Scale, Source
from rattlesweep.sweeps.bodies.sampler import bodies_of, draw_bodies, sequence_points
from rattlesweep.sweeps.bodies.table import KEPT, TableBodies, read_bodies
from rattlesweep.sweeps.columns import F64, MEASURED, required
from rattlesweep.sweeps.config.schema import (
    Config,
    PresetSource,
    SdSource,
    ShapeSource,
    TableSource,
)

CHUNK = 4096
"""Samples that are drawn together, and kept while the other cases of their target ask for them."""
SIZES = {"KL": (1.0, 0.01)}
"""Mass in kg and height of the centre of mass in m of presets that have a size."""
UNIT = np.array([[0.0, 1.0]] * 4 + [[-np.degrees(1.0), 0.0]])
"""Ranges of which the sampler makes numbers from 0 to 1."""


def make_source(config: Config, base: Path | None = None) -> Source:
    """Return the source that a config asks for; a table is read here, once.

    A relative path is looked up from the working directory, and then from `base`.  A ConfigError
    says which of the bodies cannot exist.
    """
    bodies = config.bodies
    if isinstance(bodies, SdSource):
        return SdBodies(config.seed, bodies)
    if isinstance(bodies, ShapeSource):
        return ShapeBodies(config.seed, bodies)
    if isinstance(bodies, TableSource):
        return read_bodies(bodies.path, base).with_surface(bodies)
    preset: str | None
    varying: dict[str, list[float]] = {}
    if isinstance(bodies, PresetSource):
        preset, given = bodies.name, bodies.overrides.given()
    else:
        preset, given, varying = bodies.base.preset, bodies.base.given(), bodies.varying
    if preset is not None:
        body = PRESETS[preset]()
        given = {name: getattr(body, name) for name in (*PARAMETERS, "c")} | given
    c = bodies.c[0] if isinstance(bodies.c, list) else bodies.c or given.get("c")
    given.pop("c", None)
    if c is not None and bodies.ellipsoidal:
        given["c"] = c
    axes = {name: np.array(values, float) for name, values in varying.items()}
    for name, sign in (("xi_deg", 1), ("minus_xi_deg", -1)):
        if name in axes:
            axes["xi"] = sign * np.radians(axes.pop(name))
    # Each rule is linear in each parameter, so a grid that breaks it breaks it in a corner.
    corners = GridBodies(given, {name: np.array([x.min(), x.max()]) for name, x in axes.items()})
    every = corners.bodies(np.nan, np.arange(corners.samples))
    _check(every, "bodies.axes" if axes else "bodies.overrides")
    # The runs of a preset of known size are in seconds too where the config is.
    return GridBodies(given, axes, SIZES.get(preset or "") if config.in_si else None)


def content_hash(source: Source) -> str:
    """Return a hash of what determines the bodies beside the config; "" if nothing does."""
    return source.content_hash if isinstance(source, TableBodies) else ""


class SdBodies:
    """Shell-dumbbell bodies drawn from ranges, by seed, value of the target and number alone."""

    fields: tuple[pa.Field, ...] = ()

    def __init__(self, seed: int, source: SdSource) -> None:
        theta = source.ranges.theta
        if source.c is not None and not source.c[0] > theta[1]:
            raise ConfigError(
                f"bodies.c: c down to {source.c[0]:g} and theta up to {theta[1]:g} give bodies "
                "that would rather lie on their sides; c must be above theta in all of them"
            )
        self.samples = source.samples
        self._seed, self._source, self._ranges = seed, source, ranges_of(source)
        self._chunk = lru_cache(maxsize=64)(self._draw_chunk)

    def __reduce__(self) -> tuple[Any, ...]:
        # Without what has been drawn: another process draws the same.
        return SdBodies, (self._seed, self._source)

    def check_targets(self) -> None:
        """Draw a few bodies of each target, and raise a ConfigError if one is out of reach."""
        target = self._source.target
        for value in target.values if target else ():
            draw_bodies(self._seed, np.arange(min(self.samples, 16)), self._ranges, target, value)

    def bodies(self, target: float | Floats, sample: Integers) -> Bodies:
        """Return the bodies of some runs; all cases of a target share theirs."""
        if self._source.target is None and self._source.draw == "random":
            return drawn(draw_bodies(self._seed, sample, self._ranges)[0])
        # It is slow to draw for a target, and points of a sequence come one after another.
        columns = np.empty((2 + len(self._ranges), len(sample)))
        chunk, place = np.divmod(sample, CHUNK)
        # A NaN is not equal to itself, so that none would be found again in the cache.
        target = np.nan_to_num(np.broadcast_to(target, sample.shape))
        for value in np.unique(target):
            for number in np.unique(chunk[target == value]):
                here = (target == value) & (chunk == number)
                columns[:, here] = self._chunk(float(value), int(number))[:, place[here]]
        return drawn(columns)

    def _draw_chunk(self, value: float, number: int) -> Floats:
        first, stop = number * CHUNK, min((number + 1) * CHUNK, self.samples)
        source, seed, ranges = self._source, self._seed, self._ranges
        if source.draw != "random":
            group = 2 + len(source.drawn) if source.draw == "saltelli" else 1
            return bodies_of(sequence_points(len(ranges), seed, first, stop, group), ranges)
        return draw_bodies(seed, np.arange(first, stop), ranges, source.target, value)[0]


def ranges_of(source: SdSource) -> Floats:
    """Return the ranges that bodies are drawn from, shape (5, 2), or (6, 2) with that of ``c``."""
    return np.array([*source.ranges.ends(), *([] if source.c is None else [source.c])])


def drawn(columns: Floats) -> Bodies:
    """Return bodies from the columns of :func:`rattlesweep.sweeps.bodies.sampler.draw_bodies`."""
    gamma, f_sd, theta, phi, xi, alpha, beta, *c = columns
    return Bodies(alpha, beta, gamma, theta, phi, xi, f_sd, c=c[0] if c else None)


class GridBodies:
    """A base body with some parameters varied over the product of their axes.

    `size` is the mass in kg and the height of the centre of mass in m, where they are known.
    """

    def __init__(
        self,
        base: dict[str, float],
        axes: dict[str, Floats],
        size: tuple[float, float] | None = None,
    ) -> None:
        self._base, self._axes, self._size = base, axes, size
        self._shape = tuple(len(values) for values in axes.values())
        self.samples = math.prod(self._shape)
        self.fields: tuple[pa.Field, ...] = MEASURED if size else ()

    def bodies(self, target: float | Floats, sample: Integers) -> Bodies:
        """Return the bodies of some runs; all cases have the same."""
        count = len(sample)
        values = {name: np.full(count, value) for name, value in self._base.items()}
        places = np.unravel_index(sample, self._shape) if self._shape else ()
        for (name, axis), place in zip(self._axes.items(), places, strict=True):
            values[name] = axis[place]
        f_sd = values.pop("f_sd", None)
        if f_sd is None:
            f_sd = np.full(count, np.nan)
        else:
            values["alpha"], values["beta"] = shell_dumbbell(values["gamma"], f_sd)
        size = (*self._size, si.GRAVITY) if self._size else ()
        scale = Scale(*(np.full(count, x) for x in size)) if size else None
        return Bodies(f_sd=f_sd, **values, scale=scale)  # type: ignore[arg-type]


class ShapeBodies:
    """Bodies of a simple shape and a known size; what is a range is drawn for each sample."""

    fields = (
        *(required(name, F64, KEPT[name], "of the body") for name in ("mass_kg", "height_m")),
        *MEASURED,
    )

    def __init__(self, seed: int, source: ShapeSource) -> None:
        self._seed, self._ranges = seed, np.array(list(source.sizes.values()))
        self.samples = (source.samples or 1000) if source.drawn else 1
        # The conditions of a body are monotonic in each size.
        corners = np.array(list(product(*self._ranges))).T
        _check(_shaped(corners), "bodies", dict(zip(source.sizes, corners, strict=True)))

    def bodies(self, target: float | Floats, sample: Integers) -> Bodies:
        """Return the bodies of some runs; all cases have the same."""
        low, high = self._ranges.T[:, :, None]
        unit = draw_bodies(self._seed, sample, UNIT)[0][:5] if (low < high).any() else 0.0
        return _shaped(low + (high - low) * unit * np.ones(len(sample)))


def _shaped(sizes: Floats) -> Bodies:
    """Return half ellipsoids of some lengths, widths, heights, masses and skew angles."""
    length, width, height, mass, skew = sizes
    found = half_ellipsoid(length, width, height, mass, np.abs(skew))
    mass, a = found.pop("mass"), found.pop("height")
    none, gravity = np.full(mass.shape, np.nan), np.full(mass.shape, si.GRAVITY)
    kept = {"mass_kg": mass, "height_m": a}
    return Bodies(**found, f_sd=none, scale=Scale(mass, a, gravity), carried=kept)


def _check(bodies: Bodies, where: str, sizes: dict[str, Floats] | None = None) -> None:
    """Raise a ConfigError if a body cannot exist; of several, told by its parameters or `sizes`."""
    names = PARAMETERS if bodies.c is None else (*PARAMETERS, "c")
    columns = {name: getattr(bodies, name) for name in names}
    for place, sentence in violations(**columns):
        told = (f"{name} {values[place]:g}" for name, values in (sizes or columns).items())
        which = f"at {', '.join(told)}: " if len(bodies.alpha) > 1 else ""
        raise ConfigError(f"{where}: {which}{sentence}")
