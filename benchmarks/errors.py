"""Calibration of the errors that a second, looser integration estimates.

    python benchmarks/errors.py [--quick]      # share covered, overestimate, extra time
    python benchmarks/errors.py --fit          # constants, after a change of the kernel
    python benchmarks/errors.py --promise      # accuracy: {t_r: 1e-6}
    python benchmarks/errors.py --worst 40     # the worst runs of quickstart, 32 digits
    python benchmarks/errors.py --mix sliding --seed 7  # with friction, further bodies
    python benchmarks/errors.py --mix sliding --fit     # its constants
    python benchmarks/errors.py --friction --seed 7     # all mixes with friction
    python benchmarks/errors.py --wide --seed 2         # any legal body in any position

The estimate and its constants are those of the package (rattlesweep/work/error*.py);
docs/accuracy.md describes the runs with large errors, which it has to mark.

The truth is verner98 at 1e-14; where dop853 at 1e-13 differs by more than 1e-9, the
difference is added to the error. ``--exact 20`` takes the 20 runs of each mix with the
largest difference in 32 digits instead (double_double.py, some seconds each).
"""

from __future__ import annotations

import itertools
import sys
import tempfile
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import double_double
import numpy as np
import pandas as pd
from machine import ROOT, all_runs, heading, in_turns, plan_of

from rattlesweep.arrays import take
from rattlesweep.config.read import parse_config
from rattlesweep.config.schema import Integrator
from rattlesweep.design.models import model_of
from rattlesweep.design.plan import make_plan
from rattlesweep.kernel.batch import integrate
from rattlesweep.kernel.method.tableau import METHODS
from rattlesweep.kernel.outcome import Estimated
from rattlesweep.kernel.state.status import Status
from rattlesweep.rows.types import classify, sure_types
from rattlesweep.work import error, error_fit
from rattlesweep.work.block import run_batch

sys.path.insert(0, str(ROOT / "tests" / "helpers"))
import samples

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from rattlesweep.arrays import Flags, Floats
    from rattlesweep.config.schema import Config
    from rattlesweep.kernel.outcome import Batch, Outcome
    from rattlesweep.motion.model import Model

    Codes = NDArray[np.int8]

# Config and samples of each case, by the name of the mix; for launches that mostly
# swing, their number and the seed of their bodies.
MIXES = {
    "sd": ("tradeoff.yaml", 60),
    "quickstart": ("quickstart.yaml", 400),
    "steady": ("steady.yaml", 40),
    "unsteady": ("unsteady.yaml", 40),
}
SWINGING = "swinging"
SWINGING_RUNS = 1600
SWINGING_SEED = 2
# Surface, dissipation and samples of mixes with friction, in both directions.
PIVOT = {"pivot": [5e-4, 2e-3], "creep": [0]}
MU = {"mu": [0.1, 0.3, 1.0]}
ROLLING = {"rolling": [1e-5, 1e-4]}
ELLIPSOID = {"c": [1.0, 3.0]}
FRICTION: dict[str, tuple[dict[str, Any], dict[str, list[float]], int]] = {
    "pivoting": ({}, PIVOT, 90),
    "sliding": ({}, MU, 54),
    "pivoting-sliding": ({}, MU | PIVOT, 27),
    "rolling-pivoting": ({}, ROLLING | PIVOT, 45),
    "rolling-sliding": ({}, ROLLING | MU, 27),
    "rolling-pivoting-sliding": ({}, ROLLING | MU | PIVOT, 14),
    "ellipsoid-pivoting": (ELLIPSOID, PIVOT, 110),
    "ellipsoid-sliding": (ELLIPSOID, MU, 54),
    "ellipsoid-pivoting-sliding": (ELLIPSOID, MU | PIVOT, 27),
    "ellipsoid-rolling-pivoting": (ELLIPSOID, ROLLING | PIVOT, 55),
    "ellipsoid-rolling-sliding": (ELLIPSOID, ROLLING | MU, 27),
    "ellipsoid-rolling-pivoting-sliding": (ELLIPSOID, ROLLING | MU | PIVOT, 14),
}
# Of the reduced model, pushed between the modes.
SIGMA = {"sigma": [0.0, 5e-4, 2e-3]}
REDUCED: dict[str, tuple[dict[str, list[float]], int]] = {
    "reduced-damped": ({"sigma": [5e-4, 2e-3]}, 90),
    "reduced-rolling": ({"sigma": [0.0, 2e-3], "rolling": [1e-5, 1e-4]}, 45),
    "reduced-pivoting": (SIGMA | PIVOT | {"creep": [0.0, 0.3]}, 15),
}
FRICTION_SEED = 21  # of the calibration of slides; --seed takes others
# Friction and number of launches of mixes of wide bodies (`samples.wide_launches`), on
# paraboloids; each is there on ellipsoids too.  The constants were fitted to seed 1.
WIDE_OF_PARABOLOIDS: dict[str, tuple[tuple[str, ...], int]] = {
    "wide": ((), 3000),
    "wide-viscous": (("sigma",), 3000),
    "wide-rolling": (("sigma", "rolling"), 3000),
    "wide-pivoting": (("sigma", "pivot"), 3000),
    "wide-rolling-pivoting": (("sigma", "rolling", "pivot"), 3000),
    "wide-creep": (("sigma", "pivot", "creep"), 1005),
    "wide-sliding": (("sigma", "mu"), 2000),
    "wide-pivoting-sliding": (("sigma", "mu", "pivot", "creep"), 2000),
}
WIDE: dict[str, tuple[str, tuple[str, ...], int]] = {}
for _name, (_losses, _size) in WIDE_OF_PARABOLOIDS.items():
    WIDE[_name] = "paraboloid", _losses, _size
    WIDE[f"ellipsoid-{_name}"] = "ellipsoid", _losses, _size
