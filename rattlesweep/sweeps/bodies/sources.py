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
from rattlesweep.errors import ConfigError
from rattlesweep.integrate.batch import available_threads
from rattlesweep.integrate.compile import Kernel, load_kernels
from rattlesweep.integrate.task import Control, side_by_side
from rattlesweep.physics import body, si, theory
from rattlesweep.physics.body import PARAMETERS, PRESETS, shell_dumbbell, violations
from rattlesweep.physics.si import half_ellipsoid
from rattlesweep.sweeps.bodies import Bodies, Source
from rattlesweep.sweeps.bodies.table import TableBodies, read_bodies, run_fields
from rattlesweep.sweeps.columns import MEASURED
from rattlesweep.sweeps.config.schema import Config, SdSource, ShapeSource, Target

# Units of the sizes of a shape in the names of columns.
SIZES = {
    "length": "m",
    "width": "m",
    "height": "m",
    "mass": "kg",
    "skew": "rad",
    "weights": "kg",
}
CHUNK = (
    4096  # samples that are drawn together, and cached for the other cases of a target
)


def make_source(config: Config, base: Path | None, rows: TableBodies | None) -> Source:
    """Return the source of a config's bodies; a table is read here, once."""
    bodies = config.bodies
    if bodies.source == "sd":
        return SdBodies(config.seed, bodies)
    if bodies.source == "shape":
        return ShapeBodies(config.seed, bodies)
    if bodies.source == "table":
        return (rows or read_bodies(bodies.path, base)).with_surface(bodies)
    preset: str | None
    if bodies.source == "preset":
        preset, given, varying = bodies.name, bodies.overrides.parameters, {}
    else:
        preset, given, varying = (
            bodies.base.preset,
            bodies.base.parameters,
            bodies.varying,
        )
    axes = {name: np.array(values, float) for name, values in varying.items()}
    units: si.Units | None = None
    if preset is not None:
        one = PRESETS[preset]()
        given = {name: getattr(one, name) for name in (*PARAMETERS, "c")} | given
        # Runs get columns in SI units if the config uses them.
        units = one.units if config.in_si else None
    preset_c = given.pop("c", None)
    c = bodies.c[0] if isinstance(bodies.c, list) else bodies.c or preset_c
    if c is not None and bodies.ellipsoidal:
        given["c"] = c
    for name, sign in (("xi_deg", 1), ("minus_xi_deg", -1)):
        if name in axes:
            axes["xi"] = sign * np.radians(axes.pop(name))
    # Each rule is linear in each parameter, so a grid that breaks a rule breaks it at a
    # corner.
    corners = GridBodies(
        given, {name: np.array([x.min(), x.max()]) for name, x in axes.items()}
    )
    where = "bodies.axes" if axes else "bodies.overrides"
    _check(corners.bodies(np.nan, np.arange(corners.samples)), where)
    return GridBodies(given, axes, units)


def _check(bodies: Bodies, where: str, sizes: dict[str, Floats] | None = None) -> None:
    """Raise a ConfigError if a body is impossible; of several, name it by `sizes` or
    parameters.
    """
    names = PARAMETERS if bodies.c is None else (*PARAMETERS, "c")
    columns = {name: getattr(bodies, name) for name in names}
    for place, message in violations(**columns):
        values = (
            f"{name} {values[place]:g}" for name, values in (sizes or columns).items()
        )
        which = f"at {', '.join(values)}: " if len(bodies.alpha) > 1 else ""
        raise ConfigError(f"{where}: {which}{message}")


