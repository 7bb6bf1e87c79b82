"""Sources of bodies: drawn from ranges, a preset, a grid or a shape; for tables see
`table`.

A random point of the unit cube is a function of ``(seed, word, sample, draw)`` alone,
so any sample can be drawn by itself.  The word encodes the target; `draw` counts the
attempts to meet it.  The bits are those of ``numpy.random.Philox(key=(seed, word),
counter=(2 draw, sample, 0, 0))`` (Philox 4x64-10, Salmon et al., SC'11); creating
NumPy's objects would take too long.

Points of a scrambled Sobol' sequence (Owen, J. Complexity 14, 466, 1998) fill the
ranges more evenly than random ones; each is a function of the seed and its number.
"""

# mypy: disable-error-code="no-untyped-def"
# Numba infers the types in compiled functions.
from __future__ import annotations

import math
from functools import lru_cache, partial
from itertools import pairwise, product
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyarrow as pa
from numba import njit
from numba.extending import register_jitable

from rattlesweep.arrays import Floats, Integers
from rattlesweep.compiling.intrinsics import UNFUSED
from rattlesweep.compiling.loading import Kernel, load_kernels
from rattlesweep.config.body_sources import (
    GridSource,
    MeshSource,
    PresetSource,
    SdSource,
    ShapeSource,
    TableSource,
    Target,
    of_preset,
)
from rattlesweep.config.schema import Config
from rattlesweep.design.bodies import Source
from rattlesweep.design.bodies.meshes import read_meshes
from rattlesweep.design.bodies.table import TableBodies, read_bodies, run_fields
from rattlesweep.kernel.task import Control, side_by_side
from rattlesweep.kernel.threads import available_threads
from rattlesweep.physics import body, si, theory
from rattlesweep.physics.body import PARAMETERS, PRESETS, shell_dumbbell, violations
from rattlesweep.physics.si import half_ellipsoid
from rattlesweep.rows.columns import MEASURED
from rattlesweep.rows.prepared import Bodies
from rattlesweep.words.errors import ConfigError
from rattlesweep.words.quantities import ANGLES, CONSTANT_OF_SURFACE, SURFACE_CONSTANTS

# Units of the sizes of a shape in the names of columns.
_SIZES = {
    "length": "m",
    "width": "m",
    "height": "m",
    "mass": "kg",
    "skew": "rad",
    "weights": "kg",
}
DRAWN_TOGETHER = (
    4096  # samples drawn together, and cached for the other cases of a target
)


def make_source(config: Config, base: Path | None, rows: TableBodies | None) -> Source:
    """Return the source of a config's bodies; a table is read here, once."""
    bodies = config.bodies
    if isinstance(bodies, SdSource):
        return SdBodies(config.seed, bodies)
    if isinstance(bodies, ShapeSource):
        return ShapeBodies(config.seed, bodies)
    if isinstance(bodies, MeshSource):
        return read_meshes(bodies, base)
    if isinstance(bodies, TableSource):
        if rows is None:
            rows = read_bodies(bodies.path, base)
        return rows.with_surface(bodies)
    return _grid_bodies(config, bodies)


def _grid_bodies(config: Config, bodies: PresetSource | GridSource) -> GridBodies:
    """Return the bodies of a preset, or those of a grid about a base."""
    if isinstance(bodies, PresetSource):
        where = "bodies.overrides"
        preset: str | None = bodies.name
        parameters = dict(bodies.overrides.parameters)
        axes: dict[str, Floats] = {}
    else:
        where = "bodies.axes"
        preset = bodies.base.preset
        parameters = dict(bodies.base.parameters)
        axes = {name: np.array(x, float) for name, x in bodies.varying.items()}
    units: si.Units | None = None
    if preset is not None:
        known = PRESETS[preset]()
        names = [*PARAMETERS, *of_preset(preset)]
        parameters = {name: getattr(known, name) for name in names} | parameters
        # Runs get columns in SI units if the config uses them.
        if config.in_si:
            units = known.units
    constant = CONSTANT_OF_SURFACE[bodies.bottom]
    parameters = {
        name: value
        for name, value in parameters.items()
        if name not in SURFACE_CONSTANTS or name == constant
    }
    if constant is not None and bodies.constant(constant) is not None:
        # Several values of the key are an axis, which replaces the first.
        parameters[constant] = np.ravel(bodies.constant(constant))[0]
    for name, sign in ANGLES.items():
        if name in axes:
            axes["xi"] = sign * np.radians(axes.pop(name))
    # Each rule is linear in each parameter, so a grid that breaks a rule breaks it at a
    # corner.
    ends = {name: np.array([x.min(), x.max()]) for name, x in axes.items()}
    corners = GridBodies(parameters, ends)
    _check(corners.bodies(np.nan, np.arange(corners.samples)), where)
    return GridBodies(parameters, axes, units)