WIDE_HORIZON = 600.0
# Errors with creep are refused, and counted with the constants of pivoting.
for _surface in ("paraboloid", "ellipsoid"):
    error_fit.MOTION_FITS[_surface, "pivoting_creep"] = error_fit.MOTION_FITS[
        _surface, "pivoting"
    ]
SETTINGS = (
    ("dop853", 1e-5),
    ("dop853", 1e-6),
    ("dop853", 1e-9),
    ("dop853", 1e-12),
    ("verner98", 1e-9),
    ("verner98", 1e-12),
    ("rk4", 0.02),
)
# Constants that --fit tries, without friction and with it.
TRIED: dict[str, tuple[float, ...]] = {
    "floor": (0.3, 0.5, 0.7),
    "near": (5.0, 10.0, 15.0),
    "slope": (8.0, 10.5, 12.0),
    "share": (0.0005, 0.0007, 0.001),
}
TRIED_WITH_FRICTION: dict[str, tuple[float, ...]] = {
    "looser": (30.0, 100.0, 300.0),
    "slides": (0.0, 3e-12, 5e-12),
    "swings": (2.0,),
    "power": (0.3, 0.5, 0.65, 0.8, 0.9, 1.0),
    "near": (0.0, 5.0),
    "floor": (0.3, 0.5, 1.0, 2.0, 5.0),
    "slope": (4.0, 6.0, 9.0, 12.0, 20.0),
    "share": (0.0007, 0.0015, 0.003),
}
# Of runs that tell the truth.  With rolling resistance, a body that comes to rest takes
# ever shorter steps at the tightest tolerances.
MOST_STEPS = 200_000
LEAST_DOUBT = 1e-9  # smallest difference of the two methods that counts as a doubt
WANTED = 0.9953  # share of errors to be covered in every mix
WANTED_WITH_FRICTION = 0.9965  # each mix has constants of its own
LOOSEST_FITTED = 1e-6  # largest tolerance for which they are fitted


def integrate_at(
    batch: Batch, model: Model, method: str, value: float, **options: Any
) -> Outcome:
    """Integrate with a tolerance or a step."""
    tableau = METHODS[method]
    options["tol" if tableau.adaptive else "dt"] = value
    return integrate(batch, tableau, model, threads=1, **options)