class GridBodies:
    """A base body with some parameters varied over the product of axes."""

    def __init__(
        self,
        base: dict[str, float],
        axes: dict[str, Floats],
        units: si.Units | None = None,
    ) -> None:
        self._base, self._axes, self._units = base, axes, units
        self._shape = tuple(map(len, axes.values()))
        self.samples = math.prod(self._shape)
        self.fields: tuple[pa.Field, ...] = MEASURED if units else ()

    def bodies(self, target: float | Floats, sample: Integers) -> Bodies:
        """Return the bodies of some samples, which are the same in all cases."""
        places = np.unravel_index(sample, self._shape) if self._shape else ()
        values: dict[str, Any] = {"f_sd": np.nan} | self._base
        for (name, axis), place in zip(self._axes.items(), places, strict=True):
            values[name] = axis[place]
        columns = {name: np.full(sample.shape, value) for name, value in values.items()}
        if "alpha" not in columns:
            columns["alpha"], columns["beta"] = shell_dumbbell(
                columns["gamma"], columns["f_sd"]
            )
        return Bodies(**columns, units=self._units)  # type: ignore[arg-type]


class ShapeBodies:
    """Bodies of a simple shape and a known size; sizes with a range are drawn for each
    sample.
    """

    def __init__(self, seed: int, source: ShapeSource) -> None:
        self._seed, self._source = seed, source
        self._ranges = np.array(list(source.sizes.values()))
        self.samples = (source.samples or 1000) if source.drawn else 1
        # The rules for bodies are monotonic in each size, so the corners suffice.
        sizes = dict(
            zip(source.sizes, np.array(list(product(*self._ranges))).T, strict=True)
        )
        corners = self._shaped(sizes)
        _check(corners, "bodies", sizes)
        self.fields = run_fields(corners.units, corners.carried)

    def bodies(self, target: float | Floats, sample: Integers) -> Bodies:
        """Return the bodies of some samples, which are the same in all cases."""
        low, high = self._ranges.T[:, :, None]
        points = np.zeros((len(low), len(sample)))
        if self._source.drawn:
            points = draw_points(self._seed, sample)[: len(low)]
        return self._shaped(
            dict(zip(self._source.sizes, low + (high - low) * points, strict=True))
        )

    def _shaped(self, sizes: dict[str, Floats]) -> Bodies:
        """Return bodies of some sizes; those that are drawn become columns of the
        runs.
        """
        found = half_ellipsoid(**sizes, **self._source.fixed)
        mass, a = found.pop("mass"), found.pop("height")
        units, kept = si.Units(mass, a), {"mass_kg": mass, "height_m": a}
        kept |= {
            f"shape_{name}_{SIZES[name]}": sizes[name] for name in self._source.drawn
        }
        return Bodies(
            **found, f_sd=np.full(mass.shape, np.nan), units=units, carried=kept
        )


class SdBodies:
    """Shell-dumbbell bodies drawn from ranges, as a function of seed, target and sample
    alone.
    """

    def __init__(self, seed: int, source: SdSource) -> None:
        self.samples = source.samples
        self.fields: tuple[pa.Field, ...] = ()
        self._seed, self._source, self._ranges = seed, source, ranges_of(source)
        self._chunk = lru_cache(maxsize=64)(self._draw_chunk)

    def __reduce__(self) -> tuple[Any, ...]:
        return SdBodies, (self._seed, self._source)

    def check_targets(self) -> None:
        """Draw a few bodies for each target; raise a ConfigError if one is out of
        reach.
        """
        target = self._source.target
        for value in target.values if target else ():
            draw_points(
                self._seed,
                np.arange(min(self.samples, 16)),
                self._ranges,
                target,
                value,
            )

    def bodies(self, target: float | Floats, sample: Integers) -> Bodies:
        """Return the bodies of some samples for their targets, in any order."""
        if self._source.target is None and self._source.draw == "random":
            return bodies_at(draw_points(self._seed, sample), self._ranges)
        # Draws for a target are slow, and a sequence is made in order: both go by whole
        # chunks.
        points = np.empty((6, len(sample)))
        chunk, place = np.divmod(sample, CHUNK)
        # NaN, for no target, is unequal to itself, so the cache would never find it.
        value = np.nan_to_num(np.broadcast_to(target, sample.shape))
        for one, number in {*zip(value.tolist(), chunk.tolist(), strict=True)}:
            here = (value == one) & (chunk == number)
            points[:, here] = self._chunk(one, number)[:, place[here]]
        return bodies_at(points, self._ranges)

    def _draw_chunk(self, value: float, number: int) -> Floats:
        first, stop = number * CHUNK, min((number + 1) * CHUNK, self.samples)
        source, ranges = self._source, self._ranges
        if source.draw == "random":
            return draw_points(
                self._seed, np.arange(first, stop), ranges, source.target, value
            )
        group = source.group if source.draw == "saltelli" else 1
        points = sequence_points(len(ranges), self._seed, first, stop, group)
        return np.pad(points, ((0, 6 - len(points)), (0, 0)))