def _check(bodies: Bodies, where: str, sizes: dict[str, Floats] | None = None) -> None:
    """Raise a ConfigError if a body is impossible.

    Of several bodies, the message names the first by its `sizes`, or its parameters.
    """
    parameters = {name: getattr(bodies, name) for name in PARAMETERS}
    columns = parameters | bodies.further
    for place, message in violations(**parameters, c=bodies.further.get("c")):
        which = ""
        if len(bodies.alpha) > 1:
            shown = sizes or columns
            values = [f"{name} {shown[name][place]:g}" for name in shown]
            which = f"at {', '.join(values)}: "
        raise ConfigError(f"{where}: {which}{message}")


class GridBodies:
    """A base body with some parameters varied over the product of axes."""

    def __init__(
        self,
        base: dict[str, float],
        axes: dict[str, Floats],
        units: si.Units | None = None,
    ) -> None:
        self._base = base
        self._axes = axes
        self._units = units
        self._shape = tuple(map(len, axes.values()))
        self.samples = math.prod(self._shape)
        self.fields: tuple[pa.Field, ...] = ()
        if units is not None:
            self.fields = MEASURED

    def bodies(self, target: float | Floats, sample: Integers) -> Bodies:
        """Return the bodies of some samples, which are the same in all cases."""
        values: dict[str, float | Floats] = {"f_sd": np.nan, **self._base}
        if self._axes:
            places = np.unravel_index(sample, self._shape)
            for (name, axis), place in zip(self._axes.items(), places, strict=True):
                values[name] = axis[place]
        columns = {name: np.full(sample.shape, value) for name, value in values.items()}
        if "alpha" not in columns:
            alpha, beta = shell_dumbbell(columns["gamma"], columns["f_sd"])
            columns |= {"alpha": alpha, "beta": beta}
        return Bodies.of(columns, units=self._units)


class ShapeBodies:
    """Bodies of a simple shape and a known size; ranges are drawn for each sample."""

    def __init__(self, seed: int, source: ShapeSource) -> None:
        self._seed = seed
        self._source = source
        self.samples = 1
        if source.drawn:
            self.samples = source.samples or 1000
        # The rules for bodies are monotonic in each size, so the corners suffice.
        corners = np.array(list(product(*source.sizes.values()))).T
        sizes = dict(zip(source.sizes, corners, strict=True))
        bodies = self._shaped(sizes)
        _check(bodies, "bodies", sizes)
        outside = {name: sizes[name] for name in ("length", "width", "height")}
        wall = source.fixed.get("wall", np.inf)
        volume = si.half_ellipsoid_volume(**outside, wall=wall)
        try:
            si.check_density(sizes["mass"], volume)
        except ValueError as error:
            raise ConfigError(f"bodies.mass: {error}") from None
        self.fields = run_fields(bodies.units, bodies.carried)

    def bodies(self, target: float | Floats, sample: Integers) -> Bodies:
        """Return the bodies of some samples, which are the same in all cases."""
        ranges = self._source.sizes
        points = np.zeros((len(ranges), len(sample)))
        if self._source.drawn:
            points = draw_points(self._seed, sample)[: len(ranges)]
        sizes = {}
        for (name, (low, high)), point in zip(ranges.items(), points, strict=True):
            sizes[name] = low + (high - low) * point
        return self._shaped(sizes)

    def _shaped(self, sizes: dict[str, Floats]) -> Bodies:
        """Return bodies of some sizes, of which the runs keep those that are drawn."""
        parameters = half_ellipsoid(**sizes, **self._source.fixed)
        mass = parameters.pop("mass")
        height = parameters.pop("height")
        # The flat side is as high as the semi-axis.
        carried = {"mass_kg": mass, "height_m": height, "rim": parameters["c"]}
        for name in self._source.drawn:
            carried[f"shape_{name}_{_SIZES[name]}"] = sizes[name]
        return Bodies.of(
            parameters,
            f_sd=np.full(mass.shape, np.nan),
            units=si.Units(mass, height),
            carried=carried,
        )