def codes_of(outcome: Outcome, config: Config) -> Codes:
    """Return types as numbers."""
    is_ok = outcome.status == Status.OK
    observed = outcome.t_r, outcome.amp_growth, outcome.n_departure
    return classify(is_ok, *observed, config.classify)


@dataclass
class Mix:
    """Runs of a config with their true reversal times, NaN without a reversal."""

    name: str
    batch: Batch
    config: Config
    keys: NDArray[np.int64]  # case and sample
    true: Floats
    doubt: Floats  # relative uncertainty of the truth
    true_codes: Codes

    def is_known(self, t_r: Floats) -> Flags:
        """Return whether the truth is certain enough to judge these times.

        In the mixes of wide bodies, some of which are chaotic, a run is left out where
        two methods differ by more than a tenth of its error.  In the others the
        difference is added to the error.
        """
        if self.name not in WIDE:
            return np.ones(len(t_r), dtype=bool)
        difference = np.nan_to_num(np.abs(t_r / self.true - 1.0))
        return self.doubt <= np.maximum(LEAST_DOUBT, 0.1 * difference)

    @property
    def model(self) -> Model:
        return model_of(self.config)

    def off(self, t_r: Floats) -> Floats:
        """Return relative errors; 1 where a run should not have reversed."""
        errors = np.abs(t_r / self.true - 1.0) + self.doubt
        errors[np.isfinite(t_r) & ~np.isfinite(self.true)] = 1.0
        return errors


def draw(name: str, share: float, seed: int) -> tuple[Batch, Config, NDArray[np.int64]]:
    """Return the runs of a mix that have a horizon, with their keys."""
    if name == SWINGING:
        plan = _swinging_plan(int(SWINGING_RUNS * share))
    elif name in FRICTION:
        plan = _friction_plan(name, share, seed)
    elif name in REDUCED:
        plan = _reduced_plan(name, share, seed)
    elif name in WIDE:
        plan = _wide_plan(name, share, seed)
    else:
        config, count = MIXES[name]
        plan = plan_of(config, f"bodies.samples={int(count * share)}")
    launches, batch = all_runs(plan)
    good = np.isfinite(batch.t_end) & (batch.t_end > 0)
    keys = np.stack([launches.case, launches.sample], axis=1)[good]
    return take(batch, good), plan.config, keys


def _swinging_plan(size: int) -> Any:
    table = samples.swinging_launches(size, SWINGING_SEED)
    return _plan_of_table(table, horizon={"t_rgh": 5, "t": 3000})


def _wide_plan(name: str, share: float, seed: int) -> Any:
    surface, losses, count = WIDE[name]
    size = int(count * share)
    table = samples.wide_launches(size, seed, losses, surface == "ellipsoid")
    table["t_end"] = np.full(size, WIDE_HORIZON)
    return _plan_of_table(table, surface)


def _plan_of_table(
    table: dict[str, Floats], surface: str = "paraboloid", **keys: Any
) -> Any:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bodies.csv"
        pd.DataFrame(table).to_csv(path, index=False)
        bodies = {"source": "table", "path": str(path), "surface": surface}
        return make_plan(parse_config({"bodies": bodies} | keys))


def _friction_plan(name: str, share: float, seed: int) -> Any:
    surface, losses, count = FRICTION[name]
    config = {
        "seed": seed,
        "bodies": {"source": "sd", "samples": int(count * share)} | surface,
        "dissipation": losses,
        "spin": {"n_i": [0.1, 0.3, 0.5, -0.1, -0.3], "omega_xy0": [0.01, 0.1]},
        "horizon": {"t_rgh": 5, "t": 2000},
    }
    return make_plan(parse_config(config))


def _reduced_plan(name: str, share: float, seed: int) -> Any:
    losses, count = REDUCED[name]
    spin = {"n_i": [0.1, 0.3, 0.5, -0.1, -0.3], "omega_xy0": [0.01, 0.1], "psi": 20}
    config = {
        "seed": seed,
        "model": "reduced",
        "bodies": {"source": "sd", "samples": int(count * share)},
        "dissipation": losses,
        "spin": spin,
        "horizon": {"t_rgh": 5, "t": 2000},
    }
    return make_plan(parse_config(config))


