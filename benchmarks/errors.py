"""Calibration of the error that a second, looser integration estimates for every
reversal time.

    python benchmarks/errors.py [--quick]      # the table: share covered, overestimate,
    extra time python benchmarks/errors.py --fit          # the constants again, after a
    change of the kernel python benchmarks/errors.py --promise      # accuracy: {t_r:
    1e-6}: errors and extra time python benchmarks/errors.py --worst 40     # the worst
    runs of quickstart in 32 digits

The estimate and its constants are those of the package (rattlesweep/sweeps/error.py);
docs/accuracy.md describes the runs with large errors, which it has to mark.

The truth is verner98 at 1e-14; where dop853 at 1e-13 differs by more than 1e-9, the
difference is added to the error.  ``--exact 20`` takes the 20 runs of each mix with the
largest difference in 32 digits instead (double_double.py, some seconds each).
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

from rattlesweep.arrays import take
from rattlesweep.integrate.batch import integrate
from rattlesweep.integrate.model import FULL
from rattlesweep.integrate.status import Status
from rattlesweep.integrate.tableau import METHODS
from rattlesweep.sweeps.block import prepare_runs, run_batch
from rattlesweep.sweeps.config.read import load_config
from rattlesweep.sweeps.config.schema import Integrator
from rattlesweep.sweeps.error import (
    FITS,
    Estimated,
    Fit,
    companion_setting,
    with_errors,
)
from rattlesweep.sweeps.plan import make_plan
from rattlesweep.sweeps.types import classify, sure_types

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rattlesweep.integrate.batch import Batch, Outcome
    from rattlesweep.sweeps.config.schema import Config

    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]

CONFIGS = Path(__file__).resolve().parent.parent / "configs"
# Config and samples of each case, by the name of the mix.
MIXES = {
    "sd": ("tradeoff", 60),
    "quickstart": ("quickstart", 400),
    "steady": ("steady", 40),
    "unsteady": ("unsteady", 40),
}
SETTINGS = (
    ("dop853", 1e-6),
    ("dop853", 1e-9),
    ("dop853", 1e-12),
    ("verner98", 1e-9),
    ("verner98", 1e-12),
    ("rk4", 0.02),
)


def run(batch: Batch, method: str, value: float) -> Outcome:
    """Integrate with a tolerance or a step."""
    name = "tol" if METHODS[method].adaptive else "dt"
    return integrate(batch, METHODS[method], FULL, threads=1, **{name: value})


# ----------------------------------------------------------------- calibration


@dataclass
class Mix:
    """Runs of a config with their true reversal times, NaN for runs that do not
    reverse.
    """

    name: str
    batch: Batch
    config: Config
    labels: NDArray[np.int64]
    true: Floats
    doubt: Floats
    true_codes: NDArray[np.int8]


def codes(outcome: Outcome, config: Config) -> NDArray[np.int8]:
    """Types as numbers."""
    ok = outcome.status == Status.OK
    observed = outcome.t_r, outcome.amp_growth, outcome.n_departure
    return classify(ok, *observed, config.classify)


def draw(name: str, share: float) -> tuple[Batch, Config, NDArray[np.int64]]:
    """Return the runs of a mix that have a horizon, with their cases and samples."""
    config, samples = MIXES[name]
    settings = load_config(
        CONFIGS / f"{config}.yaml", [f"bodies.samples={int(samples * share)}"]
    )
    plan = make_plan(settings)
    launches, batch = prepare_runs(plan, *np.divmod(np.arange(plan.runs), plan.samples))
    assert batch is not None
    good = np.isfinite(batch.t_end) & (batch.t_end > 0)
    labels = np.stack([launches.case, launches.sample], axis=1)[good]
    return take(batch, good), settings, labels


def references(batch: Batch) -> tuple[Outcome, Floats]:
    """Return the result of verner98 at 1e-14, and its difference from dop853 at
    1e-13.
    """
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
    """Return a mix with its true times, with 32 digits for the ``most`` least certain
    runs.
    """
    batch, config, labels = draw(name, share)
    best, apart = references(batch)
    true = best.t_r.copy()
    worst = np.argsort(-apart)[:most]
    worst = worst[apart[worst] > 0]
    if len(worst):
        true[worst] = exact(batch, worst, best)
        apart[worst] = 0.0
    return Mix(name, batch, config, labels, true, apart, codes(best, config))


def with_setting(config: Config, method: str, value: float) -> Config:
    """Return the config with a tolerance or a step."""
    name = "tol" if METHODS[method].adaptive else "dt"
    integrator = Integrator.model_validate({"method": method, name: value})
    return config.model_copy(update={"integrator": integrator})


class Pair(NamedTuple):
    """A mix integrated with a setting and with that of its companion."""

    mix: Mix
    method: str
    value: float
    tight: Outcome
    loose: Outcome
    price: float

    @property
    def settings(self) -> tuple[float, float]:
        """Settings of the runs and of their companions."""
        return self.value, companion_setting(self.config, self.value)

    @property
    def config(self) -> Config:
        """Config of the mix with the setting."""
        return with_setting(self.mix.config, self.method, self.value)

    @property
    def error(self) -> Floats:
        """Relative errors of the reversal times; 1 where a run should not have
        reversed.
        """
        found = np.abs(self.tight.t_r / self.mix.true - 1.0) + self.mix.doubt
        found[np.isfinite(self.tight.t_r) & ~np.isfinite(self.mix.true)] = 1.0
        return found

    @property
    def told(self) -> Estimated:
        """Outcome of the runs with their estimated errors, as in the rows of a
        sweep.
        """
        return with_errors(
            self.config, self.mix.batch, self.tight, self.loose, self.settings
        )

    @property
    def estimate(self) -> Floats:
        """The estimate of the relative error."""
        return self.told.t_r_error / self.tight.t_r

    @property
    def sure(self) -> Flags:
        """Whether the types are sure, as in the rows of a sweep."""
        told, config = self.told, self.mix.config
        return sure_types(
            codes(told, config),
            told.reversal_sure,
            (told.amp_growth, told.n_departure),
            (told.amp_growth_error, told.n_departure_error),
            config.classify,
        )

    def judge(self) -> tuple[float, float]:
        """Share of reversing runs that are covered, and the median overestimate."""
        error, estimate = self.error, self.estimate
        some = np.isfinite(self.tight.t_r)
        covered = float((error <= estimate)[some].mean())
        return covered, float(np.median((estimate / np.maximum(error, 1e-16))[some]))


def measure(mix: Mix, method: str, value: float) -> Pair:
    """Do both integrations, and measure the time of the second relative to the
    first.
    """
    run(take(mix.batch, np.arange(3)), method, value)  # loads the kernel
    begin = time.process_time()
    tight = run(mix.batch, method, value)
    middle = time.process_time()
    companion = companion_setting(with_setting(mix.config, method, value), value)
    loose = run(mix.batch, method, companion)
    price = (time.process_time() - middle) / (middle - begin)
    return Pair(mix, method, value, tight, loose, price)


HEAD = (
    f"{'mix':12}{'setting':16}{'runs':>6}{'covered':>9}{'over':>7}{'price':>7}{'error 50%':>11}"
    f"{'99%':>9}{'off 1e-6':>9}{'marked':>8}{'unseen':>7}{'types off':>10}{'unsure':>7}"
    f"{'unseen':>7}"
)


def row(pair: Pair) -> str:
    """A line of the table."""
    covered, over = pair.judge()
    some = np.isfinite(pair.tight.t_r)
    error, estimate = pair.error[some], pair.estimate[some]
    off, marked = error > 1e-6, estimate > 1e-6
    sure = pair.sure
    wrong = codes(pair.tight, pair.mix.config) != pair.mix.true_codes
    middle, most = np.quantile(error, [0.5, 0.99], method="inverted_cdf")
    setting = f"{pair.method} {pair.value:.0e}"
    return (
        f"{pair.mix.name:12}{setting:16}{len(error):6}{100 * covered:8.2f}%"
        f"{over:7.1f}{100 * pair.price:6.0f}%{middle:11.1e}{most:9.1e}{off.sum():9}"
        f"{marked.sum():8}{(off & ~marked).sum():7}{wrong.sum():10}{(~sure).sum():7}"
        f"{(wrong & sure).sum():7}"
    )


def refit(pairs: list[Pair], wanted: float = 0.9953) -> None:
    """Print the constants with the least overestimate that cover the wanted share in
    all mixes.
    """
    found = []
    for values in itertools.product(
        (0.3, 0.5, 0.7, 1, 1.5),
        (5, 10, 15),
        (5, 8, 12, 16),
        (0.0005, 0.0007, 0.001, 0.0015),
    ):
        FITS["dop853"] = Fit(*values)
        judged = [pair.judge() for pair in pairs]
        found.append(
            (min(c for c, _ in judged), max(o for _, o in judged), Fit(*values))
        )
    good = sorted((f for f in found if f[0] >= wanted), key=lambda f: f[1])
    for covered, over, fit in (good or sorted(found, reverse=True))[:5]:
        click.echo(
            f"covered {100 * covered:.2f} %, overestimate {over:.1f} at the worst: {fit}"
        )


def promised(name: str, share: float, goal: float) -> None:
    """Print the errors with accuracy: {t_r: ...} for the runs of a config."""
    mix = prepare(name, share, 0)
    asked = ["integrator={accuracy: {t_r: %g}}" % goal]  # noqa: UP031 - braces
    config = load_config(CONFIGS / f"{MIXES[name][0]}.yaml", asked)
    found = run_batch(config, mix.batch)
    assert isinstance(found, Estimated)
    off = np.abs(found.t_r / mix.true - 1.0)
    off[np.isfinite(found.t_r) & ~np.isfinite(mix.true)] = 1.0
    marked = found.t_r_error > goal * found.t_r
    unseen = (off > goal) & ~marked
    levels, runs = np.unique(found.tol, return_counts=True)
    at = ", ".join(
        f"{n} at {tol:.0e}" for tol, n in zip(levels[::-1], runs[::-1], strict=True)
    )
    click.echo(
        f"{name}: {len(mix.batch)} runs, {np.isfinite(found.t_r).sum()} reverse; {at}"
    )
    none = (np.isfinite(mix.true) & ~np.isfinite(found.t_r)).sum()
    click.echo(
        f"off by more than {goal:g} {(off > goal).sum()}, marked {marked.sum()}, off and not "
        f"marked {unseen.sum()}; without a reversal by mistake {none}"
    )
    for k in np.flatnonzero(unseen):
        click.echo(
            f"  case {mix.labels[k][0]}, sample {mix.labels[k][1]}: off {off[k]:.1e}, "
            f"by its row {found.t_r_error[k] / found.t_r[k]:.1e}"
        )


def price_of_goal(name: str, goal: float, step: int) -> None:
    """Print the time with accuracy: {t_r: ...} relative to the plain config."""
    path = CONFIGS / f"{MIXES[name][0]}.yaml"
    asked = "integrator={accuracy: {t_r: %g}}" % goal  # noqa: UP031 - braces
    plan, config = make_plan(load_config(path)), load_config(path, [asked])
    spent = np.zeros(2)
    keys = np.divmod(np.arange(0, plan.runs, step), plan.samples)
    batch = prepare_runs(plan, *keys)[1]
    assert batch is not None
    for which, settings in enumerate((plan.config, config)):
        begin = time.process_time()
        run_batch(settings, batch, threads=1)
        spent[which] += time.process_time() - begin
    click.echo(
        f"{name}: {len(batch)} runs, {spent[1] / spent[0]:.3f} of the time of the config "
        "as it is"
    )


def worst(count: int) -> None:
    """Print the worst runs of quickstart at the default tolerance, one by one."""
    mix = prepare("quickstart", 1.0, count)
    pair = measure(mix, "dop853", 1e-9)
    error = np.where(
        np.isfinite(mix.true) & ~np.isfinite(pair.tight.t_r), 1.0, pair.error
    )
    estimate = pair.estimate
    click.echo(
        f"{'case':>4}{'sample':>7}{'true':>15}{'looser':>12}{'1e-9':>12}{'error':>9}{'told':>9}"
    )
    for k in np.argsort(-np.nan_to_num(error))[:count]:
        case, sample = mix.labels[k]
        click.echo(
            f"{case:4}{sample:7}{mix.true[k]:15.6f}{pair.loose.t_r[k]:12.3f}"
            f"{pair.tight.t_r[k]:12.3f}{error[k]:9.1e}{estimate[k]:9.1e}"
        )


@click.command()
@click.option("--quick", is_flag=True, help="A fifth of the runs.")
@click.option("--fit", is_flag=True, help="Find the constants again.")
@click.option("--promise", is_flag=True, help="Measure accuracy: {t_r: ...}.")
@click.option(
    "--goal", default=1e-6, show_default=True, help="The error that is promised."
)
@click.option(
    "--exact", "most", type=int, default=0, help="Runs of each mix in 32 digits."
)
@click.option(
    "--worst", "count", type=int, default=0, help="Print the worst runs of quickstart."
)
@click.option(
    "--mix", "names", multiple=True, type=click.Choice(list(MIXES)), help="Only these."
)
def main(
    quick: bool,
    fit: bool,
    promise: bool,
    goal: float,
    most: int,
    count: int,
    names: tuple[str, ...],
) -> None:
    """Print how well the estimated errors of reversal times match the true ones."""
    share = 0.2 if quick else 1.0
    if promise:
        for name in names or MIXES:
            promised(name, share, goal)
        price_of_goal("steady", goal, 5 if quick else 1)
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
