"""The error of every reversal time from a second, looser integration: its calibration.

    python benchmarks/errors.py [--quick]      # the table: share covered, overestimate, price
    python benchmarks/errors.py --fit          # the constants again, after a change of the kernel
    python benchmarks/errors.py --promise      # accuracy: {t_r: 1e-6} on the mix of steady.yaml
    python benchmarks/errors.py --worst 40     # the worst runs of quickstart in 32 digits

A *companion* is the same batch at a tolerance LOOSER times as large.  With d = |t_r'/t_r - 1| and s
the distance of the two states at their reversals, relative to the oscillation,

    t_r_error / t_r = floor tol + slope T (d + share s / sqrt(N)) + G,
    T = max(tol / tol', min(1, (s / PARTED)^2)),   N = n_steps / 1000,

and 1 where the companion does not reverse.  The first term is the common size of the error; the
second carries the difference over to the tighter tolerance, in proportion as long as both runs
stay together (s small), and in full once they have parted.  docs/sensitive.md says when they do.
d alone is small by chance too often; s, which has four components, is not.  G is one swing of the
spin where an extremum touches zero within the tolerance (near_tangencies), else nothing.

The truth is verner98 at 1e-14; where dop853 at 1e-13 is off it by more than 1e-9, this is added
to the error.  ``--exact 20`` takes the 20 runs of each mix with the largest difference in 32 digits
instead (double_double.py, some seconds each).
"""

from __future__ import annotations

import itertools
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click
import double_double
import numpy as np

from rattlesweep.integrate.batch import integrate
from rattlesweep.integrate.model import FULL
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.sweeps.blocks.block import prepare_runs, take
from rattlesweep.sweeps.cases.plan import make_plan
from rattlesweep.sweeps.config.load import load_config
from rattlesweep.sweeps.tables.types import classify

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rattlesweep.integrate.batch import Batch, Outcome
    from rattlesweep.sweeps.config.schema import Classify

    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]

CONFIGS = Path(__file__).resolve().parent.parent / "configs"
# Config, samples of each case, and where to cut the longest runs.
MIXES = {"sd": ("tradeoff", 60), "quickstart": ("quickstart", 400), "steady": ("steady", 40),
         "unsteady": ("unsteady", 40)}  # fmt: skip
SETTINGS = (("dop853", 1e-6), ("dop853", 1e-9), ("dop853", 1e-12), ("verner98", 1e-9),
            ("verner98", 1e-12), ("rk4", 0.02))  # fmt: skip

LOOSER, LOOSEST = 2e3, 1e-5
"""Ratio of the tolerances, and the loosest that a companion gets: beyond, most runs part."""
TIGHTEST = 1e-14
"""Below it the error of a step is rounding."""
PARTED = 0.2
"""Distance at which two runs have nothing to do with each other any more."""
DIFFER = 10.0
"""A type is sure if no observable is nearer to a threshold than so many differences."""


class Fit(NamedTuple):
    """Constants of the estimate."""

    floor: float = 1.5
    slope: float = 8.0
    share: float = 0.0015


FIT = {"dop853": Fit(), "verner98": Fit(floor=0.4), "rk4": Fit(floor=0.0)}
"""By method: how far the error of a step stays below what the control allows differs."""
PROMISED = Fit(1.0, 3.0, 0.001)
"""Less cautious: a limit is kept if the estimate is a few times the error, not thirty."""


def looser(method: str, value: float) -> float:
    """Setting of the companion: a tolerance, or twice the step of a method of fixed step."""
    if not METHODS[method].adaptive:
        return 2.0 * value
    return max(10.0 * value, min(LOOSER * value, LOOSEST))


def run(batch: Batch, method: str, value: float) -> Outcome:
    """Integrate with a tolerance or a step."""
    name = "tol" if METHODS[method].adaptive else "dt"
    return integrate(batch, METHODS[method], FULL, threads=1, **{name: value})


# ----------------------------------------------------------------- what goes into the package


def distance(y: Floats, other: Floats, constants: Floats) -> Floats:
    """Distance of states relative to the oscillation in ``y``, in the norm of the step control."""
    ix, iy, _, cxx, cxy, cyy = constants.T

    def square(v: Floats) -> Floats:
        p, q, a, b = v.T[:4]
        total = (ix + 1) * a * a + (iy + 1) * b * b + cxx * p * p + 2 * cxy * p * q + cyy * q * q
        return np.asarray(total)

    return np.asarray(np.sqrt(square(y - other) / square(y)))