def prepare(name: str, share: float, most_exact: int, seed: int = FRICTION_SEED) -> Mix:
    """Return a mix with true times, of the least certain runs in 32 digits."""
    batch, config, keys = draw(name, share, seed)
    model = model_of(config)
    best = integrate_at(batch, model, "verner98", 1e-14, max_steps=MOST_STEPS)
    second = integrate_at(batch, model, "dop853", 1e-13, max_steps=MOST_STEPS)
    known = (best.status == Status.OK) & (second.status == Status.OK)
    if not known.all():
        click.echo(f"{name}: {(~known).sum()} runs without a true time are left out")
        batch, best, second = (take(each, known) for each in (batch, best, second))
        keys = keys[known]
    difference = np.abs(second.t_r / best.t_r - 1.0)
    difference[np.isfinite(best.t_r) != np.isfinite(second.t_r)] = 1.0
    doubt = np.where(difference > LEAST_DOUBT, difference, 0.0)
    true = best.t_r.copy()
    least_certain = np.argsort(-doubt)[:most_exact]
    least_certain = least_certain[doubt[least_certain] > 0]
    if len(least_certain):
        known = np.nan_to_num(true[least_certain], nan=np.inf)
        horizon = np.minimum(batch.t_end[least_certain], 1.3 * known)
        few = take(batch, least_certain)
        true[least_certain] = double_double.reversal_times(few, horizon)
        doubt[least_certain] = 0.0
    return Mix(name, batch, config, keys, true, doubt, codes_of(best, config))


@dataclass
class Pair:
    """A mix integrated with a setting and with that of its companions."""

    mix: Mix
    method: str
    value: float
    companions_by_setting: dict[float, Outcome] = field(default_factory=dict)

    @cached_property
    def config(self) -> Config:
        """The config of the mix with the setting."""
        name = "tol" if METHODS[self.method].adaptive else "dt"
        setting = {"method": self.method, name: self.value}
        integrator = Integrator.model_validate(setting)
        return self.mix.config.model_copy(update={"integrator": integrator})

    @property
    def companion_setting(self) -> float:
        return error.companion_setting(self.config, self.value)

    def integrate_runs(self) -> Outcome:
        mix = self.mix
        return integrate_at(mix.batch, mix.model, self.method, self.value)

    def integrate_companions(self) -> Outcome:
        mix = self.mix
        longest = error.longest_companion_steps(mix.batch, mix.model)
        setting = self.companion_setting
        return integrate_at(
            mix.batch, mix.model, self.method, setting, longest_step=longest
        )

    @cached_property
    def runs(self) -> Outcome:
        return self.integrate_runs()

    @property
    def companions(self) -> Outcome:
        setting = self.companion_setting
        if setting not in self.companions_by_setting:
            self.companions_by_setting[setting] = self.integrate_companions()
        return self.companions_by_setting[setting]

    @property
    def estimated(self) -> Estimated:
        """The runs with their estimated errors, as in the rows of a sweep."""
        settings = error.Settings(self.value, self.companion_setting)
        batch = self.mix.batch
        return error.with_errors(
            self.config, batch, self.runs, self.companions, settings
        )

    def errors(self) -> tuple[Floats, Floats]:
        """Return true and estimated relative errors of the runs that reverse."""
        t_r = self.runs.t_r
        judged = np.isfinite(t_r) & self.mix.is_known(t_r)
        estimates = self.estimated.t_r_error / t_r
        return self.mix.off(t_r)[judged], estimates[judged]

    def price(self) -> float:
        """Return the time of the companions over that of the runs."""
        calls = {"runs": self.integrate_runs, "companions": self.integrate_companions}
        seconds = in_turns(calls, 1)
        return seconds["companions"] / seconds["runs"]

    def is_sure(self) -> Flags:
        """Return whether types are sure, as in the rows of a sweep."""
        estimated = self.estimated
        return sure_types(
            codes_of(estimated, self.mix.config),
            estimated.reversal_sure,
            (estimated.amp_growth, estimated.n_departure),
            (estimated.amp_growth_error, estimated.n_departure_error),
            self.mix.config.classify,
        )