class SdBodies:
    """Shell-dumbbell bodies drawn from ranges.

    A body is a function of seed, target and sample alone.
    """

    def __init__(self, seed: int, source: SdSource) -> None:
        self.samples = source.samples
        self.fields: tuple[pa.Field, ...] = ()
        self._seed = seed
        self._source = source
        self._ranges = ranges_of(source)
        self._constant = CONSTANT_OF_SURFACE[source.bottom]
        self._chunk = lru_cache(maxsize=64)(self._draw_chunk)

    def __reduce__(self) -> tuple[type[SdBodies], tuple[int, SdSource]]:
        return SdBodies, (self._seed, self._source)

    def check_targets(self) -> None:
        """Draw a few bodies for each target; raise a ConfigError if one is not met.

        NumPy draws them: a command that only checks a config compiles no kernel.
        """
        target = self._source.target
        if target is None:
            return
        samples = range(min(self.samples, 16))
        for value, sample in product(target.values, samples):
            if not _is_met(self._seed, sample, self._ranges, target, value):
                raise _unmet(target, value, sample)

    def bodies(self, target: float | Floats, sample: Integers) -> Bodies:
        """Return the bodies of some samples for their targets, in any order."""
        if self._source.target is None and self._source.draw == "random":
            points = draw_points(self._seed, sample)
            return bodies_at(points, self._ranges, self._constant)
        # Draws for a target are slow, and a sequence is made in order: both go by whole
        # chunks.
        points = np.empty((6, len(sample)))
        chunks, places = np.divmod(sample, DRAWN_TOGETHER)
        # NaN, for no target, is unequal to itself, so the cache would never find it.
        values = np.nan_to_num(np.broadcast_to(target, sample.shape))
        wanted = {*zip(values.tolist(), chunks.tolist(), strict=True)}
        for value, number in wanted:
            rows = (values == value) & (chunks == number)
            points[:, rows] = self._chunk(value, number)[:, places[rows]]
        return bodies_at(points, self._ranges, self._constant)

    def _draw_chunk(self, value: float, number: int) -> Floats:
        """Return the points of the samples of a chunk, for the `value` of a target."""
        source = self._source
        ranges = self._ranges
        first = number * DRAWN_TOGETHER
        stop = min(first + DRAWN_TOGETHER, self.samples)
        if source.draw == "random":
            samples = np.arange(first, stop)
            return draw_points(self._seed, samples, ranges, source.target, value)
        group = source.group if source.draw == "saltelli" else 1
        points = sequence_points(len(ranges), self._seed, first, stop, group)
        return np.pad(points, ((0, 6 - len(points)), (0, 0)))


def ranges_of(source: SdSource) -> Floats:
    """Return the ranges of the parameters, shape (5, 2).

    For a surface with a further constant, its range follows, shape (6, 2).
    """
    ranges = list(dict(source.ranges).values())
    constant = CONSTANT_OF_SURFACE[source.bottom]
    if constant is not None:
        ranges.append(source.constant(constant))
    return np.array(ranges)


def _shell_parameters(u, ranges):
    """Return ``gamma, f_sd, theta, phi, xi`` at one or many points of the unit cube."""
    gamma = ranges[0, 0] + (ranges[0, 1] - ranges[0, 0]) * u[0]
    f_sd = ranges[1, 0] + (ranges[1, 1] - ranges[1, 0]) * u[1]
    theta = ranges[2, 0] + (ranges[2, 1] - ranges[2, 0]) * u[2]
    phi = ranges[3, 0] + (ranges[3, 1] - ranges[3, 0]) * u[3]
    # Drawn from (low, high], so the skew angle is never zero.
    xi = -np.radians(ranges[4, 1] - (ranges[4, 1] - ranges[4, 0]) * u[4])
    return gamma, f_sd, theta, phi, xi