def ranges_of(source: SdSource) -> Floats:
    """Return the ranges of the parameters, of the shape (5, 2), or (6, 2) with
    ``c``.
    """
    return np.array([*dict(source.ranges).values(), *([source.c] if source.c else [])])


def _shell_parameters(u, ranges):
    """Return ``gamma, f_sd, theta, phi, xi`` at a point ``u`` of the unit cube, or at
    many.
    """
    gamma = ranges[0, 0] + (ranges[0, 1] - ranges[0, 0]) * u[0]
    f_sd = ranges[1, 0] + (ranges[1, 1] - ranges[1, 0]) * u[1]
    theta = ranges[2, 0] + (ranges[2, 1] - ranges[2, 0]) * u[2]
    phi = ranges[3, 0] + (ranges[3, 1] - ranges[3, 0]) * u[3]
    # Drawn from (low, high], so the skew angle is never zero.
    xi = -np.radians(ranges[4, 1] - (ranges[4, 1] - ranges[4, 0]) * u[4])
    return gamma, f_sd, theta, phi, xi


def bodies_at(points: Floats, ranges: Floats) -> Bodies:
    """Return bodies at points of the unit cube, one row for each of `ranges` or
    more.
    """
    gamma, f_sd, theta, phi, xi = cast("Any", _shell_parameters)(points, ranges)
    c = (
        None
        if len(ranges) < 6
        else ranges[5, 0] + (ranges[5, 1] - ranges[5, 0]) * points[5]
    )
    return Bodies(*shell_dumbbell(gamma, f_sd), gamma, theta, phi, xi, f_sd, c)