def judge(errors: Floats, estimates: Floats) -> tuple[float, float]:
    """Return the share of errors that are covered, and the median overestimate."""
    over = estimates / np.maximum(errors, 1e-16)
    return float((errors <= estimates).mean()), float(np.median(over))


HEAD = (
    f"{'mix':30}{'setting':16}{'runs':>6}{'covered':>9}{'over':>7}{'worst':>9}"
    f"{'price':>7}"
    f"{'error 50%':>11}{'99%':>9}{'off 1e-6':>9}{'marked':>8}{'unseen':>7}"
    f"{'types off':>10}{'unsure':>7}{'unseen':>7}"
)


def row(pair: Pair) -> str:
    """Return a line of the table."""
    errors, estimates = pair.errors()
    covered, over = judge(errors, estimates)
    is_off = errors > 1e-6
    is_marked = estimates > 1e-6
    is_sure = pair.is_sure()
    is_wrong = codes_of(pair.runs, pair.mix.config) != pair.mix.true_codes
    median, p99 = np.quantile(errors, [0.5, 0.99], method="inverted_cdf")
    setting = f"{pair.method} {pair.value:.0e}"
    return (
        f"{pair.mix.name:30}{setting:16}{len(errors):6}{100 * covered:8.2f}%"
        f"{over:7.1f}{np.max(errors / estimates):9.3g}{100 * pair.price():6.0f}%"
        f"{median:11.1e}{p99:9.1e}"
        f"{is_off.sum():9}{is_marked.sum():8}{(is_off & ~is_marked).sum():7}"
        f"{is_wrong.sum():10}{(~is_sure).sum():7}{(is_wrong & is_sure).sum():7}"
    )


def refit(pairs: list[Pair]) -> None:
    """Print the constants of least overestimate that cover the wanted share."""
    tried = TRIED
    wanted = WANTED
    config = pairs[0].mix.config
    with_friction = bool(config.dissipation)
    if with_friction:
        tried = TRIED_WITH_FRICTION
        wanted = WANTED_WITH_FRICTION
        pairs = [pair for pair in pairs if pair.value <= LOOSEST_FITTED]
    trials = []
    for values in itertools.product(*tried.values()):
        fit = error_fit.ErrorFit(**dict(zip(tried, values, strict=True)))
        if with_friction:
            error_fit.MOTION_FITS[error_fit.fitted_motion(config)] = fit
        else:
            error_fit.FITS["dop853"] = fit
        judged = [judge(*pair.errors()) for pair in pairs]
        least_covered = min(covered for covered, _ in judged)
        most_over = max(over for _, over in judged)
        trials.append((least_covered, most_over, fit))
    good = [trial for trial in trials if trial[0] >= wanted]
    best = sorted(good, key=lambda trial: trial[1]) or sorted(trials, reverse=True)
    for least_covered, most_over, fit in best[:5]:
        click.echo(f"covered {least_covered:.2%}, at most {most_over:.1f} times: {fit}")


def promised(mix: Mix, goal: float) -> None:
    """Print the errors with accuracy: {t_r: ...}, and the time that it takes."""
    integrator = Integrator.model_validate({"accuracy": {"t_r": goal}})
    change = {"integrator": integrator, "record": ["error"]}
    config = mix.config.model_copy(update=change)
    outcome = run_batch(config, mix.batch, threads=1)
    assert isinstance(outcome, Estimated)
    reverses = np.isfinite(outcome.t_r)
    is_off = reverses & (mix.off(outcome.t_r) > goal)
    is_marked = outcome.t_r_error > goal * outcome.t_r
    unseen = is_off & ~is_marked
    levels, counts = np.unique(outcome.tol, return_counts=True)
    by_level = [f"{n} at {tol:.0e}" for tol, n in zip(levels, counts, strict=True)]
    failed = [Status(code).label for code in outcome.status if code != Status.OK]
    click.echo(
        f"{mix.name}, {goal:g}: {len(reverses)} runs, {reverses.sum()} reverse; "
        f"{', '.join(reversed(by_level))}\noff by more than {goal:g} {is_off.sum()}, "
        f"marked {(reverses & is_marked).sum()}, off and not marked {unseen.sum()}; "
        f"no reversal by mistake {(np.isfinite(mix.true) & ~reverses).sum()}; "
        f"failed: {', '.join(failed) or 'none'}"
    )
    for k in np.flatnonzero(unseen):
        estimate = outcome.t_r_error[k] / outcome.t_r[k]
        off = mix.off(outcome.t_r)[k]
        click.echo(f"  case, sample {mix.keys[k]}: off {off:.1e}, told {estimate:.1e}")
    seconds = in_turns(
        {
            "without": lambda: run_batch(mix.config, mix.batch, threads=1),
            "with": lambda: run_batch(config, mix.batch, threads=1),
        },
        1,
    )
    ratio = seconds["with"] / seconds["without"]
    click.echo(f"{ratio:.3f} of the time of the config as it is")