def bodies_at(points: Floats, ranges: Floats, constant: str | None = None) -> Bodies:
    """Return bodies at points of the unit cube, with a row for each of `ranges`.

    The sixth is that of the further `constant` of their surface.
    """
    gamma, f_sd, theta, phi, xi = cast("Any", _shell_parameters)(points, ranges)
    alpha, beta = shell_dumbbell(gamma, f_sd)
    further = {}
    if constant is not None:
        low, high = ranges[5]
        further[constant] = low + (high - low) * points[5]
    return Bodies(alpha, beta, gamma, theta, phi, xi, f_sd, further)


def sequence_points(
    dimensions: int, seed: int, first: int, stop: int, group: int = 1
) -> Floats:
    """Return points `first` to `stop` of a Sobol' sequence, or of Saltelli's design.

    The points of a design come in groups of the size `group`.
    """
    # scipy.stats takes longer to import than all the rest.
    from scipy.stats import qmc

    if group > 1:
        # One point of twice the dimensions is a pair; a group is both, and the first
        # with each coordinate in turn taken from the second.
        number, place = np.divmod(np.arange(first, stop), group)
        pairs = sequence_points(
            2 * dimensions, seed, int(number[0]), int(number[-1]) + 1
        )
        point, partner = np.split(pairs[:, number - number[0]], 2)
        swapped = (place == 1) | (place == 2 + np.arange(dimensions)[:, None])
        return np.where(swapped, partner, point)
    sobol = qmc.Sobol(dimensions, rng=np.random.default_rng((seed, 0)))
    if first:
        sobol.fast_forward(first)
    count = stop - first
    # SciPy warns unless the number of the first points is a power of two.
    asked = count if first else 1 << (count - 1).bit_length()
    return np.array(sobol.random(asked)[:count].T)


def draw_points(
    seed: int,
    samples: Integers,
    ranges: Floats | None = None,
    target: Target | None = None,
    value: float = np.nan,
) -> Floats:
    """Return a random point for each sample, whose body meets a target's value."""
    # These arrays have the types that the sampler is compiled for.
    numbers = np.array(samples, dtype=np.int64)
    if target is None:
        # The first draw is taken, for which no kernel need be compiled.
        with np.errstate(over="ignore"):
            return np.stack(uniforms(seed, 0, numbers, 0)[:6])
    points = np.full((6, samples.size), np.nan)
    word, which = _word(target, value)
    within = np.array(ranges, dtype=float, order="C")
    aim = (which, float(value), target.rel_tol, target.max_draws)
    settings = (seed, numbers, word, within, *aim, points)
    draw = load_kernels((sampler,))[0]

    def draw_some(first: int, last: int, control: Control) -> None:
        draw(first, last, control.flag, *settings)

    threads = available_threads()
    edges = np.linspace(0, samples.size, threads + 1).astype(int).tolist()
    # Python's threads, as Numba's pool aborts the process if another kernel runs
    # meanwhile; and the main thread stays free to notice Ctrl-C.
    side_by_side([partial(draw_some, *ends) for ends in pairwise(edges)], threads)
    unmet = np.isnan(points[0])
    if unmet.any():
        raise _unmet(target, value, samples[np.argmax(unmet)])
    return points


def _word(target: Target, value: float) -> tuple[int, int]:
    """Return the word of a target, and which of the torque coefficients it is."""
    which = 2
    signed = value
    if target.name == "K_p":
        which = 1
        signed = -value
    # The 64 bits of the value, with the sign bit set for K_p.
    return int(np.float64(signed).view(np.int64)), which


def _unmet(target: Target, value: float, sample: int) -> ConfigError:
    """Return the error of a sample that does not meet its target."""
    return ConfigError(
        f"bodies.target.{target.name}: {value:g} was not met to {target.rel_tol:g} in "
        f"{target.max_draws} draws of sample {sample}; choose another target, wider "
        "ranges, a larger rel_tol or more max_draws"
    )


def _is_met(
    seed: int, sample: int, ranges: Floats, target: Target, value: float
) -> bool:
    """Return whether some draw of a sample meets a target, by NumPy's own Philox."""
    word, which = _word(target, value)
    key = np.array([seed, word]).view(np.uint64)
    philox = np.random.Philox(key=key, counter=np.array([0, sample, 0, 0], np.uint64))
    drawn = np.random.Generator(philox)
    left = target.max_draws
    while left:
        draws = min(left, DRAWN_TOGETHER)
        left -= draws
        points = drawn.random((draws, 8)).T
        gamma, f_sd, *angles = cast("Any", _shell_parameters)(points, ranges)
        coefficients = theory.torque_coefficients(*shell_dumbbell(gamma, f_sd), *angles)
        distance = np.abs(coefficients[1 + which] - value)
        if (distance <= target.rel_tol * value).any():
            return True
    return False