def sequence_points(
    dimensions: int, seed: int, first: int, stop: int, group: int = 1
) -> Floats:
    """Return points `first` to `stop` of a Sobol' sequence, or of Saltelli's groups of
    points.
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
        one, other = np.split(pairs[:, number - number[0]], 2)
        swapped = (place == 1) | (place == 2 + np.arange(dimensions)[:, None])
        return np.where(swapped, other, one)
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
    """Return a random point for each sample, at which the body meets the target's
    `value`.
    """
    points = np.full((6, samples.size), np.nan)
    word, aim = 0, (0, 0.0, 0.0, 1)  # without a target, the first draw is taken
    if target is not None:
        # The 64 bits of the value, with the sign bit set for K_p.
        word = int(np.float64(-value if target.name == "K_p" else value).view(np.int64))
        aim = (
            1 if target.name == "K_p" else 2,
            float(value),
            target.rel_tol,
            target.max_draws,
        )
    # These arrays have the types that the sampler is compiled for.
    within = np.array(
        np.zeros((5, 2)) if ranges is None else ranges, dtype=float, order="C"
    )
    settings = (seed, np.array(samples, dtype=np.int64), word, within, *aim, points)
    draw = load_kernels((sampler,))[0]
    if target is None:
        draw(0, samples.size, Control().flag, *settings)
        return points

    def part(first: int, last: int, control: Control) -> None:
        draw(first, last, control.flag, *settings)

    threads = available_threads()
    edges = np.linspace(0, samples.size, threads + 1).astype(int).tolist()
    # Python's threads, as Numba's pool aborts the process if another kernel runs
    # meanwhile; and the main thread stays free to notice Ctrl-C.
    side_by_side([partial(part, *ends) for ends in pairwise(edges)], threads)
    if (unmet := np.isnan(points[0])).any():
        raise ConfigError(
            f"bodies.target.{target.name}: {value:g} was not met to "
            f"{target.rel_tol:g} in {target.max_draws} draws of sample "
            f"{samples[np.argmax(unmet)]}; choose another target, wider ranges, a "
            "larger rel_tol or more max_draws"
        )
    return points


def sampler() -> Kernel:
    """Return the sampler as a kernel to compile."""
    flag, whole = Control().flag, np.zeros(0, dtype=np.int64)
    like = (0, 0, flag, 0, whole, 0, np.zeros((5, 2)), 0, 0.0, 0.0, 0, np.zeros((6, 0)))
    return Kernel(_draw, like, {"nogil": True}, (__file__,))


# Formulas for arrays, here compiled for scalars too.
_shell_dumbbell = njit(nogil=True)(body.shell_dumbbell)
register_jitable(nogil=True)(theory.hessian)
_torque_coefficients = njit(nogil=True)(theory.torque_coefficients)
_drawn_parameters = njit(nogil=True)(_shell_parameters)

_M0, _M1 = np.uint64(0xD2E7470EE14C6C93), np.uint64(0xCA5A826395121157)
_W0, _W1 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBB67AE8584CAA73B)
_LOW, _HALF, _SHIFT = np.uint64(0xFFFFFFFF), np.uint64(32), np.uint64(11)
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
    """Fill in points, NaN if none meets the target; `which`: 0 no target, 1 K_p, 2
    K_r.
    """
    for i in range(first, last):
        if stop[0]:
            return
        for k in range(max_draws):
            u = uniforms(seed, word, samples[i], k)
            if which > 0:
                gamma, f_sd, theta, phi, xi = _drawn_parameters(u, ranges)
                alpha, beta = _shell_dumbbell(gamma, f_sd)
                coefficients = _torque_coefficients(alpha, beta, theta, phi, xi)
                if abs(coefficients[1 + which] - target) > rel_tol * target:
                    continue
            for row in range(len(points)):
                points[row, i] = u[row]
            break


@njit(nogil=True)
def uniforms(seed, word, sample, draw):
    """Return eight numbers in [0, 1)."""
    s, w, k = np.uint64(seed), np.uint64(word), np.uint64(sample)
    # NumPy increments its counter before using it.
    first = np.uint64(2) * np.uint64(draw) + np.uint64(1)
    return _philox(s, w, first, k) + _philox(s, w, first + np.uint64(1), k)


@njit(nogil=True)
def _philox(key0, key1, c0, c1):
    """Return four multiples of 2^-53 in [0, 1) for a key and a counter of 64-bit
    words.
    """
    c2 = c3 = np.uint64(0)
    for _ in range(10):
        high0, low0 = _multiply(_M0, c0)
        high1, low1 = _multiply(_M1, c2)
        c0, c1, c2, c3 = high1 ^ c1 ^ key0, low1, high0 ^ c3 ^ key1, low0
        key0 += _W0
        key1 += _W1
    return (
        float(c0 >> _SHIFT) * _UNIT,
        float(c1 >> _SHIFT) * _UNIT,
        float(c2 >> _SHIFT) * _UNIT,
        float(c3 >> _SHIFT) * _UNIT,
    )


@njit(nogil=True)
def _multiply(a, b):
    """Return the high and the low word of the product of two 64-bit words."""
    a_high, a_low = a >> _HALF, a & _LOW
    b_high, b_low = b >> _HALF, b & _LOW
    low = a_low * b_low
    middle = a_high * b_low + (low >> _HALF)
    cross = a_low * b_high + (middle & _LOW)
    return a_high * b_high + (middle >> _HALF) + (cross >> _HALF), a * b