def worst(count: int, share: float) -> None:
    """Print the worst runs of quickstart at the default tolerance, one by one."""
    pair = Pair(prepare("quickstart", share, count), "dop853", 1e-9)
    mix = pair.mix
    runs = pair.estimated
    missed = np.isfinite(mix.true) & ~np.isfinite(runs.t_r)
    errors = np.where(missed, 1.0, mix.off(runs.t_r))
    click.echo("case, sample           true      looser        1e-9    error     told")
    for k in np.argsort(-np.nan_to_num(errors))[:count]:
        click.echo(
            f"{mix.keys[k]!s:12}{mix.true[k]:15.6f}{runs.companion_t_r[k]:12.3f}"
            f"{runs.t_r[k]:12.3f}{errors[k]:9.1e}{runs.t_r_error[k] / runs.t_r[k]:9.1e}"
        )


@click.command()
@click.option("--quick", is_flag=True, help="A twentieth of the runs.")
@click.option("--fit", is_flag=True, help="Find the constants again.")
@click.option("--promise", is_flag=True, help="Measure accuracy: {t_r: ...}.")
@click.option(
    "--goal",
    "goals",
    multiple=True,
    default=[1e-6],
    show_default=True,
    help="The promised errors.",
)
@click.option("--exact", "most", default=0, help="Runs of each mix in 32 digits.")
@click.option("--worst", "count", default=0, help="Print the worst of quickstart.")
@click.option(
    "--seed",
    default=FRICTION_SEED,
    show_default=True,
    help="Draw other bodies in the mixes with friction, and wide ones.",
)
@click.option(
    "--mix",
    "names",
    multiple=True,
    type=click.Choice([*MIXES, SWINGING, *FRICTION, *REDUCED, *WIDE]),
    help="Only these.",
)
@click.option("--friction", "is_rubbed", is_flag=True, help="All mixes with friction.")
@click.option("--wide", "is_wide", is_flag=True, help="All mixes of wide bodies.")
def main(
    quick: bool,
    fit: bool,
    promise: bool,
    goals: tuple[float, ...],
    most: int,
    count: int,
    seed: int,
    names: tuple[str, ...],
    is_rubbed: bool,
    is_wide: bool,
) -> None:
    """Print how well the estimated errors of reversal times match the true ones."""
    click.echo(heading())
    share = 0.05 if quick else 1.0
    chosen = names or (*MIXES, SWINGING)
    if is_rubbed:
        chosen = tuple(FRICTION)
    if is_wide:
        chosen = tuple(WIDE)
    if promise:
        for name in chosen:
            mix = prepare(name, share, 0, seed)
            for goal in goals:
                promised(mix, goal)
        return
    if count:
        worst(count, share)
        return
    click.echo(HEAD)
    pairs = []
    for name in chosen:
        mix = prepare(name, share, most, seed)
        # The fixed steps of the last method cannot follow slides.
        is_smooth = name in MIXES or name == SWINGING
        most = None if is_smooth and not fit else 4
        for method, value in SETTINGS[:most]:
            pairs.append(Pair(mix, method, value))
            click.echo(row(pairs[-1]))
    if fit:
        refit(pairs)


if __name__ == "__main__":
    main()