def sampler() -> Kernel:
    """Return the sampler as a kernel to compile."""
    flag = Control().flag
    samples = np.zeros(0, dtype=np.int64)
    ranges = np.zeros((5, 2))
    points = np.zeros((6, 0))
    like = (0, 0, flag, 0, samples, 0, ranges, 0, 0.0, 0.0, 0, points)
    return Kernel(_draw, like, {"nogil": True}, (__file__,), small=True)


# Formulas for arrays, here compiled for scalars too.
register_jitable(nogil=True, **UNFUSED)(theory.hessian)
_shell_dumbbell, _torque_coefficients, _drawn_parameters = map(
    njit(nogil=True, no_cpython_wrapper=True, no_cfunc_wrapper=True, **UNFUSED),
    (body.shell_dumbbell, theory.torque_coefficients, _shell_parameters),
)

# Multipliers and increments of Philox 4x64.
_M0 = np.uint64(0xD2E7470EE14C6C93)
_M1 = np.uint64(0xCA5A826395121157)
_W0 = np.uint64(0x9E3779B97F4A7C15)
_W1 = np.uint64(0xBB67AE8584CAA73B)
_LOW = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)
_SHIFT = np.uint64(11)
_UNIT = 2.0**-53


def _draw(
    first,
    last,
    stop,
    seed,
    samples,
    word,
    ranges,
    which,
    target,
    rel_tol,
    max_draws,
    points,
):
    """Fill in points; those that do not meet the target stay NaN.

    The target is one of ``K_p`` if `which` is 1, of ``K_r`` if 2.
    """
    for i in range(first, last):
        if stop[0]:
            return
        for k in range(max_draws):
            u = uniforms(seed, word, samples[i], k)
            gamma, f_sd, theta, phi, xi = _drawn_parameters(u, ranges)
            alpha, beta = _shell_dumbbell(gamma, f_sd)
            coefficients = _torque_coefficients(alpha, beta, theta, phi, xi)
            if not abs(coefficients[1 + which] - target) > rel_tol * target:
                for row in range(len(points)):
                    points[row, i] = u[row]
                break


@register_jitable(nogil=True, **UNFUSED)
def uniforms(seed, word, sample, draw):
    """Return eight numbers in [0, 1), or arrays of them for an array of samples."""
    key0 = np.uint64(seed)
    key1 = np.uint64(word)
    number = np.uint64(sample)
    # NumPy increments its counter before using it.
    first = np.uint64(2) * np.uint64(draw) + np.uint64(1)
    second = first + np.uint64(1)
    return _philox(key0, key1, first, number) + _philox(key0, key1, second, number)


@register_jitable(nogil=True, **UNFUSED)
def _philox(key0, key1, c0, c1):
    """Return four numbers in [0, 1) for a key and a counter of 64-bit words."""
    c2 = c3 = np.uint64(0)
    for _ in range(10):
        high0, low0 = _multiply(_M0, c0)
        high1, low1 = _multiply(_M1, c2)
        c0 = high1 ^ c1 ^ key0
        c2 = high0 ^ c3 ^ key1
        c1 = low1
        c3 = low0
        key0 += _W0
        key1 += _W1
    return (
        (c0 >> _SHIFT) * _UNIT,
        (c1 >> _SHIFT) * _UNIT,
        (c2 >> _SHIFT) * _UNIT,
        (c3 >> _SHIFT) * _UNIT,
    )


@register_jitable(nogil=True, **UNFUSED)
def _multiply(a, b):
    """Return the high and the low word of the product of two 64-bit words."""
    a_high = a >> _HALF
    a_low = a & _LOW
    b_high = b >> _HALF
    b_low = b & _LOW
    low = a_low * b_low
    middle = a_high * b_low + (low >> _HALF)
    cross = a_low * b_high + (middle & _LOW)
    return a_high * b_high + (middle >> _HALF) + (cross >> _HALF), a * b