def relative_error(
    batch: Batch, tight: Outcome, loose: Outcome, ratio: float, scale: float, fit: Fit
) -> Floats:
    """Estimate of ``|t_r / true - 1|``, NaN where there is no ``t_r``.

    Parameters
    ----------
    tight, loose : Outcome
        Of the runs and of their companions.
    ratio : float
        Of the errors to be expected: that of the tolerances, or ``2**-order`` for steps.
    scale : float
        The tolerance; 0 for a fixed step, whose errors do not add up at random.
    """
    known = np.isfinite(tight.t_r)
    lost = ~np.isfinite(loose.t_r)
    d = np.where(lost, 1.0, np.abs(loose.t_r / tight.t_r - 1.0))
    s = np.where(lost, 1.0, distance(tight.y_end, loose.y_end, batch.constants))
    carried = np.maximum(ratio, np.minimum(1.0, (s / PARTED) ** 2))
    thousands = tight.n_steps / 1000.0
    grazing = tight.near_tangencies + loose.near_tangencies > 0
    estimate = (
        fit.floor * max(scale, TIGHTEST)
        + fit.slope * carried * (d + fit.share * s / np.sqrt(thousands))
        + np.where(grazing, 2 * np.pi / batch.swing / tight.t_r, 0.0)
    )
    return np.where(known, np.minimum(estimate, 1.0), np.nan)


def type_sure(tight: Outcome, loose: Outcome, codes: tuple[Floats, Floats], error: Floats,
              horizon: Floats, limits: Classify) -> Flags:  # fmt: skip
    """Whether the type survives errors of the size of the differences."""
    reverses = np.isfinite(tight.t_r)
    growth, departure = (np.abs(getattr(tight, name) - getattr(loose, name)) * DIFFER
                         for name in ("amp_growth", "n_departure"))  # fmt: skip
    in_time = tight.t_r * (1.0 + error) < horizon
    # A spin that comes near zero may cross it.
    stays = 1.0 - tight.n_departure > departure
    far = np.abs(tight.amp_growth - limits.ss_growth) > np.minimum(growth, DIFFER)
    far &= (codes[0] == 1) | (np.abs(tight.n_departure - limits.sw_departure) > departure)
    return np.asarray((codes[0] == codes[1]) & (codes[0] >= 0)
                      & np.where(reverses, in_time, stays & far))  # fmt: skip


def promise(
    batch: Batch, wanted: float, fit: Fit = PROMISED
) -> tuple[Floats, Floats, list[int], float]:
    """Reversal times to a relative error ``wanted``: runs that fail are done again, tighter.

    Returns
    -------
    t_r, error : ndarray
    redone : list of int
        Runs at each level.
    tries : float
        Steps tried in all.
    """
    levels = tuple(wanted * 10.0**k for k in (1, -1, -3, -5))
    before = run(batch, "dop853", levels[0])
    now = run(batch, "dop853", levels[1])
    tries = sum(float((o.n_steps + o.n_rejected).sum()) for o in (before, now))
    t_r, error = now.t_r.copy(), relative_error(batch, now, before, 1e-2, levels[1], fit)
    redone: list[int] = []
    # Runs of which only one of the two reverses are not known either.
    failed = np.flatnonzero(~(error <= wanted) & (np.isfinite(now.t_r) | np.isfinite(before.t_r)))
    before = take(now, failed)
    for level in levels[2:]:
        if level < TIGHTEST or not len(failed):
            break
        redone.append(len(failed))
        part = take(batch, failed)
        now = run(part, "dop853", level)
        tries += float((now.n_steps + now.n_rejected).sum())
        t_r[failed] = now.t_r
        error[failed] = relative_error(part, now, before, 1e-2, level, fit)
        again = ~(error[failed] <= wanted) & np.isfinite(now.t_r)
        failed, before = failed[again], take(now, again)
    return t_r, error, redone, tries


# ----------------------------------------------------------------- calibration


@dataclass
class Mix:
    """Runs of a config with their true reversal times, NaN for runs that do not reverse."""

    name: str
    batch: Batch
    limits: Classify
    labels: NDArray[np.int64]
    true: Floats
    doubt: Floats
    true_codes: Floats


def codes(outcome: Outcome, limits: Classify) -> Floats:
    """Types as numbers."""
    ok = outcome.status == Status.OK
    return classify(ok, outcome.t_r, outcome.amp_growth, outcome.n_departure, limits).astype(float)


def draw(name: str, share: float) -> tuple[Batch, Classify, NDArray[np.int64]]:
    """Runs of a mix that have a horizon, with their cases and samples."""
    config, samples = MIXES[name]
    settings = load_config(CONFIGS / f"{config}.yaml", [f"bodies.samples={int(samples * share)}"])
    plan = make_plan(settings)
    launches, batch = prepare_runs(plan, *np.divmod(np.arange(plan.runs), plan.samples))
    assert batch is not None
    good = np.isfinite(batch.t_end) & (batch.t_end > 0)
    labels = np.stack([launches.case, launches.sample], axis=1)[good]
    return take(batch, good), settings.classify, labels


def references(batch: Batch) -> tuple[Outcome, Floats]:
    """verner98 at 1e-14, and how far dop853 at 1e-13 is off it, if by more than rounding."""
    best, other = run(batch, "verner98", 1e-14), run(batch, "dop853", 1e-13)
    apart = np.abs(other.t_r / best.t_r - 1.0)
    apart[np.isfinite(best.t_r) != np.isfinite(other.t_r)] = 1.0
    return best, np.where(apart > 1e-9, apart, 0.0)


def exact(batch: Batch, rows: NDArray[np.int64], best: Outcome) -> Floats:
    """Reversal times of a few runs in 32 digits."""
    known = np.nan_to_num(best.t_r[rows], nan=np.inf)
    return double_double.reversal_times(
        take(batch, rows), np.minimum(batch.t_end[rows], 1.3 * known)
    )


def prepare(name: str, share: float, most: int) -> Mix:
    """A mix with its truth: in 32 digits for the ``most`` runs that are most in doubt."""
    batch, limits, labels = draw(name, share)
    best, apart = references(batch)
    true = best.t_r.copy()
    worst = np.argsort(-apart)[:most]
    worst = worst[apart[worst] > 0]
    if len(worst):
        true[worst] = exact(batch, worst, best)
        apart[worst] = 0.0
    return Mix(name, batch, limits, labels, true, apart, codes(best, limits))


class Pair(NamedTuple):
    """A mix integrated with a setting and with that of its companion."""

    mix: Mix
    method: str
    value: float
    tight: Outcome
    loose: Outcome
    price: float

    @property
    def error(self) -> Floats:
        """Of the reversal times; 1 where a run should not have reversed."""
        found = np.abs(self.tight.t_r / self.mix.true - 1.0) + self.mix.doubt
        found[np.isfinite(self.tight.t_r) & ~np.isfinite(self.mix.true)] = 1.0
        return found

    def estimate(self, fit: Fit | None = None) -> Floats:
        """The estimate that the rows would hold."""
        fit = fit or FIT[self.method]
        tableau = METHODS[self.method]
        companion = looser(self.method, self.value)
        ratio = self.value / companion if tableau.adaptive else 2.0**-tableau.order
        scale = self.value if tableau.adaptive else 0.0
        return relative_error(self.mix.batch, self.tight, self.loose, ratio, scale, fit)

    def judge(self, fit: Fit | None = None) -> tuple[float, float]:
        """Share of reversing runs that are covered, and the median overestimate."""
        error, estimate = self.error, self.estimate(fit)
        some = np.isfinite(self.tight.t_r)
        covered = float((error <= estimate)[some].mean())
        return covered, float(np.median((estimate / np.maximum(error, 1e-16))[some]))


def measure(mix: Mix, method: str, value: float) -> Pair:
    """Both integrations, and what the second costs in terms of the first."""
    run(take(mix.batch, np.arange(3)), method, value)  # loads the kernel
    begin = time.process_time()
    tight = run(mix.batch, method, value)
    middle = time.process_time()
    loose = run(mix.batch, method, looser(method, value))
    price = (time.process_time() - middle) / (middle - begin)
    return Pair(mix, method, value, tight, loose, price)


HEAD = (f"{'mix':12}{'setting':16}{'runs':>6}{'covered':>9}{'over':>7}{'price':>7}{'error 50%':>11}"
        f"{'99%':>9}{'off 1e-6':>9}{'marked':>8}{'unseen':>7}{'types off':>10}{'unsure':>7}"
        f"{'unseen':>7}")  # fmt: skip


def row(pair: Pair) -> str:
    """A line of the table."""
    covered, over = pair.judge()
    some = np.isfinite(pair.tight.t_r)
    error, estimate = pair.error[some], pair.estimate()[some]
    off, marked = error > 1e-6, estimate > 1e-6
    kinds = codes(pair.tight, pair.mix.limits), codes(pair.loose, pair.mix.limits)
    sure = type_sure(pair.tight, pair.loose, kinds, pair.estimate(), pair.mix.batch.t_end,
                     pair.mix.limits)  # fmt: skip
    wrong = kinds[0] != pair.mix.true_codes
    middle, most = np.quantile(error, [0.5, 0.99], method="inverted_cdf")
    setting = f"{pair.method} {pair.value:.0e}"
    return (f"{pair.mix.name:12}{setting:16}{len(error):6}{100 * covered:8.2f}%"
            f"{over:7.1f}{100 * pair.price:6.0f}%{middle:11.1e}{most:9.1e}{off.sum():9}"
            f"{marked.sum():8}{(off & ~marked).sum():7}{wrong.sum():10}{(~sure).sum():7}"
            f"{(wrong & sure).sum():7}")  # fmt: skip


def refit(pairs: list[Pair], wanted: float = 0.9955) -> None:
    """Print the constants of least overestimate that cover the wanted share everywhere."""
    found = []
    for values in itertools.product((0.5, 1, 1.5, 2, 3), (2, 3, 5, 8, 12),
                                    (0.0005, 0.001, 0.002, 0.004)):  # fmt: skip
        judged = [pair.judge(Fit(*values)) for pair in pairs]
        found.append((min(c for c, _ in judged), max(o for _, o in judged), Fit(*values)))
    good = sorted((f for f in found if f[0] >= wanted), key=lambda f: f[1])
    for covered, over, fit in (good or sorted(found, reverse=True))[:5]:
        click.echo(f"covered {100 * covered:.2f} %, overestimate {over:.1f} at the worst: {fit}")


def kept(name: str, share: float, rounds: int) -> None:
    """Print what accuracy: {t_r: 1e-6} keeps and costs."""
    mix = prepare(name, share, 0)
    spent: dict[str, list[float]] = {"plain": [], "promise": []}
    for _ in range(rounds):
        begin = time.process_time()
        plain = run(mix.batch, "dop853", 1e-9)
        middle = time.process_time()
        t_r, error, redone, tries = promise(mix.batch, 1e-6)
        spent["plain"].append(middle - begin)
        spent["promise"].append(time.process_time() - middle)
    off = np.abs(t_r / mix.true - 1.0)
    off[np.isfinite(t_r) & ~np.isfinite(mix.true)] = 1.0
    marked = np.isfinite(t_r) & ~(error <= 1e-6)
    steps = tries / float((plain.n_steps + plain.n_rejected).sum())
    unseen = int(((off > 1e-6) & ~marked).sum())
    seconds = float(np.median(spent["promise"]) / np.median(spent["plain"]))
    click.echo(f"{len(mix.batch)} runs, done again {redone}; marked {marked.sum()}")
    click.echo(f"off by more than 1e-6 {(off > 1e-6).sum()}, of these not marked {unseen}")
    click.echo(f"of dop853 at 1e-9: {steps:.3f} of the steps, {seconds:.3f} of the time")


def worst(count: int) -> None:
    """Print the worst runs of quickstart at the default tolerance, one by one."""
    mix = prepare("quickstart", 1.0, count)
    pair = measure(mix, "dop853", 1e-9)
    error = np.where(np.isfinite(mix.true) & ~np.isfinite(pair.tight.t_r), 1.0, pair.error)
    estimate = pair.estimate()
    click.echo(
        f"{'case':>4}{'sample':>7}{'true':>15}{'looser':>12}{'1e-9':>12}{'error':>9}{'told':>9}"
    )
    for k in np.argsort(-np.nan_to_num(error))[:count]:
        case, sample = mix.labels[k]
        click.echo(f"{case:4}{sample:7}{mix.true[k]:15.6f}{pair.loose.t_r[k]:12.3f}"
                   f"{pair.tight.t_r[k]:12.3f}{error[k]:9.1e}{estimate[k]:9.1e}")  # fmt: skip


@click.command()
@click.option("--quick", is_flag=True, help="A fifth of the runs.")
@click.option("--fit", is_flag=True, help="Find the constants again.")
@click.option("--promise", "promised", is_flag=True, help="Measure accuracy: {t_r: 1e-6}.")
@click.option("--exact", "most", type=int, default=0, help="Runs of each mix in 32 digits.")
@click.option("--worst", "count", type=int, default=0, help="Print the worst runs of quickstart.")
@click.option("--mix", "names", multiple=True, type=click.Choice(list(MIXES)), help="Only these.")
def main(
    quick: bool, fit: bool, promised: bool, most: int, count: int, names: tuple[str, ...]
) -> None:
    """Print how well reversal times know their own error."""
    share = 0.2 if quick else 1.0
    if promised:
        for name in names or ("steady",):
            kept(name, share, 3)
        return
    if count:
        worst(count)
        return
    pairs = []
    click.echo(HEAD)
    for name in names or MIXES:
        mix = prepare(name, share, most)
        for method, value in SETTINGS[: 3 if fit else None]:
            pairs.append(measure(mix, method, value))
            click.echo(row(pairs[-1]))
    if fit:
        refit(pairs)


if __name__ == "__main__":
    main()
